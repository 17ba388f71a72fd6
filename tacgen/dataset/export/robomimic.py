"""Export to robomimic's HDF5: one demonstration a grasp, for imitation learning.

``data/demo_<k>/{obs/<name>, next_obs/<name>, actions, rewards, dones}`` with ``num_samples``:
rewards and dones (T,), the others (T, D), images (T, H, W, 3). ``next_obs`` are views into ``obs``
of the same file, the last frame's its own: they take no room.

The masks ``mask/{train, valid, test}`` list the demonstrations that succeeded, those named
``…_failed`` those that did not: what is imitated should have worked. ``valid`` is a
tenth of the recipe's training side: what is chosen by it is not chosen on the test grasps.

Actions lie in [−1, 1], which robomimic's policies can reach and its ``get_dataset_info`` demands:
``action = 2 (value − action_low) / (action_high − action_low) − 1``, with the bounds as attributes
of ``data``. Source: robomimic's documentation, "Dataset Contents and Structure".
"""

import json
import math
import zlib
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tacgen.core.files import DiskFile
from tacgen.core.records import AXES, LABEL_SUCCESS
from tacgen.core.types import FloatArray
from tacgen.dataset.export import arrays_of, camera_facts
from tacgen.dataset.reader import Dataset
from tacgen.dataset.samples import GraspSample
from tacgen.dataset.schema import Field

FILE = "grasps.hdf5"
VALID_FRACTION = 0.1  # of the training grasps of each outcome, rounded up; never all of them


def write(dataset: Dataset, grasps: pd.DataFrame, folder: Path) -> str:
    """Write each of the chosen grasps as a demonstration into ``grasps.hdf5``.

    The action of every frame is the grasp's configuration, (T, 5): force_n, x_mm, y_mm, z_mm,
    yaw_rad, each scaled from its range over the grasps to [−1, 1]. The reward of the last frame is
    the label.
    """
    configurations = grasps[list(AXES)].to_numpy(np.float64)
    low, high = configurations.min(axis=0), configurations.max(axis=0)
    actions = _scaled(configurations, low, high)
    with DiskFile(folder / FILE) as disk, h5py.File(disk, "w") as file:
        data = file.create_group("data")
        names = np.array([f"demo_{k}" for k in range(len(grasps))], dtype="S")
        for demo_name, index, action in zip(names, grasps["index"], actions, strict=True):
            demo, sample = data.create_group(demo_name.decode()), dataset.read(int(index))
            _write_demo(demo, sample, action)
            for owner, field, values in arrays_of(dataset, sample):
                name = f"camera_{owner}" if field.of == "camera" else owner
                name = f"{name}_{field.name}"
                if field.of == "pad" and not field.is_of_frames:
                    name = f"{field.name}/{owner}"
                _write_array(demo, name, field, values)
            write_next(demo)
            disk.raise_failure()
        data.attrs["total"] = len(grasps) * dataset.n_frames
        for pad in dataset.pads:
            if "markers_mm" in dataset.touch_names:
                data.attrs[f"{pad}_marker_rest_mm"] = dataset.marker_rest_mm(pad)
        for one in dataset.cameras.values():
            data.attrs[f"camera_{one.name}"] = json.dumps(camera_facts(one))
        data.attrs.update({"action_names": list(AXES), "action_low": low, "action_high": high})
        # robomimic builds its environment from these; type 2 is its general (gym) one.
        about = {"env_name": "tacgen", "type": 2, "env_kwargs": {"sensor": dataset.sensor}}
        data.attrs["env_args"] = json.dumps(about)
        split, held = grasps["split"].to_numpy(), grasps["label"].to_numpy() == LABEL_SUCCESS
        for suffix, rows in (("", np.flatnonzero(held)), ("_failed", np.flatnonzero(~held))):
            train = rows[split[rows] == "train"]
            drawn = sorted(
                train, key=lambda row: zlib.crc32(str(grasps["index"].iloc[row]).encode())
            )
            n_valid = min(math.ceil(VALID_FRACTION * len(drawn)), max(len(drawn) - 1, 0))
            valid = np.isin(train, drawn[:n_valid])
            sides = {"train": train[~valid], "valid": train[valid]}
            for mask, those in (sides | {"test": rows[split[rows] == "test"]}).items():
                file.create_dataset(f"mask/{mask}{suffix}", data=names[those])
        file.close()
        disk.raise_failure()
    masks = f"{held.sum()} successes in mask/train, valid and test, {(~held).sum()} failures apart"
    return f"{len(grasps)} demonstrations in robomimic's HDF5 format: {masks}"


def _scaled(values: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Values (N, n) from [low, high] to [−1, 1]; 0 for one that never changes."""
    span = np.where(high > low, high - low, 1.0)
    scaled = np.where(high > low, 2 * (values - low) / span - 1, 0.0)
    return np.asarray(np.clip(scaled, -1.0, 1.0))


def _write_demo(demo: h5py.Group, sample: GraspSample, action: FloatArray) -> None:
    object_pose = np.asarray(sample.object_pose)
    count = len(object_pose)
    rewards, dones = np.zeros(count), np.zeros(count, np.int64)
    rewards[-1], dones[-1] = sample.label, 1
    moment = {"grasp_frame": sample.grasp_frame, "grasp_time_s": sample.grasp_time_s}
    demo.attrs.update({"num_samples": count, "object": sample.config.object, **moment})
    demo["actions"] = np.tile(action, (count, 1))
    demo["rewards"], demo["dones"] = rewards, dones
    demo.create_group("obs")["object_pose"] = object_pose


def _write_array(demo: h5py.Group, name: str, field: Field, values: NDArray[Any]) -> None:
    """An observation, or beside them what is of the moment of grasp and not one a frame."""
    if not field.is_of_frames:
        demo.create_dataset(name, data=values)
        return
    how = {"chunks": (1, *values.shape[1:]), "compression": "gzip"} if field.image else {}
    values = values.reshape(len(values), *(values.shape[1:] or (1,)))
    demo.create_dataset(f"obs/{name}", data=values, **how)


def write_next(demo: h5py.Group) -> None:
    """What is observed a frame later, as views into the demonstration's ``obs``.

    Not by h5py's ``create_virtual_dataset``, which writes the time of creation: two exports of a
    dataset have the same bytes.
    """
    following = demo.create_group("next_obs")
    for name, observed in demo["obs"].items():
        created = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        created.set_obj_track_times(False)
        last = len(observed) - 1
        for shown, source, count in ((0, 1, last), (last, last, 1)):
            if count:
                view, of = (_frames(observed.shape, first, count) for first in (shown, source))
                created.set_virtual(view, b".", observed.name.encode(), of)
        whole = h5py.h5s.create_simple(observed.shape)
        h5py.h5d.create(following.id, name.encode(), observed.id.get_type(), whole, created)


def _frames(shape: tuple[int, ...], first: int, count: int) -> h5py.h5s.SpaceID:
    """The HDF5 selection of ``count`` frames of an array (T, …)."""
    space = h5py.h5s.create_simple(shape)
    space.select_hyperslab((first, *(0 for _ in shape[1:])), (count, *shape[1:]))
    return space

"""Export to robomimic's HDF5: one demonstration a grasp, for imitation learning.

``data/demo_<k>/{obs/<name>, actions, rewards, dones}``, each (T, …), with ``num_samples``; the
masks ``mask/{train, valid}`` list the demonstrations of each split. The layout: robomimic's
documentation, "Dataset Contents and Structure".
"""

import json
from pathlib import Path

import h5py
import numpy as np
import pandas as pd

from tacgen.dataset.export.lerobot import ACTION
from tacgen.dataset.reader import Dataset
from tacgen.dataset.samples import GraspSample
from tacgen.dataset.schema import FRAME_FIELDS

FILE = "grasps.hdf5"
MASKS = {"train": "train", "valid": "test"}  # robomimic's name of each split of the recipe


def write(dataset: Dataset, grasps: pd.DataFrame, folder: Path) -> str:
    """Write each of the chosen grasps as a demonstration into ``grasps.hdf5``.

    The action of every frame is the grasp's configuration, (T, 5): force_n, x_mm, y_mm, z_mm,
    yaw_rad. The reward of the last frame is the label.
    """
    with h5py.File(folder / FILE, "w") as file:
        data = file.create_group("data")
        names = [f"demo_{k}" for k in range(len(grasps))]
        for name, index in zip(names, grasps["index"], strict=True):
            _write_demo(data.create_group(name), dataset.read(int(index)))
        data.attrs["total"] = len(grasps) * dataset.n_frames
        # robomimic builds its environment from these; type 2 is its general (gym) one.
        about = {"env_name": "tacgen", "type": 2, "env_kwargs": {"sensor": dataset.sensor}}
        data.attrs["env_args"] = json.dumps(about)
        split = grasps["split"].to_numpy()
        for mask, of in MASKS.items():
            chosen = [name for name, here in zip(names, split, strict=True) if here == of]
            file.create_dataset(f"mask/{mask}", data=np.array(chosen, dtype="S"))
    return f"{len(grasps)} demonstrations in robomimic's HDF5 format"


def _write_demo(demo: h5py.Group, sample: GraspSample) -> None:
    object_pose = np.asarray(sample.object_pose)
    count = len(object_pose)
    configuration = [getattr(sample.config, name) for name in ACTION]
    rewards, dones = np.zeros(count), np.zeros(count, np.int64)
    rewards[-1], dones[-1] = sample.label, 1
    moment = {"grasp_frame": sample.grasp_frame, "grasp_time_s": sample.grasp_time_s}
    demo.attrs.update({"num_samples": count, "object": sample.config.object, **moment})
    demo["actions"] = np.tile(np.array(configuration), (count, 1))
    demo["rewards"], demo["dones"] = rewards, dones
    observed = demo.create_group("obs")
    observed["object_pose"] = object_pose
    for pad, frames in sample.pads.items():
        options = {"chunks": (1, *frames.rgb.shape[1:]), "compression": "gzip"}
        observed.create_dataset(f"{pad}_rgb", data=frames.rgb, **options)
        for field in FRAME_FIELDS:
            observed[f"{pad}_{field.name}"] = field.value(frames)
        if frames.depth_mm is not None:
            # Of the moment of grasp: not one a frame, so it stands beside the observations.
            demo[f"depth_mm/{pad}"] = frames.depth_mm

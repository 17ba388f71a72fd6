"""Export to WebDataset: tar files of samples that stream into a training loop.

A sample is the files of one base name: ``<grasp_id>.<pad>.<k>.png`` (frame k of a pad), ``.npy``
arrays, and ``.json`` with everything else; of a camera ``<grasp_id>.camera.<name>.<k>.png`` and
``.npy``. Format: github.com/webdataset/webdataset.
"""

import io
import json
import tarfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tacgen.core.images import encode_png
from tacgen.core.records import AXES
from tacgen.dataset.export import arrays_of, camera_facts
from tacgen.dataset.export.real_grasps import grasp_id
from tacgen.dataset.reader import Dataset
from tacgen.dataset.samples import GraspSample

GRASPS_PER_TAR = 1000
"""At 4 images of 100 kB a grasp about 400 MB, WebDataset's recommended order of size."""
COLUMNS = ("object", *AXES, "label", "failure_mode", "split")


def write(dataset: Dataset, grasps: pd.DataFrame, folder: Path) -> str:
    """Write the chosen grasps as ``grasps-000000.tar`` …"""
    count = 0
    for start in range(0, len(grasps), GRASPS_PER_TAR):
        with tarfile.open(folder / f"grasps-{count:06d}.tar", "w") as archive:
            for row in grasps.iloc[start : start + GRASPS_PER_TAR].to_dict("records"):
                sample = dataset.read(int(row["index"]))
                for name, content in _files(dataset, sample, {key: row[key] for key in COLUMNS}):
                    entry = tarfile.TarInfo(f"{grasp_id(sample.config.index)}.{name}")
                    entry.size = len(content)
                    archive.addfile(entry, io.BytesIO(content))
        count += 1
    files = "1 tar file" if count == 1 else f"{count} tar files"
    return f"{len(grasps)} grasps in {files} of WebDataset's format"


def _files(
    dataset: Dataset, sample: GraspSample, row: dict[str, Any]
) -> Iterator[tuple[str, bytes]]:
    moment = None if np.isnan(sample.grasp_time_s) else sample.grasp_time_s
    about = {"grasp_frame": sample.grasp_frame, "grasp_time_s": moment, **row}
    if sample.cameras:
        about["cameras"] = {name: camera_facts(one) for name, one in dataset.cameras.items()}
    yield "json", json.dumps(about, default=lambda value: value.item()).encode()
    yield "object_pose.npy", _npy(np.asarray(sample.object_pose))
    for owner, field, values in arrays_of(dataset, sample):
        name = f"camera.{owner}" if field.of == "camera" else owner
        if field.name == "rgb":
            for k, rgb in enumerate(values if field.is_of_frames else [values]):
                yield f"{name}.{k}.png", encode_png(rgb)
        else:
            yield f"{name}.{field.name}.npy", _npy(values)
        if field.rest:
            yield f"{name}.{field.rest}.npy", _npy(dataset.marker_rest_mm(owner))


def _npy(array: np.ndarray[Any, np.dtype[Any]]) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=False)
    return buffer.getvalue()

"""Export to PNG images and CSV tables, with depth and the figures of each frame."""

from pathlib import Path

import numpy as np
import pandas as pd

from tacgen.dataset.export import real_grasps
from tacgen.dataset.export.real_grasps import grasp_id, pad_suffix
from tacgen.dataset.reader import Dataset
from tacgen.dataset.samples import frame_columns, frame_flags


def write(dataset: Dataset, grasps: pd.DataFrame, folder: Path) -> str:
    """Write PNG images and ``grasps.csv``, with depth and forces of every pad.

    ``images/<grasp_id>/<k>.png`` are the first pad's frames, ``contact/<grasp_id>.csv`` the forces
    of its frames, ``depth/<grasp_id>.npy`` (H, W), or (T, H, W) where the dataset has the depth of
    every frame, float32, mm, its indentation where the dataset has it. Those of another pad stand
    in ``images_<pad>``, ``contact_<pad>`` and ``depth_<pad>``.
    """
    real_grasps.write(dataset, grasps, folder)
    for index in map(int, grasps["index"]):
        sample, name = dataset.read(index), grasp_id(index)
        for pad_name, pad in sample.pads.items():
            suffix = pad_suffix(dataset, pad_name)
            contact, depth = folder / f"contact{suffix}", folder / f"depth{suffix}"
            contact.mkdir(exist_ok=True)
            times = {"time_s": dataset.times_s(index)}
            flags = {flag: held.astype(int) for flag, held in frame_flags(pad).items()}
            forces = pd.DataFrame(times | frame_columns(pad) | flags)
            forces.to_csv(contact / f"{name}.csv", index=False)
            if pad.depth_mm is not None:
                depth.mkdir(exist_ok=True)
                np.save(depth / f"{name}.npy", pad.depth_mm.astype(np.float32))
    pads = "" if len(dataset.pads) == 1 else f", {' and '.join(dataset.pads)} pad apart"
    return f"{len(grasps)} grasps as PNG and CSV{pads}"

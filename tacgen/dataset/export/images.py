"""Export to PNG images and CSV tables, with depth and the figures of each frame."""

from pathlib import Path

import numpy as np
import pandas as pd

from tacgen.dataset.export import real_grasps
from tacgen.dataset.export.real_grasps import grasp_id
from tacgen.dataset.reader import Dataset
from tacgen.dataset.samples import frame_columns
from tacgen.dataset.schema import STATE_FIELDS, VALIDITY_FIELDS


def write(dataset: Dataset, grasps: pd.DataFrame, folder: Path) -> str:
    """Write PNG images and ``grasps.csv``, with depth and forces of the first pad.

    ``images/<grasp_id>/<k>.png`` are the first pad's frames, ``contact/<grasp_id>.csv`` the forces
    of its frames, ``depth/<grasp_id>.npy`` (H, W) float32, mm, its indentation where the dataset
    has it.
    """
    real_grasps.write(dataset, grasps, folder)
    (folder / "contact").mkdir()
    for index in map(int, grasps["index"]):
        sample = dataset.read(index)
        pad, name = sample.pads[dataset.pads[0]], grasp_id(index)
        figures = frame_columns(pad, (*STATE_FIELDS, *VALIDITY_FIELDS))
        forces = {"time_s": dataset.times_s(index), **figures}
        pd.DataFrame(forces).to_csv(folder / "contact" / f"{name}.csv", index=False)
        if pad.depth_mm is not None:
            (folder / "depth").mkdir(exist_ok=True)
            np.save(folder / "depth" / f"{name}.npy", pad.depth_mm.astype(np.float32))
    return f"{len(grasps)} grasps as PNG and CSV"

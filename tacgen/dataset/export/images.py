"""Export as plain files: the layout of real grasps, with depth maps and contact forces beside."""

from pathlib import Path

import numpy as np
import pandas as pd

from tacgen.dataset.export.real_grasps import grasp_id, write_real_grasps
from tacgen.dataset.reader import Dataset


def write_images(dataset: Dataset, grasps: pd.DataFrame, folder: Path) -> str:
    """Write PNG images and ``grasps.csv``, with depth and forces of the first pad.

    ``images/<grasp_id>/<k>.png`` are the first pad's frames, ``contact/<grasp_id>.csv`` the forces
    of its frames, ``depth/<grasp_id>.npy`` (H, W) float32, mm, its indentation where the dataset
    has it.
    """
    write_real_grasps(dataset, grasps, folder)
    (folder / "contact").mkdir()
    for index in map(int, grasps["index"]):
        pad = dataset.read(index).pads[dataset.pads[0]]
        name = grasp_id(index)
        forces = {
            "time_s": dataset.time_s,
            "force_normal_n": pad.force_normal_n,
            "force_shear_x_n": pad.force_shear_n[:, 0],
            "force_shear_y_n": pad.force_shear_n[:, 1],
            "indentation_mm": pad.indentation_mm,
        }
        pd.DataFrame(forces).to_csv(folder / "contact" / f"{name}.csv", index=False)
        if pad.depth_mm is not None:
            (folder / "depth").mkdir(exist_ok=True)
            np.save(folder / "depth" / f"{name}.npy", pad.depth_mm.astype(np.float32))
    return f"{len(grasps)} grasps as PNG and CSV"

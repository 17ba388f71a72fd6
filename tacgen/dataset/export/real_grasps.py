"""Export to the folder that real grasps come in: to try out, without a robot, what takes them.

Only what a real experiment would leave behind is written: images, which of them are of the moment
of grasp and the last before the lift, what the gripper was asked to do, and how the grasp ended.
``about.json`` states that the grasps are simulated.
"""

import json
from pathlib import Path

import pandas as pd

from tacgen.core.files import write_text
from tacgen.core.images import encode_png
from tacgen.dataset.reader import Dataset
from tacgen.dataset.real_grasps import ABOUT, BACKGROUND, FRAME_UNKNOWN, FRAMES

NOTE = "Simulated by tacgen, written in the format of real grasps. Not real."
COLUMNS = ("object", "force_n", "x_mm", "y_mm", "z_mm", "yaw_rad", "label", "failure_mode")


def write(dataset: Dataset, grasps: pd.DataFrame, folder: Path, *, images: bool = True) -> str:
    """Write the chosen grasps as a folder of real grasps."""
    table = grasps[list(COLUMNS)].copy()
    table.insert(0, "grasp_id", [grasp_id(int(index)) for index in grasps["index"]])
    if images:
        columns = {name: column.to_numpy() for name, column in grasps.items()}
        for name, frames in zip(
            FRAMES, (grasps["grasp_frame"], dataset.lift_frames(columns)), strict=True
        ):
            table[name] = pd.Series(frames, grasps.index, dtype="Int64").replace(
                FRAME_UNKNOWN, pd.NA
            )
    write_text(folder / "grasps.csv", table.to_csv(index=False))
    about = {"simulated": True, "note": NOTE, "taken_with": dataset.taken_with()}
    write_text(folder / ABOUT, json.dumps(about, indent=1))
    if images:
        (folder / BACKGROUND).write_bytes(encode_png(dataset.reference()))
        for index in map(int, grasps["index"]):
            place = folder / "images" / grasp_id(index)
            place.mkdir(parents=True)
            for k, frame in enumerate(dataset.rgb(index)):
                (place / f"{k}.png").write_bytes(encode_png(frame))
    return f"{len(grasps)} simulated grasps in the format of real ones"


def grasp_id(index: int) -> str:
    """Name of a grasp of the dataset: ``g00012``."""
    return f"g{index:05d}"

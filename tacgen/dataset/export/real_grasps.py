"""Export to the folder that real grasps come in: to try out, without a robot, what takes them.

Only what a real experiment would leave behind is written: images, which of them are of the moment
of grasp and the last before the lift, what the gripper was asked to do, and how the grasp ended.
``about.json`` states that the grasps are simulated. The first pad's images stand where a reader of
one pad looks for them, ``images/``; those of a second pad in ``images_<pad>/``, with a
``background_<pad>.png`` of its own.
"""

import json
from pathlib import Path
from typing import Any

import pandas as pd

from tacgen.core.files import write_text
from tacgen.core.images import encode_png
from tacgen.core.records import AXES
from tacgen.dataset.reader import Dataset
from tacgen.dataset.real_grasps import ABOUT, BACKGROUND, FRAME_UNKNOWN, FRAMES

NOTE = "Simulated by tacgen, written in the format of real grasps. Not real."
COLUMNS = ("object", *AXES, "label", "failure_mode")


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
    about: dict[str, Any] = {"simulated": True, "note": NOTE, "taken_with": dataset.taken_with()}
    if images and len(dataset.pads) > 1:
        about["images"] = {pad: f"images{pad_suffix(dataset, pad)}" for pad in dataset.pads}
    write_text(folder / ABOUT, json.dumps(about, indent=1))
    for pad in dataset.pads if images else ():
        suffix, background = pad_suffix(dataset, pad), Path(BACKGROUND)
        reference = encode_png(dataset.reference(pad))
        (folder / f"{background.stem}{suffix}{background.suffix}").write_bytes(reference)
        for index in map(int, grasps["index"]):
            place = folder / f"images{suffix}" / grasp_id(index)
            place.mkdir(parents=True)
            for k, frame in enumerate(dataset.rgb(index, pad)):
                (place / f"{k}.png").write_bytes(encode_png(frame))
    said = f"{len(grasps)} simulated grasps in the format of real ones"
    if images and len(dataset.pads) > 1:
        places = (f"{pad} pad in images{pad_suffix(dataset, pad)}/" for pad in dataset.pads)
        said += f": {', '.join(places)}"
    return said


def pad_suffix(dataset: Dataset, pad: str) -> str:
    """What the folders of a pad end in; nothing for the first, which readers of one pad take."""
    return "" if pad == dataset.pads[0] else f"_{pad}"


def grasp_id(index: int) -> str:
    """Name of a grasp of the dataset: ``g00012``."""
    return f"g{index:05d}"

"""A dataset written as if a robot had made it: a stand-in for reality, called what it is.

Only what a real experiment would leave behind is written: images, what was asked for, and how it
ended. It is still a simulation.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from tacgen.core.errors import DatasetError
from tacgen.core.files import write_text
from tacgen.core.records import LABEL_NOT_EXECUTED
from tacgen.dataset import Dataset
from tacgen.learning.real_grasps import ABOUT
from tacgen.report.page import encode_png

NOTE = "Simulated by tacgen in another world, written in the format of real grasps. Not real."


def write_stand_in(
    data: Path, out: Path, *, split: str, per_object: int | None = None, images: bool = True
) -> int:
    """Write the grasps of one side of a dataset's split as a folder of real grasps.

    Parameters
    ----------
    per_object : int, optional
        Only the first so many of each object.
    images : bool
        Whether to write the images; labels alone are enough to calibrate friction on.

    Returns
    -------
    int
        How many grasps were written.

    Raises
    ------
    DatasetError
        If the folder exists, or no grasp is on that side.
    """
    if out.exists():
        msg = f"{out} exists already; give a new folder, or remove it"
        raise DatasetError(msg)
    dataset = Dataset(data)
    columns = pd.DataFrame(
        {name: values for name, values in dataset.columns().items() if values.ndim == 1}
    )
    chosen = columns[(columns.split == split) & (columns.label != LABEL_NOT_EXECUTED)]
    if per_object is not None:
        chosen = chosen.groupby("object", sort=False).head(per_object)
    if chosen.empty:
        msg = f"{data}: no executed grasps on the side {split!r} of its split"
        raise DatasetError(msg)
    partial = out.with_name(f".{out.name}.part")
    shutil.rmtree(partial, ignore_errors=True)
    try:
        _write_grasps(chosen, partial, dataset.lines[0].recipe_sha256)
        if images:
            _write_images(dataset, [int(index) for index in chosen["index"]], partial)
        partial.rename(out)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return len(chosen)


def _grasp_id(index: int) -> str:
    return f"g{index:05d}"


def _write_grasps(chosen: pd.DataFrame, folder: Path, recipe_sha256: str) -> None:
    names = ["object", "force_n", "x_mm", "y_mm", "z_mm", "yaw_rad", "label", "failure_mode"]
    table = chosen[names].copy()
    table.insert(0, "grasp_id", [_grasp_id(int(index)) for index in chosen["index"]])
    write_text(folder / "grasps.csv", table.to_csv(index=False))
    about = {"simulated": True, "note": NOTE, "recipe_sha256": recipe_sha256}
    write_text(folder / ABOUT, json.dumps(about, indent=1))


def _write_images(dataset: Dataset, indices: Sequence[int], folder: Path) -> None:
    (folder / "background.png").write_bytes(encode_png(dataset.reference()))
    for index in indices:
        images = folder / "images" / _grasp_id(index)
        images.mkdir(parents=True)
        for k, frame in enumerate(dataset.rgb(index)):
            (images / f"{k}.png").write_bytes(encode_png(frame))

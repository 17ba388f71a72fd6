"""Export to the formats of other tools.

A format is a function that writes some grasps of a dataset into a new folder; it is entered in
``FORMATS``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pandas as pd

from tacgen.core.errors import DatasetError
from tacgen.core.files import atomic_folder
from tacgen.core.records import LABEL_NOT_EXECUTED
from tacgen.dataset.disk import disk_errors
from tacgen.dataset.export.images import write_images
from tacgen.dataset.export.lerobot import write_lerobot
from tacgen.dataset.export.real_grasps import write_real_grasps
from tacgen.dataset.export.robomimic import write_robomimic
from tacgen.dataset.export.webdataset import write_webdataset
from tacgen.dataset.reader import Dataset
from tacgen.dataset.schema import SPLITS

Writer = Callable[[Dataset, pd.DataFrame, Path], str]
"""Takes the dataset, the chosen grasps (a row each: index, object, label, split, …) and an empty
folder; returns a few words on what it wrote."""

FORMATS: Mapping[str, Writer] = {
    "lerobot": write_lerobot,
    "images": write_images,
    "webdataset": write_webdataset,
    "robomimic": write_robomimic,
    "real-grasps": write_real_grasps,
}


@dataclass(frozen=True, slots=True)
class Exported:
    """What an export wrote: grasps of the dataset that are in it, and that are not."""

    folder: str
    format: str
    grasps: int
    not_executed: int
    content: str

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        tail = f"; {self.not_executed} grasps that were not executed are not exported"
        return f"{self.folder}: {self.content}{tail if self.not_executed else ''}"


def export_dataset(
    root: Path | str,
    out: Path | str,
    format_name: str,
    *,
    split: str | None = None,
    per_object: int | None = None,
    images: bool = True,
) -> Exported:
    """Write executed grasps of the dataset in ``root`` to the new folder ``out``.

    ``split`` (``train`` or ``test``) and ``per_object``, the first so many of each object, limit
    the grasps; without ``images``, labels and forces are written, which suffice to calibrate
    friction.

    Raises ``DatasetError`` if the format or the split is not known, ``out`` exists, or no grasp is
    left to export.
    """
    for name, value, known in (
        ("--format", format_name, FORMATS),
        ("--split", split, (None, *SPLITS)),
    ):
        if value not in known:
            msg = f"{name} {value}: not known; give one of {', '.join(filter(None, known))}"
            raise DatasetError(msg)
    writer = FORMATS[format_name]
    if not images and writer is not write_real_grasps:
        msg = f"--no-images: {format_name} always holds images; use --format real-grasps"
        raise DatasetError(msg)
    if not images:
        writer = partial(write_real_grasps, images=False)
    with disk_errors(Path(out)), atomic_folder(Path(out)) as folder:
        dataset = Dataset(root)
        grasps, not_executed = _chosen(dataset, split, per_object)
        content = writer(dataset, grasps, folder)
    return Exported(str(out), format_name, len(grasps), not_executed, content)


def _chosen(
    dataset: Dataset, split: str | None, per_object: int | None
) -> tuple[pd.DataFrame, int]:
    """The grasps to export, and how many of these splits were not executed."""
    columns = dataset.columns().items()
    table = pd.DataFrame({name: values for name, values in columns if values.ndim == 1})
    if split is not None:
        table = table[table["split"] == split]
    executed = table[table["label"] != LABEL_NOT_EXECUTED]
    not_executed = len(table) - len(executed)
    if per_object is not None:
        executed = executed.groupby("object", sort=False).head(per_object)
    if executed.empty:
        where = "" if split is None else f" of the {split} split"
        msg = (
            f"{dataset.root}: no grasp{where} was executed, so there is nothing to export; "
            "collect grasps that the gripper can reach"
        )
        raise DatasetError(msg)
    return executed, not_executed

"""Export to the formats of other tools.

A format is a function that writes some grasps of a dataset into a new folder; it is entered in
``FORMATS``.
"""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd

from tacgen.core.errors import DatasetError, require_known
from tacgen.core.files import atomic_folder
from tacgen.core.optional_dependencies import require_extra
from tacgen.core.records import LABEL_NOT_EXECUTED
from tacgen.dataset.disk import disk_errors
from tacgen.dataset.export.real_grasps import write_images, write_real_grasps
from tacgen.dataset.export.robomimic import write_robomimic
from tacgen.dataset.export.webdataset import write_webdataset
from tacgen.dataset.reader import Dataset
from tacgen.dataset.schema import SPLITS

Writer = Callable[[Dataset, pd.DataFrame, Path], str]
"""Takes the dataset, the chosen grasps (a row each: index, object, label, split, …) and an empty
folder; returns a few words on what it wrote."""


def write_lerobot(dataset: Dataset, grasps: pd.DataFrame, folder: Path) -> str:
    """Write each of the chosen grasps as an episode; needs the extra ``parquet``."""
    require_extra("parquet", "--format lerobot needs", DatasetError)
    from tacgen.dataset.export import lerobot

    return lerobot.write_lerobot(dataset, grasps, folder)


FORMATS: Mapping[str, Writer] = {
    "lerobot": write_lerobot,
    "images": write_images,
    "webdataset": write_webdataset,
    "robomimic": write_robomimic,
    "real-grasps": write_real_grasps,
}


def export_dataset(
    root: Path | str,
    out: Path | str,
    format_name: str,
    *,
    split: str | None = None,
    images: bool = True,
) -> dict[str, Any]:
    """Write executed grasps of the dataset in ``root`` to the new folder ``out``; what it wrote.

    ``split`` is ``train``, ``test`` or both; without ``images``, labels and forces are written,
    which suffice to calibrate friction.

    Raises ``DatasetError`` if the format or the split is not known, ``out`` exists, or no grasp is
    left to export.
    """
    require_known("--format", format_name, FORMATS, DatasetError)
    require_known("--split", split or "train", SPLITS, DatasetError)
    writer = FORMATS[format_name]
    if not images:
        if writer is not write_real_grasps:
            msg = f"--no-images: {format_name} always holds images; use --format real-grasps"
            raise DatasetError(msg)
        writer = partial(write_real_grasps, images=False)
    with disk_errors(Path(out)), atomic_folder(Path(out)) as folder:
        dataset = Dataset(root)
        grasps, not_executed = _chosen(dataset, split)
        content = writer(dataset, grasps, folder)
    counts = {"grasps": len(grasps), "not_executed": not_executed}
    return {"folder": str(out), "format": format_name, **counts, "content": content}


def _chosen(dataset: Dataset, split: str | None) -> tuple[pd.DataFrame, int]:
    columns = dataset.columns().items()
    table = pd.DataFrame({name: values for name, values in columns if values.ndim == 1})
    if split is not None:
        table = table[table["split"] == split]
    executed = table[table["label"] != LABEL_NOT_EXECUTED]
    not_executed = len(table) - len(executed)
    if executed.empty:
        where = "" if split is None else f" of the {split} split"
        fix = "collect grasps that the gripper can reach"
        msg = f"{dataset.root}: no grasp{where} was executed, so nothing can be exported; {fix}"
        raise DatasetError(msg)
    return executed, not_executed

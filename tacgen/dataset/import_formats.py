"""Real grasps of other projects, written as the folder of real grasps that tacgen reads.

Such a folder holds ``grasps.csv`` and ``images/<grasp_id>/<k>.png`` in time order.
"""

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import h5py
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tacgen.core.errors import DatasetError
from tacgen.core.files import atomic_folder
from tacgen.core.safe_io import read_bgr

POSEIT_FOLDER = re.compile(r"(?P<object>.+)_(?P<time>\d+)_F(?P<force>[\d.]+)_pose(?P<pose>\d+)$")
POSEIT_FRAME = re.compile(r"(_(?P<frame>\d+))?_(?P<time>\d+)\.jpe?g$", re.IGNORECASE)
FEELING_OF_SUCCESS_MOMENTS = ("before", "during", "after")


@dataclass(frozen=True, slots=True)
class ImportedGrasp:
    """One grasp of a foreign set; ``images_bgr`` in time order."""

    grasp_id: str
    columns: Mapping[str, float | int | str]
    images_bgr: tuple[NDArray[np.uint8], ...]


def import_grasps(format_name: str, source: Path, out: Path) -> tuple[int, tuple[str, ...]]:
    """Write the grasps of ``source`` as a folder of real grasps ``out``, whole or not at all.

    The result is how many were written, and a line for each that was not, with its reason.
    Raises ``DatasetError`` if there is none that can be written.
    """
    notes: list[str] = []
    rows = []
    with atomic_folder(out) as folder:
        for grasp in GRASP_FORMATS[format_name](Path(source), notes):
            images = folder / "images" / grasp.grasp_id
            images.mkdir(parents=True)
            for k, image in enumerate(grasp.images_bgr):
                cv2.imwrite(str(images / f"{k}.png"), image)
            rows.append({"grasp_id": grasp.grasp_id, **grasp.columns})
        if not rows:
            problems = notes or [f"{source}: no grasps of the layout {format_name}"]
            raise DatasetError.from_problems(problems)
        pd.DataFrame(rows).to_csv(folder / "grasps.csv", index=False)
    return len(rows), tuple(notes)


def read_poseit(source: Path, notes: list[str]) -> Iterator[ImportedGrasp]:
    """PoseIt: ``<object>_<time>_F<force>_pose<i>`` folders (UR5e, WSG-50, GelSight).

    Source: Kanitkar et al. 2022, *PoseIt* (arXiv 2209.05022); files as public loaders read them:
    ``stages.csv`` (phase, unix second), ``label.csv`` (phase, pass, slip or drop), ``gelsight/
    gelsight_<frame>_<unix second>.jpg``. A grasp succeeds where every phase passes. Frames are
    those from the start of the grasp to the start of the phase after it.
    """
    for folder in sorted(path for path in source.iterdir() if path.is_dir()):
        match = POSEIT_FOLDER.match(folder.name)
        if match is None:
            continue
        try:
            stages = _two_columns(folder / "stages.csv")
            results = {result.lower() for _, result in _two_columns(folder / "label.csv")}
            if not results or not results <= {"pass", "slip", "drop"}:
                msg = f"label.csv says {', '.join(sorted(results)) or 'nothing'}"
                raise ValueError(msg)
            images = tuple(_poseit_frames(folder / "gelsight", stages))
            if not images:
                msg = "no readable picture of the grasp in gelsight/"
                raise ValueError(msg)
        except (OSError, ValueError) as error:
            notes.append(f"{folder}: not imported: {error}")
            continue
        columns: dict[str, float | int | str] = {
            "object": match["object"],
            "force_n": float(match["force"]),
            "label": int(results == {"pass"}),
        }
        if results & {"slip", "drop"}:
            columns["poseit_result"] = "drop" if "drop" in results else "slip"
        yield ImportedGrasp(folder.name, columns, images)


def _two_columns(path: Path) -> list[tuple[str, str]]:
    """The rows of a CSV of two columns; a header, whose second cell is a word too, is kept out."""
    table = pd.read_csv(path, header=None, dtype=str, skipinitialspace=True).dropna(how="all")
    if table.shape[1] < 2 or table.empty:
        msg = f"{path.name} has no rows of two columns"
        raise ValueError(msg)
    rows = [(str(a).strip(), str(b).strip()) for a, b in zip(table[0], table[1], strict=True)]
    headers = {"unix_timestamp", "timestamp", "time", "result", "label"}
    return [row for row in rows if row[1].lower() not in headers]


def _poseit_frames(folder: Path, stages: list[tuple[str, str]]) -> Iterator[NDArray[np.uint8]]:
    times = [(name.lower(), float(second)) for name, second in stages]
    start = next((second for name, second in times if "grasp" in name), -np.inf)
    end = min((second for _, second in times if second > start), default=np.inf)
    named = [(POSEIT_FRAME.search(path.name), path) for path in folder.glob("*.[jJ]*")]
    frames = [(int(m["time"]), int(m["frame"] or 0), path) for m, path in named if m is not None]
    for second, _, path in sorted(frames):
        image = read_bgr(path) if start <= second <= end else None
        if image is not None:
            yield image


def read_feeling_of_success(source: Path, notes: list[str]) -> Iterator[ImportedGrasp]:
    """The Feeling of Success: HDF5 files with before, during and after of two GelSights.

    Source: Calandra et al. 2017 (arXiv 1710.05512); fields as public loaders read them
    (``object_name``, ``is_gripping``, ``gelsightA_before`` …), in the layout that deepdish writes:
    a list of groups ``i0``, ``i1`` … One grasp becomes one for each finger, ``…_A`` and ``…_B``;
    force and place are not in the set.
    """
    files = [source] if source.is_file() else sorted([*source.glob("*.h5"), *source.glob("*.hdf5")])
    for file in files:
        try:
            with h5py.File(file) as h5:
                root = h5["data"] if isinstance(h5.get("data"), h5py.Group) else h5
                groups = {name: one for name, one in root.items() if isinstance(one, h5py.Group)}
                for name in sorted(groups, key=lambda name: (len(name), name)):
                    yield from _both_fingers(f"{file.stem}_{name}", groups[name], notes)
        except OSError as error:
            notes.append(f"{file}: not imported: cannot be read as HDF5: {error}")


def _both_fingers(grasp_id: str, group: h5py.Group, notes: list[str]) -> Iterator[ImportedGrasp]:
    held = _deepdish_value(group, "is_gripping")
    if held is None:
        notes.append(f"{grasp_id}: not imported: no is_gripping")
        return
    name = _deepdish_value(group, "object_name")
    text = name.decode() if isinstance(name, bytes) else str(name)
    for finger in "AB":
        moments = [f"gelsight{finger}_{moment}" for moment in FEELING_OF_SUCCESS_MOMENTS]
        found = [np.asarray(group[m], np.uint8) for m in moments if m in group]
        images = tuple(np.ascontiguousarray(rgb[..., ::-1]) for rgb in found)
        if not images:
            notes.append(f"{grasp_id}_{finger}: not imported: no tactile picture")
            continue
        columns: dict[str, float | int | str]
        columns = {"object": text, "label": int(bool(held)), "finger": finger}
        yield ImportedGrasp(f"{grasp_id}_{finger}", columns, images)


def _deepdish_value(group: h5py.Group, name: str) -> object:
    """A scalar, which deepdish writes as an attribute, or as an array of one."""
    if name in group.attrs:
        return group.attrs[name]
    if name in group:
        return np.asarray(group[name]).reshape(-1)[0]
    return None


GRASP_FORMATS: Mapping[str, Callable[[Path, list[str]], Iterator[ImportedGrasp]]] = {
    "poseit": read_poseit,
    "feeling-of-success": read_feeling_of_success,
}

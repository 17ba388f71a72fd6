"""Real grasps of other projects, written as the folder of real grasps that tacgen reads.

Such a folder holds ``grasps.csv`` and ``images/<grasp_id>/<k>.png`` in time order.
"""

import os
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tacgen.core.errors import DatasetError
from tacgen.core.files import atomic_folder
from tacgen.core.images import encode_png
from tacgen.core.progress import print_status
from tacgen.core.safe_io import decode_rgb, read_rgb, rgb_of_array

POSEIT_FOLDER = re.compile(r"(?P<object>.+)_(?P<time>\d+)_F(?P<force>[\d.]+)_pose(?P<pose>\d+)$")
POSEIT_PHASES = ("grasp", "pose", "stability")
"""Phases that ``label.csv`` has a result of, in their order."""
POSEIT_UNUSED = ("f_t.csv", "gripper.csv", "rgb")
"""What else a folder holds and the folder of real grasps has no place for."""
PICTURES = (".jpg", ".jpeg", ".png")
MAX_PICTURE_BYTES = 1 << 28
FEELING_OF_SUCCESS_MOMENTS = ("before", "during", "after")
FEELING_OF_SUCCESS_USED = ("object_name", "is_gripping")


@dataclass(frozen=True, slots=True)
class ImportedGrasp:
    """One grasp of a foreign set; ``images_rgb`` in time order."""

    grasp_id: str
    columns: Mapping[str, float | int | str]
    images_rgb: tuple[NDArray[np.uint8], ...]


@dataclass(slots=True)
class Notes:
    """What a reader has to say: trials read, a line for each left out, and what is not used."""

    trials: int
    left_out: list[str]
    unused: set[str]


def import_grasps(format_name: str, source: Path, out: Path) -> tuple[int, tuple[str, ...]]:
    """Write the grasps of ``source`` as a folder of real grasps ``out``, whole or not at all.

    The result is how many were written, and notes: a line for each that was not, with its reason,
    and what of the layout is not used. How many trials and failures there were is shown.
    Raises ``DatasetError`` if there is none that can be written.
    """
    notes = Notes(0, [], set())
    rows = []
    with atomic_folder(out) as folder:
        for grasp in GRASP_FORMATS[format_name](Path(source), notes):
            images = folder / "images" / grasp.grasp_id
            images.mkdir(parents=True)
            for k, image in enumerate(grasp.images_rgb):
                (images / f"{k}.png").write_bytes(encode_png(image))
            rows.append({"grasp_id": grasp.grasp_id, **grasp.columns})
        if not rows:
            problems = notes.left_out or [f"{source}: no grasps of the layout {format_name}"]
            raise DatasetError.from_problems(problems)
        pd.DataFrame(rows).to_csv(folder / "grasps.csv", index=False)
    failures = sum(row["label"] == 0 for row in rows)
    pictures = f"{len(rows)} sequences of pictures written, {failures} of them of failures"
    print_status(f"{notes.trials} trials read, {len(notes.left_out)} left out; {pictures}")
    unused = (f"not imported: {', '.join(sorted(notes.unused))}",) if notes.unused else ()
    return len(rows), (*notes.left_out, *unused)


def read_poseit(source: Path, notes: Notes) -> Iterator[ImportedGrasp]:
    """PoseIt: ``<object>_<time>_F<force>_pose<i>`` folders (UR5e, WSG-50, GelSight).

    Source: Kanitkar et al. 2022, *PoseIt* (arXiv 2209.05022); files as public loaders read them:
    ``stages.csv`` (phase, unix second), ``label.csv`` (phase, pass, slip or drop), ``gelsight/
    gelsight_<frame>_<unix second>.jpg``. A grasp succeeds where every phase passes; one that slips
    or drops has failed, and later phases need no result. Frames are those of the whole seconds
    that lie in the phase of the grasp.
    """
    for folder in sorted(path for path in source.iterdir() if path.is_dir()):
        match = POSEIT_FOLDER.match(folder.name)
        if match is None:
            continue
        notes.trials += 1
        notes.unused |= {name for name in POSEIT_UNUSED if (folder / name).exists()}
        try:
            stages = _two_columns(folder / "stages.csv")
            result = _poseit_result(_two_columns(folder / "label.csv"))
            images = tuple(_poseit_frames(folder / "gelsight", stages))
        except (OSError, ValueError, DatasetError) as error:
            why = str(error).removeprefix(f"{folder}{os.sep}")
            notes.left_out.append(f"{folder}: not imported: {why}")
            continue
        columns: dict[str, float | int | str] = {
            "object": match["object"],
            "force_n": float(match["force"]),
            "label": int(result == "pass"),
            "poseit_pose": int(match["pose"]),
            "poseit_result": result,
        }
        yield ImportedGrasp(folder.name, columns, images)


def _poseit_result(rows: list[tuple[str, str]]) -> str:
    """``pass``, or ``slip`` or ``drop`` of the first phase that did not pass.

    Raises ``ValueError`` where a phase has no result and none before it has failed.
    """
    results = {name.lower(): result.lower() for name, result in rows}
    if not results:
        msg = "label.csv says nothing"
        raise ValueError(msg)
    if set(results) <= set(POSEIT_PHASES):
        results = {name: results.get(name, "") for name in POSEIT_PHASES}
    for phase, result in results.items():
        if result in ("slip", "drop"):
            return result
        if result != "pass":
            said = f"says {result!r}" if result not in ("", "nan") else "has no result"
            msg = f"label.csv {said} for {phase}; write pass, slip or drop"
            raise ValueError(msg)
    return "pass"


def _two_columns(path: Path) -> list[tuple[str, str]]:
    """The rows of a CSV of two columns; a header, whose second cell is a word too, is kept out."""
    table = pd.read_csv(path, header=None, dtype=str, skipinitialspace=True).dropna(how="all")
    if table.shape[1] < 2 or table.empty:
        msg = f"{path.name} has no rows of two columns"
        raise ValueError(msg)
    table = table.fillna("")
    rows = [(str(a).strip(), str(b).strip()) for a, b in zip(table[0], table[1], strict=True)]
    headers = {"unix_timestamp", "timestamp", "time", "result", "label"}
    return [row for row in rows if row[1].lower() not in headers]


def _poseit_frames(folder: Path, stages: list[tuple[str, str]]) -> Iterator[NDArray[np.uint8]]:
    """The pictures of the phase of the grasp, in time order.

    Raises ``ValueError`` where there is no such phase, or none of its pictures.
    """
    times = [(name.lower(), float(second)) for name, second in stages]
    starts = [second for name, second in times if "grasp" in name]
    if not starts:
        msg = "stages.csv has no phase of the grasp"
        raise ValueError(msg)
    start = starts[0]
    end = min((second for _, second in times if second > start), default=np.inf)
    frames = []
    for path in folder.iterdir():
        numbers = re.findall(r"\d+(?:\.\d+)?", path.stem)
        if path.suffix.lower() in PICTURES and numbers:
            frame = float(numbers[-2]) if len(numbers) > 1 else 0.0
            frames.append((float(numbers[-1]), frame, path))
    # A whole second may have been cut short: it must lie in the phase to its end.
    lasts_s = 1.0 if all(second.is_integer() for second, *_ in frames) else 0.0
    inside = [
        path
        for second, _, path in sorted(frames)
        if start <= second < end and second + lasts_s <= end
    ]
    if not inside:
        msg = f"no readable picture of the grasp in gelsight/, seconds {start:.0f} to {end:.0f}"
        raise ValueError(msg)
    for path in inside:
        yield read_rgb(path, DatasetError)


def read_feeling_of_success(source: Path, notes: Notes) -> Iterator[ImportedGrasp]:
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
                data = _member(h5, "data")
                root = data if isinstance(data, h5py.Group) else h5
                members = {name: _member(root, name) for name in root}
                groups = {name: one for name, one in members.items() if isinstance(one, h5py.Group)}
                for name in sorted(groups, key=lambda name: (len(name), name)):
                    notes.trials += 1
                    yield from _both_fingers(f"{file.stem}_{name}", groups[name], notes)
        except (OSError, RuntimeError, LookupError, ValueError, TypeError) as error:
            # h5py raises the latter for damage that it meets on the way.
            notes.left_out.append(f"{file}: not imported: cannot be read as HDF5: {error}")


def _both_fingers(grasp_id: str, group: h5py.Group, notes: Notes) -> Iterator[ImportedGrasp]:
    named = {f"gelsight{f}_{m}" for f in "AB" for m in FEELING_OF_SUCCESS_MOMENTS}
    notes.unused |= {*group, *group.attrs} - named - {*FEELING_OF_SUCCESS_USED} - _HDF5_OWN
    label = _held(_deepdish_value(group, "is_gripping"))
    if label is None:
        notes.left_out.append(f"{grasp_id}: not imported: is_gripping is neither true nor false")
        return
    name = _deepdish_value(group, "object_name")
    text = name.decode() if isinstance(name, bytes) else str(name)
    for finger in "AB":
        moments = [f"gelsight{finger}_{moment}" for moment in FEELING_OF_SUCCESS_MOMENTS]
        missing = [moment for moment in moments if _array(group, moment) is None]
        try:
            if missing:
                msg = f"no {', '.join(missing)} as a picture in this file"
                raise DatasetError(msg)
            kind_of = f"{group.file.filename}: gelsight{finger}"
            images = tuple(_picture(_array(group, one), one, kind_of) for one in moments)
        except DatasetError as error:
            notes.left_out.append(f"{grasp_id}_{finger}: not imported: {error}")
            continue
        columns: dict[str, float | int | str]
        columns = {"object": text, "label": label, "finger": finger}
        yield ImportedGrasp(f"{grasp_id}_{finger}", columns, images)


_HDF5_OWN = {"CLASS", "TITLE", "VERSION", "DEEPDISH_IO_VERSION", "PYTABLES_FORMAT_VERSION"}
"""Attributes that PyTables and deepdish give every group."""


def _picture(value: Any, where: str, kind_of: str) -> NDArray[np.uint8]:
    """A picture that is stored as an array, or encoded as JPEG or PNG."""
    array = np.asarray(value)
    if array.ndim == 1 and array.dtype == np.uint8:
        return decode_rgb(array.tobytes(), where, DatasetError, kind_of=kind_of)
    return rgb_of_array(array, where, DatasetError, kind_of=kind_of)


def _held(value: object) -> int | None:
    """Label of ``is_gripping``, a truth value, number or word; None where it is none of these."""
    text = value.decode() if isinstance(value, bytes) else str(value)
    return {"true": 1, "1": 1, "1.0": 1, "false": 0, "0": 0, "0.0": 0}.get(text.strip().lower())


def _deepdish_value(group: h5py.Group, name: str) -> object:
    """A scalar, which deepdish writes as an attribute, or as an array of one."""
    if name in group.attrs:
        return group.attrs[name]
    values = _array(group, name)
    return None if values is None or not values.size else values.reshape(-1)[0]


def _member(group: h5py.Group, name: str) -> h5py.Group | h5py.Dataset | None:
    """What a group holds itself; None for links, which lead to other files or in circles."""
    link = group.get(name, getlink=True)
    return group[name] if isinstance(link, h5py.HardLink) else None


def _array(group: h5py.Group, name: str) -> NDArray[Any] | None:
    """An array that this file holds, of at most a picture's size; else None."""
    found = _member(group, name)
    if not isinstance(found, h5py.Dataset) or found.is_virtual or found.external:
        return None
    return np.asarray(found[()]) if found.size and found.nbytes <= MAX_PICTURE_BYTES else None


GRASP_FORMATS: Mapping[str, Callable[[Path, Notes], Iterator[ImportedGrasp]]] = {
    "poseit": read_poseit,
    "feeling-of-success": read_feeling_of_success,
}

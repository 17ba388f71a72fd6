"""Real grasps: a folder with ``grasps.csv`` and, where there are any, images by grasp."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from tacgen.core.errors import DatasetError, did_you_mean
from tacgen.core.files import read_small_text
from tacgen.core.images import in_time_order
from tacgen.core.records import (
    GRASPS,
    FailureMode,
    GraspConfig,
    csv_problem,
    similar_columns,
    unit_problems,
)
from tacgen.core.resources import unknown_object_hint
from tacgen.core.safe_io import IMAGE_SUFFIXES

if TYPE_CHECKING:
    import pandas as pd

REQUIRED = ("grasp_id", "object", "label")
CONFIGURATION = ("force_n", "x_mm", "y_mm", "z_mm")
"""What a grasp must say to be simulated again; networks do without."""
FRAMES = ("grasp_frame", "lift_frame")
FRAME_UNKNOWN = -1
FAILURE_MODES: tuple[FailureMode, ...] = get_args(FailureMode)
BACKGROUND = "background.png"  # image of the undeformed gel, where there is one
ABOUT, MAX_ABOUT_BYTES = "about.json", 1 << 20
"""Says ``simulated: true`` where no robot made the grasps; a robot's folder needs none."""
MAX_BYTES, MAX_COLUMNS = 256 << 20, 1000  # some million grasps
MAX_PROBLEMS_SHOWN = 20  # enough to see a pattern in a message


@dataclass(frozen=True, slots=True)
class RealGrasp:
    """One real grasp: what was asked for, and how it ended (label 1 success, 0 failure).

    Of its images ``grasp_frame`` is that of the moment of grasp and ``lift_frame`` the last before
    the lift; ``FRAME_UNKNOWN`` where that is not known.
    """

    grasp_id: str
    config: GraspConfig
    label: int
    failure_mode: FailureMode
    images: tuple[Path, ...]
    grasp_frame: int = FRAME_UNKNOWN
    lift_frame: int = FRAME_UNKNOWN


@dataclass(frozen=True, slots=True)
class RealGrasps:
    """The grasps of a folder, in the order of the file, and warnings about them.

    ``about.json`` tells whether a simulation made them, ``is_simulated``, and what the images were
    ``taken_with``, as ``Dataset.taken_with`` says it.
    """

    folder: Path
    grasps: tuple[RealGrasp, ...]
    warnings: tuple[str, ...]
    is_simulated: bool = False
    taken_with: Mapping[str, Any] = field(default_factory=dict)

    @property
    def kind(self) -> str:
        """What they are, before the word grasps."""
        return "exported simulated" if self.is_simulated else "real"

    def by_object(self) -> Mapping[str, tuple[RealGrasp, ...]]:
        """The grasps of each object, objects in the order of the file."""
        names = dict.fromkeys(grasp.config.object for grasp in self.grasps)
        return {
            name: tuple(grasp for grasp in self.grasps if grasp.config.object == name)
            for name in names
        }


def read_real_grasps(
    folder: Path | str, *, known_objects: Sequence[str] = (), needs: Sequence[str] = CONFIGURATION
) -> RealGrasps:
    """Read and check a folder of real grasps.

    Exact repeats of a configuration are kept (they are evidence); repeats whose labels contradict
    each other are kept too, with a warning that no model can fit both.

    ``known_objects`` are the names an object may have, any if empty; ``needs`` the columns beside
    ``grasp_id``, ``object`` and ``label`` that every grasp must fill: what is neither needed nor
    given is NaN.
    Raises ``DatasetError``, listing every row that cannot be used, with its line and the fix.
    """
    folder = Path(folder)
    path = folder / "grasps.csv"
    table = _read_table(path, needs)
    problems = list(_problems(table, path, known_objects, needs))
    if problems:
        shown = problems[:MAX_PROBLEMS_SHOWN]
        if len(problems) > len(shown):
            shown.append(f"{path}: and {len(problems) - len(shown)} more")
        raise DatasetError.from_problems(shown)
    records = enumerate(table.to_dict("records"))
    unused: list[str] = []
    grasps = tuple(_grasp(folder, number, row, unused) for number, row in records)
    problems = [
        f"{path}: grasp {grasp.grasp_id!r}: {name} = {frame}, but it has {len(grasp.images)} images"
        for grasp in grasps
        for name, frame in zip(FRAMES, (grasp.grasp_frame, grasp.lift_frame), strict=True)
        if grasp.images and frame >= len(grasp.images)
    ]
    DatasetError.raise_if(problems[:MAX_PROBLEMS_SHOWN])
    warnings = similar_columns(table.columns, GRASPS, str(path))
    for name in ("z_mm", "yaw_rad"):
        if problem := unit_problems(name, np.array(list(map(_number, table.get(name, ()))))):
            warnings.append(f"{path}: {name} is {problem}")
    warnings += _warnings(grasps, path)
    warnings += unused[:MAX_PROBLEMS_SHOWN]
    if len(unused) > MAX_PROBLEMS_SHOWN:
        warnings.append(f"{folder}: pictures of {len(unused)} grasps are not used")
    about = _about(folder)
    taken_with = about.get("taken_with")
    return RealGrasps(
        folder,
        grasps,
        tuple(warnings),
        is_simulated=about.get("simulated") is True,
        taken_with=taken_with if isinstance(taken_with, dict) else {},
    )


def _about(folder: Path) -> dict[str, Any]:
    """What ``about.json`` says; nothing where it is missing or broken."""
    with contextlib.suppress(OSError, ValueError, RecursionError):
        about = json.loads(read_small_text(folder / ABOUT, MAX_ABOUT_BYTES))
        return about if isinstance(about, dict) else {}
    return {}


def _read_table(path: Path, needs: Sequence[str]) -> pd.DataFrame:
    import pandas as pd  # slow to import, and workers that simulate need only the records

    try:
        if path.stat().st_size > MAX_BYTES:
            msg = f"{path}: larger than {MAX_BYTES >> 20} MiB; this is not a list of grasps"
            raise DatasetError(msg)
        with path.open("rb") as file:
            if file.readline(MAX_ABOUT_BYTES).count(b",") > MAX_COLUMNS:
                msg = f"{path}: more than {MAX_COLUMNS} columns; this is not a list of grasps"
                raise DatasetError(msg)
        table = pd.read_csv(path, dtype=str, keep_default_na=False)
    except FileNotFoundError:
        msg = f"{path}: no such file; real grasps are a folder with grasps.csv and images/"
        raise DatasetError(msg) from None
    except (OSError, ValueError) as error:
        msg = f"{path}: cannot be read: {csv_problem(error)}"
        raise DatasetError(msg) from None
    table.columns = [str(name).strip() for name in table.columns]
    missing = [name for name in (*REQUIRED, *needs) if name not in table.columns]
    if missing:
        why = "; without force and place a grasp cannot be simulated" if needs else ""
        others = [name for name in table.columns if name not in GRASPS]
        near = "".join(did_you_mean(name, others) for name in missing)
        needed = f"this needs {', '.join((*REQUIRED, *needs))}{why}"
        msg = f"{path}: has no column {', '.join(missing)}{near}; {needed}"
        raise DatasetError(msg)
    if table.empty:
        msg = f"{path}: holds no grasps"
        raise DatasetError(msg)
    return table


def _problems(
    table: pd.DataFrame, path: Path, known_objects: Sequence[str], needs: Sequence[str]
) -> list[str]:
    problems = []

    def add(row: int, text: str) -> None:
        problems.append(f"{path}:{row + 2}: {text}")

    for row, record in enumerate(table.to_dict("records")):
        for text in _row_problems(record, needs):
            add(row, text)
    for name in table["object"].unique() if known_objects else ():
        if name not in known_objects:
            rows = np.flatnonzero(table["object"] == name)
            where = "1 row" if len(rows) == 1 else f"{len(rows)} rows, the first"
            hint = unknown_object_hint(name, known_objects)
            add(rows[0], f"object = {name!r} ({where}) is not an object here{hint}")
    for grasp_id in table["grasp_id"][table["grasp_id"].duplicated()].unique():
        first, second = np.flatnonzero(table["grasp_id"] == grasp_id)[:2]
        known = f"grasp_id {grasp_id!r} stands on line {first + 2} already"
        add(second, f"{known}; give each grasp its own")
    return problems


def _row_problems(record: Mapping[str, str], needs: Sequence[str]) -> Iterator[str]:
    for name in [name for name in (*CONFIGURATION, "yaw_rad") if name in record]:
        empty = record[name] == "" and name not in needs
        if not empty and not np.isfinite(_number(record[name])):
            yield f"{name} = {record[name]!r} is no number; give it or drop the row"
    for name in filter(record.get, FRAMES):
        if not (_number(record[name]).is_integer() and _number(record[name]) >= 0):
            yield f"{name} = {record[name]!r} is no number of an image, from 0; leave it out"
    if _number(record.get("force_n", "")) <= 0:
        yield f"force_n = {record['force_n']} is no force to grip with"
    if _number(record["label"]) not in (0.0, 1.0):
        wrong = f"label = {record['label']!r} is neither 1 (success) nor 0 (failure)"
        yield f"{wrong}; write one of them or drop the row"
    if (mode := record.get("failure_mode", "")) not in FAILURE_MODES:
        yield f"failure_mode = {mode!r} is none of {', '.join(FAILURE_MODES[1:])}"


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")


def _grasp(folder: Path, number: int, record: Mapping[str, Any], unused: list[str]) -> RealGrasp:
    axes = {name: _number(record.get(name, "")) for name in CONFIGURATION}
    yaw_rad = float(record.get("yaw_rad") or 0.0)
    config = GraspConfig(index=number, object=record["object"], yaw_rad=yaw_rad, **axes)
    name, label = record["grasp_id"], int(float(record["label"]))
    images = _images(folder, name, unused)
    frames = [int(float(record.get(column) or FRAME_UNKNOWN)) for column in FRAMES]
    return RealGrasp(name, config, label, record.get("failure_mode", ""), images, *frames)


def _images(folder: Path, grasp_id: str, unused: list[str]) -> tuple[Path, ...]:
    """The pictures in ``images/<grasp_id>`` in time order; a name cannot lead out of the folder.

    Where not all names fit one order, those that are plain numbers are taken, and a line on the
    others is added to ``unused``.
    """
    if Path(grasp_id).name != grasp_id:
        return ()
    try:
        names = sorted((folder / "images" / grasp_id).iterdir())
    except (OSError, ValueError):  # no name that a folder can have
        return ()
    found = [path for path in names if path.suffix.lower() in IMAGE_SUFFIXES]
    reason = "no PNG or JPEG"
    try:
        ordered = in_time_order(found, DatasetError)
    except DatasetError as error:
        reason = str(error).partition(": ")[2]
        plain = [path for path in found if path.stem.isdecimal()]
        try:
            ordered = in_time_order(plain, DatasetError)
        except DatasetError:
            ordered = []
    if len(ordered) < len(names):
        others = [path.name for path in names if path not in ordered]
        listed = ", ".join(others[:MAX_PROBLEMS_SHOWN])
        unused.append(f"{folder / 'images' / grasp_id}: {listed} not used: {reason}")
    return tuple(ordered)


def _warnings(grasps: Sequence[RealGrasp], path: Path) -> list[str]:
    labels_at: dict[tuple[object, ...], dict[int, str]] = {}
    for grasp in grasps:
        labels_at.setdefault(grasp.config.point, {}).setdefault(grasp.label, grasp.grasp_id)
    contradictions = [ids for ids in labels_at.values() if len(ids) > 1]
    warnings = [
        f"{path}: grasps {ids[0]!r} and {ids[1]!r} have the same configuration and opposite "
        "labels; both are kept, and no simulation can match both"
        for ids in contradictions
    ]
    for name in dict.fromkeys(grasp.config.object for grasp in grasps):
        labels = {grasp.label for grasp in grasps if grasp.config.object == name}
        if len(labels) == 1:
            word = "succeeded" if labels == {1} else "failed"
            warnings.append(f"{path}: every grasp of {name} {word}; friction can only be bounded")
    return warnings

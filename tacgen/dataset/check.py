"""What must hold for a grasp and for a shard, whether about to be written or read back."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tacgen.core.errors import DatasetError
from tacgen.core.files import sha256_of
from tacgen.core.records import LABEL_FAILURE, LABEL_NOT_EXECUTED, LABEL_SUCCESS
from tacgen.dataset.manifest import ShardLine
from tacgen.dataset.samples import DatasetSpec, GraspSample, PadSample
from tacgen.dataset.schema import CONTACT_NAMES, FAILURE_MODES, MAX_OBJECT_BYTES, SPLITS, STATUSES
from tacgen.dataset.shard import Shard, broken_as_error, is_image_sound, open_shard, read_image

OUTCOME = {LABEL_SUCCESS: "success", LABEL_FAILURE: "failure", LABEL_NOT_EXECUTED: "not_executed"}


Outcome = tuple[int, str, str, str, str]  # of a grasp: label, status, failure mode, split, object


def tally(grasps: Iterable[Outcome]) -> dict[str, Any]:
    """The counts of a shard's line, by the names of its fields."""
    none = dict.fromkeys(OUTCOME.values(), 0)
    found: dict[str, Any] = {"counts": dict(none), "status": {}, "failure_modes": {}, "splits": {}}
    objects: dict[str, dict[str, int]] = {}
    for label, *own, name in grasps:
        objects.setdefault(name, dict(none))[OUTCOME[label]] += 1
        for counts, key in zip(found.values(), (OUTCOME[label], *own), strict=True):
            counts[key] = counts.get(key, 0) + 1
    found["failure_modes"].pop("", None)
    return found | {"objects": objects}


Decode = Literal["none", "first", "all"]
_MAX_NAMED = 5  # enough to see a pattern in a message


def byte_problems(path: Path, line: ShardLine) -> list[str]:
    """Whether the file ``path`` has the bytes that ``line`` of the manifest says."""
    if not path.is_file():
        return ["is missing"]
    if (size := path.stat().st_size) != line.bytes:
        return [f"has {size} bytes, not {line.bytes}"]
    if sha256_of(path) != line.sha256:
        return ["does not have the bytes that were written (its SHA-256 differs)"]
    return []


def content_problems(path: Path, line: ShardLine, *, decode: Decode) -> list[str]:
    """Everything in the file ``path`` that is not as ``line`` says, or cannot be.

    ``decode`` says which images are decompressed: none, those of the first executed grasp at the
    moment of grasp, or all. Every other image is still known to be there, with a header that fits.
    """
    try:
        with open_shard(path) as shard, broken_as_error(path):
            return list(_content_problems(shard, line, decode))
    except DatasetError as error:
        return [text.removeprefix(f"{path}: ") for text in str(error).splitlines()]


def _content_problems(shard: Shard, line: ShardLine, decode: Decode) -> Iterator[str]:
    layout = shard.layout
    said = {
        "sensor": layout.sensor,
        "pads": layout.pads,
        "recipe_sha256": shard.recipe_sha256,
        "index_range": shard.index_range,
        "frames": shard.arrays["/time_s"].id.shape[0],
    }
    for name, here in said.items():
        if here != getattr(line, name):
            yield f"{name} is {here}, but {getattr(line, name)} in the manifest"
    columns = {a.path: shard.read(a.path) for a in layout.arrays() if not a.image}
    for array in layout.arrays():
        values = columns.get(array.path)
        if values is not None and values.dtype.kind == "f" and not array.nan:
            yield from _named(array.path, ~np.isfinite(values), "is not finite")
    yield from _grasp_problems(columns, line)
    yield from _image_problems(shard, columns, decode)


def _grasp_problems(columns: dict[str, NDArray[Any]], line: ShardLine) -> Iterator[str]:
    index = columns["/grasp/index"]
    if not np.array_equal(index, np.arange(*line.index_range)):
        yield f"/grasp/index is not {line.index_range[0]} to {line.index_range[1] - 1}, each once"
    seeds, times = np.unique(columns["/grasp/seed"], return_counts=True)
    yield from _named(
        "/grasp/seed", np.isin(columns["/grasp/seed"], seeds[times > 1]), "is the same grasp again"
    )
    texts = [
        [bytes(text).decode("utf-8", "replace") for text in columns[f"/grasp/{name}"]]
        for name in ("status", "failure_mode", "split", "object")
    ]
    grasps = list(zip(map(int, columns["/grasp/label"]), *texts, strict=True))
    for number, (label, status, mode, split, _) in zip(index, grasps, strict=True):
        problem = outcome_problem(label, status, mode, split)
        if problem:
            yield f"grasp {number}: {problem}"
            return
    for name, counts in tally(grasps).items():
        if counts != getattr(line, name):
            yield f"{name} are {counts}, but {getattr(line, name)} in the manifest"
    frame = columns["/grasp/grasp_frame"]
    yield from _named("/grasp/grasp_frame", (frame < 0) | (frame >= line.frames), "is no frame")


def _image_problems(
    shard: Shard, columns: dict[str, NDArray[Any]], decode: Decode
) -> Iterator[str]:
    executed = np.flatnonzero(columns["/grasp/status"] == b"executed")
    moments = columns["/grasp/grasp_frame"]
    for array in shard.layout.arrays():
        if not array.image:
            continue
        dataset = shard.arrays[array.path]
        per_frame = array.shape[1] == "T"
        n_frames = dataset.shape[1] if per_frame else 1
        rows: Iterable[int] = executed if array.shape[0] == "N" else (-1,)
        for row, frame in itertools.product(rows, range(n_frames)):
            place = () if row < 0 else (int(row), frame)[: 1 + per_frame]
            first = row in (-1, *executed[:1]) and frame == (moments[row] if per_frame else 0)
            if not is_image_sound(dataset, place):
                if array.path != "/scene/picture":
                    yield f"{array.path}: the image {place} is missing"
            elif decode == "all" or (decode == "first" and first):
                image = read_image(dataset, place)
                if image.dtype.kind == "f" and not np.isfinite(image).all():
                    yield f"{array.path}: the image {place} is not finite"


def _named(path: str, wrong: NDArray[np.bool_], words: str) -> Iterator[str]:
    """One problem that names the first rows at which ``wrong`` is true."""
    rows = np.unique(np.nonzero(wrong)[0])
    if rows.size:
        more = "" if rows.size <= _MAX_NAMED else f" and {rows.size - _MAX_NAMED} more"
        yield f"{path}: row {', '.join(map(str, rows[:_MAX_NAMED]))}{more} {words}"


def sample_problems(sample: GraspSample, spec: DatasetSpec) -> list[str]:
    """Everything about ``sample`` that does not fit ``spec`` or itself; empty where it fits."""
    outcome = (sample.label, sample.status, sample.failure_mode, sample.split)
    problems = [outcome_problem(*outcome)]
    if not 1 <= len(sample.config.object.encode()) <= MAX_OBJECT_BYTES:
        problems.append(f"object {sample.config.object!r} is not of 1 to {MAX_OBJECT_BYTES} bytes")
    n_frames = len(spec.time_s)
    if not 0 <= sample.grasp_frame < n_frames:
        problems.append(f"grasp_frame {sample.grasp_frame} is not one of {n_frames} frames")
    if sample.object_pose is not None:
        problems += _array_problems("object_pose", sample.object_pose, (n_frames, 7))
    if sample.picture is not None and spec.picture_px is not None:
        problems += _array_problems("picture", sample.picture, (*spec.picture_px, 3), "uint8")
    if sample.status == "executed" and set(sample.pads) != set(spec.pads):
        problems.append(
            f"pads {', '.join(sorted(sample.pads)) or 'none'} are not {', '.join(spec.pads)}"
        )
    for pad in sorted(set(sample.pads) & set(spec.pads)):
        problems += [f"{pad} pad: {text}" for text in _pad_problems(sample.pads[pad], spec)]
    return [text for text in problems if text]


def outcome_problem(label: int, status: str, failure_mode: str, split: str) -> str:
    """What is wrong about a grasp's outcome and its split; empty where nothing is."""
    if status not in STATUSES:
        return f"status {status!r} is not one of {', '.join(STATUSES)}"
    if failure_mode not in FAILURE_MODES:
        return f"failure mode {failure_mode!r} is not one of {', '.join(FAILURE_MODES[1:])}"
    if label not in (LABEL_SUCCESS, LABEL_FAILURE, LABEL_NOT_EXECUTED):
        return f"label {label} is not 1, 0 or -1"
    if (label == LABEL_NOT_EXECUTED) != (status != "executed"):
        return f"label {label} does not go with status {status}"
    if failure_mode and label != LABEL_FAILURE:
        return f"failure mode {failure_mode} does not go with label {label}"
    return "" if split in SPLITS else f"split {split!r} is not one of {', '.join(SPLITS)}"


def _pad_problems(pad: PadSample, spec: DatasetSpec) -> Iterator[str]:
    n_frames, (height, width) = len(spec.time_s), spec.sensor.shape_px
    yield from _array_problems("rgb", pad.rgb, (n_frames, height, width, 3), "uint8")
    shapes: dict[str, tuple[int, ...]] = dict.fromkeys(CONTACT_NAMES, (n_frames,))
    shapes["force_shear_n"] = (n_frames, 2)
    if spec.depth:
        shapes["depth_mm"] = (height, width)
    for name, shape in shapes.items():
        array = getattr(pad, name)
        yield from [f"{name} is missing"] if array is None else _array_problems(name, array, shape)


def _array_problems(
    name: str, array: NDArray[Any], shape: tuple[int, ...], dtype: str = ""
) -> Iterator[str]:
    if array.shape != shape:
        yield f"{name} has shape {array.shape}, not {shape}"
    elif dtype and array.dtype != dtype:
        yield f"{name} is {array.dtype}, not {dtype}"
    elif array.dtype.kind not in "fiu":
        yield f"{name} is {array.dtype}, not numbers"
    elif array.dtype.kind == "f" and not np.isfinite(array).all():
        yield f"{name} is not finite"

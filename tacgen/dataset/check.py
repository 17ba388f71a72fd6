"""What must hold for a grasp and for a shard, whether just written or read back later."""

import itertools
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.core.errors import DatasetError
from tacgen.core.files import sha256_of
from tacgen.core.records import LABEL_FAILURE, LABEL_NOT_EXECUTED, LABEL_SUCCESS
from tacgen.dataset.manifest import ShardLine
from tacgen.dataset.schema import FAILURE_MODES, FLAG_FIELDS, SEGMENTS, SPLITS, STATUSES, Layout
from tacgen.dataset.shard import Shard, broken_as_error, is_image_sound, open_shard, read_image

OUTCOME = {LABEL_SUCCESS: "success", LABEL_FAILURE: "failure", LABEL_NOT_EXECUTED: "not_executed"}

GraspFacts = tuple[
    int, str, str, str, str
]  # of a grasp: label, status, failure mode, split, object


def tally(grasps: Iterable[GraspFacts]) -> dict[str, Any]:
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


def validity(columns: Mapping[str, NDArray[Any]], layout: Layout) -> dict[str, dict[str, int]]:
    """How many of a shard's frames, of all pads, and grasps at their moment do not show the force.

    ``columns`` are the shard's small arrays by their path.
    """
    executed = columns["/grasp/status"] == b"executed"
    found: dict[str, dict[str, int]] = {"frames": {}, "grasps": {}}
    for field in FLAG_FIELDS:
        pads = [columns[layout.path(field, pad)][executed] != 0 for pad in layout.pads]
        found["frames"][field.name] = int(np.sum(pads))
        found["grasps"][field.name] = int(flags_at_moment(columns, layout, field.name).sum())
    return found


def flags_at_moment(
    columns: Mapping[str, NDArray[Any]], layout: Layout, name: str
) -> NDArray[np.bool_]:
    """Whether a flag is set at the moment of grasp on any pad, (N,), by the arrays' paths."""
    field = next(field for field in FLAG_FIELDS if field.name == name)
    moments = columns["/grasp/grasp_frame"]
    rows = np.arange(len(moments))
    pads = [columns[layout.path(field, pad)][rows, moments] != 0 for pad in layout.pads]
    executed = columns["/grasp/status"] == b"executed"
    return np.asarray(executed & np.any(pads, axis=0))


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


def content_problems(path: Path, line: ShardLine, *, decode: bool = False) -> list[str]:
    """Everything in the file ``path`` that is not as ``line`` says, or cannot be.

    With ``decode`` every image is decompressed; without it, it is there with a header that fits.
    """
    try:
        with closing(open_shard(path)) as shard, broken_as_error(path):
            return list(_content_problems(shard, line, decode))
    except DatasetError as error:
        return [text.removeprefix(f"{path}: ") for text in str(error).splitlines()]


def _content_problems(shard: Shard, line: ShardLine, decode: bool) -> Iterator[str]:
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
    columns = shard.small_arrays()
    for array in layout.placed():
        values = columns.get(array.path)
        if values is not None and values.dtype.kind == "f" and not array.field.nan:
            yield from _named(array.path, ~np.isfinite(values), "is not finite")
    problems = list(_grasp_problems(columns, line))
    yield from problems
    if not problems and (found := validity(columns, layout)) != line.validity:
        yield f"validity is {found}, but {line.validity} in the manifest"
    executed = np.flatnonzero(columns["/grasp/status"] == b"executed")
    yield from _image_problems(shard, executed, decode)


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
        problem = _outcome_problem(label, status, mode, split)
        if problem:
            yield f"grasp {number}: {problem}"
            return
    for name, counts in tally(grasps).items():
        if counts != getattr(line, name):
            yield f"{name} are {counts}, but {getattr(line, name)} in the manifest"
    frame = columns["/grasp/grasp_frame"]
    yield from _named("/grasp/grasp_frame", (frame < 0) | (frame >= line.frames), "is no frame")


def _image_problems(shard: Shard, executed: NDArray[np.int64], decode: bool) -> Iterator[str]:
    for array in shard.layout.placed():
        if not array.field.image:
            continue
        dataset = shard.arrays[array.path]
        per_frame = array.shape[1] == "T"
        n_frames = dataset.shape[1] if per_frame else 1
        rows: Iterable[int] = executed if array.shape[0] == "N" else (-1,)
        for row, frame in itertools.product(rows, range(n_frames)):
            place = () if row < 0 else (int(row), frame)[: 1 + per_frame]
            if not is_image_sound(dataset, place):
                if array.path != "/scene/picture":
                    yield f"{array.path}: the image {place} is missing"
            elif decode:
                image = read_image(dataset, place)
                if array.path.endswith("/segmentation") and image.max() >= len(SEGMENTS):
                    yield f"{array.path}: the image {place} has a number without a name"
                if image.dtype.kind == "f" and not np.isfinite(image).all():
                    yield f"{array.path}: the image {place} is not finite"


def _named(path: str, wrong: NDArray[np.bool_], words: str) -> Iterator[str]:
    """One problem that names the first rows at which ``wrong`` is true."""
    rows = np.unique(np.nonzero(wrong)[0])
    if rows.size:
        more = "" if rows.size <= _MAX_NAMED else f" and {rows.size - _MAX_NAMED} more"
        yield f"{path}: row {', '.join(map(str, rows[:_MAX_NAMED]))}{more} {words}"


def _outcome_problem(label: int, status: str, failure_mode: str, split: str) -> str:
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

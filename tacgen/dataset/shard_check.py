"""Checking one shard: its bytes against the manifest, its arrays against what must hold."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tacgen.core.errors import DatasetError
from tacgen.core.files import sha256_of
from tacgen.dataset.check import outcome_problem
from tacgen.dataset.manifest import ShardLine
from tacgen.dataset.schema import SPLITS
from tacgen.dataset.shard import (
    Shard,
    broken_as_error,
    is_image_sound,
    open_shard,
    read_image,
)
from tacgen.dataset.tally import Tally

Decode = Literal["none", "first", "all"]
_MAX_NAMED = 5


def byte_problems(path: Path, line: ShardLine) -> list[str]:
    """Whether the file ``path`` has the bytes that ``line`` of the manifest says."""
    if not path.is_file():
        return ["is missing"]
    size = path.stat().st_size
    if size != line.bytes:
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
        "sensor": (layout.sensor, line.sensor),
        "pads": (layout.pads, line.pads),
        "recipe_sha256": (shard.recipe_sha256, line.recipe_sha256),
        "index_range": (shard.index_range, line.index_range),
        "frames": (shard.arrays["/time_s"].id.shape[0], line.frames),
    }
    for name, (here, there) in said.items():
        if here != there:
            yield f"{name} is {here}, but {there} in the manifest"
    columns = {a.path: shard.read(a.path) for a in layout.arrays() if not a.image}
    for array in layout.arrays():
        values = columns.get(array.path)
        if values is not None and values.dtype.kind == "f" and not array.nan:
            yield from _named(array.path, ~np.isfinite(values), "is not finite")
    yield from _grasp_problems(columns, line)
    yield from _image_problems(shard, columns, decode)


def _grasp_problems(columns: dict[str, NDArray], line: ShardLine) -> Iterator[str]:
    index = columns["/grasp/index"]
    if not np.array_equal(index, np.arange(*line.index_range)):
        yield f"/grasp/index is not {line.index_range[0]} to {line.index_range[1] - 1}, each once"
    seeds, times = np.unique(columns["/grasp/seed"], return_counts=True)
    yield from _named(
        "/grasp/seed", np.isin(columns["/grasp/seed"], seeds[times > 1]), "is the same grasp again"
    )
    label = columns["/grasp/label"]
    texts = {
        name: [bytes(text).decode("utf-8", "replace") for text in columns[f"/grasp/{name}"]]
        for name in ("status", "failure_mode", "split", "object")
    }
    tally = Tally()
    for row, (status, mode, split, name) in enumerate(zip(*texts.values(), strict=True)):
        problem = outcome_problem(int(label[row]), status, mode)
        if not problem and split not in SPLITS:
            problem = f"split {split!r} is not one of {', '.join(SPLITS)}"
        if problem:
            yield f"grasp {index[row]}: {problem}"
            return
        tally.add(int(label[row]), status, mode, split, name)
    for name, counts in tally.counts().items():
        if counts != getattr(line, name):
            yield f"{name} are {counts}, but {getattr(line, name)} in the manifest"
    frame = columns["/grasp/grasp_frame"]
    yield from _named("/grasp/grasp_frame", (frame < 0) | (frame >= line.frames), "is no frame")


def _image_problems(shard: Shard, columns: dict[str, NDArray], decode: Decode) -> Iterator[str]:
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
            place = () if row < 0 else (int(row), frame) if per_frame else (int(row),)
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
    rows = np.unique(np.nonzero(wrong)[0]) if wrong.any() else np.empty(0, int)
    if rows.size:
        more = "" if rows.size <= _MAX_NAMED else f" and {rows.size - _MAX_NAMED} more"
        yield f"{path}: row {', '.join(map(str, rows[:_MAX_NAMED]))}{more} {words}"

"""The manifest: one line of JSON for each finished shard, and one small file beside it.

The small files (``shards/shard-00000.json``) are the truth: each is written by the one process
that finished its shard. ``manifest.jsonl`` is all of them in one file, made by ``merge``; a
reader adds the small files that it does not hold yet. So no two writers share a file, and
merging twice, or at the same time on two machines, loses nothing.
"""

import json
import os
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Literal

from pydantic import (
    Field,
    NonNegativeInt,
    PositiveInt,
    TypeAdapter,
    ValidationError,
    model_validator,
)
from pydantic.dataclasses import dataclass

from tacgen.core.errors import DatasetError
from tacgen.core.files import read_small_text, write_text
from tacgen.core.resources import newer_problem

MAX_LINE_BYTES = 1 << 20  # a line has some kilobytes
MAX_SHARDS = 1_000_000  # of a dataset: with more, no file system lists them
MAX_SHARD_GRASPS = 1_000_000
FIX_MERGED = "remake the manifest with `tacgen merge`"
FIX_PART = "`tacgen collect` remakes that shard"


def shard_file(shard: int) -> str:
    """Path of a shard inside the dataset's folder."""
    return f"shards/shard-{shard:05d}.h5"


@dataclass(frozen=True, slots=True, kw_only=True, config={"extra": "forbid", "strict": True})
class ShardLine:
    """What the manifest says of one shard.

    ``counts`` counts ``success``, ``failure`` and ``not_executed``; ``objects`` does so by
    object. ``raw_bytes`` is the size of the arrays uncompressed. ``inputs`` names by role all that
    the shard depends on (see ``inputs.py``) and ``engine`` the physics engine, whose version stands
    in ``versions``; ``device`` drew the images, where the recipe asks for one; ``validity`` counts
    the ``frames``, and the ``grasps`` at their moment, that do not show the whole force, by the
    flags of the schema; ``part`` is 0, or counts how often the dataset had grown when the shard was
    added.
    """

    schema: Literal[1] = 1
    shard: NonNegativeInt
    file: str
    index_range: tuple[NonNegativeInt, NonNegativeInt]
    sha256: str
    bytes: PositiveInt
    raw_bytes: PositiveInt
    recipe: str
    recipe_sha256: str
    calibration: dict[str, str]
    sensor: str
    pads: Annotated[tuple[str, ...], Field(min_length=1)]
    frames: PositiveInt
    versions: dict[str, str]
    counts: dict[str, int]
    status: dict[str, int]
    failure_modes: dict[str, int]
    splits: dict[str, int]
    objects: dict[str, dict[str, int]]
    validity: dict[str, dict[str, int]] = Field(default_factory=dict)
    inputs: dict[str, str]
    engine: str
    part: NonNegativeInt
    device: str = ""

    @model_validator(mode="after")
    def _checked(self) -> "ShardLine":
        if self.index_range[0] >= self.index_range[1]:
            msg = f"index_range = {self.index_range} is not [start, stop]"
            raise ValueError(msg)
        if self.n_grasps > MAX_SHARD_GRASPS or self.shard >= MAX_SHARDS:
            msg = f"shard {self.shard} of {self.n_grasps} grasps is larger than any"
            raise ValueError(msg)
        if self.index_range[1] > MAX_SHARDS * MAX_SHARD_GRASPS:
            msg = f"index_range = {self.index_range} is larger than any"
            raise ValueError(msg)
        if self.file != shard_file(self.shard):
            msg = f"file = {self.file!r} is not that of shard {self.shard}"
            raise ValueError(msg)
        return self

    @property
    def n_grasps(self) -> int:
        """How many grasps the shard holds."""
        return self.index_range[1] - self.index_range[0]

    def to_json(self) -> str:
        """One line, the same for the same shard; without later keys that say nothing."""
        later = ("device",)
        found = {name: value for name, value in asdict(self).items() if value or name not in later}
        return json.dumps(found, sort_keys=True)


def parse_line(text: str, where: str, fix: str = FIX_MERGED) -> ShardLine:
    """The record that ``text`` holds; a ``DatasetError`` names its place ``where`` and ``fix``."""
    try:
        return TypeAdapter(ShardLine).validate_json(text)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(map(str, first["loc"]))
        if key == "schema" and (newer := newer_problem(first["input"], 1)):
            msg = f"{where}: {newer}"
            raise DatasetError(msg) from None
        problem = f"{key}: {first['msg']}" if key else first["msg"].removeprefix("Value error, ")
        msg = f"{where}: not a line of a manifest: {problem}; {fix}"
        raise DatasetError(msg) from None


def read_manifest(folder: Path) -> dict[int, ShardLine]:
    """Every finished shard's line, by shard, from ``manifest.jsonl`` and the files it lacks.

    Raises ``DatasetError`` if a line cannot be understood.
    """
    lines = read_lines(folder / "manifest.jsonl")
    missing = (path for path in part_paths(folder) if part_number(path) not in lines)
    lines.update((line.shard, line) for line in map(read_part, missing))
    return dict(sorted(lines.items()))


def merge_manifest(folder: Path) -> dict[int, ShardLine]:
    """Make the one ``manifest.jsonl`` of every finished shard; what it said before is kept.

    Raises ``DatasetError`` if a line cannot be understood, or nothing is there to merge.
    """
    path = folder / "manifest.jsonl"
    parts = [read_part(part) for part in part_paths(folder)]
    try:
        lines = read_lines(path)
    except DatasetError:
        # A broken manifest is remade as long as the files that it was made of are all there.
        lines = {}
        if not parts:
            raise
    lines.update((line.shard, line) for line in parts)
    if not lines:
        msg = f"{folder}: no finished shard to merge; `tacgen collect` makes them"
        raise DatasetError(msg)
    lines = dict(sorted(lines.items()))
    text = "".join(f"{line.to_json()}\n" for line in lines.values())
    if not path.is_file() or path.read_text(encoding="utf-8", errors="replace") != text:
        write_text(path, text)
    return lines


def manifest_problems(lines: Sequence[ShardLine], n_grasps: int | None) -> list[str]:
    """Gaps, overlaps and mixtures in a manifest; ``n_grasps`` is how many there are to be."""
    problems = []
    due = 0
    for line in lines:
        start, stop = line.index_range
        if start > due and n_grasps is not None:
            problems.append(f"grasps {due} to {start - 1} are missing; `tacgen collect` resumes")
        if start < due:
            problems.append(f"{line.file}: grasps {start} to {due - 1} are there twice")
        due = stop
    if n_grasps is not None and due < n_grasps:
        problems.append(f"grasps {due} to {n_grasps - 1} are missing; `tacgen collect` resumes")
    if n_grasps is not None and due > n_grasps:
        problems.append(f"grasps {n_grasps} to {due - 1} are more than the recipe asks for")
    for name in ("recipe_sha256", "calibration", "sensor", "pads", "frames"):
        odd = [line.file for line in lines if getattr(line, name) != getattr(lines[0], name)]
        if odd:
            which = f"{', '.join(odd[:3])} and {lines[0].file}"
            problems.append(f"{which} differ in {name}; keep them in two folders")
    problems += _mixed_inputs(lines)
    versions = {line.versions.get("tacgen", "") for line in lines}
    if len(versions) > 1:
        problems.append(f"shards of different versions of tacgen: {', '.join(sorted(versions))}")
    return problems


def _mixed_inputs(lines: Sequence[ShardLine]) -> list[str]:
    """A problem for each input that the shards were made with in two forms."""
    first: dict[str, ShardLine] = {}  # the first line that names each role
    mixed: dict[str, list[str]] = {}
    for line in lines:
        for role, digest in line.inputs.items():
            if first.setdefault(role, line).inputs[role] != digest:
                mixed.setdefault(role, []).append(line.file)
    return [
        f"{', '.join(odd[:3])} and {first[role].file} were made with another {role}; keep them in "
        "two folders"
        for role, odd in mixed.items()
    ]


def total(lines: Iterable[ShardLine], name: str) -> dict[str, int]:
    """The sum over lines of one of their ``counts``, ``status``, ``splits``, ``failure_modes``."""
    tally: Counter[str] = Counter()
    for line in lines:
        tally.update(getattr(line, name))
    return dict(sorted(tally.items()))


def read_lines(path: Path) -> dict[int, ShardLine]:
    """The lines of one ``manifest.jsonl``, by shard; none where it does not exist.

    Raises ``DatasetError`` if a line cannot be understood, or two are of the same shard.
    """
    if not path.is_file():
        return {}
    lines: dict[int, ShardLine] = {}
    with path.open(encoding="utf-8", errors="replace") as file:
        for number, text in enumerate(iter(lambda: file.readline(MAX_LINE_BYTES), ""), start=1):
            line = parse_line(text, f"{path}:{number}")
            if line.shard in lines:
                msg = f"{path}:{number}: shard {line.shard} stands there twice; run `tacgen merge`"
                raise DatasetError(msg)
            lines[line.shard] = line
    return lines


def part_paths(folder: Path) -> list[Path]:
    """The lines beside the shards; raises ``DatasetError`` if their folder may not be read."""
    shards = folder / "shards"
    if shards.is_dir() and not os.access(shards, os.R_OK | os.X_OK):
        msg = f"{shards}: permission denied; ask its owner for the right to read it"
        raise DatasetError(msg)
    return sorted(folder.glob("shards/shard-*.json"))


def part_number(path: Path) -> int:
    """The shard that a line beside it is of, by its name; −1 where it says none."""
    digits = path.stem.removeprefix("shard-")
    return int(digits) if digits.isdecimal() else -1


def read_part(path: Path) -> ShardLine:
    """The line that stands beside a shard.

    Raises ``DatasetError`` if it cannot be understood, or is that of another shard.
    """
    try:
        text = read_small_text(path, MAX_LINE_BYTES)
    except (OSError, ValueError) as error:
        msg = f"{path}: {getattr(error, 'strerror', None) or error}; {FIX_PART}"
        raise DatasetError(msg) from error
    line = parse_line(text, str(path), FIX_PART)
    if line.shard != part_number(path):
        fix = "it was copied: remove it and its .h5; `tacgen collect` makes what is missing then"
        msg = f"{path}: holds the line of shard {line.shard}; {fix}"
        raise DatasetError(msg)
    return line

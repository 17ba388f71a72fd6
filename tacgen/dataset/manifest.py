"""The manifest: one line of JSON for each finished shard, and one small file beside it.

The small files (``shards/shard-00000.json``) are the truth: each is written by the one process
that finished its shard. ``manifest.jsonl`` is all of them in one file, made by ``merge``; a
reader adds the small files that it does not hold yet. So no two writers share a file, and
merging twice, or at the same time on two machines, loses nothing.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tacgen.core.errors import DatasetError
from tacgen.core.files import read_small_text, write_text

SCHEMA = 1
MAX_LINE_BYTES = 1 << 20
FIX_MERGED = "remake the manifest with `tacgen merge`"
FIX_PART = "`tacgen collect` remakes that shard"


@dataclass(frozen=True, slots=True)
class ShardLine:
    """What the manifest says of one shard.

    ``counts`` counts ``success``, ``failure`` and ``not_executed``; ``objects`` does so by
    object. ``raw_bytes`` is the size of the arrays uncompressed.
    """

    shard: int
    file: str
    index_range: tuple[int, int]
    sha256: str
    bytes: int
    raw_bytes: int
    recipe: str
    recipe_sha256: str
    calibration: Mapping[str, str]
    sensor: str
    pads: tuple[str, ...]
    frames: int
    versions: Mapping[str, str]
    counts: Mapping[str, int]
    status: Mapping[str, int]
    failure_modes: Mapping[str, int]
    splits: Mapping[str, int]
    objects: Mapping[str, Mapping[str, int]]
    schema: int = SCHEMA

    def to_json(self) -> str:
        """One line, the same for the same shard."""
        return json.dumps(asdict(self), sort_keys=True)


def parse_line(text: str, where: str, fix: str = FIX_MERGED) -> ShardLine:
    """The record that ``text`` holds; ``where`` names the place in the error, ``fix`` what helps.

    Raises ``DatasetError`` if it is no such record.
    """
    try:
        data = json.loads(text)
    except (ValueError, RecursionError):
        data = None
    problem = _problem_of(data)
    if problem:
        msg = f"{where}: {problem}; {fix}"
        raise DatasetError(msg)
    data["index_range"] = tuple(data["index_range"])
    data["pads"] = tuple(data["pads"])
    return ShardLine(**data)


_COUNTS: dict[str, type] = {
    "counts": int,
    "status": int,
    "failure_modes": int,
    "splits": int,
    "calibration": str,
    "versions": str,
}
_FIELDS: dict[str, type] = {
    "shard": int,
    "file": str,
    "index_range": list,
    "sha256": str,
    "bytes": int,
    "raw_bytes": int,
    "recipe": str,
    "recipe_sha256": str,
    "sensor": str,
    "pads": list,
    "frames": int,
    "objects": dict,
    "schema": int,
} | dict.fromkeys(_COUNTS, dict)


def _problem_of(data: Any) -> str:
    """What is wrong with a parsed line; empty where nothing is."""
    if not isinstance(data, dict):
        return "not a line of a manifest"
    if data.get("schema") != SCHEMA:
        return f"schema {data.get('schema')!r} is not {SCHEMA}"
    odd = sorted(set(_FIELDS) ^ set(data))
    if odd:
        return f"keys missing or unknown: {', '.join(odd)}"
    for key, kind in _FIELDS.items():
        if not isinstance(data[key], kind) or isinstance(data[key], bool):
            return f"{key} = {data[key]!r} is not {kind.__name__}"
    for key, kind in _COUNTS.items():
        if not all(isinstance(value, kind) for value in data[key].values()):
            return f"{key} = {data[key]!r} does not hold {kind.__name__}"
    for tally in data["objects"].values():
        if not isinstance(tally, dict) or not all(isinstance(n, int) for n in tally.values()):
            return f"objects = {data['objects']!r} does not hold counts"
    span = data["index_range"]
    if len(span) != 2 or not all(isinstance(n, int) for n in span) or not 0 <= span[0] < span[1]:
        return f"index_range = {span!r} is not [start, stop]"
    if data["shard"] < 0 or data["file"] != shard_file(data["shard"]):
        return f"file = {data['file']!r} is not that of shard {data['shard']}"
    return ""


def shard_file(shard: int) -> str:
    """Path of a shard inside the dataset's folder."""
    return f"shards/shard-{shard:05d}.h5"


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


def manifest_problems(lines: list[ShardLine], n_grasps: int | None) -> list[str]:
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
        problems += _mixed(lines, name)
    versions = {line.versions.get("tacgen", "") for line in lines}
    if len(versions) > 1:
        problems.append(f"shards of different versions of tacgen: {', '.join(sorted(versions))}")
    return problems


def _mixed(lines: list[ShardLine], name: str) -> list[str]:
    odd = [line.file for line in lines if getattr(line, name) != getattr(lines[0], name)]
    if not odd:
        return []
    return [f"{', '.join(odd[:3])} and {lines[0].file} differ in {name}; keep them in two folders"]


def total(lines: Iterable[ShardLine], name: str) -> dict[str, int]:
    """The sum over lines of one of their ``counts``, ``status``, ``splits``, ``failure_modes``."""
    tally: dict[str, int] = {}
    for line in lines:
        for key, count in getattr(line, name).items():
            tally[key] = tally.get(key, 0) + count
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
    """The lines that stand beside the shards.

    Raises ``DatasetError`` if the folder is there, but may not be looked into.
    """
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
        reason = error.strerror if isinstance(error, OSError) else error
        msg = f"{path}: {reason}; {FIX_PART}"
        raise DatasetError(msg) from error
    line = parse_line(text, str(path), FIX_PART)
    if line.shard != part_number(path):
        msg = f"{path}: holds the line of shard {line.shard}; {FIX_PART}"
        raise DatasetError(msg)
    return line

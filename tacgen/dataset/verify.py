"""Checking a dataset on disk: every byte by its hash, every grasp by what must hold for it."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tacgen.core.errors import DatasetError, RecipeError, TacgenError
from tacgen.core.files import sha256_of_content
from tacgen.dataset import manifest
from tacgen.dataset.check import byte_problems, content_problems
from tacgen.dataset.folder import DatasetFolder
from tacgen.dataset.input_hashes import changed_roles
from tacgen.dataset.samples import shard_range

_FOREIGN = "no shard of this dataset: remove it, and the .json of its name"


@dataclass(frozen=True, slots=True)
class Problem:
    """What is wrong, and with which file; ``shard`` is −1 where it is not one shard's fault."""

    file: str
    reason: str
    shard: int = -1


@dataclass(frozen=True, slots=True)
class Verification:
    """What ``verify`` found."""

    problems: tuple[Problem, ...]
    n_shards: int
    n_grasps: int
    bytes: int

    @property
    def bad_shards(self) -> tuple[int, ...]:
        """The shards to be made anew."""
        return tuple(sorted({p.shard for p in self.problems if p.shard >= 0}))

    @property
    def foreign(self) -> tuple[str, ...]:
        """Lines on what lies among the shards and is none: making shards anew does not mend it."""
        odd = (p for p in self.problems if p.shard < 0 and p.file.startswith("shards/"))
        return tuple(f"{p.file}: {p.reason}" for p in odd)

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``."""
        return {
            "ok": not self.problems,
            "shards": self.n_shards,
            "grasps": self.n_grasps,
            "bytes": self.bytes,
            "bad_shards": list(self.bad_shards),
            "problems": [{"file": p.file, "reason": p.reason} for p in self.problems],
        }


def verify(
    root: Path | str, *, decode: bool = False, progress: Callable[[int], None] = lambda _: None
) -> Verification:
    """Check the whole dataset in ``root``.

    ``decode`` also decompresses every image; without it the hash of the shard vouches for them,
    taken when the shard was written and checked. ``progress`` gets the bytes of each shard
    that is through.

    Raises ``DatasetError`` if there is no dataset at all.
    """
    folder = DatasetFolder(root)
    lines, problems = _all_lines(folder)
    if not lines and not problems and not folder.plan_path.is_file():
        msg = f"{folder.root} is not a dataset; give the folder that `tacgen collect --out` made"
        raise DatasetError(msg)
    paths = [folder.shard_path(shard) for shard in lines]
    with ThreadPoolExecutor(max_workers=1) as thread:
        # The next shards are hashed, which needs no lock, while this one is looked into.
        hashed = thread.map(byte_problems, paths, lines.values())
        for path, line, wrong_bytes in zip(paths, lines.values(), hashed, strict=True):
            reasons = wrong_bytes or content_problems(path, line, decode=decode)
            problems += [Problem(line.file, reason, line.shard) for reason in reasons]
            progress(line.bytes)
    problems += _whole_problems(folder, lines)
    n_grasps = sum(line.n_grasps for line in lines.values())
    n_bytes = sum(line.bytes for line in lines.values())
    return Verification(tuple(problems), len(lines), n_grasps, n_bytes)


def _all_lines(folder: DatasetFolder) -> tuple[dict[int, manifest.ShardLine], list[Problem]]:
    """Every line that can be read; a shard's own wins over the merged one, which must agree."""
    problems = []
    try:
        merged = manifest.read_lines(folder.manifest_path)
    except DatasetError as error:
        merged = {}
        problems.append(Problem("manifest.jsonl", _without_path(error, folder.manifest_path)))
    lines = dict(merged)
    for path in manifest.part_paths(folder.root):
        name = path.relative_to(folder.root).as_posix()
        try:
            line = manifest.read_part(path)
        except DatasetError as error:
            shard = manifest.part_number(path)
            problems.append(Problem(name, _without_path(error, path), shard))
            continue
        if line.shard in merged and merged[line.shard] != line:
            reason = f"{name} says otherwise about the shard; `tacgen merge` brings them together"
            problems.append(Problem("manifest.jsonl", reason))
        lines[line.shard] = line
    return dict(sorted(lines.items())), problems


def _whole_problems(folder: DatasetFolder, lines: dict[int, manifest.ShardLine]) -> list[Problem]:
    n_grasps, n_shards = None, 0
    problems = []
    if lines or folder.plan_path.exists():
        try:
            plan = folder.plan()
            n_grasps, n_shards = plan["n_grasps"], plan["n_shards"]
            problems += _plan_problems(folder, plan, list(lines.values()))
        except DatasetError as error:
            problems.append(Problem(folder.plan_path.name, _without_path(error, folder.plan_path)))
    files = {f"shards/{path.name}" for path in folder.root.glob("shards/*.h5")}
    for name in sorted(files - {line.file for line in lines.values()}):
        shard = manifest.part_number(Path(name))
        is_due = 0 <= shard < n_shards
        reason = "is not in the manifest: " + ("unfinished" if is_due else _FOREIGN)
        problems.append(Problem(name, reason, shard if is_due else -1))
    found = manifest.manifest_problems(list(lines.values()), n_grasps)
    return problems + [Problem("manifest.jsonl", reason) for reason in found]


def _plan_problems(
    folder: DatasetFolder, plan: dict[str, Any], lines: list[manifest.ShardLine]
) -> list[Problem]:
    """Where ``dataset.json`` or ``recipe.yaml`` differ from the shards."""
    problems = []
    size, n_grasps, name = plan["shard_size"], plan["n_grasps"], folder.plan_path.name
    parts = plan["parts"]
    n_shards = sum(-(-part // size) for part in parts)
    if plan["n_shards"] != n_shards or sum(parts) != n_grasps:
        reason = f"n_shards is {plan['n_shards']} for {n_grasps} grasps, {size} a shard"
        problems.append(Problem(name, reason))
    odd: list[tuple[manifest.ShardLine, str]] = []
    for line in lines:
        due = shard_range(parts, size, line.shard)[1]
        recorded = {
            "recipe_sha256": line.recipe_sha256,
            "calibration": line.calibration,
            "sensor": line.sensor,
            "pads": list(line.pads),
            "tacgen_version": line.versions.get("tacgen"),
        }
        differing = ["index_range"] if (due.start, due.stop) != line.index_range else []
        differing += [key for key, there in recorded.items() if plan.get(key) != there]
        differing += changed_roles(line.inputs, plan["inputs"])
        is_beyond = 0 < len(plan["grids"]) <= line.part
        differing += ["grid"] if is_beyond else []
        odd += [(line, ", ".join(differing))] if differing else []
    for line, what in odd:
        if len(odd) == len(lines):  # the one file is wrong, or all shards are to be made anew
            problems.append(Problem(name, f"differs from {line.file} in {what}", line.shard))
        elif line.shard >= n_shards:
            problems.append(Problem(line.file, _FOREIGN))
        else:
            reason = f"was made with another {what} than {name} says"
            problems.append(Problem(line.file, reason, line.shard))
    try:
        if sha256_of_content(folder.recipe()) == plan.get("resolved_sha256"):
            return problems
        reason = "is not the recipe that dataset.json is of"
    except RecipeError as error:
        reason = _without_path(error, folder.recipe_path)
    reason = f"{reason}; `tacgen collect` with that recipe writes it again"
    return [*problems, Problem(folder.recipe_path.name, reason)]


def _without_path(error: TacgenError, path: Path) -> str:
    return str(error).removeprefix(f"{path}:").strip()

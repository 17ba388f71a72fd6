"""The folder of a dataset: all its paths, who may write to it, and how a shard gets there.

``dataset.json``, the plan, holds what all shards of a folder have in common.
"""

import contextlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import yaml

from tacgen.core.errors import DatasetError, RecipeError
from tacgen.core.files import (
    alone,
    atomic_path,
    disk_errors,
    holder_of,
    locked,
    read_small_text,
    refuse_foreign,
    sha256_of_content,
    write_text,
)
from tacgen.core.resources import __version__, newer_problem
from tacgen.core.schema import read_yaml
from tacgen.dataset.check import content_problems
from tacgen.dataset.input_hashes import GRID, changed_roles
from tacgen.dataset.manifest import (
    MAX_SHARDS,
    ShardLine,
    merge_manifest,
    part_number,
    part_paths,
    read_lines,
    read_manifest,
    read_part,
    shard_file,
)
from tacgen.dataset.samples import DatasetSpec, GraspSample
from tacgen.dataset.writer import write_shard_file

MAX_VALUE_CHARS = 120  # of a setting in a message: longer ones are shortened to what they list
MAX_PLAN_BYTES = 64 << 20  # a plan has some kilobytes, and the axes of each object


class MissingPlanError(DatasetError):
    """There is no plan, or it cannot be read."""


class DatasetFolder:
    """Every path of a dataset, and the steps that change it.

    A writer calls ``prepare`` once, then for each of its shards::

        with folder.claim(shard) as mine:
            if mine:
                folder.write_shard(shard, samples, spec)
        folder.merge()

    A shard counts as done when its line of the manifest is there and the file has its size;
    what a killed process leaves behind is neither, and is made anew.
    """

    def __init__(self, root: Path | str) -> None:
        self.root = Path(root)
        self.recipe_path = self.root / "recipe.yaml"
        self.plan_path = self.root / "dataset.json"
        self.manifest_path = self.root / "manifest.jsonl"
        self.card_path = self.root / "README.md"
        self.gallery_path = self.root / "index.html"

    def shard_path(self, shard: int) -> Path:
        """``shards/shard-00000.h5``."""
        return self.root / shard_file(shard)

    def line_path(self, shard: int) -> Path:
        """``shards/shard-00000.json``: the shard's line of the manifest."""
        return self.shard_path(shard).with_suffix(".json")

    def lock_path(self, shard: int) -> Path:
        """``shards/shard-00000.lock``: held while a process works on the shard."""
        return self.shard_path(shard).with_suffix(".lock")

    def prepare(self, spec: DatasetSpec, *, grow: bool = False) -> None:
        """Make the folder ready for shards of ``spec``, or check that it is.

        With ``grow`` a dataset of which ``spec`` has all grasps and more gets the others too.

        Raises ``DatasetError`` if it cannot be written to, or holds a dataset of another recipe,
        object, sensor, calibration, engine or version; the message shows the difference and says
        how to go on.
        """
        plan = {
            "schema": 1,
            "tacgen_version": __version__,
            "recipe": spec.recipe.get("name", ""),
            "recipe_sha256": spec.recipe_sha256,
            "resolved_sha256": sha256_of_content(spec.recipe),
            "calibration": spec.calibration,
            "inputs": spec.inputs.sha256,
            "engine": spec.inputs.engine,
            **({"device": spec.inputs.device} if spec.inputs.device else {}),
            "versions": spec.inputs.versions,
            "sensor": spec.sensor.name,
            "colors_from": spec.colors_from,
            "pads": spec.pads,
            "n_grasps": spec.n_grasps,
            "shard_size": spec.shard_size,
            "n_shards": spec.n_shards,
            "grids": spec.grids,
            "parts": spec.part_sizes,
        }
        with disk_errors(self.root):
            (self.root / "shards").mkdir(parents=True, exist_ok=True)
            if self._to_write(plan, spec, grow=grow):
                # Another process may prepare or grow it at the same time.
                lock, fix = self.root / "dataset.lock", "run this again"
                with alone(lock, self.root, "preparing it", DatasetError, fix):
                    for path, content in self._to_write(plan, spec, grow=grow):
                        write_text(path, content)

    def is_done(self, shard: int) -> bool:
        """Whether the shard is finished and its file is there, whole by its size.

        One whose line cannot be read is not: it is to be made again.
        """
        line, path = self._line(shard), self.shard_path(shard)
        return line is not None and path.is_file() and path.stat().st_size == line.bytes

    @contextlib.contextmanager
    def claim(self, shard: int, *, redo: bool = False) -> Iterator[bool]:
        """Whether the caller may write the shard now; it holds the lock until the block ends.

        False where another process works on it, or where it is done (unless ``redo``). The
        system frees the lock of a process that dies. Where the file system has no locks, two
        processes may do the same work; they write the same bytes under names of their own.
        """
        with contextlib.ExitStack() as stack:
            with disk_errors(self.root):
                held = stack.enter_context(locked(self.lock_path(shard)))
            # Whoever held the lock before may have finished the shard.
            if not redo:
                self._refuse_foreign(shard)
            mine = held is not False and (redo or not self.is_done(shard))
            if mine and held:
                for path in self.root.glob(f"shards/.{self.shard_path(shard).stem}.*.part"):
                    path.unlink(missing_ok=True)
            yield mine

    def write_shard(
        self, shard: int, samples: Iterable[GraspSample], spec: DatasetSpec
    ) -> ShardLine:
        """Write one shard, whole or not at all, and then its line of the manifest.

        Raises ``DatasetError`` if a grasp does not fit, the folder is gone or not prepared for
        this recipe, or the disk is full or may not be written to.
        """
        if self.plan().get("recipe_sha256") != spec.recipe_sha256:
            msg = f"{self.root}: now holds a dataset of another recipe; give another --out"
            raise DatasetError(msg)
        with disk_errors(self.root, "finished shards are kept"):
            self.line_path(shard).unlink(missing_ok=True)
            path = self.shard_path(shard)
            with atomic_path(path) as partial:
                line = write_shard_file(partial, samples, spec, shard)
                problems = content_problems(partial, line)
                DatasetError.raise_if([f"{path}: {text}" for text in problems])
            write_text(self.line_path(shard), f"{line.to_json()}\n")
        return line

    def manifest(self) -> dict[int, ShardLine]:
        """Every finished shard's line, by shard; complete whether or not it was merged."""
        return read_manifest(self.root)

    def merge(self) -> dict[int, ShardLine]:
        """Make the one ``manifest.jsonl`` out of the shards' own lines."""
        with disk_errors(self.root):
            return merge_manifest(self.root)

    def plan(self) -> dict[str, Any]:
        """What ``dataset.json`` says; raises ``DatasetError`` if the folder is not a dataset's."""
        plan: dict[str, Any] = {}
        is_whole = False
        with contextlib.suppress(
            FileNotFoundError, ValueError, KeyError, TypeError, AttributeError, RecursionError
        ):
            plan = json.loads(read_small_text(self.plan_path, MAX_PLAN_BYTES))
            if problem := newer_problem(plan.get("schema", 1), 1):
                msg = f"{self.plan_path}: {problem}"
                raise DatasetError(msg)
            numbers = [plan[name] for name in ("n_grasps", "shard_size", "n_shards")]
            kinds = {"inputs": dict, "grids": list, "parts": list}
            # JSON's true is an int in Python.
            is_whole = (
                all(isinstance(number, int) and number > 0 for number in numbers)
                and all(isinstance(plan[name], kind) for name, kind in kinds.items())
                and all(type(part) is int and part > 0 for part in plan["parts"])
                and all(isinstance(record, dict) for grid in plan["grids"] for record in grid)
            )
        if not is_whole:
            fix = "give the folder that `tacgen collect --out` made"
            name = self.plan_path.name
            msg = f"{self.root} is not a dataset: {name} is missing or broken; {fix}"
            raise MissingPlanError(msg)
        if plan["n_shards"] > MAX_SHARDS or plan["n_grasps"] > MAX_SHARDS * plan["shard_size"]:
            n_shards = max(plan["n_shards"], -(-plan["n_grasps"] // plan["shard_size"]))
            msg = f"{self.plan_path}: {n_shards:g} shards, more than {MAX_SHARDS}; make fewer"
            raise DatasetError(msg)
        return plan

    def recipe(self) -> dict[str, Any]:
        """What ``recipe.yaml`` says; raises ``RecipeError`` if it is missing or broken."""
        return read_yaml(self.recipe_path).data

    def running(self) -> list[tuple[int, str]]:
        """(shard, who) for each shard that some process holds now."""
        locks = sorted(self.root.glob("shards/shard-*.lock"))
        found = [(part_number(path), holder_of(path)) for path in locks]
        return [(shard, holder) for shard, holder in found if shard >= 0 and holder]

    def grids(self) -> list[Any]:
        """The grids of the dataset, one after another (see ``GraspPlan``); none where it is new."""
        with contextlib.suppress(MissingPlanError):
            return list(self.plan()["grids"])
        return []

    def _line(self, shard: int) -> ShardLine | None:
        own = self.line_path(shard)
        with contextlib.suppress(DatasetError):
            return read_part(own) if os.path.lexists(own) else self._merged.get(shard)
        return None

    def _refuse_foreign(self, shard: int) -> None:
        """Raise a ``DatasetError`` where a shard is there that was made with other inputs."""
        line = self._line(shard)
        roles = changed_roles(line.inputs, self.plan()["inputs"]) if line else []
        if roles:
            msg = (
                f"{self.shard_path(shard)}: was made with another {', '.join(roles)} than this "
                "dataset; keep them in two folders, or make it anew with `tacgen collect --repair`"
            )
            raise DatasetError(msg)

    @cached_property
    def _merged(self) -> dict[int, ShardLine]:
        """``manifest.jsonl`` as it stood at first; later shards have lines of their own."""
        return read_lines(self.manifest_path)

    def _to_write(
        self, plan: Mapping[str, Any], spec: DatasetSpec, *, grow: bool
    ) -> list[tuple[Path, str]]:
        """The files, and their content, that the dataset of ``plan`` lacks.

        Raises ``DatasetError`` if the folder holds another dataset, or something else.
        """
        text = json.dumps(plan, indent=1, sort_keys=True)
        try:
            self._refuse_another(self.plan(), json.loads(text), spec, grow=grow)
        except MissingPlanError:
            self._refuse_other_shards(spec)
        recipe = yaml.safe_dump(dict(spec.recipe), sort_keys=False, allow_unicode=True)
        wanted = ((self.plan_path, text), (self.recipe_path, recipe))
        return [
            (path, content)
            for path, content in wanted
            if not (path.is_file() and path.read_bytes() == content.encode())
        ]

    def _refuse_other_shards(self, spec: DatasetSpec) -> None:
        """Where no plan says what the shards are of that are there, they say it themselves."""
        own = (self.recipe_path, self.manifest_path, self.card_path, self.gallery_path)
        if not part_paths(self.root):
            refuse_foreign(self.root, self.plan_path.name, [path.name for path in own])
        wanted = (spec.recipe_sha256, dict(spec.calibration), __version__)
        for path in part_paths(self.root):
            here: tuple[object, ...] = wanted
            roles: list[str] = []
            with contextlib.suppress(DatasetError):
                line = read_part(path)
                here = (line.recipe_sha256, line.calibration, line.versions.get("tacgen"))
                roles = changed_roles(line.inputs, spec.inputs.sha256)
                roles += ["grid"] if line.part >= len(spec.part_sizes) else []
            if here != wanted or roles:
                what = ", ".join(roles) or "recipe, calibration or version"
                fix = "give another --out, or delete the folder"
                msg = (
                    f"{self.root}: {path.name} is of another {what}, and {self.plan_path.name} is "
                    f"missing or broken; {fix}"
                )
                raise DatasetError(msg)

    def _refuse_another(
        self, made: Mapping[str, Any], plan: Mapping[str, Any], spec: DatasetSpec, *, grow: bool
    ) -> None:
        """Raise a ``DatasetError`` where a dataset that was ``made`` is not that of ``plan``."""
        roles = changed_roles(made["inputs"], plan["inputs"])
        roles = [role for role in roles if not role.startswith(GRID)]  # see the parts
        n_parts = len(made["parts"])
        is_grown = made["parts"][:n_parts] == plan["parts"][:n_parts]
        is_grown &= made["grids"] in ([], plan["grids"][:n_parts])
        is_grown &= made["n_grasps"] < plan["n_grasps"] or made["parts"] == plan["parts"]
        same = ["tacgen_version", "sensor", "pads", "shard_size"]
        same += [] if is_grown else ["n_grasps"]
        same += [] if roles else ["calibration"]
        lines = list(
            differences({key: made[key] for key in same}, {key: plan[key] for key in same})
        )
        is_said = any(role.endswith("recipe") for role in roles)
        if made["recipe_sha256"] != plan["recipe_sha256"] or is_said or not is_grown:
            lines += self._changed_settings(made, plan, spec.recipe)
        lines += [text for role in roles for text in _changed_input(role, made, plan, spec)]
        if not lines and is_grown and (made["parts"] == plan["parts"] or grow):
            return
        fix = "give another --out, set these back to what made it, or delete the folder"
        if not lines and not is_grown:
            lines = ["grid: other grasps there than now, perhaps by an object's own grasp_ranges"]
        elif not lines:
            more = plan["n_grasps"] - made["n_grasps"]
            lines = [f"the recipe has {more} grasps that are not in the plan of the dataset"]
            fix = "add them with `tacgen collect --grow`, or give another --out"
        elif grow and not is_grown:
            fix += "; --grow adds grasps to a recipe that still has all of those there"
        first = f"{self.root} holds another dataset; these differ:"
        raise DatasetError.from_problems([first, *(f"  {text}" for text in lines), fix])

    def _changed_settings(
        self, made: Mapping[str, Any], plan: Mapping[str, Any], recipe: Mapping[str, Any]
    ) -> list[str]:
        """What differs in the recipes; the hashes where there is no recipe to compare with."""
        with contextlib.suppress(RecipeError):
            old, new = self.recipe(), json.loads(json.dumps(recipe))
            uncounted = ("name", "description")
            return [
                text for text in differences(old, new) if text.partition(":")[0] not in uncounted
            ]
        return list(differences(made["recipe_sha256"], plan["recipe_sha256"], "recipe_sha256"))


def _changed_input(
    role: str, made: Mapping[str, Any], plan: Mapping[str, Any], spec: DatasetSpec
) -> Iterator[str]:
    """A line, or a few, on an input whose content is another than that of the dataset."""
    engine, other, old, new = made["engine"], plan["engine"], made["versions"], plan["versions"]
    if role == "engine":  # whose version is not known where it is not installed
        made_by = [old[engine]] if engine in old else []
        here = [new[other]] if other in new else []
        there, now = (" ".join([name, *v]) for name, v in ((engine, made_by), (other, here)))
        yield (
            f"engine: {there} there, {now} now; install it with `pip install "
            f"{'=='.join([engine, *made_by])}` and name it in the recipe: "
            f"`physics: {{engine: {engine}}}`"
        )
    elif role == "device":
        yield f"device: images drawn on {made['device']} there, on {plan['device']} now"
    elif role == "versions":
        libraries = set(old) & set(new) - {"tacgen", engine, other}
        for name in sorted(libraries):
            yield from differences(old[name], new[name], f"version of {name}")
    elif role != "recipe":
        file = spec.inputs.files.get(role)
        yield f"{role} ({file}) has changed" if file else f"{role} has changed"


def differences(old: Any, new: Any, where: str = "") -> Iterator[str]:
    """One line for each setting that differs: where, what it was, what it would be."""
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        for key in dict.fromkeys([*old, *new]):
            yield from differences(old.get(key), new.get(key), f"{where}.{key}" if where else key)
    elif _are_sections(old) and _are_sections(new) and len(old) == len(new):
        for k, pair in enumerate(zip(old, new, strict=True)):
            yield from differences(*pair, f"{where}[{k}]")
    elif old != new:
        yield f"{where}: {_short(old)} there, {_short(new)} now"


def _short(value: Any) -> str:
    """A value in a line: the names of what it lists, where it is long."""
    text = json.dumps(value)
    if len(text) <= MAX_VALUE_CHARS:
        return text
    if _are_sections(value):
        names = [str(one.get("dataset_name") or one.get("name") or "?") for one in value]
        text = f"{len(value)} ({', '.join(names)})"
    elif isinstance(value, list):
        text = f"{len(value)} values, {json.dumps(value[0])} to {json.dumps(value[-1])}"
    elif isinstance(value, Mapping):
        text = f"keys {', '.join(value)}"
    return text if len(text) <= MAX_VALUE_CHARS else f"{text[:MAX_VALUE_CHARS]} …"


def _are_sections(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(one, Mapping) for one in value)

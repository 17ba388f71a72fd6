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
from tacgen.core.files import atomic_path, read_small_text, write_text
from tacgen.core.lock import holder_of, locked
from tacgen.core.version import __version__
from tacgen.core.yaml_source import read_yaml
from tacgen.dataset.check import content_problems
from tacgen.dataset.disk import disk_errors
from tacgen.dataset.manifest import (
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

MAX_PLAN_BYTES = 1 << 20  # a plan has some kilobytes


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

    def prepare(self, spec: DatasetSpec) -> None:
        """Make the folder ready for shards of ``spec``, or check that it is.

        Raises ``DatasetError`` if it cannot be written to, or holds a dataset of another recipe,
        calibration or version of tacgen; the message shows the difference and says how to go on.
        """
        plan = {
            "schema": 1,
            "tacgen_version": __version__,
            "recipe": spec.recipe.get("name", ""),
            "recipe_sha256": spec.recipe_sha256,
            "calibration": dict(sorted(spec.calibration.items())),
            "sensor": spec.sensor.name,
            "pads": list(spec.pads),
            "n_grasps": spec.n_grasps,
            "shard_size": spec.shard_size,
            "n_shards": spec.n_shards,
        }
        with disk_errors(self.root):
            (self.root / "shards").mkdir(parents=True, exist_ok=True)
            try:
                made = self.plan()
            except DatasetError:
                self._refuse_other_shards(spec)
                write_text(self.plan_path, json.dumps(plan, indent=1, sort_keys=True))
                made = self.plan()
            if made != plan:
                self._refuse_another(made, plan, spec.recipe)
            recipe = yaml.safe_dump(dict(spec.recipe), sort_keys=False, allow_unicode=True)
            there = self.recipe_path
            if not (there.is_file() and there.read_bytes() == recipe.encode()):
                write_text(there, recipe)

    def is_done(self, shard: int) -> bool:
        """Whether the shard is finished and its file is there, whole by its size.

        One whose line cannot be read is not: it is to be made again.
        """
        own, path = self.line_path(shard), self.shard_path(shard)
        try:
            line = read_part(own) if os.path.lexists(own) else self._merged.get(shard)
        except DatasetError:
            return False
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
        with disk_errors(self.root):
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
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError, RecursionError):
            plan: dict[str, Any] = json.loads(read_small_text(self.plan_path, MAX_PLAN_BYTES))
            numbers = [plan[name] for name in ("n_grasps", "shard_size", "n_shards")]
            if all(isinstance(number, int) and number > 0 for number in numbers):
                return plan
        fix = "give the folder that `tacgen collect --out` made"
        msg = f"{self.root} is not a dataset: {self.plan_path.name} is missing or broken; {fix}"
        raise DatasetError(msg)

    def recipe(self) -> dict[str, Any]:
        """What ``recipe.yaml`` says; raises ``RecipeError`` if it is missing or broken."""
        return read_yaml(self.recipe_path).data

    def running(self) -> list[tuple[int, str]]:
        """(shard, who) for each shard that some process holds now."""
        locks = sorted(self.root.glob("shards/shard-*.lock"))
        found = [(part_number(path), holder_of(path)) for path in locks]
        return [(shard, holder) for shard, holder in found if shard >= 0 and holder]

    @cached_property
    def _merged(self) -> dict[int, ShardLine]:
        """``manifest.jsonl`` as it stood at first; later shards have lines of their own."""
        return read_lines(self.manifest_path)

    def _refuse_other_shards(self, spec: DatasetSpec) -> None:
        """Where no plan says what the shards are of that are there, they say it themselves."""
        wanted = (spec.recipe_sha256, dict(spec.calibration), __version__)
        for path in part_paths(self.root):
            here: tuple[object, ...] = wanted
            with contextlib.suppress(DatasetError):
                line = read_part(path)
                here = (line.recipe_sha256, line.calibration, line.versions.get("tacgen"))
            if here != wanted:
                other = f"{path.name} is of another recipe, calibration or version"
                fix = "give another --out, or delete the folder"
                msg = f"{self.root}: {other}, and {self.plan_path.name} is missing or broken; {fix}"
                raise DatasetError(msg)

    def _refuse_another(
        self, made: Mapping[str, Any], plan: Mapping[str, Any], recipe: Mapping[str, Any]
    ) -> None:
        lines = list(differences(made, plan))
        if made.get("recipe_sha256") != plan["recipe_sha256"]:
            # Without a recipe to compare with, the hashes are shown.
            with contextlib.suppress(RecipeError):
                settings = differences(self.recipe(), json.loads(json.dumps(recipe)))
                others = [text for text in lines if not text.startswith("recipe_sha256")]
                lines = [*settings, *others]
        first = f"{self.root} holds another dataset; these differ:"
        fix = "give another --out, set these back to what made it, or delete the folder"
        raise DatasetError.from_problems([first, *(f"  {text}" for text in lines), fix])


def differences(old: Any, new: Any, where: str = "") -> Iterator[str]:
    """One line for each setting that differs: where, what it was, what it would be."""
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        for key in dict.fromkeys([*old, *new]):
            yield from differences(old.get(key), new.get(key), f"{where}.{key}" if where else key)
    elif old != new:
        yield f"{where}: {json.dumps(old)} there, {json.dumps(new)} now"

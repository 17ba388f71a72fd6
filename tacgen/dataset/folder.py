"""The folder of a dataset: all its paths, who may write to it, and how a shard gets there."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import os
import socket
import time
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

import tacgen
from tacgen.dataset.disk import disk_errors
from tacgen.dataset.manifest import (
    ShardLine,
    merge_manifest,
    read_lines,
    read_manifest,
    read_part,
    shard_file,
)
from tacgen.dataset.samples import DatasetSpec, GraspSample
from tacgen.dataset.shard_check import content_problems
from tacgen.dataset.writer import write_shard_file
from tacgen.errors import DatasetError
from tacgen.files import atomic_path, sync_directory, sync_file, write_text

_NO_LINKS_HERE = (errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK)
_LOCK_TRIES, _LOCK_PAUSE_S = 75, 0.02
_NO_LOCKS_HERE = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)


class DatasetFolder:
    """Every path of a dataset, and the steps that change it.

    A writer calls ``prepare`` once, then for each shard of its share::

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
        self._merged_seen: tuple[tuple[int, ...], dict[int, ShardLine]] = ((), {})

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

        Raises
        ------
        DatasetError
            If it cannot be written to, or holds a dataset of another recipe, calibration or
            version of tacgen; the message shows the difference and says how to go on.
        """
        with disk_errors(self.root):
            (self.root / "shards").mkdir(parents=True, exist_ok=True)
            plan = _plan_of(spec)
            recipe_text = yaml.safe_dump(dict(spec.recipe), sort_keys=False, allow_unicode=True)
            # The first to create the plan decides; everyone else compares with it.
            if not _create_whole(self.plan_path, json.dumps(plan, indent=1, sort_keys=True)):
                self._refuse_another(plan, spec.recipe)
            if not self.recipe_path.is_file():
                write_text(self.recipe_path, recipe_text)

    def line(self, shard: int) -> ShardLine | None:
        """The manifest's line of one shard, or None while it is not finished."""
        path = self.line_path(shard)
        if path.is_file():
            return read_part(path)
        return self._merged().get(shard)

    def is_done(self, shard: int) -> bool:
        """Whether the shard is finished and its file is there, whole by its size."""
        line = self.line(shard)
        path = self.shard_path(shard)
        return line is not None and path.is_file() and path.stat().st_size == line.bytes

    @contextlib.contextmanager
    def claim(self, shard: int, *, redo: bool = False) -> Iterator[bool]:
        """Whether the caller may write the shard now; it holds the lock until the block ends.

        False where another process works on it, or where it is done (unless ``redo``). The
        system frees the lock of a process that dies. Where the file system has no locks, two
        processes may do the same work; they write the same bytes under names of their own.
        """
        path = self.lock_path(shard)
        with disk_errors(self.root):
            descriptor, held = _open_locked(path)
        try:
            # Whoever held the lock before may have finished the shard.
            if held is False or (self.is_done(shard) and not redo):
                yield False
                return
            if held:
                _write_holder(descriptor)
                self._remove_leftovers(shard)
            yield True
        finally:
            if held is not False:
                path.unlink(missing_ok=True)
            os.close(descriptor)

    def write_shard(
        self, shard: int, samples: Iterable[GraspSample], spec: DatasetSpec
    ) -> ShardLine:
        """Write one shard, whole or not at all, and then its line of the manifest.

        Raises
        ------
        DatasetError
            If a grasp does not fit, the folder was never prepared or is gone, or the disk is full
            or may not be written to.
        """
        self.plan()
        with disk_errors(self.root):
            self.line_path(shard).unlink(missing_ok=True)
            with atomic_path(self.shard_path(shard)) as partial:
                line = write_shard_file(partial, samples, spec, shard)
                problems = content_problems(partial, line, decode="first")
                if problems:
                    raise DatasetError.from_problems(
                        [f"{self.shard_path(shard)}: {text}" for text in problems]
                    )
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
        """What ``dataset.json`` says: ``n_grasps``, ``shard_size``, ``n_shards``, hashes, version.

        Raises
        ------
        DatasetError
            If the folder is not a dataset's.
        """
        return _read_plan(self.plan_path)

    def running(self) -> list[tuple[int, str]]:
        """(shard, who) for each shard that some process holds now."""
        found = []
        for path in sorted(self.root.glob("shards/shard-*.lock")):
            with contextlib.suppress(FileNotFoundError), path.open("r+") as file:
                if _lock(file.fileno()) is False:
                    found.append((int(path.stem.removeprefix("shard-")), file.read(200).strip()))
        return found

    def _merged(self) -> dict[int, ShardLine]:
        """``manifest.jsonl`` as it stands, read anew when it changed."""
        if not self.manifest_path.is_file():
            return {}
        status = self.manifest_path.stat()
        key = (status.st_mtime_ns, status.st_size, status.st_ino)
        if self._merged_seen[0] != key:
            self._merged_seen = (key, read_lines(self.manifest_path))
        return self._merged_seen[1]

    def _remove_leftovers(self, shard: int) -> None:
        for path in self.root.glob(f"shards/.{self.shard_path(shard).stem}.*.part"):
            path.unlink(missing_ok=True)

    def _refuse_another(self, plan: Mapping[str, Any], recipe: Mapping[str, Any]) -> None:
        made = _read_plan(self.plan_path)
        if made == plan:
            return
        differences = list(_differences(made, plan))
        if made.get("recipe_sha256") != plan["recipe_sha256"] and self.recipe_path.is_file():
            old = yaml.safe_load(self.recipe_path.read_text(encoding="utf-8"))
            told = list(_differences(old, json.loads(json.dumps(recipe))))
            differences = told + [d for d in differences if not d.startswith("recipe_sha256")]
        raise DatasetError.from_problems(
            [
                f"{self.root} holds a dataset made otherwise:",
                *(f"  {text}" for text in differences),
                "give another --out, set these back to what made it, or delete the folder",
            ]
        )


def _plan_of(spec: DatasetSpec) -> dict[str, Any]:
    return {
        "schema": 1,
        "tacgen_version": tacgen.__version__,
        "recipe": spec.recipe.get("name", ""),
        "recipe_sha256": spec.recipe_sha256,
        "calibration": dict(sorted(spec.calibration.items())),
        "sensor": spec.sensor.name,
        "pads": list(spec.pads),
        "n_grasps": spec.n_grasps,
        "shard_size": spec.shard_size,
        "n_shards": spec.n_shards,
    }


def _read_plan(path: Path) -> dict[str, Any]:
    try:
        plan = json.loads(path.read_text(encoding="utf-8"))
        numbers = [plan[name] for name in ("n_grasps", "shard_size", "n_shards")]
        if all(isinstance(number, int) and number > 0 for number in numbers):
            return plan
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        pass
    msg = (
        f"{path.parent} is not a dataset: {path.name} is missing or broken; "
        "give the folder that `tacgen collect --out` made"
    )
    raise DatasetError(msg)


def _differences(old: Any, new: Any, where: str = "") -> Iterator[str]:
    """One line for each setting that differs: where, what it was, what it would be."""
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        for key in dict.fromkeys([*old, *new]):
            yield from _differences(old.get(key), new.get(key), f"{where}.{key}" if where else key)
    elif old != new:
        yield f"{where}: {json.dumps(old)} there, {json.dumps(new)} now"


def _create_whole(path: Path, text: str) -> bool:
    """Create ``path`` with all of ``text``; False if it exists, whoever came first."""
    partial = path.with_name(f".{path.name}.{socket.gethostname()}.{os.getpid()}.part")
    try:
        partial.write_text(text, encoding="utf-8")
        sync_file(partial)
        try:
            os.link(partial, path)
        except OSError as error:
            if error.errno not in _NO_LINKS_HERE:
                raise
            if path.exists():
                return False
            os.replace(partial, path)
    except FileExistsError:
        return False
    finally:
        partial.unlink(missing_ok=True)
    sync_directory(path.parent)
    return True


def _open_locked(path: Path) -> tuple[int, bool | None]:
    """Open and lock ``path``; (descriptor, True), or False where another holds it.

    None instead of True where this file system has no locks.
    """
    tries = _LOCK_TRIES
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        held = _lock(descriptor)
        tries -= 1
        if held is False and tries:
            # It may be `running`, looking whether a lock is held, which lasts an instant, or a
            # worker of a run that was killed, which ends within a second on a busy machine.
            os.close(descriptor)
            time.sleep(_LOCK_PAUSE_S)
            continue
        # The holder removes the file when it is through: a lock on a removed file is no lock.
        if not held or _is_same_file(descriptor, path):
            return descriptor, held
        os.close(descriptor)


def _lock(descriptor: int) -> bool | None:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return None if error.errno in _NO_LOCKS_HERE else False
    return True


def _is_same_file(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False


def _write_holder(descriptor: int) -> None:
    os.ftruncate(descriptor, 0)
    os.write(descriptor, f"process {os.getpid()} on {socket.gethostname()}\n".encode())

"""``dataset.json``: what all shards of a folder have in common, decided by who comes first."""

from __future__ import annotations

import errno
import json
import os
import socket
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from tacgen.core.errors import DatasetError
from tacgen.core.files import read_small_text, sync_directory, sync_file
from tacgen.core.version import __version__
from tacgen.dataset.samples import DatasetSpec

MAX_PLAN_BYTES = 1 << 20  # a plan has some kilobytes
_NO_LINKS_HERE = (errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK)


def plan_of(spec: DatasetSpec) -> dict[str, Any]:
    """What ``dataset.json`` says for ``spec``."""
    return {
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


def read_plan(path: Path) -> dict[str, Any]:
    """What ``dataset.json`` says.

    Raises ``DatasetError`` if it is missing or broken.
    """
    try:
        plan: dict[str, Any] = json.loads(read_small_text(path, MAX_PLAN_BYTES))
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


def differences(old: Any, new: Any, where: str = "") -> Iterator[str]:
    """One line for each setting that differs: where, what it was, what it would be."""
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        for key in dict.fromkeys([*old, *new]):
            yield from differences(old.get(key), new.get(key), f"{where}.{key}" if where else key)
    elif old != new:
        yield f"{where}: {json.dumps(old)} there, {json.dumps(new)} now"


def holds(path: Path, text: str) -> bool:
    """Whether the file ``path`` is there and its content ``text``."""
    try:
        return read_small_text(path, len(text.encode())) == text
    except ValueError:
        return False


def create_whole(path: Path, text: str) -> bool:
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

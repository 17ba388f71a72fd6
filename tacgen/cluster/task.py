"""What runs inside a batch job: shards of a recipe or a command, and a note of how it went."""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tacgen.cluster.records import Note, read_note, write_note
from tacgen.collection.recipe import Recipe
from tacgen.collection.run import collect
from tacgen.core.errors import TacgenError


class _Resumable:
    def checkpoint(self: Any) -> Any:
        """What submitit queues instead of this task when it is preempted: the same again."""
        from submitit.helpers import DelayedSubmission

        return DelayedSubmission(self)


@dataclass(frozen=True)
class CollectTask(_Resumable):
    """Collects its shards; called again after a preemption, it resumes."""

    recipe: Recipe
    out: Path
    shards: tuple[int, ...]
    workers: int
    note: Path

    def __call__(self) -> dict[str, int]:
        """Collect, and keep a note of the state for ``tacgen status``."""
        with _noted(self.note):
            return collect(
                self.recipe, self.out, workers=self.workers, shards=self.shards, progress=False
            ).summary()


@dataclass(frozen=True)
class CommandTask(_Resumable):
    """Runs a command of tacgen that resumes, as ``train`` and ``friction`` do.

    ``run`` runs a command, given as the arguments after ``tacgen``.
    """

    command: tuple[str, ...]
    run: Callable[[Sequence[str]], None]
    folder: Path
    note: Path
    shards: tuple[int, ...] = ()

    def __call__(self) -> None:
        """Run the command as if typed in ``folder``; what it prints goes to the job's log."""
        os.chdir(self.folder)
        with _noted(self.note):
            self.run(self.command)


@contextlib.contextmanager
def _noted(path: Path) -> Iterator[None]:
    """Keep a note of how the block goes: running, then done, failed or interrupted."""
    before = read_note(path)
    attempt = before.attempt + 1 if before else 1

    def record(state: str, reason: str = "") -> None:
        write_note(path, Note(state, attempt, socket.gethostname(), os.getpid(), reason))

    record("running")
    try:
        yield
    except Exception as error:
        kind = "" if isinstance(error, TacgenError) else f"{type(error).__name__}: "
        record("failed", f"{kind}{error}")
        raise
    except BaseException:
        record("interrupted", "preempted, out of time or cancelled")
        raise
    record("done")

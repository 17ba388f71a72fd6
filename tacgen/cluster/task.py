"""What runs inside a batch job: shards of a recipe or a command, and a note of how it went."""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tacgen.cluster.records import Note, read_note, write_note
from tacgen.core.errors import TacgenError


@dataclass(frozen=True)
class Job:
    """A job that resumes when it is called again: collects ``shards``, or runs a command."""

    run: Callable[[], object]
    note: Path
    shards: tuple[int, ...] = ()

    def __call__(self) -> None:
        """Run, and keep a note of the state for ``tacgen status``."""
        with _noted(self.note):
            self.run()

    def checkpoint(self) -> Any:
        """What submitit queues instead of this job when it is preempted: the same again."""
        from submitit.helpers import DelayedSubmission

        return DelayedSubmission(self)


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

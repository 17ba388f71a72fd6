"""What runs inside a batch job: shards of a recipe or a command, and a note of how it went."""

import os
import socket
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tacgen.cluster.records import Note, read_note, write_record
from tacgen.core.errors import TacgenError


@dataclass(frozen=True)
class Job:
    """A job that resumes when it is called again: collects ``shards``, or runs a command."""

    run: Callable[[], object]
    note: Path
    shards: tuple[int, ...] = ()

    def __call__(self) -> None:
        """Run, and keep a note for ``tacgen status``: running, then done, failed or interrupted."""
        before = read_note(self.note)
        attempt = before.attempt + 1 if before else 1

        def record(state: str, reason: str = "") -> None:
            note = Note(state, attempt, socket.gethostname(), os.getpid(), reason)
            write_record(self.note, note)

        record("running")
        try:
            self.run()
        except Exception as error:
            kind = "" if isinstance(error, TacgenError) else f"{type(error).__name__}: "
            record("failed", f"{kind}{error}")
            raise
        except BaseException:
            record("interrupted", "preempted, out of time or cancelled")
            raise
        record("done")

    def checkpoint(self) -> Any:
        """What submitit queues instead of this job when it is preempted: the same again."""
        from submitit.helpers import DelayedSubmission

        return DelayedSubmission(self)

"""What runs inside a batch job: some shards of a recipe, and a note of how it went."""

from __future__ import annotations

import os
import socket
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tacgen.cluster.ledger import Note, read_note, write_note
from tacgen.collect import collect
from tacgen.errors import TacgenError
from tacgen.recipe import Recipe


@dataclass(frozen=True, slots=True)
class CollectTask:
    """Collects its shards; called again after a preemption, it goes on where it stopped."""

    recipe: Recipe
    out: Path
    shards: tuple[int, ...]
    workers: int
    note: Path

    def __call__(self) -> dict[str, int]:
        """Collect, and keep a note of the state for ``tacgen status``."""
        before = read_note(self.note)
        attempt = before.attempt + 1 if before else 1
        self._say("running", attempt)
        try:
            result = collect(
                self.recipe,
                self.out,
                workers=self.workers,
                shards=self.shards,
                progress=False,
            )
        except TacgenError as error:
            self._say("failed", attempt, str(error))
            raise
        except Exception as error:
            self._say("failed", attempt, f"{type(error).__name__}: {error}")
            raise
        except BaseException:
            self._say("interrupted", attempt, "preempted, out of time or cancelled")
            raise
        self._say("done", attempt)
        return result.summary()

    def checkpoint(self) -> Any:
        """What submitit queues instead of this task when it is preempted: the same again."""
        from submitit.helpers import DelayedSubmission

        return DelayedSubmission(self)

    def _say(self, state: str, attempt: int, reason: str = "") -> None:
        write_note(self.note, Note(state, attempt, socket.gethostname(), os.getpid(), reason))

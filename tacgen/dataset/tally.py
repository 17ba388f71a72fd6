"""Counting the grasps of one shard, by outcome and by object."""

from __future__ import annotations

from collections import Counter
from typing import Any

from tacgen.core.records import LABEL_FAILURE, LABEL_NOT_EXECUTED, LABEL_SUCCESS

OUTCOME = {LABEL_SUCCESS: "success", LABEL_FAILURE: "failure", LABEL_NOT_EXECUTED: "not_executed"}


class Tally:
    """Counts the grasps of one shard for its line."""

    def __init__(self) -> None:
        self._by: dict[str, Counter[str]] = {
            "counts": Counter(dict.fromkeys(OUTCOME.values(), 0)),
            "status": Counter(),
            "failure_modes": Counter(),
            "splits": Counter(),
        }
        self._objects: dict[str, Counter[str]] = {}

    def add(self, label: int, status: str, failure_mode: str, split: str, name: str) -> None:
        """Count one grasp of the object ``name``."""
        outcome = OUTCOME[label]
        self._by["counts"][outcome] += 1
        self._by["status"][status] += 1
        self._by["splits"][split] += 1
        if failure_mode:
            self._by["failure_modes"][failure_mode] += 1
        empty = Counter(dict.fromkeys(OUTCOME.values(), 0))
        self._objects.setdefault(name, empty)[outcome] += 1

    def counts(self) -> dict[str, Any]:
        """The counts as a line holds them, by the names of its fields."""
        counts: dict[str, Any] = {name: dict(tally) for name, tally in self._by.items()}
        return counts | {"objects": {name: dict(tally) for name, tally in self._objects.items()}}

"""Independent fits side by side in processes, with the same result in any number of them."""

from __future__ import annotations

import multiprocessing
import os
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

Result = TypeVar("Result")

_tasks: dict[str, Callable[[int], Any]] = {}
"""The task of a forked process; it is set in the child alone."""


def in_processes(
    task: Callable[[int], Result], items: Sequence[int], processes: int | None = None
) -> list[Result]:
    """``task`` of every item, in order, in up to ``processes`` processes (default: one a core).

    The arrays are small, so each process computes with one thread. Where processes cannot be
    forked safely the items are worked through one after the other.
    """
    count = min(len(items), processes or _cores())
    if count < 2 or not _can_fork():
        with threadpool_limits(limits=1):
            return [task(item) for item in items]
    context = multiprocessing.get_context("fork")
    with ProcessPoolExecutor(count, context, initializer=_begin, initargs=(task,)) as pool:
        return list(pool.map(_work, items))


def _begin(task: Callable[[int], Any]) -> None:
    _tasks["task"] = task
    threadpool_limits(limits=1)


def _work(item: int) -> Any:
    return _tasks["task"](item)


def _cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _can_fork() -> bool:
    """On Linux, and not inside a process that may have no children of its own."""
    return sys.platform == "linux" and not multiprocessing.current_process().daemon

"""Processes that work through tasks, watched: one that dies or hangs costs the item in hand.

A task is a list of items (a shard and its grasps). Before each item a worker says which one it
starts, so that when native code takes the process down, or an item takes longer than it may, the
supervisor knows the culprit: the task runs again without it. A worker that was killed from
outside (SIGKILL: the system was out of memory, or somebody's hand) proves nothing about its item,
so the task just runs again.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from multiprocessing.connection import Connection, wait
from typing import Any

from tacgen.core.errors import TacgenError
from tacgen.core.processes import start, start_early

MAX_KILLS_PER_TASK = 5
MAX_CRASHES_IN_A_ROW = 3
_NATIVE_CRASHES = {signal.SIGSEGV, signal.SIGABRT, signal.SIGFPE, signal.SIGBUS, signal.SIGILL}
SILENCE_LIMIT_S = 600.0
"""Between items, where a worker opens files and writes them; after that it is taken for dead."""
_POLL_S = 1.0
_LONGEST_LOOK_S = 5.0

Report = Callable[[str, int, Any], None]
"""Called by a job with ("start", item, None) and then ("item", item, anything to show)."""


Job = Callable[[int, Mapping[int, str], Report], Any]
"""What a worker does with a task; items in the mapping (item → reason) crash and are left out."""

JobFactory = Callable[[], contextlib.AbstractContextManager[Job]]


@dataclass(frozen=True, slots=True)
class Event:
    """What happened: ``kind`` is item, crashed, retried or done."""

    kind: str
    task: int
    item: int = -1
    value: Any = None


@dataclass
class _Worker:
    process: multiprocessing.process.BaseProcess
    connection: Connection
    task: int | None = None
    item: int | None = None
    heard_s: float = 0.0


class _AwakeClock:
    """Seconds in which this process was running.

    A job that the scheduler suspends, or a machine that sleeps, must not blame its grasps for it.
    """

    def __init__(self) -> None:
        self.now_s = 0.0
        self._seen_s = time.monotonic()

    def look(self) -> None:
        """Count the time since the last look, if it is not longer than looks are apart."""
        seen_s = time.monotonic()
        self.now_s += min(seen_s - self._seen_s, _LONGEST_LOOK_S)
        self._seen_s = seen_s


@dataclass
class _Progress:
    queue: deque[int]
    clock: _AwakeClock = field(default_factory=_AwakeClock)
    crashed: dict[int, dict[int, str]] = field(default_factory=dict)
    kills: dict[int, int] = field(default_factory=dict)


def run_tasks(
    tasks: Sequence[int], make_job: JobFactory, *, workers: int, item_limit_s: float
) -> Iterator[Event]:
    """Work through ``tasks`` in ``workers`` processes and yield what happens as it happens.

    ``make_job`` is called once in each process; it must be picklable. Leaving the iterator early
    ends every process.

    Raises
    ------
    TacgenError
        If a job raises one, if three items in a row crash, or if a task's worker is killed again
        and again.
    """
    progress = _Progress(deque(tasks))
    start_early(_module_of(make_job))
    crew: list[_Worker] = []
    try:
        crew += [_start(make_job) for _ in range(min(workers, len(tasks)))]
        while progress.queue or any(worker.task is not None for worker in crew):
            for worker in crew:
                if worker.task is None and progress.queue:
                    _hand_out(worker, progress)
            _await_news(crew)
            progress.clock.look()
            for k, worker in enumerate(crew):
                # Looked at once: a worker may die at any line below, and is then found dead next
                # time, with its task.
                alive = worker.process.is_alive()
                yield from _read_news(worker, progress.clock)
                if alive:
                    yield from _end_if_hung(worker, progress, item_limit_s)
                else:
                    yield from _account_for_death(worker, progress)
                if worker.task is None and progress.queue and not worker.process.is_alive():
                    crew[k] = _start(make_job)
    finally:
        for worker in crew:
            _stop(worker)


def _module_of(make_job: JobFactory) -> str:
    """Where the job is defined, so that it is imported once for all workers."""
    while isinstance(make_job, partial):
        make_job = make_job.func
    return getattr(make_job, "__module__", __name__)


def _start(make_job: JobFactory) -> _Worker:
    ours, theirs = multiprocessing.Pipe()
    process = start(_serve, theirs, make_job)
    theirs.close()
    return _Worker(process, ours)


def _hand_out(worker: _Worker, progress: _Progress) -> None:
    worker.task = progress.queue.popleft()
    worker.item, worker.heard_s = None, progress.clock.now_s
    with contextlib.suppress(BrokenPipeError):  # it died idle; its death is accounted for
        worker.connection.send((worker.task, progress.crashed.get(worker.task, {})))


def _await_news(crew: Sequence[_Worker]) -> None:
    wait(
        [worker.connection for worker in crew] + [worker.process.sentinel for worker in crew],
        timeout=_POLL_S,
    )


def _read_news(worker: _Worker, clock: _AwakeClock) -> Iterator[Event]:
    """Everything the worker has said since."""
    try:
        while worker.task is not None and worker.connection.poll():
            kind, item, value = worker.connection.recv()
            task, worker.heard_s = worker.task, clock.now_s
            if kind == "error":
                raise TacgenError(value)
            if kind == "bug":
                msg = f"a worker failed unexpectedly:\n{value}"
                raise RuntimeError(msg)
            if kind == "start":
                worker.item = item
                continue
            worker.item = None
            if kind == "done":
                worker.task = None
            yield Event(kind, task, item, value)
    except (EOFError, ConnectionResetError):
        return


def _end_if_hung(worker: _Worker, progress: _Progress, limit_s: float) -> Iterator[Event]:
    silent_s = progress.clock.now_s - worker.heard_s
    if worker.item is not None and silent_s > limit_s:
        worker.process.kill()
        worker.process.join()
        yield _blame_item(worker, progress, f"took longer than {limit_s:g} s")
    elif worker.task is not None and silent_s > max(limit_s, SILENCE_LIMIT_S):
        worker.process.kill()  # found dead at the next look, and its task run again


def _account_for_death(worker: _Worker, progress: _Progress) -> Iterator[Event]:
    if worker.task is None:
        return
    worker.process.join()
    code = worker.process.exitcode or 0
    if worker.item is not None and -code in _NATIVE_CRASHES:
        yield _blame_item(worker, progress, f"the simulator died of {signal.Signals(-code).name}")
        return
    task, worker.task = worker.task, None
    progress.kills[task] = progress.kills.get(task, 0) + 1
    if progress.kills[task] > MAX_KILLS_PER_TASK:
        msg = (
            f"the worker of shard {task} was ended {progress.kills[task]} times "
            f"(exit code {code}); is the machine out of memory? use fewer --workers"
        )
        raise TacgenError(msg)
    progress.queue.appendleft(task)
    yield Event("retried", task, -1, f"its worker was ended from outside (exit code {code})")


def _blame_item(worker: _Worker, progress: _Progress, reason: str) -> Event:
    """Put the task back, to be run without the item that took its worker down."""
    task, item = worker.task, worker.item
    if task is None or item is None:
        msg = "a worker without an item cannot be blamed for one"
        raise RuntimeError(msg)
    progress.crashed.setdefault(task, {})[item] = reason
    if _crashed_around(item, progress) >= MAX_CRASHES_IN_A_ROW:
        msg = f"{MAX_CRASHES_IN_A_ROW} grasps in a row crashed, the last ({item}) because {reason}"
        raise TacgenError(msg)
    worker.task = worker.item = None
    progress.queue.appendleft(task)
    return Event("crashed", task, item, reason)


def _crashed_around(item: int, progress: _Progress) -> int:
    """How many items in a row crashed, this one among them, whatever their tasks."""
    every = {crashed for items in progress.crashed.values() for crashed in items}
    first = last = item
    while first - 1 in every:
        first -= 1
    while last + 1 in every:
        last += 1
    return last - first + 1


def _stop(worker: _Worker) -> None:
    worker.connection.close()
    worker.process.join(timeout=0.2)
    if worker.process.is_alive():
        worker.process.kill()
        worker.process.join()


def _serve(connection: Connection, make_job: JobFactory) -> None:
    """A worker's life: tasks in, news out, until the supervisor closes the line or is gone."""
    # Ctrl-C reaches the whole group; the supervisor decides what it means.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _end_with_the_supervisor()

    def report(kind: str, item: int, value: Any = None) -> None:
        connection.send((kind, item, value))

    try:
        with make_job() as job:
            while True:
                task, crashed = connection.recv()
                connection.send(("done", -1, job(task, crashed, report)))
    except (EOFError, BrokenPipeError, ConnectionResetError):
        os._exit(0)
    except TacgenError as error:
        _last_words(connection, ("error", error.exit_code, str(error)))
    except Exception:
        # Whatever it is, the supervisor must hear of it; it ends the run with this text.
        _last_words(connection, ("bug", -1, traceback.format_exc()))


def _end_with_the_supervisor() -> None:
    """Amid an item too: whoever takes over must not find the lock of a shard held by an orphan."""
    supervisor = multiprocessing.parent_process()
    if supervisor is None:
        return

    def watch(sentinel: int) -> None:
        wait([sentinel])
        os._exit(1)

    threading.Thread(target=watch, args=(supervisor.sentinel,), daemon=True).start()


def _last_words(connection: Connection, words: tuple[str, int, str]) -> None:
    with contextlib.suppress(BrokenPipeError):  # the run has been ended by another worker's
        connection.send(words)

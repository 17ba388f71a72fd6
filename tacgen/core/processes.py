"""Work in several processes: independent tasks side by side, and watched workers.

``map_in_processes`` is for tasks that give the same result in any number of processes.

``run_tasks`` is for long work in which native code may crash or hang. A task is a list of items
(a shard and its grasps). Before each item a worker reports which one it starts, so that when it
crashes, or the item takes longer than it may, the supervisor knows the culprit: the task runs
again without it. A worker that was killed from outside (SIGKILL: the system was out of memory, or
somebody ended it) proves nothing about its item, so the task just runs again.

Watched workers are copies of a process that has imported what they need (Python's fork server):
importing takes longer than a few grasps. It runs nothing else and has no threads, so copying it is
safe where copying the parent would not be. Libraries get one thread in each worker: a worker is
one core's work, and sums must not depend on a machine's number of cores. Nor on its processor:
workers see ``SAME_SUMS``.
"""

import contextlib
import ctypes
import itertools
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from functools import lru_cache, partial
from multiprocessing import forkserver, resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.util import get_temp_dir
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, TypeVar

from tacgen.core.errors import TacgenError
from tacgen.core.progress import LOG, print_status

_POOLS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
ONE_THREAD = dict.fromkeys((*_POOLS, "VECLIB_MAXIMUM_THREADS"), "1")

SAME_SUMS = {
    "OPENBLAS_CORETYPE": "Haswell",
    "GLIBC_TUNABLES": "",
    "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512F AVX512_SKX",
}
"""Which variants of their kernels OpenBLAS, the C library and numpy use, whatever was set: those of
an x86-64 processor with AVX2 and FMA. Left to themselves they choose by the processor, and round
differently. numba's code and PyBullet's have one variant."""

_PR_SET_PDEATHSIG = 1  # from linux/prctl.h
_START_TRIES, _START_PAUSE_S = 20, 0.05

MAX_KILLS_PER_TASK = 5  # an item that ends a worker this often is at fault itself
MAX_CRASHES_IN_A_ROW = 3  # with different items: then the machine is at fault
_ENDING_SIGNALS = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}
_NATIVE_CRASHES = {signal.SIGSEGV, signal.SIGABRT, signal.SIGFPE, signal.SIGBUS, signal.SIGILL}
SILENCE_LIMIT_S = 600.0
"""Between items, where a worker opens and writes files; after that it is ended and replaced."""
_POLL_S = 1.0  # how late a dead worker is noticed at most
_LONGEST_LOOK_S = 5.0  # longer pauses are those of a suspended machine, not of a hanging worker
LONGEST_FOLDER = 89  # bytes: a socket in it is called listener- and eight letters, of 107 in all

Report = Callable[[str, int, Any], None]
"""Called by a job with ("start", item, None) and then ("item", item, anything to show)."""

TaskFunction = Callable[[int, Mapping[int, str], Report], Any]
"""What a worker does with a task; items in the mapping (item → reason) crashed, and are skipped."""

JobFactory = Callable[[], contextlib.AbstractContextManager[TaskFunction]]


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
    task: int = -1  # none
    item: int = -1
    last_message_s: float = 0.0
    waited_s: float = 0.0  # for a core, until its last message

    def note_message(self, now_s: float) -> None:
        """Its last message came, or its task went, at ``now_s``."""
        self.last_message_s, self.waited_s = now_s, waited_for_a_core_s(self.process.pid)


@dataclass
class _Progress:
    queue: deque[int]
    crashed: dict[int, dict[int, str]] = field(default_factory=dict)
    kills: dict[int, int] = field(default_factory=dict)
    awake_s: float = 0.0  # in which this process ran: a suspended job must not blame its grasps
    looked_s: float = field(default_factory=time.monotonic)

    def look(self) -> None:
        """Count the time since the last look, if it is not longer than looks are apart."""
        now_s = time.monotonic()
        self.awake_s += min(now_s - self.looked_s, _LONGEST_LOOK_S)
        self.looked_s = now_s


Item = TypeVar("Item")
Result = TypeVar("Result")

_pool_task: dict[str, Callable[[Any], Any]] = {}
"""The task of a process of ``map_in_processes``; it is set in the child alone."""


def map_in_processes(
    task: Callable[[Item], Result],
    items: Sequence[Item],
    processes: int | None = None,
    *,
    method: Literal["fork", "spawn"] = "fork",
) -> list[Result]:
    """``task`` of every item, in order, in up to ``processes`` processes (default: one a core).

    ``fork`` shares the task's arrays and works on Linux alone; ``spawn`` is for libraries that
    run threads of their own, and pickles the task. Where processes cannot be started so, the
    items are worked through one after the other.

    Raises ``TacgenError`` if a process is killed.
    """
    count = min(len(items), processes or available_cores())
    possible = method == "spawn" or sys.platform == "linux"
    # A daemon may have no children of its own, and one of these processes has a core to itself.
    is_child = bool(_pool_task) or multiprocessing.current_process().daemon
    if count < 2 or not possible or is_child:
        return [task(item) for item in items]
    others = set(multiprocessing.active_children())
    context = multiprocessing.get_context(method)
    with contextlib.ExitStack() as stack:
        begin = partial(_set_task, task)
        if method == "spawn":
            # In a file: a process that is killed as it starts leaves nobody to read a long pipe.
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="tacgen-task-"))
            begin = partial(_load_task, Path(folder) / "task.pickle")
            begin.args[0].write_bytes(pickle.dumps(task))
        stack.enter_context(_without_opencv_threads())
        pool = stack.enter_context(ProcessPoolExecutor(count, context, initializer=begin))
        try:
            with _signals_held():
                results = pool.map(_run_task, items)  # starts the processes
            return list(results)
        except BaseException as error:
            # Leaving the block waits for results that nobody will look at.
            for child in set(multiprocessing.active_children()) - others:
                child.terminate()
            if not isinstance(error, (BrokenProcessPool, BrokenPipeError)):
                raise
            fix = "run the same command again with fewer --workers, it resumes where it can"
            msg = f"a worker process was killed, perhaps because memory ran out; {fix}"
            raise TacgenError(msg) from error


@contextlib.contextmanager
def _without_opencv_threads() -> Iterator[None]:
    """A process that is copied while such a thread holds a lock would wait for it for ever."""
    opencv = sys.modules.get("cv2")
    if opencv is None:
        yield
        return
    before = opencv.getNumThreads()
    opencv.setNumThreads(1)  # ends them
    try:
        yield
    finally:
        opencv.setNumThreads(before)


@contextlib.contextmanager
def _signals_held() -> Iterator[None]:
    """Signals arrive after this block, in a process that is started in it after ``_set_task``.

    A new copy of this process still has its handlers, and Python drops what a handler raises
    there at first: the copy that was to end would live on and wait for its work for ever.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDING_SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _set_task(task: Callable[[Any], Any]) -> None:
    for number in (signal.SIGTERM, signal.SIGHUP):  # not an error that is sent back, but the end
        if signal.getsignal(number) != signal.SIG_IGN:  # as under nohup
            signal.signal(number, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent acts on it
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _ENDING_SIGNALS)
    _end_with_the_supervisor()
    _pool_task["task"] = task


def _load_task(path: Path) -> None:
    _set_task(pickle.loads(path.read_bytes()))


def _run_task(item: Any) -> Any:
    return _pool_task["task"](item)


def available_cores() -> int:
    """Cores that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity else os.cpu_count() or 1


def waited_for_a_core_s(pid: int | None) -> float:
    """How long a process was ready to run while others had the cores; 0 where nothing says so."""
    try:
        figures = Path(f"/proc/{pid}/schedstat").read_text(encoding="ascii").split()
    except OSError:  # it is gone, or the kernel does not count
        return 0.0
    return int(figures[1]) / 1e9


def run_tasks(
    tasks: Sequence[int], make_job: JobFactory, *, workers: int, item_limit_s: float
) -> Iterator[Event]:
    """Work through ``tasks`` in ``workers`` processes and yield what happens as it happens.

    ``make_job`` is called once in each process; it must be picklable. Leaving the iterator early
    ends every process.

    Raises ``TacgenError`` if a job raises one, if three items in a row crash, or if a task's worker
    is killed again and again.
    """
    if not tasks:
        return
    progress, count = _Progress(deque(tasks)), min(workers, len(tasks))
    print_status(f"{count} worker process{'es' if count > 1 else ''}")
    start_early(_module_of(make_job))
    crew: list[_Worker] = []
    try:
        crew += [_start(make_job) for _ in range(count)]
        while progress.queue or any(worker.task >= 0 for worker in crew):
            for worker in crew:
                if worker.task < 0 and progress.queue:
                    _assign(worker, progress)
            signals = [on for worker in crew for on in (worker.connection, worker.process.sentinel)]
            wait(signals, timeout=_POLL_S)
            progress.look()
            for k, worker in enumerate(crew):
                # Looked at once: a worker may die at any line below, and is then found dead next
                # time, with its task.
                alive = worker.process.is_alive()
                yield from _read_messages(worker, progress)
                if alive:
                    yield from _end_if_hung(worker, progress, item_limit_s)
                else:
                    yield from _handle_death(worker, progress)
                if worker.task < 0 and progress.queue and not worker.process.is_alive():
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
    """Start a worker, which ends with this process."""
    context: Any = multiprocessing.get_context("forkserver")
    ours, theirs = multiprocessing.Pipe()
    # The process that is copied may have been started under another environment.
    given = (dict(os.environ) | _settings(), theirs, make_job)
    for left in reversed(range(_START_TRIES)):
        process = context.Process(target=_serve, args=given, daemon=True)
        try:
            with _for_workers():
                process.start()
            break
        except (EOFError, ConnectionError) as error:
            # The fork server was killed and is not yet seen to be gone; then a new one starts.
            if not left:
                msg = (
                    f"no worker process could be started with {sys.executable} "
                    f"({error or type(error).__name__}); what it printed stands above, if it began "
                    "at all; is there memory left, and may you run it?"
                )
                raise TacgenError(msg) from error
            time.sleep(_START_PAUSE_S)
    theirs.close()
    return _Worker(process, ours)


def _assign(worker: _Worker, progress: _Progress) -> None:
    worker.task = progress.queue.popleft()
    worker.item = -1
    worker.note_message(progress.awake_s)
    with contextlib.suppress(BrokenPipeError):  # it died idle; its death is accounted for
        worker.connection.send((worker.task, progress.crashed.get(worker.task, {})))


def _read_messages(worker: _Worker, progress: _Progress) -> Iterator[Event]:
    try:
        while worker.task >= 0 and worker.connection.poll():
            kind, item, value = worker.connection.recv()
            task = worker.task
            worker.note_message(progress.awake_s)
            if kind == "error":
                raise TacgenError(value)
            if kind == "bug":
                msg = f"a worker failed unexpectedly:\n{value}"
                raise RuntimeError(msg)
            if kind == "start":
                worker.item = item
                continue
            worker.item = -1
            if kind == "done":
                worker.task = -1
            yield Event(kind, task, item, value)
    except (EOFError, OSError):  # it was killed, maybe within a message
        return


def _end_if_hung(worker: _Worker, progress: _Progress, limit_s: float) -> Iterator[Event]:
    silent_s = progress.awake_s - worker.last_message_s
    if worker.task < 0 or silent_s <= limit_s:
        return
    # On a busy machine a worker that waits for a core does not hang.
    silent_s -= waited_for_a_core_s(worker.process.pid) - worker.waited_s
    if worker.item >= 0 and silent_s > limit_s:
        worker.process.kill()
        worker.process.join()
        yield _skip_item(worker, progress, f"took longer than {limit_s:g} s")
    elif worker.task >= 0 and silent_s > max(limit_s, SILENCE_LIMIT_S):
        worker.process.kill()  # found dead at the next look, and its task run again


def _handle_death(worker: _Worker, progress: _Progress) -> Iterator[Event]:
    if worker.task < 0:
        return
    worker.process.join()
    code = worker.process.exitcode or 0
    if worker.item >= 0 and -code in _NATIVE_CRASHES:
        yield _skip_item(worker, progress, f"the simulator died of {signal.Signals(-code).name}")
        return
    task, worker.task = worker.task, -1
    progress.kills[task] = progress.kills.get(task, 0) + 1
    if progress.kills[task] > MAX_KILLS_PER_TASK:
        ended = f"the worker of shard {task} was ended {progress.kills[task]} times"
        msg = f"{ended} (exit code {code}); is the machine out of memory? use fewer --workers"
        raise TacgenError(msg)
    progress.queue.appendleft(task)
    yield Event("retried", task, -1, f"its worker was ended from outside (exit code {code})")


def _skip_item(worker: _Worker, progress: _Progress, reason: str) -> Event:
    task, item = worker.task, worker.item
    progress.crashed.setdefault(task, {})[item] = reason
    if _crashed_around(item, progress) >= MAX_CRASHES_IN_A_ROW:
        msg = f"{MAX_CRASHES_IN_A_ROW} grasps in a row crashed, the last ({item}) because {reason}"
        raise TacgenError(msg)
    worker.task = worker.item = -1
    progress.queue.appendleft(task)
    return Event("crashed", task, item, reason)


def _crashed_around(item: int, progress: _Progress) -> int:
    """How many items in a row crashed, this one among them, whatever their tasks."""
    every = {crashed for items in progress.crashed.values() for crashed in items}
    before = itertools.takewhile(every.__contains__, itertools.count(item, -1))
    after = itertools.takewhile(every.__contains__, itertools.count(item + 1))
    return len([*before, *after])


def _stop(worker: _Worker) -> None:
    worker.connection.close()
    worker.process.join(timeout=0.2)
    if worker.process.is_alive():
        worker.process.kill()
        worker.process.join()


def _serve(environment: Mapping[str, str], connection: Connection, make_job: JobFactory) -> None:
    """A worker's life: tasks in, reports out, until the supervisor closes the line or is gone."""
    os.environ.clear()
    os.environ.update(environment)
    if "cv2" in sys.modules:
        sys.modules["cv2"].setNumThreads(1)
    if sys.platform == "linux":
        # End with the fork server: once it is gone, the supervisor sees its copies as dead too,
        # and one that worked on would hold the lock of a shard that nobody waits for.
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
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
        last = ("error", -1, str(error))
    except Exception:
        # Whatever it is, the supervisor must hear of it; it ends the run with this text.
        last = ("bug", -1, traceback.format_exc())
    with contextlib.suppress(BrokenPipeError):  # the run has been ended by another worker's
        connection.send(last)


@lru_cache(maxsize=1)
def _settings() -> dict[str, str]:
    """Environment variables of workers, whatever the user's are.

    All that they write to the disk for a while lies in one folder, which goes with this process.
    """
    settings = ONE_THREAD | {"TMPDIR": get_temp_dir()}
    cpuinfo = Path("/proc/cpuinfo")
    flags = set(cpuinfo.read_text(encoding="utf-8").split()) if cpuinfo.is_file() else set()
    if {"avx2", "fma"} <= flags:
        return settings | SAME_SUMS
    LOG.warning("this processor lacks AVX2 and FMA: shards differ from those of others by rounding")
    return settings


def _end_with_the_supervisor() -> None:
    """Amid an item too: whoever takes over must not find the lock of a shard held by an orphan."""
    supervisor = multiprocessing.parent_process()
    if supervisor is None:
        return

    def watch(sentinel: int) -> None:
        wait([sentinel])
        os._exit(1)

    threading.Thread(target=watch, args=(supervisor.sentinel,), daemon=True).start()


def start_early(*modules: str) -> None:
    """Start the process that workers are copied from; it imports ``modules`` meanwhile.

    Where it runs already, this does nothing. Raises ``TacgenError`` where it cannot have a socket.
    """
    folder = get_temp_dir()
    if len(os.fsencode(folder)) > LONGEST_FOLDER:
        msg = f"{folder}: too long a path for a socket; set TMPDIR to a shorter one, such as /tmp"
        raise TacgenError(msg)
    first = ("tacgen.core.end_quietly", "tacgen.core.rare_collections")
    preload = [*first, *modules, "tacgen.core.compiler_start"]
    multiprocessing.get_context("forkserver").set_forkserver_preload(preload)
    _remover(folder)
    resource_tracker.ensure_running()  # which takes the block below away
    # The process that is copied would otherwise print where Ctrl-C struck its imports.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        with _for_workers():
            forkserver.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@lru_cache(maxsize=1)
def _remover(folder: str) -> "subprocess.Popen[bytes]":
    """A process that removes a folder of temporary files when this one is gone, even by SIGKILL.

    It waits for the end of a pipe, and a second more: workers may still write for a moment.
    """
    command = ["/bin/sh", "-c", 'cat > /dev/null; sleep 1; rm -rf -- "$1"', "sh", folder]
    return subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


@contextlib.contextmanager
def _for_workers() -> Iterator[None]:
    """Processes started meanwhile inherit these settings: libraries look when they are loaded.

    The script that runs is hidden from them: they would import it, and with it run it again.
    """
    before, script = dict(os.environ), sys.modules["__main__"]
    os.environ.update(_settings())
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = script
        os.environ.clear()
        os.environ.update(before)

"""How worker processes start: as copies of a process that has imported what they need.

Importing takes longer than a few grasps, so it is done once, in a process of its own (Python's
fork server), which can be started while its parent still reads recipes. It runs nothing else and
has no threads, so copying it is safe where copying the parent would not be. Libraries get one
thread in each worker: a worker is one core's work, and sums must not follow a machine's cores.
"""

from __future__ import annotations

import contextlib
import ctypes
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from tacgen.core.errors import TacgenError

ONE_THREAD = dict.fromkeys(
    (
        "OMP_NUM_THREADS",
        "OPENBLAS_NUM_THREADS",
        "MKL_NUM_THREADS",
        "NUMBA_NUM_THREADS",
        "VECLIB_MAXIMUM_THREADS",
    ),
    "1",
)

_PR_SET_PDEATHSIG = 1
_START_TRIES, _START_PAUSE_S = 20, 0.05


def start_early(*modules: str) -> None:
    """Start the process that workers are copied from; it imports ``modules`` meanwhile.

    Where it runs already, or the system has no such thing, this does nothing.
    """
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return
    from multiprocessing import forkserver

    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["__main__", *modules])
    with _threads_pinned():
        forkserver.ensure_running()


def start(target: Callable[..., None], *arguments: object) -> multiprocessing.process.BaseProcess:
    """Run ``target(*arguments)`` in a new process that ends with this one."""
    methods = multiprocessing.get_all_start_methods()
    context: Any = multiprocessing.get_context("forkserver" if "forkserver" in methods else "spawn")
    # The process that is copied may have been started under another environment.
    given = (target, dict(os.environ) | ONE_THREAD, *arguments)
    for left in reversed(range(_START_TRIES)):
        process: multiprocessing.process.BaseProcess
        process = context.Process(target=_run, args=given, daemon=True)
        try:
            with _threads_pinned():
                process.start()
        except (EOFError, ConnectionError) as error:
            # The fork server was killed and is not yet seen to be gone; then a new one starts.
            if not left:
                msg = (
                    f"no worker process could be started with {sys.executable} "
                    f"({error or type(error).__name__}); what it said stands above, if it began "
                    "at all; is there memory left, and may you run it?"
                )
                raise TacgenError(msg) from error
            time.sleep(_START_PAUSE_S)
        else:
            break
    return process


def _run(target: Callable[..., None], environment: Mapping[str, str], *arguments: object) -> None:
    for name in set(os.environ) - set(environment):
        del os.environ[name]
    os.environ.update(environment)
    if "cv2" in sys.modules:
        sys.modules["cv2"].setNumThreads(1)
    _end_with_the_process_copied()
    target(*arguments)


def _end_with_the_process_copied() -> None:
    """Die with the fork server: once it is gone, the supervisor takes its copies for dead too.

    One that worked on would hold the lock of a shard that nobody waits for.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


@contextlib.contextmanager
def _threads_pinned() -> Iterator[None]:
    """Processes started meanwhile inherit ``ONE_THREAD``: libraries look when they are loaded."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value

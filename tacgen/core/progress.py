"""Progress on standard error: a bar on a terminal, elsewhere a line a minute; status lines.

The logger ``tacgen`` sets how much is written: WARNING (``-q``) only warnings, DEBUG (``-v``)
also tracebacks.
"""

import contextlib
import functools
import logging
import math
import sys
import threading
import time
from collections.abc import Callable, Iterator

from tqdm import tqdm

# Its own lock is one of the system's too, which a process that is ended leaves behind.
tqdm.set_lock(threading.RLock())

LOG = logging.getLogger("tacgen")
LINE_EVERY_S = 60.0  # interval of progress lines in logs
FIRST_SHARE = 0.1  # of the time until the first is done, by which other processes may be later

Show = Callable[..., None]  # ``show(done, total, note="")``: the state of some work


def is_quiet() -> bool:
    """Whether only results, warnings and errors are written."""
    return LOG.level > logging.INFO


@contextlib.contextmanager
def progress_counter(unit: str, *, name: str = "tacgen", enabled: bool = True) -> Iterator[Show]:
    """Yield a function ``show(done, total, note="")`` that displays the progress; 0: no total."""
    if not enabled or is_quiet():
        yield lambda done, total, note="": None
        return
    if not sys.stderr.isatty():
        yield _lines(unit, name)
        return
    with tqdm(unit=unit, desc=name, dynamic_ncols=True) as bar:

        def show(done: int, total: int, note: str = "") -> None:
            bar.total = total or None
            bar.set_postfix_str(note, refresh=False)
            bar.update(done - bar.n)  # whose rate is of what was done last

        yield show


def _lines(unit: str, name: str) -> Show:
    started_s = written_s = time.monotonic()
    then_s, n_then = math.inf, 0

    def show(done: int, total: int, note: str = "") -> None:
        nonlocal written_s, then_s, n_then
        now_s = time.monotonic()
        # Until the first is done, by each of the processes, libraries are loaded and compiled.
        if done and then_s == math.inf:
            then_s = now_s + FIRST_SHARE * (now_s - started_s)
        if now_s <= then_s:
            n_then = done
        if now_s - written_s < LINE_EVERY_S:
            return
        written_s = now_s
        left = ""
        if done > n_then and total:
            left_min = (now_s - then_s) / 60 * (total - done) / (done - n_then)
            left = f", about {left_min:.0f} min left"
        end = f", {note}" if note else ""
        of = f" of {total}" if total else ""
        print_status(f"{done}{of} {unit}s{left}{end}", name)

    return show


def print_status(text: str, name: str = "tacgen") -> None:
    """Print a line on standard error, above any progress bar, unless ``-q`` is given."""
    if not is_quiet():
        tqdm.write(f"{name}: {text}", file=sys.stderr)


@functools.cache
def print_once(text: str) -> None:
    """``print_status``, the first time that a process says this."""
    print_status(text)

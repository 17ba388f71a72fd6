"""Progress on standard error: a bar on a terminal, elsewhere a line a minute; status lines.

The logger ``tacgen`` sets how much is written: WARNING (``-q``) only warnings, DEBUG (``-v``)
also tracebacks.
"""

import contextlib
import functools
import logging
import sys
import threading
import time
from collections.abc import Callable, Iterator

from tqdm import tqdm

# Its own lock is one of the system's too, which a process that is ended leaves behind.
tqdm.set_lock(threading.RLock())

LOG = logging.getLogger("tacgen")
LINE_EVERY_S = 60.0  # interval of progress lines in logs

Show = Callable[..., None]  # ``show(done, total, note="")``: the state of some work


def is_quiet() -> bool:
    """Whether only results, warnings and errors are written."""
    return LOG.level > logging.INFO


@contextlib.contextmanager
def progress_counter(unit: str, *, name: str = "tacgen", enabled: bool = True) -> Iterator[Show]:
    """Yield a function ``show(done, total, note="")`` that displays the progress."""
    if not enabled or is_quiet():
        yield lambda done, total, note="": None
        return
    if not sys.stderr.isatty():
        yield _lines(unit, name)
        return
    with tqdm(unit=unit, desc=name, dynamic_ncols=True) as bar:

        def show(done: int, total: int, note: str = "") -> None:
            bar.total, bar.n = total, done
            bar.set_postfix_str(note, refresh=False)
            bar.refresh()

        yield show


def _lines(unit: str, name: str) -> Show:
    started_s = written_s = time.monotonic()

    def show(done: int, total: int, note: str = "") -> None:
        nonlocal written_s
        now_s = time.monotonic()
        if now_s - written_s < LINE_EVERY_S:
            return
        written_s = now_s
        left_min = (now_s - started_s) / 60 * (total - done) / max(done, 1)
        end = f", {note}" if note else ""
        print_status(f"{done} of {total} {unit}s, about {left_min:.0f} min left{end}", name)

    return show


def print_status(text: str, name: str = "tacgen") -> None:
    """Print a line on standard error, above any progress bar, unless ``-q`` is given."""
    if not is_quiet():
        tqdm.write(f"{name}: {text}", file=sys.stderr)


@functools.cache
def print_once(text: str) -> None:
    """``print_status``, the first time that a process says this."""
    print_status(text)

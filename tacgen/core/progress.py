"""Progress on standard error: a bar on a terminal, and lines about what is done."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator

from tqdm import tqdm


@contextlib.contextmanager
def progress_counter(unit: str) -> Iterator[Callable[[int, int], None]]:
    """Yield ``show(done, total)``, which draws the bar."""
    with tqdm(unit=unit, disable=not sys.stderr.isatty(), dynamic_ncols=True) as bar:

        def show(done: int, total: int) -> None:
            bar.total, bar.n = total, done
            bar.refresh()

        yield show


def print_status(text: str) -> None:
    """Print a line on standard error, above any progress bar."""
    tqdm.write(f"tacgen: {text}", file=sys.stderr)

"""The program ``tacgen``, also as ``python -m tacgen``."""

import os
import signal
import sys
from types import FrameType


def main() -> None:
    """Run the command line; a signal that comes while it is still being imported ends it at once.

    Nothing is at work yet, and an exception amid imports would print where it struck.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _end)
    from tacgen.cli import main as run

    run()


def _end(_signal: int, _frame: FrameType | None) -> None:
    sys.stderr.write("tacgen: interrupted\n")
    sys.stderr.flush()
    os._exit(130)


if __name__ == "__main__":
    main()

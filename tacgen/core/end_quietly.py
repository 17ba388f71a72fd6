"""Ctrl-C ends the process that workers are copied from while it imports, without a traceback.

Imported first by that process, which is started with the signal blocked. Nor does a worker print
one whose orders were cut off, since the process that gave them was interrupted.
"""

import os
import pickle
import signal
import sys
from types import TracebackType


def _unless_cut_off(
    kind: type[BaseException], error: BaseException, trace: TracebackType | None
) -> None:
    is_cut_off = isinstance(error, pickle.UnpicklingError) and "truncated" in str(error)
    if not (is_cut_off or isinstance(error, EOFError)):
        sys.__excepthook__(kind, error, trace)


sys.excepthook = _unless_cut_off
signal.signal(signal.SIGINT, lambda *_: os._exit(130))
signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})

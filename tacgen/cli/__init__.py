"""The command line: each command loads its input, calls one function and prints.

Imports of the stages are inside the commands, so that ``tacgen --help`` is fast and a missing extra
only affects the commands that need it.
"""

import atexit
import io
import logging
import signal
import sys
import threading
import traceback
from importlib.machinery import ExtensionFileLoader
from types import FrameType

import typer

import tacgen.core.caches  # before any library that has one
import tacgen.core.rare_collections  # noqa: F401

# Importing a module of commands registers them.
from tacgen.cli import (  # noqa: F401
    calibrate,
    cluster,
    datasets,
    diagnose,
    learning,
    machine,
    objects,
    recipes,
    sensors,
)
from tacgen.cli.common import app
from tacgen.core.errors import Interrupted, TacgenError
from tacgen.core.files import DiskFile, disk_message
from tacgen.core.progress import LOG

RETRY_S = 0.01  # after which an interruption that came amid C code is tried again


def main() -> None:
    """Run the command line; an error that a user can fix becomes one message and an exit code."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if number == signal.SIGHUP and signal.getsignal(number) == signal.SIG_IGN:
            continue  # as `nohup` wants
        signal.signal(number, _interrupt)
    signal.signal(signal.SIGALRM, _interrupt)
    # Python, on its way out, would give the signals their deadly meaning back: all is done by then.
    atexit.register(_ignore_signals)
    sys.unraisablehook = _raise_again
    for stream in (sys.stdout, sys.stderr):  # whatever the locale: "mm³" is not in all of them
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(encoding="utf-8", errors="surrogateescape")
    try:
        app()
    except TacgenError as error:
        _stop(str(error), error.exit_code)
    except OSError as error:
        fix = "check the path and its permissions"
        _stop(disk_message(error, error.filename or "", fix), TacgenError.exit_code)
    except BaseException as error:
        # Libraries that are interrupted as they write end in errors of their own.
        if isinstance(error, SystemExit) or not _interruptions:
            raise
        _stop("interrupted; finished work is kept", 130)


def _ignore_signals() -> None:
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGALRM):
        signal.signal(number, signal.SIG_IGN)


def _stop(message: str, exit_code: int) -> None:
    if LOG.level == logging.DEBUG:
        traceback.print_exc()
    typer.echo(f"tacgen: {message}", err=True)
    sys.exit(exit_code)


_interruptions: list[int] = []


def _interrupt(_signal: int, frame: FrameType | None) -> None:
    _interruptions.append(_signal)
    # The thread of a pool whose processes are ended under it has nothing to say.
    threading.excepthook = lambda _thrown: None
    if DiskFile.holds_interruptions():
        return
    if _is_amid_c_code(frame):
        signal.setitimer(signal.ITIMER_REAL, RETRY_S)
    else:
        raise Interrupted


def _is_amid_c_code(frame: FrameType | None) -> bool:
    """Whether what runs was called by C code that an exception would end the process in.

    That is an extension module that starts, and the compiler's callbacks.
    """
    while frame is not None:
        if isinstance(frame.f_locals.get("self"), ExtensionFileLoader):
            return True
        if frame.f_globals.get("__name__", "") in ("numba.core.codegen", "llvmlite.binding.ffi"):
            return True
        frame = frame.f_back
    return False


def _raise_again(ignored: "sys.UnraisableHookArgs") -> None:
    """What a signal raises amid a callback of C code is dropped there: raise it once more."""
    if isinstance(ignored.exc_value, Interrupted):
        signal.setitimer(signal.ITIMER_REAL, RETRY_S)
    else:
        sys.__unraisablehook__(ignored)

"""The command line: each command loads its input, calls one function and prints.

Imports of the stages stand inside the commands, so that ``tacgen --help`` is quick and a missing
extra only matters to the commands that need it.
"""

from __future__ import annotations

import signal
import sys

import typer

# Importing a module of commands registers them.
from tacgen.cli import calibrate, cluster, datasets, diagnose, learning, machine, objects  # noqa: F401
from tacgen.cli.app import app
from tacgen.core.errors import Interrupted, TacgenError


def main() -> None:
    """Run the command line; a ``TacgenError`` becomes one message and its exit code."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _interrupt)
    try:
        app()
    except TacgenError as error:
        typer.echo(f"tacgen: {error}", err=True)
        sys.exit(error.exit_code)
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        mend = "check the path, its rights and the free space"
        typer.echo(f"tacgen: {where}{error.strerror or error}; {mend}", err=True)
        sys.exit(2)
    except Interrupted:
        typer.echo("tacgen: interrupted; finished work is kept", err=True)
        sys.exit(130)


def _interrupt(_signal: int, _frame: object) -> None:
    raise Interrupted

"""The command line: each command loads its input, calls one function and prints.

Imports of the stages stand inside the commands, so that ``tacgen --help`` is quick and a missing
extra only matters to the commands that need it.
"""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from tacgen.errors import TacgenError

app = typer.Typer(
    name="tacgen",
    help="Training data for robots that feel: simulated grasps, calibrated GelSight images.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)
calibrate_app = typer.Typer(
    help="Fit the lookup table and the contact law to ball presses.", no_args_is_help=True
)
diagnose_app = typer.Typer(
    help="Trace what a calibrated model leaves over to an effect it lacks.", no_args_is_help=True
)
objects_app = typer.Typer(
    help="Objects to grasp: add your own mesh, list, show.", no_args_is_help=True
)
app.add_typer(calibrate_app, name="calibrate")
app.add_typer(diagnose_app, name="diagnose")
app.add_typer(objects_app, name="objects")

JsonFlag = Annotated[
    bool, typer.Option("--json", help="Print machine-readable results on standard output.")
]


@app.command()
def version() -> None:
    """Print tacgen's version."""
    from tacgen import __version__

    typer.echo(__version__)


def main() -> None:
    """Run the command line; a ``TacgenError`` becomes one message and its exit code."""
    try:
        app()
    except TacgenError as error:
        typer.echo(f"tacgen: {error}", err=True)
        sys.exit(error.exit_code)
    except KeyboardInterrupt:
        typer.echo("tacgen: interrupted; finished work is kept", err=True)
        sys.exit(130)

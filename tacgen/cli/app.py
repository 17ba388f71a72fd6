"""The application, its groups of commands, and the arguments that commands share."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

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
app.add_typer(calibrate_app, name="calibrate", rich_help_panel="Truth")
app.add_typer(diagnose_app, name="diagnose", rich_help_panel="Truth")
app.add_typer(objects_app, name="objects", rich_help_panel="Datasets")

RecipeArgument = Annotated[
    str, typer.Argument(help="A recipe's YAML file, or the name of one that tacgen ships.")
]
DatasetArgument = Annotated[
    Path, typer.Argument(help="The folder of a dataset, made by `tacgen collect --out`.")
]
JsonFlag = Annotated[
    bool, typer.Option("--json", help="Print machine-readable results on standard output.")
]


def print_record(record: Mapping[str, object], json_output: bool) -> None:
    """A flat record: as JSON, or a line for each entry."""
    if json_output:
        typer.echo(json.dumps(record, indent=2))
        return
    for name, value in record.items():
        text = ", ".join(str(item) for item in value) if isinstance(value, (list, tuple)) else value
        typer.echo(f"{name.replace('_', ' '):>16}  {text}")

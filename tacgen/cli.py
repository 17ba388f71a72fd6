"""The command line: each command loads its input, calls one function and prints.

Imports of the stages stand inside the commands, so that ``tacgen --help`` is quick and a missing
extra only matters to the commands that need it.
"""

from __future__ import annotations

import csv
import json
import signal
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from tacgen.errors import Interrupted, TacgenError

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

RecipeArgument = Annotated[
    str, typer.Argument(help="A recipe's YAML file, or the name of one that tacgen ships.")
]
DatasetArgument = Annotated[
    Path, typer.Argument(help="The folder of a dataset, made by `tacgen collect --out`.")
]
JsonFlag = Annotated[
    bool, typer.Option("--json", help="Print machine-readable results on standard output.")
]


@app.command()
def version() -> None:
    """Print tacgen's version."""
    from tacgen import __version__

    typer.echo(__version__)


@app.command()
def doctor(json_output: JsonFlag = False) -> None:
    """Say what this machine can do, and how to mend what is missing."""
    from tacgen import doctor as examination

    findings = examination.examine()
    if json_output:
        typer.echo(json.dumps([asdict(finding) for finding in findings], indent=2))
    else:
        for finding in findings:
            mark = "ok" if finding.ok else "MISSING" if finding.needed else "none"
            mend = f"  → {finding.mend}" if finding.mend else ""
            typer.echo(f"{mark:>7}  {finding.name:<10} {finding.detail}{mend}")
    if any(finding.needed and not finding.ok for finding in findings):
        raise typer.Exit(1)


@app.command()
def grid(recipe: RecipeArgument, json_output: JsonFlag = False) -> None:
    """List the grasps of a recipe and the shard of each, as CSV."""
    from tacgen.grid import grid_rows, plan_recipe
    from tacgen.recipe import load_recipe

    rows = grid_rows(plan_recipe(load_recipe(recipe)))
    if json_output:
        typer.echo(json.dumps(rows, indent=2))
        return
    writer = csv.DictWriter(sys.stdout, fieldnames=list(rows[0]))
    writer.writeheader()
    writer.writerows(rows)


@app.command()
def inspect(folder: DatasetArgument, json_output: JsonFlag = False) -> None:
    """Show what a dataset holds: counts, labels by object, splits, sizes, origin."""
    from tacgen.dataset.summary import summarize, summary_text

    summary = summarize(folder)
    typer.echo(json.dumps(summary.as_dict(), indent=2) if json_output else summary_text(summary))


@app.command()
def verify(
    folder: DatasetArgument,
    decode: Annotated[bool, typer.Option("--decode", help="Also decompress every image.")] = False,
    json_output: JsonFlag = False,
) -> None:
    """Check a dataset: every hash, shape and label; exit 1 and the bad shards if any is wrong."""
    from tqdm import tqdm

    from tacgen.dataset import verify as check
    from tacgen.errors import VerificationError

    with tqdm(unit="B", unit_scale=True, disable=None, leave=False) as bar:
        found = check.verify(folder, decode=decode, progress=bar.update)
    if json_output:
        typer.echo(json.dumps(found.as_dict(), indent=2))
        raise typer.Exit(1 if found.problems else 0)
    if found.problems:
        raise VerificationError.from_problems(
            [
                f"{folder}: {len(found.problems)} problems, {len(found.bad_shards)} bad shards",
                *(f"  {problem.file}: {problem.reason}" for problem in found.problems),
                "`tacgen collect` makes what is missing, `tacgen collect --repair` the bad shards",
            ]
        )
    typer.echo(f"{found.n_grasps} grasps in {found.n_shards} shards, all as they were written")


@app.command()
def merge(folder: DatasetArgument) -> None:
    """Make the one manifest out of those of all shards, wherever they were made."""
    from tacgen.dataset import DatasetFolder

    lines = DatasetFolder(folder).merge()
    typer.echo(f"{folder}/manifest.jsonl: {len(lines)} shards")


@app.command()
def export(
    folder: DatasetArgument,
    out: Annotated[Path, typer.Option(help="The folder to write; it must not exist.")],
    format_name: Annotated[
        str, typer.Option("--format", help="What to write: lerobot.")
    ] = "lerobot",
) -> None:
    """Write a dataset in a format that other tools read."""
    from tacgen.dataset.lerobot import export_dataset

    typer.echo(export_dataset(folder, out, format_name))


def main() -> None:
    """Run the command line; a ``TacgenError`` becomes one message and its exit code."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _interrupt)
    try:
        app()
    except TacgenError as error:
        typer.echo(f"tacgen: {error}", err=True)
        sys.exit(error.exit_code)
    except Interrupted:
        typer.echo("tacgen: interrupted; finished work is kept", err=True)
        sys.exit(130)


def _interrupt(_signal: int, _frame: object) -> None:
    raise Interrupted

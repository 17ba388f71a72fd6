"""Commands about this machine: what it can do, how fast it is."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Annotated

import typer

from tacgen.cli.app import (
    JsonFlag,
    app,
)


@app.command(rich_help_panel="This machine")
def version() -> None:
    """Print tacgen's version."""
    from tacgen import __version__

    typer.echo(__version__)


@app.command(rich_help_panel="This machine")
def doctor(json_output: JsonFlag = False) -> None:
    """Say what this machine can do, and how to mend what is missing."""
    from tacgen.cli import doctor as examination

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


@app.command(rich_help_panel="This machine")
def bench(
    recipe: Annotated[
        str | None, typer.Option(help="Also say how long this recipe would take here.")
    ] = None,
    repeats: Annotated[int, typer.Option(min=5, help="Repeats of each frame.")] = 30,
    json_output: JsonFlag = False,
) -> None:
    """Measure frames and grasps on this machine, one thread, medians."""
    from tacgen.collection.bench import estimate_s, run_benchmarks
    from tacgen.collection.recipe import load_recipe

    estimate = estimate_s(load_recipe(recipe)) if recipe else {}
    figures = run_benchmarks(repeats=repeats)
    if json_output:
        record = {figure.name: figure.value for figure in figures}
        typer.echo(json.dumps(record | ({"recipe": estimate} if estimate else {}), indent=2))
        return
    for figure in figures:
        typer.echo(f"{figure.name:<24} {figure.value:9.4g} {figure.unit:<3} {figure.what}")
    if estimate:
        typer.echo(
            f"{recipe}: {estimate['grasps']:.0f} grasps at {estimate['grasp_s']:.2f} s, "
            f"{estimate['total_s'] / 60:.1f} min with one worker"
        )

"""Commands for this machine: check what is installed, measure its speed."""

from dataclasses import asdict
from typing import Annotated

import typer
from typer import Argument, Option

from tacgen.cli import common


@common.app.command(rich_help_panel=common.MACHINE)
def doctor(json_output: common.JsonFlag = False) -> None:
    """Check what tacgen needs on this machine and state how to install what is missing."""
    from tacgen.cli.doctor import examine

    findings = examine()
    common.print_result([asdict(finding) for finding in findings], map(str, findings), json_output)
    if any(finding.needed and not finding.ok for finding in findings):
        raise typer.Exit(1)
    common.hand_over("tacgen collect quickstart --out data")


@common.app.command(rich_help_panel=common.MACHINE)
def bench(
    repeats: Annotated[int, Option(min=5, help="Repetitions of each measurement.")] = 30,
    batch: Annotated[bool, Option("--batch", help="Measure batches of worlds instead.")] = False,
    worlds: Annotated[
        list[int] | None, Argument(min=1, help="Numbers of worlds, after --batch; 1 64 1024.")
    ] = None,
    device: Annotated[str, Option(help="Of the batches: cpu or cuda.")] = "cpu",
    json_output: common.JsonFlag = False,
) -> None:
    """Measure what frames, grasps, readings, a table and a diagnosis take on this machine."""
    from tacgen.cli.bench import BATCHES, batch_figures, run_benchmarks

    figures = list(
        batch_figures(worlds or BATCHES, device, repeats)
        if batch or worlds
        else run_benchmarks(repeats)
    )
    record = {name: value for name, value, _, _ in figures}
    width = max(len(name) for name, *_ in figures)
    lines = [
        f"{name:<{width}} {value:9.4g} {unit:<3} {what}" for name, value, unit, what in figures
    ]
    common.print_result(record, lines, json_output)

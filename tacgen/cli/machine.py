"""Commands for this machine: check what is installed, measure its speed."""

from dataclasses import asdict
from typing import Annotated

import typer
from typer import Option

from tacgen.cli import common


@common.app.command(rich_help_panel=common.MACHINE)
def doctor(json_output: common.JsonFlag = False) -> None:
    """Check what tacgen needs on this machine and state how to install what is missing."""
    from tacgen.cli.doctor import examine

    findings = examine()
    common.print_result([asdict(finding) for finding in findings], map(str, findings), json_output)
    if any(finding.needed and not finding.ok for finding in findings):
        raise typer.Exit(1)
    common.hand_over("tacgen collect quickstart --out data --workers 2")


@common.app.command(rich_help_panel=common.MACHINE)
def bench(
    recipe: Annotated[
        str | None, Option(help="Also estimate how long this recipe takes here.")
    ] = None,
    repeats: Annotated[int, Option(min=5, help="Repetitions of each measurement.")] = 30,
    json_output: common.JsonFlag = False,
) -> None:
    """Measure the time of frames and grasps on this machine: medians, one thread."""
    from tacgen.collection.bench import estimate_s, run_benchmarks
    from tacgen.collection.recipe import load_recipe

    estimate = estimate_s(load_recipe(recipe)) if recipe else {}
    figures = list(run_benchmarks(repeats))
    record: dict[str, object] = {name: value for name, value, _, _ in figures}
    lines = [f"{name:<24} {value:9.4g} {unit:<3} {what}" for name, value, unit, what in figures]
    if estimate:
        record["recipe"] = estimate
        total = f"{estimate['total_s'] / 60:.1f} min with one worker"
        each = f"{estimate['grasps']:.0f} grasps at {estimate['grasp_s']:.2f} s"
        lines.append(f"{recipe}: {each}, {total}")
    common.print_result(record, lines, json_output)

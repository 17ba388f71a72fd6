"""Commands about the networks: train, evaluate, whole studies."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from tacgen.cli.app import (
    DatasetArgument,
    JsonFlag,
    app,
)


@app.command(rich_help_panel="Networks")
def train(
    recipe: Annotated[str, typer.Argument(help="A training recipe, such as train_single.")],
    data: Annotated[Path, typer.Option("--data", help="A dataset made by `tacgen collect`.")],
    out: Annotated[Path, typer.Option("--out", help="Where the run goes; it resumes there.")],
    workers: Annotated[
        int, typer.Option(min=1, help="Models trained at a time, one an object.")
    ] = 1,
    json_output: JsonFlag = False,
) -> None:
    """Train grasp-stability networks on the training grasps of a dataset."""
    from tacgen.learning.formatting import training_lines
    from tacgen.learning.optional_dependencies import require_learning_extra
    from tacgen.learning.training_recipe import load_train_recipe

    require_learning_extra()
    from tacgen.learning.train import train as train_models

    summary = train_models(load_train_recipe(recipe), data, out, workers=workers)
    typer.echo(json.dumps(summary) if json_output else "\n".join(training_lines(summary)))


@app.command("eval", rich_help_panel="Networks")
def evaluate(
    run: Annotated[Path, typer.Argument(help="The folder of a run, made by `tacgen train`.")],
    data: Annotated[
        Path | None, typer.Option("--data", help="Test on the test grasps of this dataset.")
    ] = None,
    real: Annotated[
        Path | None, typer.Option("--real", help="Test on the real grasps of this folder.")
    ] = None,
    json_output: JsonFlag = False,
) -> None:
    """Test a run on simulated or real grasps; tells the sim-to-real gap once both are known."""
    from tacgen.learning.formatting import evaluation_lines
    from tacgen.learning.optional_dependencies import require_learning_extra

    require_learning_extra()
    from tacgen.learning.evaluate import evaluate as evaluate_run

    result = evaluate_run(run, data, real)
    typer.echo(json.dumps(result) if json_output else "\n".join(evaluation_lines(result)))


@app.command(rich_help_panel="Networks")
def told(data: DatasetArgument, json_output: JsonFlag = False) -> None:
    """How well outcomes follow from force and place: what a network can hope for."""
    from tacgen.learning.grasps import SimulatedGrasps
    from tacgen.learning.optional_dependencies import require_learning_extra
    from tacgen.learning.parameter_baseline import told_lines, told_scores

    require_learning_extra()
    scores = told_scores(SimulatedGrasps(data).table)
    typer.echo(json.dumps(scores) if json_output else "\n".join(told_lines(scores)))


@app.command(rich_help_panel="Networks")
def study(
    recipe: Annotated[str, typer.Argument(help="A study, such as paper_table.")],
    out: Annotated[Path, typer.Option("--out", help="Where datasets, runs and the table go.")],
    real: Annotated[
        Path | None, typer.Option("--real", help="Real grasps to test on as well.")
    ] = None,
    calibrate_on: Annotated[
        Path | None,
        typer.Option("--calibrate-on", help="Other real grasps, to calibrate friction on."),
    ] = None,
    contact: Annotated[
        Path | None,
        typer.Option("--contact", help="The real sensor's contact.yaml, for rows that take it."),
    ] = None,
    row: Annotated[
        list[str] | None,
        typer.Option("--row", help="Only the row of this name; may be given several times."),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="The reduced version.")] = False,
    workers: Annotated[int, typer.Option(min=1, help="Processes that collect and train.")] = 1,
) -> None:
    """Collect, train and test every row of a study; writes the table as Markdown and HTML."""
    from tacgen.learning.optional_dependencies import require_learning_extra
    from tacgen.study.study_recipe import load_study

    require_learning_extra()
    from tacgen.study.reality import Reality
    from tacgen.study.run import check_finished, run_study

    result = run_study(
        load_study(recipe),
        out,
        Reality(real, calibrate_on, contact),
        rows=row or (),
        quick=quick,
        workers=workers,
    )
    typer.echo((out / "table.md").read_text(encoding="utf-8"))
    check_finished(result)


@app.command("stand-in", rich_help_panel="Networks")
def stand_in(
    data: DatasetArgument,
    out: Annotated[Path, typer.Option("--out", help="The folder to write; it must not exist.")],
    split: Annotated[str, typer.Option("--split", help="train or test.")] = "test",
    per_object: Annotated[
        int | None, typer.Option("--per-object", min=1, help="At most so many of each object.")
    ] = None,
    images: Annotated[bool, typer.Option(help="Write the images too.")] = True,
) -> None:
    """Write a dataset as a folder of real grasps: a stand-in for reality, still simulated."""
    from tacgen.study.stand_in import write_stand_in

    count = write_stand_in(data, out, split=split, per_object=per_object, images=images)
    typer.echo(f"{out}: {count} simulated grasps in the format of real ones")

"""The command line: each command loads its input, calls one function and prints.

Imports of the stages stand inside the commands, so that ``tacgen --help`` is quick and a missing
extra only matters to the commands that need it.
"""

from __future__ import annotations

import csv
import json
import os
import signal
import sys
from collections.abc import Mapping
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


@app.command()
def train(
    recipe: Annotated[str, typer.Argument(help="A training recipe, such as train_single.")],
    data: Annotated[Path, typer.Option("--data", help="A dataset made by `tacgen collect`.")],
    out: Annotated[Path, typer.Option("--out", help="Where the run goes; it resumes there.")],
    json_output: JsonFlag = False,
) -> None:
    """Train grasp-stability networks on the training grasps of a dataset."""
    from tacgen.learning.extra import require_learning_extra
    from tacgen.learning.recipe import load_train_recipe
    from tacgen.learning.words import training_lines

    require_learning_extra()
    from tacgen.learning.train import train as train_models

    summary = train_models(load_train_recipe(recipe), data, out)
    typer.echo(json.dumps(summary) if json_output else "\n".join(training_lines(summary)))


@app.command("eval")
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
    from tacgen.learning.extra import require_learning_extra
    from tacgen.learning.words import evaluation_lines

    require_learning_extra()
    from tacgen.learning.evaluate import evaluate as evaluate_run

    result = evaluate_run(run, data, real)
    typer.echo(json.dumps(result) if json_output else "\n".join(evaluation_lines(result)))


@app.command()
def collect(
    recipe: RecipeArgument,
    out: Annotated[Path, typer.Option(help="The dataset's folder; goes on if it is there.")],
    workers: Annotated[int, typer.Option(min=1, help="Processes.")] = 1,
    shard: Annotated[
        str, typer.Option(help="Only part I of N (I from 0), or auto in a batch job's array.")
    ] = "0/1",
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show what would be done.")] = False,
    repair: Annotated[
        bool, typer.Option("--repair", help="Verify first, and remake the shards that are bad.")
    ] = False,
    grasp_limit_s: Annotated[
        float, typer.Option(min=1.0, help="A grasp that takes longer is recorded as crashed.")
    ] = 120.0,
    json_output: JsonFlag = False,
) -> None:
    """Simulate a recipe's grasps and write them as a dataset; goes on where it stopped."""
    from tacgen.collect import collect as run
    from tacgen.collect import describe, shards_to_repair
    from tacgen.recipe import load_recipe
    from tacgen.shares import parse_share, share_of

    loaded = load_recipe(recipe)
    plan = describe(loaded, out)
    part, parts, origin = parse_share(shard, os.environ)
    share = share_of(plan.shards, part, parts)
    if dry_run:
        _print_record(asdict(plan), json_output)
        return
    if parts > 1:
        typer.echo(f"part {part} of {parts} ({origin}): {len(share)} shards", err=True)
    redo = [number for number in shards_to_repair(out) if number in share] if repair else []
    result = run(
        loaded,
        out,
        workers=workers,
        shards=share,
        redo=redo,
        item_limit_s=grasp_limit_s,
        progress=not json_output,
    )
    _print_record(result.summary(), json_output)


@app.command()
def bench(
    recipe: Annotated[
        str | None, typer.Option(help="Also say how long this recipe would take here.")
    ] = None,
    repeats: Annotated[int, typer.Option(min=5, help="Repeats of each frame.")] = 30,
    json_output: JsonFlag = False,
) -> None:
    """Measure frames and grasps on this machine, one thread, medians."""
    from tacgen.bench import estimate_s, run_benchmarks
    from tacgen.recipe import load_recipe

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


@app.command()
def friction(
    recipe: RecipeArgument,
    real: Annotated[Path, typer.Option(help="A folder of real grasps: grasps.csv, images/.")],
    out: Annotated[Path, typer.Option(help="Folder of the results; goes on if it is there.")],
    mu: Annotated[str, typer.Option(help="Values of μ: start:stop:step.")] = "0:1:0.05",
    workers: Annotated[int, typer.Option(min=1, help="Processes.")] = 2,
    write_objects: Annotated[
        bool, typer.Option("--write-objects", help="Write object.yaml copies with the new μ.")
    ] = False,
    json_output: JsonFlag = False,
) -> None:
    """Find each object's friction: the μ whose simulated grasps end as the real ones did."""
    from tacgen.dataset.real_grasps import read_real_grasps
    from tacgen.friction import friction_json, mu_range, sweep_friction, write_object_copies
    from tacgen.friction_report import verdict_of, write_friction_report
    from tacgen.recipe import load_recipe
    from tacgen.resources import object_folders

    loaded = load_recipe(recipe)
    grasps = read_real_grasps(real, known_objects=tuple(object_folders()))
    for warning in grasps.warnings:
        typer.echo(f"warning: {warning}", err=True)
    from tacgen.progress import progress_counter

    with progress_counter("grasp") as show:
        fits, outcomes = sweep_friction(
            loaded, grasps, mu_range(mu), out, workers=workers, show=show
        )
    write_friction_report(out / "report.html", grasps, outcomes, fits)
    if write_objects:
        write_object_copies(fits, out / "objects")
    if json_output:
        typer.echo(json.dumps(friction_json(fits), indent=2))
    else:
        for name, fit in fits.items():
            typer.echo(verdict_of(name, fit))


def _print_record(record: Mapping[str, object], json_output: bool) -> None:
    """A flat record: as JSON, or a line for each entry."""
    if json_output:
        typer.echo(json.dumps(record, indent=2))
        return
    for name, value in record.items():
        text = ", ".join(str(item) for item in value) if isinstance(value, (list, tuple)) else value
        typer.echo(f"{name.replace('_', ' '):>16}  {text}")


@app.command()
def rig(
    recipe: RecipeArgument,
    out: Annotated[Path, typer.Option("--out", help="Folder for the log and the images.")],
) -> None:
    """Press balls on a virtual rig: a press log, press images or both, with known truth."""
    from tacgen.rig import load_rig_recipe, run_rig

    for path in run_rig(load_rig_recipe(recipe), out):
        typer.echo(str(path))


@calibrate_app.command("contact")
def calibrate_contact(
    log: Annotated[
        Path,
        typer.Argument(
            help="A press log (CSV, Parquet), force-depth curves, or a folder of press images "
            "with forces."
        ),
    ],
    out: Annotated[Path, typer.Option("--out", help="The contact.yaml to write.")],
    report: Annotated[Path | None, typer.Option(help="Folder for an HTML report.")] = None,
    by: Annotated[
        str | None, typer.Option(help="Compare k between values of this column (or `trial`).")
    ] = None,
    contact_point: Annotated[
        str, typer.Option(help="fixed, free (estimated for every press), or auto.")
    ] = "auto",
    force_unit: Annotated[
        str | None, typer.Option(help="Unit of the force columns: n, mn, gf or kgf.")
    ] = None,
    marker_pitch_mm: Annotated[
        float, typer.Option(help="Pitch of the markers whose motion was summed.")
    ] = float("nan"),
    radius_mm: Annotated[
        float | None, typer.Option(help="The ball's radius, for curves of force against depth.")
    ] = None,
    table: Annotated[
        Path | None, typer.Option(help="The sensor's table.npz, for images: shape to volume.")
    ] = None,
    save_log: Annotated[
        Path | None, typer.Option(help="Where to keep the press log found in images.")
    ] = None,
    json_output: JsonFlag = False,
) -> None:
    """Fit the contact law k_n, k_s to a press log, with intervals and held-out error."""
    from tacgen.calibration.contact_command import calibrate_contact as calibrate
    from tacgen.calibration.contact_command import result_text

    result = calibrate(
        log, out, report, by=by, contact_point=contact_point, force_unit=force_unit,
        marker_pitch_mm=marker_pitch_mm, radius_mm=radius_mm, table=table, save_log=save_log,
    )  # fmt: skip
    for warning in result.warnings:
        typer.echo(f"warning: {warning}", err=True)
    typer.echo(result_text(result, json_output=json_output))


@objects_app.command("list")
def objects_list(json_output: JsonFlag = False) -> None:
    """List every object that can be grasped here: tacgen's and those in ./objects."""
    from tacgen.objects_io.listing import object_rows, rows_text

    rows = object_rows()
    typer.echo(json.dumps(rows, indent=2, ensure_ascii=False) if json_output else rows_text(rows))


@objects_app.command("show")
def objects_show(
    name: Annotated[str, typer.Argument(help="An object's name, or its folder.")],
    out: Annotated[
        Path | None, typer.Option("--out", help="Also write a picture of it, as PNG.")
    ] = None,
    json_output: JsonFlag = False,
) -> None:
    """Show an object's figures, each with its source."""
    from tacgen.objects_io import load_object
    from tacgen.objects_io.description import read_description
    from tacgen.objects_io.listing import facts_text, object_facts
    from tacgen.objects_io.picture import write_picture
    from tacgen.resources import find_object_folder

    obj = load_object(name)
    facts = object_facts(obj, read_description(find_object_folder(name)))
    if out is not None:
        write_picture(obj, out)
    typer.echo(
        json.dumps(facts, indent=2, ensure_ascii=False) if json_output else facts_text(facts)
    )


@objects_app.command("add")
def objects_add(
    mesh: Annotated[Path, typer.Argument(help="An OBJ, STL, PLY or GLB file.")],
    mass_kg: Annotated[float, typer.Option("--mass", help="What the object weighs, kg.")],
    scale: Annotated[
        float, typer.Option("--scale", help="mm per unit of the mesh: 1000 for metres.")
    ] = 1.0,
    name: Annotated[
        str | None, typer.Option("--name", help="Name of the object [default: the file's].")
    ] = None,
    friction: Annotated[
        float, typer.Option("--friction", help="Coulomb coefficient against the gel.")
    ] = 0.4,
    up: Annotated[
        str, typer.Option("--up", help="The mesh's axis that points up: x, y or z.")
    ] = "z",
    force: Annotated[bool, typer.Option("--force", help="Replace an object of that name.")] = False,
    json_output: JsonFlag = False,
) -> None:
    """Import a mesh of your own into ./objects, ready to be named in a recipe."""
    from tacgen.objects_io.add import add_object
    from tacgen.objects_io.description import read_description
    from tacgen.objects_io.listing import facts_text, object_facts

    typer.echo(f"tacgen: importing {mesh}; convex parts take up to a minute", err=True)
    added = add_object(
        mesh, mass_kg=mass_kg, scale=scale, name=name, friction=friction, up=up, force=force
    )
    for note in added.notes:
        typer.echo(f"tacgen: note: {note}", err=True)
    facts = object_facts(added.object, read_description(Path("objects") / added.object.name))
    typer.echo(
        json.dumps(facts, indent=2, ensure_ascii=False) if json_output else facts_text(facts)
    )


@app.command()
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
    quick: Annotated[bool, typer.Option("--quick", help="The reduced version.")] = False,
    workers: Annotated[int, typer.Option(min=1, help="Processes that collect.")] = 1,
) -> None:
    """Collect, train and test every row of a study; writes the table as Markdown and HTML."""
    from tacgen.learning.extra import require_learning_extra
    from tacgen.study_recipe import load_study

    require_learning_extra()
    from tacgen.study import RealFolders, run_study

    run_study(
        load_study(recipe), out, RealFolders(real, calibrate_on), quick=quick, workers=workers
    )
    typer.echo((out / "table.md").read_text(encoding="utf-8"))


@app.command("stand-in")
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
    from tacgen.stand_in import write_stand_in

    count = write_stand_in(data, out, split=split, per_object=per_object, images=images)
    typer.echo(f"{out}: {count} simulated grasps in the format of real ones")


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

"""Commands that hold the model against measured data: friction, diagnosis."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from tacgen.cli.app import (
    JsonFlag,
    RecipeArgument,
    app,
    diagnose_app,
)


@app.command(rich_help_panel="Truth")
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
    from tacgen.calibrate.friction.report import verdict_of, write_friction_report
    from tacgen.calibrate.friction.sweep import (
        doubts_about,
        friction_json,
        mu_range,
        sweep_friction,
        write_object_copies,
    )
    from tacgen.collection.recipe import load_recipe
    from tacgen.core.resources import object_folders
    from tacgen.dataset.real_grasps import read_real_grasps

    loaded = load_recipe(recipe)
    grasps = read_real_grasps(real, known_objects=tuple(object_folders()))
    from tacgen.core.progress import progress_counter

    with progress_counter("grasp") as show:
        fits, outcomes = sweep_friction(
            loaded, grasps, mu_range(mu), out, workers=workers, show=show
        )
    doubts = doubts_about(grasps, outcomes, mu_range(mu))
    for doubt in doubts:
        typer.echo(f"warning: {doubt}", err=True)
    write_friction_report(out / "report.html", grasps, outcomes, fits, doubts)
    if write_objects:
        write_object_copies(fits, out / "objects")
    if json_output:
        typer.echo(json.dumps(friction_json(fits), indent=2))
    else:
        for name, fit in fits.items():
            typer.echo(verdict_of(name, fit))


@diagnose_app.command("contact")
def diagnose_contact(
    log: Annotated[Path, typer.Argument(help="A press log: CSV or Parquet.")],
    out: Annotated[Path, typer.Option("--out", help="Folder for the diagnosis.")],
    marker_pitch_mm: Annotated[
        float, typer.Option(help="Pitch of the markers whose motion was summed.")
    ] = float("nan"),
    grasp: Annotated[
        str | None,
        typer.Option(help="A recipe with sequences: show its strongest grasp before and after."),
    ] = None,
    json_output: JsonFlag = False,
) -> None:
    """Trace what V = k_n F_n and D = k_s F_s leave over of a press log, and extend the law."""
    from tacgen.diagnose.contact.command import diagnose_log
    from tacgen.diagnose.contact.result import diagnosis_record

    diagnosis = diagnose_log(log, out, marker_pitch_mm=marker_pitch_mm)
    for note in diagnosis.notes:
        typer.echo(note, err=True)
    if grasp is not None:
        from tacgen.collection.recipe import load_recipe
        from tacgen.diagnose.contact.law_comparison import write_before_after

        write_before_after(
            load_recipe(grasp), diagnosis.linear_law, diagnosis.law, out / "grasp.html"
        )
    if json_output:
        typer.echo(json.dumps(diagnosis_record(diagnosis), ensure_ascii=False))
        return
    for found in diagnosis.channels.values():
        typer.echo(found.sentence)


@diagnose_app.command("optics")
def diagnose_optics(
    presses: Annotated[
        Path, typer.Argument(help="A folder of press images, or Taxim's dataPack.npz.")
    ],
    out: Annotated[Path, typer.Option("--out", help="Folder of diagnosis.json, table.npz, page.")],
    table: Annotated[
        Path | None,
        typer.Option(
            "--table", help="A table from before; without one the presses make their own."
        ),
    ] = None,
    mm_per_px: Annotated[
        float | None, typer.Option("--mm-per-px", help="Size of a pixel, if not in a file.")
    ] = None,
    ball_radius_mm: Annotated[
        float | None, typer.Option("--ball-radius-mm", help="Its radius, if not in a file.")
    ] = None,
    json_output: JsonFlag = False,
) -> None:
    """Trace what a table leaves over on ball presses to optical effects."""
    from tacgen.diagnose.optics.report import sentence, write_optics_diagnosis

    diagnosis, used = write_optics_diagnosis(
        presses, out, table_path=table, mm_per_px=mm_per_px, ball_radius_mm=ball_radius_mm
    )
    for line in (*used.warnings, *(str(press) for press in used.doubtful)):
        typer.echo(f"warning: {line}", err=True)
    typer.echo(json.dumps(diagnosis.as_dict()) if json_output else sentence(diagnosis))


@diagnose_app.command("grasps")
def diagnose_grasps_command(
    real: Annotated[Path, typer.Argument(help="A folder of real grasps: grasps.csv, images/.")],
    recipe: Annotated[str, typer.Option("--recipe", help="The recipe that declares the world.")],
    out: Annotated[
        Path, typer.Option("--out", help="Folder of the results; goes on if it is there.")
    ],
    workers: Annotated[int, typer.Option(min=1, help="Processes.")] = 2,
    json_output: JsonFlag = False,
) -> None:
    """Trace grasps that end otherwise than simulated to what the declared world lacks."""
    from tacgen.collection.recipe import load_recipe
    from tacgen.core.progress import progress_counter
    from tacgen.core.resources import object_folders
    from tacgen.dataset.real_grasps import read_real_grasps
    from tacgen.diagnose.grasps.command import diagnose_grasps, record_of
    from tacgen.diagnose.grasps.report import write_grasp_report

    loaded = load_recipe(recipe)
    grasps = read_real_grasps(real, known_objects=tuple(object_folders()))
    with progress_counter("grasp") as show:
        findings = diagnose_grasps(loaded, grasps, out, workers=workers, show=lambda what: show)
    for note in findings.diagnosis.notes:
        typer.echo(f"note: {note}", err=True)
    write_grasp_report(out / "report.html", grasps, findings)
    if json_output:
        record = record_of(findings, loaded, list(grasps.by_object()))
        typer.echo(json.dumps(record, ensure_ascii=False))
    else:
        typer.echo(findings.diagnosis.sentence)

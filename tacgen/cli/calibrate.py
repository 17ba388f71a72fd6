"""Commands that calibrate a sensor, and the virtual rig that stands in for one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tacgen.cli.app import (
    JsonFlag,
    RecipeArgument,
    app,
    calibrate_app,
)

PressesArgument = Annotated[
    Path, typer.Argument(help="A folder of press images, or Taxim's dataPack.npz.")
]
ScaleOption = Annotated[
    float | None, typer.Option("--mm-per-px", help="Size of a pixel on the gel, if not in a file.")
]
BallOption = Annotated[
    float | None, typer.Option("--ball-radius-mm", help="The ball's radius, if not in a file.")
]


@app.command(rich_help_panel="Truth")
def rig(
    recipe: RecipeArgument,
    out: Annotated[Path, typer.Option("--out", help="Folder for the log and the images.")],
    seed: Annotated[
        int | None, typer.Option(help="Another session of the same recipe.", min=0)
    ] = None,
) -> None:
    """Press balls on a virtual rig: a press log, press images or both, with known truth."""
    from tacgen.rig import load_rig_recipe, run_rig

    changes = {} if seed is None else {"seed": seed}
    for path in run_rig(load_rig_recipe(recipe, changes), out):
        typer.echo(str(path))


@calibrate_app.command("lookup")
def calibrate_lookup(
    presses: PressesArgument,
    out: Annotated[Path, typer.Option("--out", help="The table.npz to write.")],
    report: Annotated[Path | None, typer.Option(help="Folder for an HTML report.")] = None,
    mm_per_px: ScaleOption = None,
    ball_radius_mm: BallOption = None,
    without_dots: Annotated[
        bool,
        typer.Option(help="Remove printed dots from the background: for optics.markers: true."),
    ] = False,
    json_output: JsonFlag = False,
) -> None:
    """Fit the lookup table to images of ball presses, with its error on held-out presses."""
    from tacgen.calibrate.lookup import command

    made, used = command.calibrate_lookup(
        presses, out, report, mm_per_px=mm_per_px, ball_radius_mm=ball_radius_mm,
        without_dots=without_dots,
    )  # fmt: skip
    for line in command.warning_lines(used, made.scale):
        typer.echo(f"warning: {line}", err=True)
    typer.echo(command.lookup_text(made, used, json_output=json_output))


@calibrate_app.command("score")
def calibrate_score(
    table: Annotated[Path, typer.Argument(help="A table.npz.")],
    presses: PressesArgument,
    mm_per_px: ScaleOption = None,
    ball_radius_mm: BallOption = None,
    json_output: JsonFlag = False,
) -> None:
    """Score a table on presses: labels as given, and each press's place re-estimated."""
    from tacgen.calibrate.lookup import command

    score, used = command.score_presses(
        table, presses, mm_per_px=mm_per_px, ball_radius_mm=ball_radius_mm
    )
    for line in command.warning_lines(used):
        typer.echo(f"warning: {line}", err=True)
    typer.echo(command.score_text(score, json_output=json_output))


@calibrate_app.command("import")
def calibrate_import(
    polycalib: Annotated[Path, typer.Argument(help="Taxim's polycalib.npz.")],
    background: Annotated[Path, typer.Option(help="Its background: .npy (BGR) or an image.")],
    mm_per_px: Annotated[float, typer.Option(help="Size of a pixel on the gel.")],
    out: Annotated[Path, typer.Option("--out", help="The table.npz to write.")],
) -> None:
    """Turn a Taxim table into one that tacgen renders the same picture with."""
    from tacgen.calibrate.lookup.taxim_import import import_polycalib
    from tacgen.optics import save_table

    save_table(import_polycalib(polycalib, background, mm_per_px), out)
    typer.echo(str(out))


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
    from tacgen.calibrate.contact.command import calibrate_contact as calibrate
    from tacgen.calibrate.contact.command import result_text

    result = calibrate(
        log, out, report, by=by, contact_point=contact_point, force_unit=force_unit,
        marker_pitch_mm=marker_pitch_mm, radius_mm=radius_mm, table=table, save_log=save_log,
    )  # fmt: skip
    for warning in result.warnings:
        typer.echo(f"warning: {warning}", err=True)
    typer.echo(result_text(result, json_output=json_output))

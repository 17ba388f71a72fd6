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


@app.command(rich_help_panel="Truth")
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

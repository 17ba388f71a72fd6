"""Commands that calibrate a sensor, and the virtual rig that simulates presses for them."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from tacgen.cli import common
from tacgen.cli.common import quoted
from tacgen.core.files import refuse_existing

ReportOption = Annotated[Path | None, Option(help="Folder for a report (HTML).")]
TableOutput = Annotated[Path, Option("--out", help="Table file to write (table.npz).")]


@common.app.command("import", rich_help_panel=common.CALIBRATION)
def import_(
    format_name: Annotated[
        str,
        Argument(
            metavar="FORMAT",
            help="gs-sdk, py3dcal, 9dtact or gelsight-mini-pretrain (ball presses); poseit or "
            "feeling-of-success (real grasps).",
        ),
    ],
    source: Annotated[Path, Argument(metavar="SRC", help="Folder or file in that format.")],
    out: Annotated[Path, Option(help="Folder to write; it must not exist yet.")],
    mm_per_px: common.MmPerPxOption = None,
    ball_radius_mm: common.BallRadiusOption = None,
    json_output: common.JsonFlag = False,
) -> None:
    """Convert the ball presses or real grasps of another project into tacgen's layout."""
    from tacgen.core.errors import DatasetError, require_known
    from tacgen.dataset.import_formats import GRASP_FORMATS, import_grasps
    from tacgen.presses.import_formats import PRESS_FORMATS, import_presses

    require_known("FORMAT", format_name, (*PRESS_FORMATS, *GRASP_FORMATS), DatasetError)
    if format_name in PRESS_FORMATS:
        found = import_presses(
            format_name, source, out, mm_per_px=mm_per_px, ball_radius_mm=ball_radius_mm
        )
        count, notes, warnings, kind = found.count, found.notes, found.warnings, "presses"
        follow = f"tacgen calibrate lookup {quoted(out)} --out table.npz"
        if not found.enough:
            follow = f"import all presses of this sensor at once, from a folder above {source}"
    else:
        count, notes = import_grasps(format_name, source, out)
        warnings, kind, follow = (), "grasps", f"tacgen eval run --real {quoted(out)}"
    common.note(notes)
    common.warn(warnings)
    record = {"folder": str(out), "format": format_name, kind: count}
    record |= {"notes": list(notes), "warnings": list(warnings)}
    common.print_result(record, f"{out}: {count} {kind}", json_output)
    common.hand_over(follow)


@common.calibrate_app.command("lookup")
def calibrate_lookup(
    presses: common.PressesArgument,
    out: TableOutput,
    report: ReportOption = None,
    mm_per_px: common.MmPerPxOption = None,
    ball_radius_mm: common.BallRadiusOption = None,
    without_dots: Annotated[
        bool,
        Option("--without-dots", help="Remove printed dots from the background (optics.markers)."),
    ] = False,
    force: common.ForceFlag = False,
    json_output: common.JsonFlag = False,
) -> None:
    """Fit the lookup table to images of ball presses; prints its error on held-out presses."""
    from tacgen.calibrate.lookup import command
    from tacgen.core.sensors import shipped_sensor

    refuse_existing(force, out)
    made, used = command.calibrate_lookup(
        presses, out, report, mm_per_px=mm_per_px, ball_radius_mm=ball_radius_mm,
        without_dots=without_dots,
    )  # fmt: skip
    common.warn(command.warning_lines(used, made.scale))
    text = command.score_text(made.heldout)
    common.print_result(command.lookup_record(made, used), text, json_output)
    dome_mm = made.table.geometry.get("dome_radius_mm")
    lines = common.table_lines(out, made.table.shape_px, made.table.mm_per_px, presses, dome_mm)
    if presses.is_dir():
        own = common.session_sensor(presses) or shipped_sensor(made.table.shape_px)
        sensor, image = quoted(own or "my_sensor.yaml"), quoted(presses / used.names[0])
        lines.append(f"tacgen read {image} --sensor {sensor} --table {quoted(out)} --out readings")
    if command.differs_by_more_than_noise(made):
        lines.append(_diagnose_optics(presses, mm_per_px, ball_radius_mm))
    common.hand_over(*lines)


def _diagnose_optics(
    presses: Path, mm_per_px: float | None, ball_radius_mm: float | None, table: str = ""
) -> str:
    given = {"--mm-per-px": mm_per_px, "--ball-radius-mm": ball_radius_mm}
    options = "".join(f" {name} {value:g}" for name, value in given.items() if value is not None)
    return f"tacgen diagnose optics {quoted(presses)}{table}{options} --out optics"


@common.calibrate_app.command("score")
def calibrate_score(
    table: Annotated[Path, Argument(help="Table file (table.npz).")],
    presses: common.PressesArgument,
    mm_per_px: common.MmPerPxOption = None,
    ball_radius_mm: common.BallRadiusOption = None,
    json_output: common.JsonFlag = False,
) -> None:
    """Compute a table's image error on presses, at the labelled and the fitted ball centres."""
    from tacgen.calibrate.lookup import command

    score, used = command.score_presses(
        table, presses, mm_per_px=mm_per_px, ball_radius_mm=ball_radius_mm
    )
    common.warn([*command.warning_lines(used), *command.contrast_warning(score)])
    common.print_result(score.as_dict(), command.score_text(score), json_output)
    with_table = f" --table {quoted(table)}"
    common.hand_over(_diagnose_optics(presses, mm_per_px, ball_radius_mm, with_table))


@common.calibrate_app.command("import")
def calibrate_import(
    polycalib: Annotated[Path, Argument(help="Taxim's polycalib.npz.")],
    background: Annotated[
        Path, Option(help="Gel without contact: image, .npy (BGR) or Taxim's dataPack.npz.")
    ],
    mm_per_px: Annotated[float, Option(help="Pixel size on the gel, mm.")],
    out: TableOutput,
    force: common.ForceFlag = False,
) -> None:
    """Convert a Taxim calibration into a table that renders the same images."""
    from tacgen.calibrate.lookup.taxim_import import convert_polycalib

    refuse_existing(force, out)
    table = convert_polycalib(polycalib, background, mm_per_px, out)
    typer.echo(str(out))
    common.hand_over(*common.table_lines(out, table.shape_px, mm_per_px))


@common.calibrate_app.command("export")
def calibrate_export(
    calibrated: Annotated[
        Path, Argument(help="Table (table.npz) for taxim, contact law (contact.yaml) for mujoco.")
    ],
    out: Annotated[Path, Option(help="Folder to write; it must not exist yet.")],
    format_name: Annotated[
        str,
        Option(
            "--format",
            help="taxim: the calibration folder of Taxim's simulators; mujoco: a pad with k_n.",
        ),
    ] = "taxim",
    sensor: Annotated[
        str, Option(help="mujoco: sensor whose gel it is.", autocompletion=common.sensor_names)
    ] = "gelsight",
    dome_radius_mm: Annotated[
        float | None,
        Option(
            help="Radius of the gel's dome, mm; default: the table's (else flat), the sensor's."
        ),
    ] = None,
    json_output: common.JsonFlag = False,
) -> None:
    """Write a table or a contact law for other simulators; prints what their form of it loses."""
    from dataclasses import asdict

    from tacgen.core.errors import TableError, require_known

    require_known("--format", format_name, ("taxim", "mujoco"), TableError)
    if format_name == "mujoco":
        from tacgen.calibrate.contact.mujoco_export import export_mujoco
        from tacgen.core.sensors import SensorChoice, load_sensor

        choice = SensorChoice(name=sensor, dome_radius_mm=dome_radius_mm)
        pad = export_mujoco(calibrated, load_sensor(choice, needs_table=False), out)
        common.warn([f"left out: {', '.join(pad.left_out)}"] if pad.left_out else [])
        path = out / "pad.xml"
        common.print_result(
            {"file": str(path), **asdict(pad)}, [str(path), pad.line()], json_output
        )
        common.hand_over(f'mujoco.MjSpec.from_file("{path.resolve()}").body("pad")  # attach it')
        return
    from tacgen.calibrate.lookup.taxim_export import export_taxim
    from tacgen.optics import load_table

    loaded = load_table(calibrated)
    loss = export_taxim(loaded, out, dome_radius_mm)
    if loaded.effects:
        common.warn([f"left out: {', '.join(loaded.effects)}, which Taxim's form has no place for"])
    common.print_result({"folder": str(out), **asdict(loss)}, [str(out), loss.line()], json_output)
    common.hand_over(f'Taxim(calib_folder=Path("{out.resolve()}"))  # of the package taxim')


@common.calibrate_app.command("contact")
def calibrate_contact(
    log: Annotated[
        Path,
        Argument(
            help="Press log with volumes or depths (CSV, Parquet), or images with forces (a folder "
            "or a ROS 2 bag); their press log is written beside the law."
        ),
    ],
    out: Annotated[Path, Option(help="Contact law to write (contact.yaml).")],
    report: ReportOption = None,
    by: Annotated[
        str | None,
        Option(
            help="Compare k between the values of this column, or `trial`; default: the indenters "
            "or the first text column."
        ),
    ] = None,
    contact_point: Annotated[
        str,
        Option(
            help="Depth at first contact: fixed (as logged), free (fitted for each press), or auto "
            "(free where presses of known balls show that they begin elsewhere)."
        ),
    ] = "auto",
    column: common.ColumnOption = None,
    flip: common.FlipOption = None,
    force_unit: common.ForceUnitOption = None,
    marker_pitch_mm: common.MarkerPitchOption = None,
    radius_mm: common.LogRadiusOption = None,
    table: common.LogTableOption = None,
    markers: common.MarkersOption = None,
    sensor: common.MarkerSensorOption = None,
    topic: common.TopicOption = None,
    background: common.BackgroundOption = None,
    force: common.ForceFlag = False,
    json_output: common.JsonFlag = False,
) -> None:
    """Fit the contact law (k_n, k_s) to a press log; prints intervals and held-out error.

    With marker tracks also friction and decay of the gel's shear field.
    """
    from tacgen.calibrate.contact.command import LogSource, result_text
    from tacgen.calibrate.contact.command import calibrate_contact as calibrate
    from tacgen.presses.lab_table import LogFormat
    from tacgen.sensor.recordings import bag_files

    log_format = LogFormat.of_options(column or [], flip or [], force_unit)
    measured = out.with_suffix(".csv") if log.is_dir() or bag_files(log) else log
    refuse_existing(force, out, *([measured] if measured != log else []))
    source = LogSource(
        log, log_format, radius_mm, table, marker_pitch_mm, markers, sensor, topic or (), background
    )
    result = calibrate(source, out, report, by=by, contact_point=contact_point)
    common.warn(result.warnings)
    typer.echo(result_text(result, json_output=json_output))
    options = [] if measured != log else log_format.arguments
    options += [] if radius_mm is None else ["--radius-mm", f"{radius_mm:g}"]
    if markers is not None and sensor is not None:
        options += ["--markers", str(markers), "--sensor", sensor]
    follow_up = ["tacgen diagnose contact", *map(quoted, [measured, *options]), "--out diagnosis"]
    common.hand_over(*common.contact_lines(out), " ".join(follow_up))


@common.app.command(rich_help_panel=common.CALIBRATION)
def friction(
    recipe: common.RecipeArgument,
    real: common.RealGraspsOption,
    out: common.ResultsOption,
    mu: Annotated[str, Option(help="Coefficients to try: start:stop:step.")] = "0:1:0.05",
    workers: common.WorkersOption = common.AUTO,
    write_objects: Annotated[
        bool, Option("--write-objects", help="Also write object.yaml files with the fitted μ.")
    ] = False,
    json_output: common.JsonFlag = False,
) -> None:
    """Fit each object's friction μ so that simulated grasps match the labels of real ones."""
    from tacgen.collection import friction as sweep
    from tacgen.collection.friction_report import verdict_of, write_friction_report
    from tacgen.collection.recipe import known_objects, load_recipe
    from tacgen.core.progress import progress_counter
    from tacgen.dataset.real_grasps import read_real_grasps

    loaded = load_recipe(recipe)
    grasps = read_real_grasps(real, known_objects=known_objects(loaded))
    with progress_counter("grasp") as show:
        fits, outcomes = sweep.sweep_friction(
            loaded, grasps, sweep.mu_range(mu), out, workers=workers, show=show
        )
    warnings = sweep.data_warnings(grasps, outcomes, sweep.mu_range(mu))
    common.warn(warnings)
    write_friction_report(out / "index.html", grasps, outcomes, fits, warnings)
    if write_objects:
        sweep.write_object_copies(fits, out / "objects", loaded, grasps.kind)
    verdicts = [verdict_of(name, fit) for name, fit in sweep.friction_json(fits).items()]
    common.print_result(sweep.friction_json(fits), verdicts, json_output)
    common.hand_over(
        common.IN_RECIPE,
        "objects:",
        *(f"  - {{name: {name}, friction: {fit.mu:g}}}" for name, fit in fits.items()),
        f"tacgen diagnose grasps {quoted(real)} --recipe {quoted(recipe)} --out causes",
    )


@common.app.command(rich_help_panel=common.CALIBRATION)
def read(
    sensor: Annotated[str, Option(help="Name of the sensor, or the path of its YAML.")],
    out: Annotated[Path, Option(help="Folder for readings.csv and depth maps.")],
    images: Annotated[
        list[Path] | None,
        Argument(
            help="Images of the sensor (PNG or JPEG), a folder of them, a video, or a ROS 2 bag "
            "(folder, .db3 or .mcap)."
        ),
    ] = None,
    table: Annotated[Path | None, Option(help="Table of `tacgen calibrate lookup`.")] = None,
    contact: Annotated[Path | None, Option(help="Law of `tacgen calibrate contact`.")] = None,
    background: common.BackgroundOption = None,
    topic: common.TopicOption = None,
    camera: Annotated[
        str | None,
        Option(
            help="Number of a camera, read as it comes; its first pictures are the gel at rest."
        ),
    ] = None,
    record: Annotated[
        Path | None, Option(help="With --camera: MCAP file to keep the pictures in.")
    ] = None,
    rerun: Annotated[
        bool, Option("--rerun", help="Show pictures and depth in Rerun (the extra `view`).")
    ] = False,
    json_output: common.JsonFlag = False,
) -> None:
    """Read depth, contact, volume and force from images, a recording or a camera."""
    from tacgen.core.errors import SensorError
    from tacgen.core.progress import progress_counter
    from tacgen.core.safe_io import read_rgb
    from tacgen.sensor import recordings
    from tacgen.sensor.bags import check_new_mcap, kept
    from tacgen.sensor.read_image import ImageReader, read_files, reading_line, sensor_of

    images = images or []
    if (camera is None) == (not images) or (record and camera is None):
        msg = "give images, a recording or --camera, one of them; --record goes with --camera"
        raise SensorError(msg)
    at_rest = None if background is None else read_rgb(background)
    known = sensor_of(sensor, table, contact)
    recording = None
    if record is not None:  # before the camera takes its background
        check_new_mcap(record)
    if camera is not None:
        recording = recordings.open_camera(camera, at_rest)
    elif any(map(recordings.is_recording, images)):
        if len(images) > 1:
            msg = f"{images[0]} and {len(images) - 1} more: give one recording at a time"
            raise SensorError(msg)
        recording = recordings.open_recording(images[0], topic or ())
    if contact is None:
        k_n = known.law.k_n_mm3_per_n.value
        common.warn([f"no --contact: forces are by the published k_n = {k_n:g} mm³/N"])
    if recording is None:
        rows = read_files(ImageReader(known, at_rest), images, out)
        lines = [*map(reading_line, rows), str(out / "readings.csv")]
        common.print_result(rows, lines, json_output)
    else:
        common.note(recording.notes)
        reader = ImageReader(known, recording.background_rgb if at_rest is None else at_rest)
        if record is not None:
            recording = kept(recording, record, reader.background_rgb)
        watch = recordings.rerun_viewer() if rerun else None
        with progress_counter("picture") as show:
            found = recordings.read_recording(reader, recording, out, show, watch)
        common.print_result(found, recordings.summary_line(found), json_output)
    files = {key: str(path) for key, path in (("table", table), ("contact", contact)) if path}
    geometry = known.table.geometry if table else {}
    given = "".join(f", {key}={value!r}" for key, value in (files | geometry).items())
    call = f"tacgen.read_image(image_rgb, tacgen.Sensor({sensor!r}{given}))"
    common.hand_over(f"look at {out}; from Python: {call}")


@common.app.command(rich_help_panel=common.CALIBRATION)
def rig(
    recipe: common.RecipeArgument,
    out: Annotated[Path, Option(help="Folder for the press log and the images.")],
    seed: Annotated[int | None, Option(help="Seed instead of the recipe's.", min=0)] = None,
    force: common.ForceFlag = False,
) -> None:
    """Simulate a ball-press rig: press log, press images or both, with known effects."""
    from tacgen.rig import load_rig_recipe, run_rig

    loaded = load_rig_recipe(recipe)
    if seed is not None:
        loaded = loaded.model_copy(update={"seed": seed})
    for path in run_rig(loaded, out, force=force):
        typer.echo(str(path))
    commands = {
        "images": [f"tacgen calibrate lookup {quoted(out)}/presses --out table.npz"],
        "log": [f"tacgen calibrate contact {quoted(out)}/press_log.csv --out contact.yaml"],
    }
    if loaded.markers is not None:
        tracks = f" --markers {quoted(out)}/markers.csv --sensor {quoted(loaded.sensor.name)}"
        commands["log"] = [commands["log"][0] + tracks]
    common.hand_over(*commands.get(loaded.output, commands["images"] + commands["log"]))

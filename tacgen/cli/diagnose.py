"""Commands that find effects missing from the contact law, the lookup table or the grasps."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from tacgen.cli import common
from tacgen.cli.common import quoted
from tacgen.core.files import refuse_existing

if TYPE_CHECKING:
    from tacgen.diagnose.contact.result import Diagnosis
    from tacgen.rig import RigRecipe

PRESSES_CONSIDERED = 200  # drawn from the rig's ranges; comparing them takes some 0.3 s


@common.diagnose_app.command("contact")
def diagnose_contact(
    log: Annotated[
        Path,
        Argument(help="Press log with volumes or depths (CSV, Parquet), or images with forces."),
    ],
    out: Annotated[Path, Option(help="Folder for diagnosis.json, contact.yaml, report.html.")],
    column: common.ColumnOption = None,
    flip: common.FlipOption = None,
    force_unit: common.ForceUnitOption = None,
    radius_mm: common.LogRadiusOption = None,
    table: common.LogTableOption = None,
    marker_pitch_mm: common.MarkerPitchOption = None,
    markers: common.MarkersOption = None,
    sensor: common.MarkerSensorOption = None,
    grasp: Annotated[
        str | None,
        Option(
            help="Recipe with sequences: also render its grasp with the largest force under the "
            "linear and the extended law (grasp.html)."
        ),
    ] = None,
    rig: Annotated[
        str | None,
        Option(
            help="Rig recipe with the balls and ranges of your rig: also propose the presses that "
            "separate the explanations best (next_presses.csv)."
        ),
    ] = None,
    next_presses: Annotated[
        int, Option(help="How many presses to propose, with --rig.", min=1, max=PRESSES_CONSIDERED)
    ] = 12,
    force: common.ForceFlag = False,
    json_output: common.JsonFlag = False,
) -> None:
    """Extend the linear contact law by the effects that a press log supports."""
    from tacgen.calibrate.contact.command import LogSource
    from tacgen.diagnose.contact.command import diagnose_log
    from tacgen.diagnose.contact.result import diagnosis_record
    from tacgen.presses.lab_table import LogFormat

    log_format = LogFormat.of_options(column or [], flip or [], force_unit)
    proposals, loaded_rig = out / "next_presses.csv", None
    refuse_existing(force, out / "diagnosis.json", proposals)
    if rig is not None:
        from tacgen.rig import load_rig_recipe

        loaded_rig = load_rig_recipe(rig)
    source = LogSource(log, log_format, radius_mm, table, marker_pitch_mm, markers, sensor)
    diagnosis = diagnose_log(source, out)
    common.note(diagnosis.notes)
    if grasp is not None:
        from tacgen.collection.recipe import load_recipe
        from tacgen.diagnose.contact.law_comparison import write_law_comparison

        laws = diagnosis.linear_law, diagnosis.law
        write_law_comparison(load_recipe(grasp), *laws, out / "grasp.html")
    sentences = [found.sentence for found in diagnosis.channels.values()]
    sentences += [diagnosis.markers.sentence] if diagnosis.markers else []
    common.print_result(diagnosis_record(diagnosis), sentences, json_output)
    common.hand_over(*common.contact_lines(out / "contact.yaml"))
    proposals.unlink(missing_ok=True)  # those of an earlier diagnosis
    if loaded_rig is not None:
        _propose_presses(diagnosis, loaded_rig, next_presses, proposals)


def _propose_presses(diagnosis: "Diagnosis", rig: "RigRecipe", count: int, path: Path) -> None:
    """Write the presses to make next, drawn from the rig's ranges; say what they separate."""
    import pandas as pd

    from tacgen.core.files import write_text
    from tacgen.diagnose.contact.next_presses import propose_presses
    from tacgen.rig.schedule import draw_press, press_course

    # Numbers beyond the recipe's own presses: those may have been made already.
    first = rig.schedule.presses
    drawn = [draw_press(rig, first + number) for number in range(PRESSES_CONSIDERED)]
    courses = [press_course(rig, press, number, 0.0) for number, press in enumerate(drawn)]
    proposed = propose_presses(diagnosis, courses, count)
    if not proposed:
        common.note(["the log's columns allow one explanation only; no further press can test it"])
        return
    table = pd.DataFrame([asdict(drawn[one.index]) for one in proposed]).round(4)
    table["separates"] = [" from ".join(one.between) for one in proposed]
    write_text(path, table.to_csv(index=False))
    quoted = json.dumps(str(path.resolve()), ensure_ascii=False)
    common.hand_over(
        f"presses to make next: {path}; the first separates {table['separates'][0]}",
        f"schedule: {{follow: {quoted}}}   # in a rig recipe; they follow its own presses",
    )


@common.diagnose_app.command("presses")
def diagnose_presses_command(
    session: Annotated[
        Path,
        Argument(
            help="Folder of a session: press images with presses.csv, press_log.csv, or both, as "
            "`tacgen rig` leaves it.",
            exists=True,
            file_okay=False,
        ),
    ],
    out: Annotated[Path, Option(help="Folder for diagnosis.json, report.html and each part.")],
    mm_per_px: common.MmPerPxOption = None,
    ball_radius_mm: common.BallRadiusOption = None,
    sensor: Annotated[
        str | None, Option(help="Of the dots in markers.csv: the sensor's name or YAML file.")
    ] = None,
    force: common.ForceFlag = False,
    json_output: common.JsonFlag = False,
) -> None:
    """Diagnose all that a session of presses holds, pictures and forces, on one page."""
    from tacgen.diagnose.session import CHANNELS, diagnose_session

    refuse_existing(force, out / "diagnosis.json")
    record = diagnose_session(
        session, out, mm_per_px=mm_per_px, ball_radius_mm=ball_radius_mm, sensor=sensor
    )
    common.note(record["notes"])
    sentences = [f"{CHANNELS[name]}: {one['sentence']}" for name, one in record["channels"].items()]
    common.print_result(record, sentences, json_output)
    common.hand_over(f"the page: {out / 'report.html'}")


@common.diagnose_app.command("optics")
def diagnose_optics(
    presses: common.PressesArgument,
    out: Annotated[Path, Option(help="Folder for diagnosis.json, table.npz, report.html.")],
    table: Annotated[Path | None, Option(help="Table to test; else one is fitted.")] = None,
    mm_per_px: common.MmPerPxOption = None,
    ball_radius_mm: common.BallRadiusOption = None,
    force: common.ForceFlag = False,
    json_output: common.JsonFlag = False,
) -> None:
    """Find the optical effects that explain a table's image residuals on ball presses."""
    from tacgen.diagnose.optics.command import diagnose_presses

    refuse_existing(force, out / "diagnosis.json")
    diagnosis, used = diagnose_presses(
        presses, out, table_path=table, mm_per_px=mm_per_px, ball_radius_mm=ball_radius_mm
    )
    common.warn((*used.warnings, *used.dropped))
    common.print_result(diagnosis.as_dict(), diagnosis.sentence, json_output)
    found = diagnosis.table
    common.hand_over(*common.table_lines(out / "table.npz", found.shape_px, found.mm_per_px))


@common.diagnose_app.command("grasps")
def diagnose_grasps_command(
    real: common.RealGraspsArgument,
    recipe: Annotated[str, Option(help="Recipe that describes the robot's set-up.")],
    out: common.ResultsOption,
    workers: common.WorkersOption = common.AUTO,
    json_output: common.JsonFlag = False,
) -> None:
    """Find simulation parameters that explain why real grasps ended differently than simulated."""
    from tacgen.collection.recipe import known_objects, load_recipe
    from tacgen.core.progress import progress_counter
    from tacgen.dataset.real_grasps import read_real_grasps
    from tacgen.diagnose.grasps.command import diagnose_grasps, record_of
    from tacgen.diagnose.grasps.report import write_grasp_report

    loaded = load_recipe(recipe)
    grasps = read_real_grasps(real, known_objects=known_objects(loaded))
    with progress_counter("grasp") as show:
        findings = diagnose_grasps(loaded, grasps, out, workers=workers, show=show)
    common.note(findings.diagnosis.notes)
    record = record_of(findings, loaded, list(grasps.by_object()))
    before, after = findings.diagnosis.simulated_before, findings.simulated_after
    write_grasp_report(out / "report.html", record, grasps, before, after)
    common.print_result(record, findings.diagnosis.sentence, json_output)
    found = "with what was found" if findings.diagnosis.found else "as it was: nothing was found"
    lines = [f"tacgen collect {quoted(out / 'recipe.yaml')} --out data   # the recipe {found}"]
    if findings.proposals:
        table = out / "next_grasps.csv"
        lines.append(f"grasps for the robot that separate the explanations: {table}")
    common.hand_over(*lines)

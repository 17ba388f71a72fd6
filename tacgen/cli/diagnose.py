"""Commands that find effects missing from the contact law, the lookup table or the grasps."""

import math
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from tacgen.cli.app import (
    BallRadiusOption,
    ForceFlag,
    JsonFlag,
    MarkerPitchOption,
    MmPerPxOption,
    PressesArgument,
    RealGraspsArgument,
    ResultsOption,
    WorkersOption,
    contact_lines,
    diagnose_app,
    hand_over,
    note,
    print_result,
    refuse_existing,
    table_lines,
    warn,
)


@diagnose_app.command("contact")
def diagnose_contact(
    log: Annotated[Path, Argument(help="Press log: CSV or Parquet.")],
    out: Annotated[Path, Option(help="Folder for diagnosis.json, contact.yaml, report.html.")],
    marker_pitch_mm: MarkerPitchOption = None,
    grasp: Annotated[
        str | None,
        Option(
            help="Recipe with sequences: also render its grasp with the largest force under the "
            "linear and the extended law (grasp.html)."
        ),
    ] = None,
    force: ForceFlag = False,
    json_output: JsonFlag = False,
) -> None:
    """Extend the linear contact law by the effects that a press log supports."""
    from tacgen.diagnose.contact.command import diagnose_log
    from tacgen.diagnose.contact.result import diagnosis_record

    refuse_existing(force, out / "diagnosis.json")
    pitch_mm = math.nan if marker_pitch_mm is None else marker_pitch_mm
    diagnosis = diagnose_log(log, out, marker_pitch_mm=pitch_mm)
    note(diagnosis.notes)
    if grasp is not None:
        from tacgen.collection.recipe import load_recipe
        from tacgen.diagnose.contact.law_comparison import write_law_comparison

        laws = diagnosis.linear_law, diagnosis.law
        write_law_comparison(load_recipe(grasp), *laws, out / "grasp.html")
    sentences = [found.sentence for found in diagnosis.channels.values()]
    print_result(diagnosis_record(diagnosis), sentences, json_output)
    hand_over(*contact_lines(out / "contact.yaml"))


@diagnose_app.command("optics")
def diagnose_optics(
    presses: PressesArgument,
    out: Annotated[Path, Option(help="Folder for diagnosis.json, table.npz, report.html.")],
    table: Annotated[Path | None, Option(help="Table to test; else one is fitted.")] = None,
    mm_per_px: MmPerPxOption = None,
    ball_radius_mm: BallRadiusOption = None,
    force: ForceFlag = False,
    json_output: JsonFlag = False,
) -> None:
    """Find the optical effects that explain a table's image residuals on ball presses."""
    from tacgen.diagnose.optics.command import diagnose_presses

    refuse_existing(force, out / "diagnosis.json")
    diagnosis, used = diagnose_presses(
        presses, out, table_path=table, mm_per_px=mm_per_px, ball_radius_mm=ball_radius_mm
    )
    warn((*used.warnings, *used.dropped))
    print_result(diagnosis.as_dict(), diagnosis.sentence, json_output)
    hand_over(*table_lines(out / "table.npz"))


@diagnose_app.command("grasps")
def diagnose_grasps_command(
    real: RealGraspsArgument,
    recipe: Annotated[str, Option(help="Recipe that describes the robot's set-up.")],
    out: ResultsOption,
    workers: WorkersOption = 2,
    json_output: JsonFlag = False,
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
        findings = diagnose_grasps(loaded, grasps, out, workers=workers, show=lambda what: show)
    note(findings.diagnosis.notes)
    record = record_of(findings, loaded, list(grasps.by_object()))
    before, after = findings.diagnosis.simulated_before, findings.simulated_after
    write_grasp_report(out / "report.html", record, grasps, before, after)
    print_result(record, findings.diagnosis.sentence, json_output)
    hand_over(
        f"tacgen collect {out / 'recipe.yaml'} --out data   # the recipe with what was found",
        f"grasps for the robot that separate the explanations: {out / 'next_grasps.csv'}",
    )

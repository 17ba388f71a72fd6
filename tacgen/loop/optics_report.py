"""What ``tacgen diagnose optics`` writes: diagnosis.json, the extended table, a page to read."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

from matplotlib.figure import Figure

from tacgen.calibration.lookup import fit_lookup
from tacgen.calibration.press_doubts import usable_presses
from tacgen.calibration.press_folder import read_presses
from tacgen.calibration.press_images import PressImages
from tacgen.files import write_text
from tacgen.loop.optics_diagnosis import IN_THE_TABLE, OpticsDiagnosis, diagnose_optics
from tacgen.optics.table import LookupTable, save_table
from tacgen.report import Section, figure_section, table_section, text_section, write_page


def write_optics_diagnosis(
    presses_path: Path,
    out: Path,
    *,
    mm_per_px: float | None = None,
    ball_radius_mm: float | None = None,
) -> tuple[OpticsDiagnosis, PressImages]:
    """Diagnose the presses at a path and write the outcome into the folder ``out``."""
    raw = read_presses(presses_path, mm_per_px=mm_per_px, ball_radius_mm=ball_radius_mm)
    presses = usable_presses(raw)
    diagnosis = diagnose_optics(presses)
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    write_text(out / "diagnosis.json", json.dumps(diagnosis.as_dict(), indent=2) + "\n")
    save_table(extended_table(presses, diagnosis), out / "table.npz")
    write_page(
        out / "report.html",
        "What the images show that the table lacks",
        _sections(presses, diagnosis),
        summary=sentence(diagnosis),
    )
    return diagnosis, presses


def extended_table(presses: PressImages, diagnosis: OpticsDiagnosis) -> LookupTable:
    """The table of all presses, with the found effects that the renderer itself applies.

    Centres, radii and drift of the presses are estimated with every table; what is left for the
    renderer is where the camera clips.
    """
    table = fit_lookup(presses)
    effects: dict[str, dict[str, float]] = {}
    names = {effect.name for effect in diagnosis.effects}
    if "saturation" in names:
        effects["saturation"] = {"level_grey": diagnosis.after.level_grey}
    return replace(table, effects=MappingProxyType(effects))


def sentence(diagnosis: OpticsDiagnosis) -> str:
    """The verdict in one plain sentence."""
    if not diagnosis.effects:
        return (
            f"The table suffices: {diagnosis.rmse_before:.2f} grey levels on presses it never "
            "saw, and no effect lowers that reliably."
        )
    names = ", ".join(
        f"{effect.name} (worth {effect.heldout_gain:.2f})" for effect in diagnosis.effects
    )
    return (
        f"Found {names}: the error on presses that took no part falls from "
        f"{diagnosis.rmse_before:.2f} to {diagnosis.rmse_after:.2f} grey levels."
    )


def _sections(presses: PressImages, diagnosis: OpticsDiagnosis) -> list[Section]:
    low, high = diagnosis.gain_interval
    rows = [
        (
            effect.name,
            effect.cv_gain,
            effect.heldout_gain,
            f"{effect.p_value:.2g}",
            effect.runner_up,
            effect.runner_up_gain,
        )
        for effect in diagnosis.effects
    ]
    return [
        text_section(
            "Verdict",
            sentence(diagnosis),
            f"95 % interval of the whole gain, over {diagnosis.n_test} test presses: {low:.2f} to "
            f"{high:.2f} grey levels. The camera's own noise is {diagnosis.noise_floor:.2f}.",
            *(str(press) for press in presses.doubtful),
        ),
        table_section(
            "Effects, in the order in which they were added",
            ("effect", "gain, cross-validated", "gain, test presses", "p", "runner-up", "its gain"),
            rows,
            note="Grey levels of RMSE inside the contact circles.",
        ),
        _ranking(diagnosis),
        text_section(
            "What presses cannot tell apart from the table",
            *(f"{name}: {why}." for name, why in IN_THE_TABLE.items()),
            *(
                f"Without {name} the table's error would be {worth:.2f} grey levels larger."
                for name, worth in diagnosis.worth_in_table.items()
            ),
            "A wrong scale or a wrong ball radius stretches the table's slopes and leaves no "
            "residual with one ball; presses with a second ball of another size would show it.",
        ),
    ]


def _ranking(diagnosis: OpticsDiagnosis) -> Section:
    figure = Figure(figsize=(9, 0.6 + 1.5 * len(diagnosis.steps)))
    axes = figure.subplots(len(diagnosis.steps), 1, squeeze=False, sharex=True)[:, 0]
    for ax, step in zip(axes, diagnosis.steps, strict=True):
        names = sorted(step.rmse, key=lambda name: -step.rmse[name])
        ax.barh(names, [step.rmse[name] for name in names], height=0.6)
        ax.axvline(step.before, color="k", lw=0.8)
    axes[-1].set_xlabel("cross-validated RMSE, grey levels; the line is before the step")
    return figure_section("Candidates at each step", figure)

"""What ``tacgen diagnose optics`` writes: diagnosis.json, the extended table, a page to read."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tacgen.core.files import write_text
from tacgen.diagnose.optics.diagnose import TEST_EVERY, OpticsDiagnosis, diagnose_optics
from tacgen.diagnose.optics.extended_table import extended_table
from tacgen.diagnose.optics.pictures import before_and_after
from tacgen.optics.table import LookupTable, load_table, save_table
from tacgen.presses.press_folder import read_presses
from tacgen.presses.press_images import PressImages
from tacgen.presses.screening import usable_presses
from tacgen.report import (
    Section,
    figure_section,
    image_section,
    table_section,
    text_section,
    write_page,
)

SHOWN = 3
"""Test presses that the page shows before and after."""


def write_optics_diagnosis(
    presses_path: Path,
    out: Path,
    *,
    table_path: Path | None = None,
    mm_per_px: float | None = None,
    ball_radius_mm: float | None = None,
) -> tuple[OpticsDiagnosis, PressImages]:
    """Diagnose the presses at a path and write the outcome into the folder ``out``."""
    given = None if table_path is None else load_table(table_path)
    raw = read_presses(presses_path, mm_per_px=mm_per_px, ball_radius_mm=ball_radius_mm)
    presses = usable_presses(raw)
    diagnosis = diagnose_optics(presses, given)
    table = extended_table(presses, diagnosis.selection.chosen, diagnosis.reference, given)
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    write_text(out / "diagnosis.json", json.dumps(diagnosis.as_dict(), indent=2) + "\n")
    save_table(table, out / "table.npz")
    write_page(
        out / "report.html",
        "What the images show that the table lacks",
        _sections(presses, diagnosis, table),
        summary=sentence(diagnosis),
    )
    return diagnosis, presses


def sentence(diagnosis: OpticsDiagnosis) -> str:
    """The verdict in one plain sentence."""
    left = ""
    if diagnosis.unexplained:
        followed = ", ".join(d.covariate for d in diagnosis.unexplained)
        left = f" What is left still follows {followed}, which no listed effect explains."
    if not diagnosis.effects:
        return (
            f"No listed effect lowers the error of {diagnosis.rmse_before:.2f} grey levels on "
            f"presses that took no part.{left}"
            if left
            else f"The table suffices: {diagnosis.rmse_before:.2f} grey levels on presses it never "
            "saw, and no effect lowers that reliably."
        )
    names = ", ".join(
        f"{effect.name} (worth {effect.heldout_gain:.2f})" for effect in diagnosis.effects
    )
    return (
        f"Found {names}: the error on presses that took no part falls from "
        f"{diagnosis.rmse_before:.2f} to {diagnosis.rmse_after:.2f} grey levels.{left}"
    )


def _sections(
    presses: PressImages, diagnosis: OpticsDiagnosis, table: LookupTable
) -> list[Section]:
    low, high = diagnosis.gain_interval
    return [
        text_section(
            "Verdict",
            sentence(diagnosis),
            f"95 % interval of the whole gain, over {diagnosis.n_test} test presses: {low:.2f} to "
            f"{high:.2f} grey levels. Inside the labelled circles alone the error falls from "
            f"{diagnosis.inside_before:.2f} to {diagnosis.inside_after:.2f}. The camera's own "
            f"noise is {diagnosis.noise_floor:.2f}.",
            *(str(press) for press in presses.dropped),
        ),
        _effects(diagnosis),
        *_pictures(presses, diagnosis),
        _ranking(diagnosis),
        table_section(
            "What was found, in numbers",
            ("effect", "quantity", "value", "standard error", "unit"),
            [
                (effect.name, name, f"{p['value']:.4g}", _stderr(p["stderr"]), p["unit"])
                for effect in diagnosis.effects
                for name, p in effect.parameters.items()
            ],
        ),
        table_section(
            "What the residual still follows",
            ("covariate", "gain if taken off, grey", "p"),
            [(d.covariate, d.gain_grey, f"{d.p_value:.2g}") for d in diagnosis.unexplained],
            note="None." if not diagnosis.unexplained else "By the same rule as the effects.",
        ),
        text_section(
            "What these presses cannot tell, and what would",
            *(diagnosis.cannot_tell or ("Nothing of that kind.",)),
        ),
        text_section(
            "What the renderer applies from now on",
            ", ".join(sorted(table.effects)) or "Nothing beside the table's own colours.",
            "table.npz holds it: name it as the sensor's table and tacgen collect renders with it. "
            "Centres, radii and the scatter of exposure belong to single presses and stay out.",
        ),
    ]


def _effects(diagnosis: OpticsDiagnosis) -> Section:
    rows = [
        (
            effect.name,
            effect.label,
            effect.cv_gain,
            effect.heldout_gain,
            f"{effect.p_value:.2g}",
            effect.runner_up,
            effect.runner_up_gain,
            ", ".join(effect.equals),
        )
        for effect in diagnosis.effects
    ]
    return table_section(
        "Effects, in the order in which they were added",
        (
            *("effect", "how", "gain, cross-validated", "gain, test presses", "p"),
            *("runner-up", "its gain", "hardly told from"),
        ),
        rows,
        note="Grey levels of RMSE within 1.6 contact radii.",
    )


def _stderr(value: float | None) -> str:
    return "–" if value is None else f"{value:.2g}"


def _pictures(presses: PressImages, diagnosis: OpticsDiagnosis) -> list[Section]:
    """Test presses beside the plain model and beside the extended one."""
    tests = np.nonzero(np.arange(len(presses)) % TEST_EVERY == TEST_EVERY - 1)[0]
    worst = tests[np.argsort(diagnosis.after_squares)[:: -max(1, len(tests) // SHOWN)]][:SHOWN]
    strips: list[NDArray[np.uint8]] = [before_and_after(presses, int(k), diagnosis) for k in worst]
    return [
        image_section(
            f"Test press {presses.names[int(k)]}: photograph, plain, extended, and what is left",
            strip,
            "Left to right: the press; the plain model; the model with the effects; the difference "
            "before and after, grey where there is none, three times as strong.",
            width_px=min(1100, 4 * strip.shape[1]),
        )
        for k, strip in zip(worst, strips, strict=True)
    ]


def _ranking(diagnosis: OpticsDiagnosis) -> Section:
    steps = diagnosis.selection.steps
    figure = Figure(figsize=(9, 0.8 + 1.9 * len(steps)))
    axes = figure.subplots(len(steps), 1, squeeze=False, sharex=True)[:, 0]
    for ax, step in zip(axes, steps, strict=True):
        names = sorted(step.rmse, key=lambda name: -step.rmse[name])
        colors = ["#2a7f62" if name == step.taken else "#9fb3c8" for name in names]
        ax.barh(names, [step.rmse[name] for name in names], height=0.65, color=colors)
        ax.axvline(step.before, color="k", lw=0.8)
        ax.set_title(f"took {step.taken}" if step.taken else "took none", fontsize=9, loc="left")
    axes[-1].set_xlabel("cross-validated RMSE, grey levels; the line is before the step")
    figure.tight_layout()
    return figure_section("Candidates at each step", figure)

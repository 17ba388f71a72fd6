"""The page of a grasp diagnosis: outcomes real and simulated, ranking, and what to do next."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tacgen.calibrate.friction.report import outcome_map
from tacgen.dataset.real_grasps import RealGrasps
from tacgen.diagnose.grasps.candidates import advice
from tacgen.diagnose.grasps.command import GraspFindings
from tacgen.diagnose.grasps.model_comparison import FALSE_ALARM, Choice, confusable
from tacgen.diagnose.grasps.result import describe
from tacgen.report import Section, figure_section, table_section, text_section, write_page

INK, GREY = "#0b6e99", "#8a94a3"


def write_grasp_report(path: Path, real: RealGrasps, findings: GraspFindings) -> None:
    """Write the self-contained page."""
    diagnosis = findings.diagnosis
    sections = [_errors(findings)]
    if diagnosis.notes or diagnosis.reading:
        sections.append(text_section("About the data", *diagnosis.notes, diagnosis.reading))
    for name in real.by_object():
        chosen = np.array([grasp.config.object == name for grasp in real.grasps])
        sections.append(
            figure_section(
                name,
                _outcome_figure(real, findings, chosen),
                "Outcome over gripping force and height, grasps at larger y drawn a little higher. "
                "Green dots succeed, red crosses fail, grey squares could not be executed; rings "
                "mark simulated grasps that end otherwise than the real ones.",
            )
        )
    sections += [_ranking(step, number) for number, step in enumerate(diagnosis.steps)]
    sections += [_confusions(findings), _next_grasps(findings)]
    write_page(
        path,
        "What the simulated grasps lack",
        [section for section in sections if section.body],
        summary=diagnosis.sentence,
    )


def _errors(findings: GraspFindings) -> Section:
    diagnosis = findings.diagnosis
    n = len(diagnosis.real)
    again = float((findings.simulated_after != diagnosis.real).mean())
    rows: list[list[object]] = [
        ["mislabelled as declared", _share(diagnosis.rate_before, n)],
        ["mislabelled after, on grasps left out in turn", _share(diagnosis.rate_after, n)],
        ["mislabelled after, all grasps simulated again", _share(again, n)],
    ]
    rows += [["found", describe(standing)] for standing in diagnosis.found]
    return table_section("Before and after", ["", ""], rows)


def _share(rate: float, n: int) -> str:
    return f"{round(rate * n)} of {n} ({100 * rate:.1f} %)"


def _outcome_figure(real: RealGrasps, findings: GraspFindings, chosen: NDArray[np.bool_]) -> Figure:
    diagnosis = findings.diagnosis
    grasps = [grasp for grasp, own in zip(real.grasps, chosen, strict=True) if own]
    truth = diagnosis.real[chosen]
    figure = Figure(figsize=(12, 3.4), layout="constrained")
    axes = figure.subplots(1, 3, sharex=True, sharey=True)
    panels = (
        ("real", truth),
        ("simulated as declared", diagnosis.simulated_before[chosen]),
        ("simulated with what was found", findings.simulated_after[chosen]),
    )
    for panel, (title, labels) in zip(axes, panels, strict=True):
        outcome_map(panel, grasps, labels, truth, title)
    return figure


def _ranking(step: Choice, number: int) -> Section:
    """What every candidate is worth at one step."""
    shown = [s for s in step.standings if np.isfinite(s.gain)]
    figure = Figure(figsize=(8, 0.9 + 0.32 * len(shown)), layout="constrained")
    axes = figure.subplots()
    names = [describe(standing) for standing in reversed(shown)]
    gains = [standing.gain for standing in reversed(shown)]
    colors = [INK if gain > step.critical_gain else GREY for gain in gains]
    axes.barh(names, gains, color=colors, height=0.6)
    axes.axvline(step.critical_gain, color="#1c2430", linewidth=0.8, linestyle="--")
    axes.set_xlabel("log-evidence over the world so far")
    verdict = "taken" if step.taken else "nothing taken"
    return figure_section(
        f"Candidates, step {number + 1}: {verdict}",
        figure,
        f"Right of the dashed line clean labels lead in {100 * FALSE_ALARM:.0f} % of draws only; "
        f"the first has p = {step.p_value:.2g}. The evidence is the sum of the scores of "
        "predicting each label from others, so a parameter that buys nothing lowers it.",
    )


def _confusions(findings: GraspFindings) -> Section:
    found = findings.diagnosis.found
    lines: list[str] = []
    for standing, step in zip(found, findings.diagnosis.steps, strict=False):
        lines += [advice(standing.name, other) for other in confusable(step.standings)]
    if not lines:
        return Section("", "")
    return text_section("What these labels cannot tell apart", *(f"{line}." for line in lines))


def _next_grasps(findings: GraspFindings) -> Section:
    proposals = findings.proposals
    title = "Real grasps to make next"
    if not proposals:
        return text_section(
            title, "No grasp of the recipe's grid would tell the leading explanations apart."
        )
    names = list(proposals[0].success)
    rows: list[Sequence[object]] = [
        [
            one.config.object,
            one.config.force_n,
            one.config.x_mm,
            one.config.y_mm,
            one.config.z_mm,
            *(f"{one.success[name]:.2f}" for name in names),
        ]
        for one in proposals
    ]
    header = ["object", "force (N)", "x (mm)", "y (mm)", "z (mm)", *(f"if {n}" for n in names)]
    return table_section(
        title, header, rows, "Probability of success under each explanation: they disagree most."
    )

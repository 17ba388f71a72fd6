"""The page of a grasp diagnosis: outcomes real and simulated, ranking, and what to do next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tacgen.calibrate.friction.report import grasp_places
from tacgen.core.arrays import IntArray
from tacgen.dataset.real_grasps import RealGrasps
from tacgen.report import (
    Section,
    facts_section,
    figure_section,
    table_section,
    text_section,
    write_page,
)
from tacgen.report import figures as plots
from tacgen.report.formatting import p_value, percent


def write_grasp_report(
    path: Path,
    record: Mapping[str, Any],
    real: RealGrasps,
    before: IntArray,
    after: IntArray,
) -> None:
    """Write the page of the content of ``diagnosis.json``.

    ``before`` and ``after`` (N,) are the labels simulated as declared and with what was found.
    """
    channel = record["channels"]["grasp"]
    labels = np.array([grasp.label for grasp in real.grasps])
    places = grasp_places(real.grasps)
    sections = []
    for name in real.by_object():
        own = np.array([grasp.config.object == name for grasp in real.grasps])
        panels = (
            ("real", labels[own]),
            ("simulated as declared", before[own]),
            ("simulated with what was found", after[own]),
        )
        figure = _outcome_figure({key: values[own] for key, values in places.items()}, panels)
        sections.append(
            figure_section(
                name, figure, f"Outcome over gripping force and height. {plots.OUTCOME_NOTE}"
            )
        )
    sections.append(_mislabels(channel))
    sections += [_ranking(step, k, channel) for k, step in enumerate(channel["steps"], start=1)]
    advice = [f"{line}." for effect in channel["effects"] for line in effect["what_would_tell"]]
    if advice:
        sections.append(text_section("Explanations that these labels cannot separate", *advice))
    sections.append(_next_grasps(channel["next_grasps"]))
    notes = [*record["notes"], *filter(None, [channel["force_from_images"]])]
    if notes:
        sections.append(text_section("About the data", *notes))
    write_page(
        path, "Grasp diagnosis", sections, summary=channel["sentence"], verdict=channel["verdict"]
    )


def _mislabels(channel: Mapping[str, Any]) -> Section:
    n = channel["trials"]["fit"]
    rows = [
        ("mislabelled as declared", channel["error_before"]),
        ("mislabelled after, each grasp held out in turn", channel["error_after"]),
        ("mislabelled after, all grasps simulated again", channel["simulated_again"]),
    ]
    facts = [
        (name, f"{one['mislabels']} of {n} ({percent(one.get('rate', one.get('rmse')))})")
        for name, one in rows
    ]
    facts += [("found", effect["description"]) for effect in channel["effects"]]
    return facts_section("Mislabels before and after", facts)


def _outcome_figure(
    places: Mapping[str, NDArray[Any]], panels: Sequence[tuple[str, IntArray]]
) -> Figure:
    figure, grid = plots.new_figure(12, 3.4, 1, len(panels), sharex=True, sharey=True)
    for axes, (title, labels) in zip(grid[0], panels, strict=True):
        plots.draw_outcomes(axes, places, labels, panels[0][1], title)
    return figure


def _ranking(step: Mapping[str, Any], number: int, channel: Mapping[str, Any]) -> Section:
    """The evidence for every candidate at one step."""
    gains = {
        one["description"]: one["log_evidence_gain"]
        for one in step["candidates"]
        if one["log_evidence_gain"] is not None
    }
    critical = step["critical_gain"]
    marked = [name for name, gain in gains.items() if gain > critical]
    verdict = "the first is added" if step["chosen"] else "none is added"
    return figure_section(
        f"Candidates, step {number}: {verdict}",
        plots.rankings([("", gains, marked, critical)], "gain in log-evidence"),
        f"Labels without effect pass the dashed line in {percent(channel['false_alarm_rate'], 0)} "
        f"of draws; the first candidate has p = {p_value(step['p_value'])}. The evidence sums the "
        "scores of predicting each label from others, so a useless parameter lowers it.",
    )


def _next_grasps(proposals: Sequence[Mapping[str, Any]]) -> Section:
    title = "Real grasps to make next"
    if not proposals:
        return text_section(
            title, "No grasp of the recipe's grid would separate the leading explanations."
        )
    names = list(proposals[0]["success"])
    rows = [
        (
            one["object"],
            *(one[key] for key in ("force_n", "x_mm", "y_mm", "z_mm")),
            *(f"{one['success'][name]:.2f}" for name in names),
        )
        for one in proposals
    ]
    header = ("object", "force, N", "x, mm", "y, mm", "z, mm", *(f"if {name}" for name in names))
    return table_section(
        title,
        header,
        rows,
        "Probability of success under each explanation: these grasps differ most.",
    )

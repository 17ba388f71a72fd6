"""The page of a grasp diagnosis: outcomes real and simulated, ranking, and what to do next."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from tacgen.collection.friction_report import grasp_places
from tacgen.core.types import IntArray
from tacgen.dataset.real_grasps import RealGrasps
from tacgen.report import figures as plots
from tacgen.report.page import write_page


def write_grasp_report(
    path: Path, record: Mapping[str, Any], real: RealGrasps, before: IntArray, after: IntArray
) -> None:
    """Write the page of the content of ``diagnosis.json``.

    ``before`` and ``after`` (N,) are the labels simulated as declared and with what was found.
    """
    channel = record["channels"]["grasp"]
    labels = np.array([grasp.label for grasp in real.grasps])
    figures = {}
    for name, grasps in real.by_object().items():
        own = np.array([grasp.config.object == name for grasp in real.grasps])
        figures[name], grid = plots.new_figure(12, 3.4, 1, 3, sharex=True, sharey=True)
        titles = (real.kind, "simulated as declared", "simulated with what was found")
        for axes, title, shown in zip(grid[0], titles, (labels, before, after), strict=True):
            plots.draw_outcomes(axes, grasp_places(grasps), shown[own], labels[own], title)
    write_page(
        path,
        "Grasp diagnosis",
        summary=channel["sentence"],
        verdict=channel["verdict"],
        template="grasp_diagnosis.html",
        made_by="diagnose grasps",
        record=record,
        channel=channel,
        figures=figures,
        outcome_note=plots.OUTCOME_NOTE,
        ranking=_ranking_figure(channel),
    )


def _ranking_figure(channel: Mapping[str, Any]) -> Figure:
    """The evidence for every candidate alone."""
    gains = {
        one["description"]: one["log_evidence_gain"]
        for one in channel["ranking"]
        if one["log_evidence_gain"] is not None
    }
    critical = channel["critical_gain"]
    marked = [name for name, gain in gains.items() if gain > critical]
    return plots.rankings([("", gains, marked, critical)], "gain in log-evidence")

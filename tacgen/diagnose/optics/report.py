"""The page of an optics diagnosis: error, pictures of presses, effects, candidates."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tacgen.diagnose.optics.pictures import DIFFERENCE_GAIN, MEAN_GAIN
from tacgen.report import figures as plots
from tacgen.report.page import write_page


def write_optics_page(
    path: Path,
    channel: Mapping[str, Any],
    pictures: Sequence[tuple[str, NDArray[np.uint8]]],
    mean_residuals: NDArray[np.uint8],
    *,
    applied: Sequence[str],
    excluded: Sequence[str],
) -> None:
    """Write the page of the channel ``rgb`` of ``diagnosis.json``.

    ``pictures`` are strips of test presses, ``mean_residuals`` one of all presses, ``applied`` the
    effects that the written table makes the renderer apply, ``excluded`` the presses that could not
    be used and why.
    """
    before, after = channel["error_before"], channel["error_after"]
    floor = channel["noise_floor"]["rmse"]
    bars = [
        ("contact and bare gel, as labelled", before["rmse"], after["rmse"], floor),
        ("inside the labelled circles", before["inside_circle"], after["inside_circle"], floor),
        ("place and exposure re-estimated", before["refined"], after["refined"], floor),
    ]
    write_page(
        path,
        "Optics diagnosis",
        summary=channel["sentence"],
        verdict=channel["verdict"],
        template="optics_diagnosis.html",
        made_by="diagnose optics",
        channel=channel,
        errors=plots.before_after(bars, "RMSE on held-out presses, grey levels"),
        pictures_of_presses=pictures,
        difference_gain=DIFFERENCE_GAIN,
        mean_residual=[("table and table with the effects", mean_residuals)],
        mean_gain=MEAN_GAIN,
        ranking=_ranking_figure(channel["steps"]),
        applied=applied,
        excluded=excluded,
    )


def _ranking_figure(steps: Sequence[Mapping[str, Any]]) -> Figure:
    panels = []
    for number_, step in enumerate(steps, start=1):
        ranked = dict(sorted(step["rmse"].items(), key=lambda item: item[1]))
        chosen = step["chosen"]
        title = f"Step {number_}: {chosen or 'no candidate'} added"
        panels.append((title, ranked, [chosen], step["error_before"]))
    return plots.rankings(panels, "cross-validated RMSE, grey levels")

"""The page of an optics diagnosis: error, pictures of presses, effects, candidates."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tacgen.diagnose.optics.pictures import DIFFERENCE_GAIN
from tacgen.report import figures as plots
from tacgen.report.formatting import estimate, interval, number, p_value
from tacgen.report.page import (
    PageSection,
    facts_section,
    figure_section,
    pictures_section,
    table_section,
    text_section,
    write_page,
)


def write_optics_page(
    path: Path,
    channel: Mapping[str, Any],
    pictures: Sequence[tuple[str, NDArray[np.uint8]]],
    *,
    applied: Sequence[str],
    excluded: Sequence[str],
) -> None:
    """Write the page of the channel ``rgb`` of ``diagnosis.json``.

    ``pictures`` are strips of test presses, ``applied`` the effects that the written table makes
    the renderer apply, ``excluded`` the presses that could not be used and why.
    """
    before, after = channel["error_before"], channel["error_after"]
    floor = channel["noise_floor"]["rmse"]
    bars = [
        ("contact and bare gel, as labelled", before["rmse"], after["rmse"], floor),
        ("inside the labelled circles", before["inside_circle"], after["inside_circle"], floor),
        ("place and exposure re-estimated", before["refined"], after["refined"], floor),
    ]
    facts = [
        ("95 % interval of the reduction", interval(channel["gain_interval_95"], "grey")),
        ("test presses", channel["trials"]["test"]),
        ("presses fitted", channel["trials"]["fit"]),
        ("camera noise", f"{number(floor, 3)} grey levels"),
    ]
    sections = [
        figure_section(
            "Error before and after",
            plots.before_after(bars, "RMSE on held-out presses, grey levels"),
        ),
        pictures_section(
            "Test presses",
            pictures,
            "Left to right: the press image, the table, the table with the effects, and the "
            f"residual of each, {DIFFERENCE_GAIN}× about grey.",
        ),
        facts_section("Errors in numbers", facts),
        *_effects(channel),
        figure_section(
            "Candidates at each step",
            _ranking_figure(channel["steps"]),
            "The dashed line is the error before the step; the blue candidate was chosen.",
        ),
        table_section(
            "What the residual still depends on",
            ("covariate", "gain, grey levels", "p"),
            [
                (d["covariate"], d["gain_grey"], p_value(d["p_value"]))
                for d in channel["unexplained"]
            ],
            "By the same rule as the effects." if channel["unexplained"] else "Nothing.",
        ),
        text_section(
            "What these presses cannot determine, and which could",
            *(channel["cannot_tell"] or ["Nothing of that kind."]),
        ),
        text_section(
            "What the renderer applies with the new table",
            ", ".join(applied) or "Only the table's own colours.",
            "Name table.npz as the sensor's table and tacgen collect renders with it. Centres, "
            "radii and the scatter of exposure belong to single presses and are not in it.",
        ),
    ]
    if excluded:
        sections.append(text_section("Presses that could not be used", *excluded))
    write_page(
        path, "Optics diagnosis", sections, summary=channel["sentence"], verdict=channel["verdict"]
    )


def _effects(channel: Mapping[str, Any]) -> list[PageSection]:
    effects = channel["effects"]
    if not effects:
        return []
    rows = [
        (
            effect["name"],
            effect["how"],
            effect["cv_gain"],
            effect["heldout_gain"],
            effect["heldout_gain_stderr"],
            p_value(effect["p_value"]),
            effect["runner_up"],
            effect["runner_up_gain"],
            ", ".join(effect["as_good"]),
        )
        for effect in effects
    ]
    header = ("effect", "form", "gain, cross-validated", "gain, all presses", "its error",
              "p", "runner-up", "its gain", "equally good")  # fmt: skip
    parameters = [
        (effect["name"], name, estimate(value))
        for effect in effects
        for name, value in effect["parameters"].items()
    ]
    return [
        table_section(
            "Effects, in the order in which they were added",
            header,
            rows,
            "Gains in grey levels of RMSE of a typical press, with what an effect does not "
            "concern of place and exposure re-estimated.",
        ),
        table_section("Parameters", ("effect", "parameter", "value ± standard error"), parameters),
    ]


def _ranking_figure(steps: Sequence[Mapping[str, Any]]) -> Figure:
    panels = []
    for number_, step in enumerate(steps, start=1):
        ranked = dict(sorted(step["rmse"].items(), key=lambda item: item[1]))
        chosen = step["chosen"]
        title = f"Step {number_}: {chosen or 'no candidate'} added"
        panels.append((title, ranked, [chosen], step["error_before"]))
    return plots.rankings(panels, "cross-validated RMSE, grey levels")

"""The page of a friction sweep: mislabels over μ, and real outcomes beside simulated ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from tacgen.calibrate.friction.fit import FrictionFit
from tacgen.calibrate.friction.sweep import Key, friction_json
from tacgen.collection.perturbed import Outcome
from tacgen.dataset.real_grasps import RealGrasp, RealGrasps
from tacgen.report import Section, figure_section, table_section, text_section, write_page
from tacgen.report import figures as plots
from tacgen.report.formatting import interval

FEW_GRASPS = 10
"""Below so many labels a bootstrap's interval is short by chance."""


def write_friction_report(
    path: Path,
    real: RealGrasps,
    outcomes: Mapping[Key, Outcome],
    fits: Mapping[str, FrictionFit],
    warnings: Sequence[str] = (),
) -> None:
    """Write the HTML page: a section of pictures for each object, then the numbers."""
    result = friction_json(fits)
    sections: list[Section] = [
        figure_section(
            name,
            _object_figure(grasps, outcomes, result[name]),
            "Left: mislabels over μ; the line is the chosen μ, the band its 95 % interval. Middle "
            f"and right: real outcomes, and simulated ones at the nearest μ. {plots.OUTCOME_NOTE}",
        )
        for name, grasps in real.by_object().items()
    ]
    rows = [
        (name, fit["mu"], interval(fit["interval"]), _fewest_mislabels(fit), fit["n_grasps"])
        for name, fit in result.items()
    ]
    sections.append(
        table_section(
            "Friction by object",
            ("object", "μ", "95 % interval", "mislabels", "real grasps"),
            rows,
            "The interval is a bootstrap over grasps; where all labels are equal it is one-sided.",
        )
    )
    if warnings:
        sections.append(text_section("Warnings about the data", *warnings))
    summary = " ".join(verdict_of(name, fit) for name, fit in result.items())
    write_page(path, "Friction from real grasps", sections, summary=summary)


def verdict_of(name: str, fit: Mapping[str, Any]) -> str:
    """One sentence about one object's entry of ``friction.json``."""
    low, high = fit["interval"]
    if fit["bounded"] == "below":
        return f"{name}: every real grasp succeeded, so μ is at least about {low:.2f}."
    if fit["bounded"] == "above":
        return f"{name}: every real grasp failed, so μ is at most about {high:.2f}."
    few = " With so few grasps the interval is a rough one." if fit["n_grasps"] < FEW_GRASPS else ""
    return (
        f"{name}: μ = {fit['mu']:.3g} ({low:.3g} to {high:.3g}), "
        f"{_fewest_mislabels(fit)} of {fit['n_grasps']} grasps mislabelled.{few}"
    )


def _fewest_mislabels(fit: Mapping[str, Any]) -> int:
    return min(count for _, count in fit["mislabels"])


def _object_figure(
    grasps: Sequence[RealGrasp], outcomes: Mapping[Key, Outcome], fit: Mapping[str, Any]
) -> Figure:
    figure, grid = plots.new_figure(12, 3.4, 1, 3, width_ratios=(1.2, 1, 1))
    curve, real_map, simulated_map = grid[0]
    mu, mislabels = np.array(fit["mislabels"]).T
    plots.draw_curve(curve, mu, mislabels, fit["mu"], tuple(fit["interval"]))
    curve.set(xlabel="coefficient of friction μ", ylabel="mislabels", ylim=(-0.3, None))
    tried = {value for name, value in outcomes if name == grasps[0].grasp_id}
    nearest = min(sorted(tried), key=lambda value: abs(value - fit["mu"]))
    real = np.array([grasp.label for grasp in grasps])
    simulated = np.array([outcomes[grasp.grasp_id, nearest].label for grasp in grasps])
    places = grasp_places(grasps)
    plots.draw_outcomes(real_map, places, real, real, "real")
    plots.draw_outcomes(simulated_map, places, simulated, real, f"simulated, μ = {nearest:.2f}")
    simulated_map.sharex(real_map)
    simulated_map.sharey(real_map)
    return figure


def grasp_places(grasps: Sequence[RealGrasp]) -> dict[str, np.ndarray]:
    """Force and place (N,) of real grasps, for ``draw_outcomes``."""
    names = ("force_n", "y_mm", "z_mm")
    return {name: np.array([getattr(grasp.config, name) for grasp in grasps]) for name in names}

"""The report of a friction sweep: mislabel curves, and real outcomes beside simulated ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from tacgen.calibrate.friction.fit import FrictionFit
from tacgen.calibrate.friction.sweep import Key
from tacgen.collection.perturbed import Outcome
from tacgen.dataset.real_grasps import RealGrasp, RealGrasps
from tacgen.report import Section, figure_section, table_section, text_section, write_page

if TYPE_CHECKING:
    from matplotlib.axes import Axes

GOOD, BAD, INK = "#2a7d4f", "#b3402e", "#0b6e99"
SPREAD = 0.07


def write_friction_report(
    path: Path,
    real: RealGrasps,
    outcomes: Mapping[Key, Outcome],
    fits: Mapping[str, FrictionFit],
    doubts: Sequence[str] = (),
) -> None:
    """Write the HTML page: one section of pictures for each object."""
    sections: list[Section] = [_summary_table(fits)]
    if doubts:
        sections.append(text_section("Doubts about the data", *doubts))
    for name, grasps in real.by_object().items():
        sections.append(
            figure_section(
                name,
                _object_figure(grasps, outcomes, fits[name]),
                "Left: mislabels over μ; the line is the chosen μ, the band its 95 % interval. "
                "Middle and right: outcome over height and force, real and simulated at the "
                "simulated μ nearest the chosen one; crosses are failures, rings mark mislabels.",
            )
        )
    write_page(path, "Friction from real grasps", sections, summary=_verdict(fits))


def verdict_of(name: str, fit: FrictionFit) -> str:
    """One sentence about one object."""
    low, high = fit.interval
    n_wrong = int(fit.mislabels.min())
    if fit.bounded == "below":
        return f"{name}: every real grasp succeeded, so μ is at least about {low:.2f}."
    if fit.bounded == "above":
        return f"{name}: every real grasp failed, so μ is at most about {high:.2f}."
    few = " Few grasps: take the interval seriously." if fit.n_grasps < 10 else ""
    return (
        f"{name}: μ = {fit.mu:.3g} ({low:.3g} to {high:.3g}), "
        f"{n_wrong} of {fit.n_grasps} grasps mislabelled.{few}"
    )


def _verdict(fits: Mapping[str, FrictionFit]) -> str:
    return " ".join(verdict_of(name, fit) for name, fit in fits.items())


def _summary_table(fits: Mapping[str, FrictionFit]) -> Section:
    rows = [
        [name, fit.mu, *fit.interval, int(fit.mislabels.min()), fit.n_grasps]
        for name, fit in fits.items()
    ]
    return table_section(
        "Friction by object",
        ["object", "μ", "from", "to", "mislabels", "real grasps"],
        rows,
        "The interval is a bootstrap over grasps; where all labels are equal it is one-sided.",
    )


def _object_figure(
    grasps: Sequence[RealGrasp], outcomes: Mapping[Key, Outcome], fit: FrictionFit
) -> Figure:
    figure = Figure(figsize=(12, 3.4), layout="constrained")
    curve, real_map, sim_map = figure.subplots(1, 3, width_ratios=(1.2, 1, 1))
    curve.axvspan(*fit.interval, color=INK, alpha=0.12)
    curve.axvline(fit.mu, color=INK)
    curve.plot(fit.mu_values, fit.mislabels, "o-", color="#1c2430", markersize=4)
    curve.set(xlabel="coefficient of friction μ", ylabel="mislabels", ylim=(-0.3, None))
    nearest = float(fit.mu_values[np.argmin(np.abs(fit.mu_values - fit.mu))])
    real_labels = np.array([grasp.label for grasp in grasps])
    simulated = np.array([outcomes[(grasp.grasp_id, nearest)].label for grasp in grasps])
    outcome_map(real_map, grasps, real_labels, real_labels, "real")
    outcome_map(sim_map, grasps, simulated, real_labels, f"simulated, μ = {nearest:.2f}")
    sim_map.sharex(real_map)
    sim_map.sharey(real_map)
    return figure


def outcome_map(
    axes: Axes,
    grasps: Sequence[RealGrasp],
    labels: np.ndarray,
    truth: np.ndarray,
    title: str,
) -> None:
    """Outcomes over force and height; rings mark labels that differ from ``truth``."""
    force = np.array([grasp.config.force_n for grasp in grasps])
    height = np.array([grasp.config.z_mm for grasp in grasps])
    side = np.array([grasp.config.y_mm for grasp in grasps])
    # Grasps that differ in y alone are drawn beside each other.
    height = height + SPREAD * np.ptp(height) * side / max(float(np.abs(side).max()), 1e-9)
    for label, marker, color in ((1, "o", GOOD), (0, "X", BAD), (-1, "s", "#8a94a3")):
        chosen = labels == label
        axes.scatter(force[chosen], height[chosen], marker=marker, color=color, s=42, alpha=0.85)
    wrong = labels != truth
    axes.scatter(force[wrong], height[wrong], s=150, facecolors="none", edgecolors="#1c2430")
    axes.set(xlabel="gripping force (N)", ylabel="height (mm)", title=title)

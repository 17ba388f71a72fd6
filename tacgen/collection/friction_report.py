"""The page of a friction sweep: mislabels over μ, and real outcomes beside simulated ones."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from tacgen.collection.friction import FrictionFit, SweepKey, friction_json
from tacgen.collection.perturbed import Outcome
from tacgen.dataset.real_grasps import RealGrasp, RealGrasps
from tacgen.report import figures as plots
from tacgen.report.page import write_page


def write_friction_report(
    path: Path,
    real: RealGrasps,
    outcomes: Mapping[SweepKey, Outcome],
    fits: Mapping[str, FrictionFit],
    warnings: Sequence[str] = (),
) -> None:
    """Write the HTML page: pictures of each object, then the numbers."""
    result = friction_json(fits)
    write_page(
        path,
        f"Friction from {real.kind} grasps",
        summary=" ".join(verdict_of(name, fit) for name, fit in result.items()),
        template="friction.html",
        made_by="friction",
        result=result,
        kind=real.kind,
        figures={
            name: _object_figure(grasps, outcomes, result[name], real.kind)
            for name, grasps in real.by_object().items()
        },
        outcome_note=plots.OUTCOME_NOTE,
        warnings=warnings,
    )


def verdict_of(name: str, fit: Mapping[str, Any]) -> str:
    """One sentence about one object's entry of ``friction.json``."""
    low, high = fit["interval"]
    if fit["bounded"] == "below":
        return f"{name}: every grasp succeeded, so μ is at least about {low:.2f}."
    if fit["bounded"] == "above":
        return f"{name}: every grasp failed, so μ is at most about {high:.2f}."
    fewest = min(count for _, count in fit["mislabels"])
    return (
        f"{name}: μ = {fit['mu']:.3g} ({low:.3g} to {high:.3g}), "
        f"{fewest} of {fit['n_grasps']} grasps mislabelled."
    )


def _object_figure(
    grasps: Sequence[RealGrasp],
    outcomes: Mapping[SweepKey, Outcome],
    fit: Mapping[str, Any],
    kind: str,
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
    plots.draw_outcomes(real_map, places, real, real, kind)
    plots.draw_outcomes(simulated_map, places, simulated, real, f"simulated, μ = {nearest:.2f}")
    simulated_map.sharex(real_map)
    simulated_map.sharey(real_map)
    return figure


def grasp_places(grasps: Sequence[RealGrasp]) -> dict[str, np.ndarray]:
    """Force and place (N,) of real grasps, for ``draw_outcomes``."""
    names = ("force_n", "y_mm", "z_mm")
    return {name: np.array([getattr(grasp.config, name) for grasp in grasps]) for name in names}

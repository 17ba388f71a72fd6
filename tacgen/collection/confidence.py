"""How sure a simulated label is: its probability where force, place and friction are not exact."""

import math
from statistics import NormalDist

import numpy as np

from tacgen.collection.recipe import Recipe
from tacgen.core.records import LABEL_SUCCESS, GraspObject, GraspTrace

PLACES = np.array([NormalDist().inv_cdf((k + 0.5) / 201) for k in range(201)])
"""Equally likely places, in standard deviations, the middle one at 0: the chance to hold is nearly
a step in the place, which needs many."""
FARTHEST_LOG_MARGIN = 3.0  # a factor of 20 in force: far beyond any uncertainty


def label_confidence(trace: GraspTrace, grasped: GraspObject, recipe: Recipe) -> float:
    """Probability that a repetition of the grasp has the same label; NaN if not executed.

    By the closed form of the margins, without simulating again. The weight takes up the share s of
    the friction, and gravity asks for the share m of the moment that the pads hold without weight:
    the grasp holds while s² + m² < 1. Both shares fall with force and friction, whose relative
    errors add up to σ; the place moves the lever of m by y. So it holds with the probability
    E_y Φ(−½ ln(s² + m(y)²)/σ). An object whose centre of mass is h below the pads may have a
    lever that is longer by h θ/2: it swings to twice the angle at which its moment balances, which
    may be the largest turn θ of a success. A label that this contradicts counts as on the border.

    Source: Howe & Cutkosky 1996 for the limit surface.
    """
    margin, uncertainty, settings = trace.margin, recipe.uncertainty, recipe.physics
    if margin is None:
        return math.nan
    share = 1 / margin.friction_ratio if margin.friction_ratio > 0 else math.inf
    ratio = margin.torsion_ratio
    # Limit and moment over the weight are levers: their difference and their ratio are known.
    lever_mm = margin.rotational / (ratio - 1) if math.isfinite(ratio) and ratio != 1 else 0.0
    limit_mm = margin.rotational + lever_mm
    below_mm = trace.config.z_mm + settings.height_offset_mm - float(grasped.center_of_mass_mm[2])
    square = np.full(len(PLACES), share**2)
    if share < 1:
        levers_mm = np.abs(lever_mm + uncertainty.position_mm * PLACES)
        levers_mm -= max(0.0, below_mm) * settings.success_turn_rad / 2
        asked = np.where(levers_mm > 0, math.inf, 0.0)
        if limit_mm > 0:
            asked = np.maximum(0.0, levers_mm) / limit_mm
        square += (1 - share**2) * asked**2
    farthest = math.exp(2 * FARTHEST_LOG_MARGIN)
    log_margin = -0.5 * np.log(np.clip(square, 1 / farthest, farthest))
    sign = 1 if trace.label == LABEL_SUCCESS else -1
    log_margin += sign * max(0.0, -sign * log_margin[len(PLACES) // 2])
    spread = math.hypot(uncertainty.force_relative, uncertainty.friction_relative)
    scaled = log_margin / max(spread * math.sqrt(2), 1e-9)
    probability = float(np.mean([(1 + math.erf(one)) / 2 for one in scaled]))
    return probability if sign > 0 else 1 - probability

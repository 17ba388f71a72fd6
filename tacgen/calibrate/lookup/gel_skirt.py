"""How wide the renderer must draw the skirt around a contact for a ball's to be as measured."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.optimize import minimize_scalar

from tacgen.calibrate.lookup.press_fit import PressModel
from tacgen.core.types import FloatArray
from tacgen.optics.deform import Deformer
from tacgen.optics.effects.skirt import SKIRT, SKIRT_RADII
from tacgen.optics.table import LookupTable
from tacgen.presses.geometry import PressedGel

GRID_MM = 0.04
"""Of the map on which the renderer's ball is pressed: a fortieth of a contact."""
WIDTH_STEP = 0.25  # Of three sensors' presses the error hardly changes over a whole width.
OVERLAPS, OVERLAP_STEP = (1.0, 1.45), 0.005
"""Radii, in contact radii, at which the ball lies level with the gel at rest: the gel around sinks
with it, and touches it in a smaller circle."""


def with_skirt(table: LookupTable) -> LookupTable:
    """The table with a skirt as wide as the gel's of the presses that it was fitted to."""
    learnt, balls_mm = table.provenance["press_model"], table.provenance["ball_radius_mm"]
    contact_mm, membrane = learnt["contact_radius_mm"], PressModel.from_dict(learnt).membrane
    width = fitted_width(PressedGel(contact_mm, float(np.mean(balls_mm)), membrane))
    return replace(table, effects={**table.effects, SKIRT.name: {"width": width}})


def fitted_width(pressed: PressedGel) -> float:
    """The width of the skirt whose slope around a ball is nearest to a measured press's.

    Slopes of the gel are compared from the middle to as far as a diagnosis looks, by area; how deep
    the ball is in is fitted along.
    """
    contact, ball = pressed.contact_radius_mm, pressed.ball_radius_mm
    n = math.ceil(2 * SKIRT_RADII[-1] * contact / GRID_MM)
    x = (np.arange(-n, n + 1) * GRID_MM).astype(np.float64)
    distance = np.sqrt(x**2 + x[:, None] ** 2)
    away = x[n:]
    measured = pressed.radial_slope(away)
    near = away < SKIRT_RADII[-1] * contact

    def error(overlap: float, width: float) -> float:
        level = math.sqrt(max(ball**2 - (overlap * contact) ** 2, 0.0))
        cap = np.sqrt(np.maximum(ball**2 - distance**2, 0.0)) - level
        drawn = _middle_row(np.maximum(cap, 0.0), width)
        slope = -np.gradient(drawn, GRID_MM)[n:]
        return float((((slope - measured) ** 2) * away)[near].sum())

    bounds = SKIRT.parameters["width"]
    widths = np.arange(bounds.lower, bounds.upper + 1e-9, WIDTH_STEP)
    by_width = [partial(error, width=width) for width in widths.tolist()]
    return float(widths[np.argmin([of(fitted_overlap(of)) for of in by_width])])


def fitted_overlap(error: Callable[[float], float]) -> float:
    """Where in ``OVERLAPS`` an error is least."""
    found = minimize_scalar(
        error, bounds=OVERLAPS, method="bounded", options={"xatol": OVERLAP_STEP}
    )
    return float(found.x)


def _middle_row(depth_mm: FloatArray, width: float) -> FloatArray:
    """The deformation of the gel along the middle of a map of an indentation."""
    n = len(depth_mm)
    whole = (0, n, 0, n)
    part, window = Deformer(GRID_MM, width).deform(depth_mm.astype(np.float32), whole, (n, n))
    row = np.zeros(n)
    row[window[2] : window[3]] = part[n // 2 - window[0]]
    return row

"""Press images → lookup table."""

from __future__ import annotations

import math
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from tacgen import __version__
from tacgen.calibration.press_fit import FitSettings, JointFit, fit_jointly
from tacgen.calibration.press_geometry import press_slope, rest_slope
from tacgen.calibration.press_images import PressImages
from tacgen.calibration.press_model import PressModel
from tacgen.calibration.press_samples import place_mm
from tacgen.calibration.smooth_model import SmoothModel, position_terms
from tacgen.calibration.table_background import (
    BackgroundRecipe,
    bare_gel_change,
    make_background,
)
from tacgen.optics.table import LookupTable

N_SLOPE, N_DIRECTION = 48, 120
"""Nodes of the table: fine enough that interpolation adds less than 0.1 grey levels."""

BEYOND_STEEPEST = 1.02
"""The table ends a little above the steepest slope that the presses hold."""


def fit_lookup(
    presses: PressImages,
    settings: FitSettings | None = None,
    background_recipe: BackgroundRecipe | None = None,
) -> LookupTable:
    """The lookup table of a sensor from its ball presses.

    Every press must have a centre and a radius, labelled or found; both are taken as a start and
    estimated.
    """
    settings = settings or FitSettings()
    recipe = background_recipe or BackgroundRecipe(smooth=0.05, drift=True)
    change = bare_gel_change(presses) if recipe.drift else None
    background = make_background(presses.background, change, recipe)
    fit = fit_jointly(presses, background, settings)
    return tabulate(presses, fit, background)


def tabulate(presses: PressImages, fit: JointFit, background: NDArray[np.float32]) -> LookupTable:
    """The fitted model as a table that renders without any of the fit's code."""
    steepest = steepest_slope_rad(presses, fit)
    slope = np.linspace(0.0, steepest, N_SLOPE)
    direction = -np.pi + 2 * np.pi * np.arange(N_DIRECTION) / N_DIRECTION
    return LookupTable(
        coefficients=fit.model.coefficients(slope, direction),
        background=without_rest(background, fit.model, fit.press_model, presses.mm_per_px),
        mm_per_px=presses.mm_per_px,
        max_slope_rad=float(steepest),
        sensor=presses.sensor,
        provenance=MappingProxyType(
            {
                "made_by": f"tacgen {__version__} calibrate lookup",
                "data_sha256": dict(presses.sha256),
                "n_presses": len(presses),
                "press_model": fit.press_model.as_dict(),
                "ball_radius_mm": sorted({float(r) for r in presses.ball_radius_mm}),
            }
        ),
    )


def steepest_slope_rad(presses: PressImages, fit: JointFit) -> float:
    """The steepest slope of the gel that any of the presses holds, and a little more."""
    model = fit.press_model
    steepest = 0.0
    for (_, _, radius), ball_radius_mm in zip(fit.geometry, presses.ball_radius_mm, strict=True):
        r = np.linspace(0.0, float(ball_radius_mm), 400)
        slope, _ = press_slope(
            r,
            np.zeros_like(r),
            float(radius),
            float(ball_radius_mm),
            model.membrane,
            model.dome_radius_mm,
        )
        steepest = max(steepest, float(np.arctan(slope).max()))
    return min(BEYOND_STEEPEST * steepest, math.pi / 2)


def without_rest(
    reference: NDArray[np.float32], model: SmoothModel, press_model: PressModel, mm_per_px: float
) -> NDArray[np.float32]:
    """The reference image less what the table adds for the gel at rest (0 for a flat gel)."""
    if press_model.dome_radius_mm <= 0:
        return reference
    height, width = reference.shape[:2]
    rows, columns = np.mgrid[:height, :width]
    x_mm, y_mm = place_mm(columns.ravel(), rows.ravel(), (height, width), mm_per_px)
    u, v = (columns.ravel() + 0.5) / width - 0.5, (rows.ravel() + 0.5) / height - 0.5
    slope = rest_slope(x_mm, y_mm, press_model.dome_radius_mm)
    at_rest = model.change(*slope, position_terms(u, v))
    return np.asarray(reference - at_rest.reshape(height, width, 3), dtype=np.float32)

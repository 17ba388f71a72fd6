"""Press images → lookup table."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen import __version__
from tacgen.calibration.lookup_choice import Choice, choose, fold_of
from tacgen.calibration.press_fit import FitSettings, JointFit, fit_jointly
from tacgen.calibration.press_geometry import press_slope, rest_slope
from tacgen.calibration.press_images import PressImages
from tacgen.calibration.press_model import PressModel
from tacgen.calibration.press_samples import place_mm
from tacgen.calibration.score import PressScore, TableScore, score_table
from tacgen.calibration.smooth_model import SmoothModel, position_terms
from tacgen.calibration.table_background import (
    BackgroundRecipe,
    bare_gel_change,
    make_background,
)
from tacgen.optics.table import LookupTable

N_SLOPE, N_DIRECTION = 48, 120
"""Nodes of the table: fine enough that interpolation adds less than 0.1 grey levels."""

FIRST_BACKGROUND = BackgroundRecipe(smooth=0.05, drift=True)
"""What the presses are first placed on; smooth, so that the choice among backgrounds is open."""

BEYOND_STEEPEST = 1.02
"""The table ends a little above the steepest slope that the presses hold."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """A table, how it was fitted, and its score on presses that had no part in fitting it.

    ``fold_tables`` are those that the score is of: press k was left out of table k mod their
    number.
    """

    table: LookupTable
    fit: JointFit
    choice: Choice
    background: NDArray[np.float32]
    heldout: TableScore | None = None
    fold_tables: tuple[LookupTable, ...] = ()


def fit_lookup(presses: PressImages) -> LookupTable:
    """The lookup table of a sensor from its ball presses.

    Every press must have a centre and a radius, labelled or found; both are taken as a start and
    estimated. Degree, ridge and background are chosen by cross-validation over whole presses.
    """
    return calibrate(presses).table


def calibrate(presses: PressImages, *, heldout: bool = False) -> Calibration:
    """Fit a table; with ``heldout`` also repeat everything five times, each without a fifth.

    The held-out presses of a fold take no part in the fit, in the choice of settings or in the
    estimate of the background that they are scored against.
    """
    first = FitSettings()
    change = bare_gel_change(presses)
    start = make_background(presses.background, change, FIRST_BACKGROUND)
    rough = fit_jointly(presses, start, first)
    choice = choose(presses, rough, first)
    background = make_background(presses.background, change, choice.background)
    fit = rough
    if (choice.settings, choice.background) != (first, FIRST_BACKGROUND):
        fit = fit_jointly(presses, background, choice.settings, start=rough, iterations=3)
    score, tables = _heldout(presses) if heldout else (None, ())
    table = tabulate(presses, fit, background, choice, score)
    return Calibration(table, fit, choice, background, score, tables)


def _heldout(presses: PressImages) -> tuple[TableScore, tuple[LookupTable, ...]]:
    """The score of five tables, each on the fifth of the presses that it was made without."""
    folds = fold_of(len(presses))
    scored: list[PressScore | None] = [None] * len(presses)
    tables = []
    for fold in np.unique(folds):
        left_out = np.nonzero(folds == fold)[0]
        table = calibrate(presses.select(folds != fold)).table
        tables.append(table)
        for k, press in zip(
            left_out, score_table(table, presses.select(left_out)).presses, strict=True
        ):
            scored[k] = press
    return TableScore(tuple(press for press in scored if press is not None)), tuple(tables)


def tabulate(
    presses: PressImages,
    fit: JointFit,
    background: NDArray[np.float32],
    choice: Choice,
    heldout: TableScore | None,
) -> LookupTable:
    """The fitted model as a table that renders without any of the fit's code."""
    steepest = steepest_slope_rad(presses, fit)
    slope = np.linspace(0.0, steepest, N_SLOPE)
    direction = -np.pi + 2 * np.pi * np.arange(N_DIRECTION) / N_DIRECTION
    provenance: dict[str, Any] = {
        "made_by": f"tacgen {__version__} calibrate lookup",
        "data_sha256": dict(presses.sha256),
        "n_presses": len(presses),
        "left_out": [str(press) for press in presses.doubtful],
        "ball_radius_mm": sorted({float(r) for r in presses.ball_radius_mm}),
        "press_model": fit.press_model.as_dict(),
        "settings": {**asdict(choice.settings), **asdict(choice.background)},
        "drift_share": fit.drift_share,
    }
    if heldout is not None:
        provenance["heldout"] = {
            name: value for name, value in heldout.as_dict().items() if name != "images"
        }
    return LookupTable(
        coefficients=fit.model.coefficients(slope, direction),
        background=without_rest(background, fit.model, fit.press_model, presses.mm_per_px),
        mm_per_px=presses.mm_per_px,
        max_slope_rad=float(steepest),
        sensor=presses.sensor,
        noise_grey=camera_noise_grey(presses),
        provenance=MappingProxyType(provenance),
    )


def camera_noise_grey(presses: PressImages) -> float:
    """Standard deviation of the camera's noise: what neighbouring pixels of bare gel differ by.

    Second differences along rows hold nothing of a smooth picture; for white noise of σ they
    have √6 σ.
    """
    noises = []
    for image in presses.images:
        grey = image.astype(np.float32)
        second = grey[:, :-2] - 2 * grey[:, 1:-1] + grey[:, 2:]
        noises.append(1.4826 * float(np.median(np.abs(second))) / math.sqrt(6))
    return float(np.median(noises))


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

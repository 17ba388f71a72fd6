"""What the residual of ball presses still follows when no listed effect is left to add."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tacgen.core.arrays import FloatArray
from tacgen.diagnose.optics.model import geometry_of, render
from tacgen.diagnose.optics.model_comparison import Entry, gain_p_value, typical_rmse
from tacgen.diagnose.optics.pixels import PressPixels

FALSE_ALARM = 0.01
LEAST_GAIN = 0.05
"""A covariate must lower the error of presses left out by this share, as an effect must."""

CELLS = 16
"""Cells along each side of the image in which a mark on the gel is looked for."""

_HELD_PRESSES = 2.0
"""A pattern is held back as if so many presses had shown nothing."""


@dataclass(frozen=True, slots=True)
class Dependence:
    """A covariate that the residual follows, and what taking it off lowers the error by."""

    covariate: str
    p_value: float
    gain_grey: float

    def as_dict(self) -> dict[str, object]:
        """For ``diagnosis.json``."""
        return {
            "covariate": self.covariate,
            "p_value": self.p_value,
            "gain_grey": self.gain_grey,
        }


def left_over(
    entry: Entry,
    folds: NDArray[np.int64],
    order: FloatArray,
    noise_grey: float,
    only: tuple[str, ...] = (),
) -> list[Dependence]:
    """Covariates that the residual of presses left out follows, the strongest first.

    For each the residual is predicted from the other folds' presses and taken off; it must gain
    by the same rule as an effect.

    Parameters
    ----------
    folds : (N,) int
    order : (N,) float
        Place of each press in the session.
    noise_grey : float
        Standard deviation of the camera's noise.
    only : tuple of str
        Look at these covariates alone.
    """
    pixels = entry.problem.pixels
    tests: dict[str, Callable[[], FloatArray]] = {
        "place_on_gel": lambda: _pattern(entry.errors, pixels, folds, _gel_cell(pixels))
    }
    tests["place_around_contact"] = lambda: _pattern(
        entry.errors, pixels, folds, _contact_cell(entry)
    )
    for name, values in _covariates(pixels, order).items():
        tests[name] = lambda values=values: _trend(entry, folds, values)  # type: ignore[misc]
    found = []
    for name, predict in tests.items():
        if only and name not in only:
            continue
        rest = entry.errors - predict()
        squares = pixels.mean_by_press((rest**2).mean(axis=1))
        p_value = gain_p_value(entry.squares, squares)
        gain = entry.rmse - typical_rmse(squares)
        # A table's polynomial and a skin's form leave rings around any contact, fainter than this.
        effect_grey = math.sqrt(max(entry.rmse**2 - (entry.rmse - gain) ** 2, 0.0))
        if name == "place_around_contact" and effect_grey < noise_grey:
            continue
        if p_value <= FALSE_ALARM / len(tests) and gain >= LEAST_GAIN * entry.rmse:
            found.append(Dependence(name, p_value, gain))
    return sorted(found, key=lambda dependence: -dependence.gain_grey)


def _covariates(pixels: PressPixels, order: FloatArray) -> dict[str, FloatArray]:
    """Conditions of each press that vary."""
    x, y, radius = pixels.labels.T
    named = {
        "image_number": order,
        "x_mm": x,
        "y_mm": y,
        "distance_from_center_mm": np.hypot(x, y),
        "contact_radius_mm": radius,
        "ball_radius_mm": pixels.ball_mm,
    }
    return {
        name: (values - values.mean()) / values.std()
        for name, values in named.items()
        if values.std() > 1e-9 * max(1.0, float(np.abs(values).max()))
    }


def _trend(entry: Entry, folds: NDArray[np.int64], values: FloatArray) -> FloatArray:
    """What a straight line in a press's condition predicts, for its level and its contrast."""
    pixels = entry.problem.pixels
    picture = render(entry.state, pixels, entry.problem.table, entry.problem.profiles)
    change = picture.grey - pixels.background
    along = values[pixels.press][:, None]
    predicted = np.zeros_like(entry.errors)
    ridge = _HELD_PRESSES * len(pixels) / pixels.n_presses
    for channel in range(3):
        size = float(np.sqrt((change[:, channel] ** 2).mean())) + 1e-9
        columns = np.hstack([along, along * change[:, channel : channel + 1] / size])
        for fold in np.unique(folds):
            out = folds[pixels.press] == fold
            kept = columns[~out]
            gram = kept.T @ kept + ridge * np.eye(2)
            weights = np.linalg.solve(gram, kept.T @ entry.errors[~out, channel])
            predicted[out, channel] = columns[out] @ weights
    return predicted


def _pattern(
    errors: FloatArray, pixels: PressPixels, folds: NDArray[np.int64], cell: NDArray[np.int64]
) -> FloatArray:
    """What the other folds' presses leave over, on average, in each pixel's cell."""
    n_cells = int(cell.max()) + 1
    key = pixels.press * n_cells + cell
    counts = np.bincount(key, minlength=pixels.n_presses * n_cells)
    seen = (counts > 0).reshape(pixels.n_presses, n_cells)
    predicted = np.zeros_like(errors)
    for channel in range(3):
        sums = np.bincount(key, errors[:, channel], minlength=counts.size)
        means = (sums / np.maximum(counts, 1)).reshape(pixels.n_presses, n_cells)
        for fold in np.unique(folds):
            kept = folds != fold
            views = seen[kept].sum(axis=0)
            pattern = (means[kept] * seen[kept]).sum(axis=0) / (views + _HELD_PRESSES)
            out = ~kept[pixels.press]
            predicted[out, channel] = pattern[cell[out]]
    return predicted


def _gel_cell(pixels: PressPixels) -> NDArray[np.int64]:
    u, v = pixels.position[:, 3], pixels.position[:, 4]
    across, down = (np.clip(((w + 0.5) * CELLS).astype(int), 0, CELLS - 1) for w in (u, v))
    return np.asarray(down * CELLS + across)


def _contact_cell(entry: Entry) -> NDArray[np.int64]:
    """Ring and sector around the contact: what a table or a form of skin cannot follow."""
    pixels = entry.problem.pixels
    place = geometry_of(entry.state, pixels)[pixels.press]
    dx, dy = pixels.x_mm - place[:, 0], pixels.y_mm - place[:, 1]
    ring = np.minimum((np.hypot(dx, dy) / place[:, 2] / 0.2).astype(int), 9)
    sector = ((np.arctan2(dy, dx) + np.pi) / (2 * np.pi) * 8).astype(int) % 8
    return np.asarray(ring * 8 + sector)

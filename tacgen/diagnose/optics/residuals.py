"""How much one model lowers the error of another, and what the residuals still follow."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from tacgen.core.arrays import FloatArray
from tacgen.diagnose.optics.pixels import PressPixels
from tacgen.diagnose.optics.rules import SelectionRules

_TINY = 1e-6
"""Squared grey levels far below any camera's noise: keeps a logarithm finite."""


def typical_rmse(squares: FloatArray) -> float:
    """Geometric mean over presses of their RMSE, from mean squared errors (N,), grey levels.

    One press beyond the slopes of all others, which a held-out fit misses, does not decide.
    """
    return float(np.exp(0.5 * np.log(squares + _TINY).mean()))


def gain_p_value(before: FloatArray, after: FloatArray) -> float:
    """One-sided paired t-test over presses of the logarithm of the squared error.

    Logarithms, so that one press with a large error does not decide.
    """
    gain = np.log(before + _TINY) - np.log(after + _TINY)
    error = gain.std(ddof=1) / math.sqrt(len(gain)) + 1e-12
    return float(student.sf(gain.mean() / error, len(gain) - 1))


def is_as_good(other: FloatArray, best: FloatArray, before: FloatArray, most: float) -> bool:
    """Whether squared errors (N,) of one model hardly differ from those of the best one.

    They are within one standard error, or have the share ``most`` of its gain over ``before``.
    """
    logs = [np.log(squares + _TINY) for squares in (before, other, best)]
    apart = logs[1] - logs[2]
    if apart.mean() <= apart.std(ddof=1) / math.sqrt(len(apart)):
        return True
    return bool((logs[0] - logs[1]).mean() >= most * (logs[0] - logs[2]).mean())


@dataclass(frozen=True, slots=True)
class Dependence:
    """A covariate that the residuals follow, and what predicting by it lowers the error by."""

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


@dataclass(frozen=True, slots=True)
class Residuals:
    """Errors of held-out presses, and the conditions that they may follow.

    Attributes
    ----------
    pixels : PressPixels
    errors : (n, 3) float
    change : (n, 3) float
        What the model changes from the background.
    places_mm : (N, 3) float
        Centre and contact radius of each press.
    folds : (N,) int
    order : (N,) float
        Place of each press in the session.
    noise_grey : float
        Standard deviation of the camera's noise.
    """

    pixels: PressPixels
    errors: FloatArray
    change: FloatArray
    places_mm: FloatArray
    folds: NDArray[np.int64]
    order: FloatArray
    noise_grey: float
    rules: SelectionRules

    def dependences(self, only: tuple[str, ...] = ()) -> list[Dependence]:
        """Covariates (all, or some) that the residuals follow, the strongest first.

        For each the residuals are predicted from the other folds' presses and subtracted; it must
        gain by the same rule as an effect.
        """
        rules, pixels = self.rules, self.pixels
        before = pixels.mean_by_press((self.errors**2).mean(axis=1))
        rmse = typical_rmse(before)
        around = "place_around_contact"
        predictions: dict[str, Callable[[], FloatArray]] = {
            "place_on_gel": lambda: self._pattern(self._gel_cell()),
            around: lambda: self._pattern(self._contact_cell()),
        }
        for name, values in self._conditions().items():
            predictions[name] = lambda values=values: self._trend(values)  # type: ignore[misc]
        found = []
        for name in only or predictions:
            if name not in predictions:
                continue
            after = pixels.mean_by_press(((self.errors - predictions[name]()) ** 2).mean(axis=1))
            p_value, gain = gain_p_value(before, after), rmse - typical_rmse(after)
            effect_grey = math.sqrt(max(rmse**2 - (rmse - gain) ** 2, 0.0))
            # A table's polynomial and a gel's form leave fainter rings around any contact.
            if name == around and effect_grey < rules.least_noise_share_of_form * self.noise_grey:
                continue
            if p_value <= rules.false_alarm / len(predictions) and gain >= rules.least_gain * rmse:
                found.append(Dependence(name, p_value, gain))
        return sorted(found, key=lambda dependence: -dependence.gain_grey)

    def _conditions(self) -> dict[str, FloatArray]:
        """Conditions of each press that vary, standardised."""
        x, y, radius = self.pixels.labels.T
        named = {
            "image_number": self.order,
            "x_mm": x,
            "y_mm": y,
            "distance_from_center_mm": np.hypot(x, y),
            "contact_radius_mm": radius,
            "ball_radius_mm": self.pixels.ball_mm,
        }
        return {
            name: (values - values.mean()) / values.std()
            for name, values in named.items()
            if values.std() > 1e-9 * max(1.0, float(np.abs(values).max()))
        }

    def _trend(self, values: FloatArray) -> FloatArray:
        """What a straight line in a press's condition predicts, for its level and contrast."""
        pixels = self.pixels
        along = values[pixels.press][:, None]
        predicted = np.zeros_like(self.errors)
        ridge = self.rules.held_presses * len(pixels) / pixels.n_presses
        for channel in range(3):
            change = self.change[:, channel : channel + 1]
            size = float(np.sqrt((change**2).mean())) + 1e-9
            columns = np.hstack([along, along * change / size])
            for fold in np.unique(self.folds):
                out = self.folds[pixels.press] == fold
                kept = columns[~out]
                gram = kept.T @ kept + ridge * np.eye(2)
                weights = np.linalg.solve(gram, kept.T @ self.errors[~out, channel])
                predicted[out, channel] = columns[out] @ weights
        return predicted

    def _pattern(self, cell: NDArray[np.int64]) -> FloatArray:
        """The mean residual of the other folds' presses in each pixel's cell."""
        pixels, n_cells = self.pixels, int(cell.max()) + 1
        key = pixels.press * n_cells + cell
        counts = np.bincount(key, minlength=pixels.n_presses * n_cells)
        seen = (counts > 0).reshape(pixels.n_presses, n_cells)
        predicted = np.zeros_like(self.errors)
        for channel in range(3):
            sums = np.bincount(key, self.errors[:, channel], minlength=counts.size)
            means = (sums / np.maximum(counts, 1)).reshape(pixels.n_presses, n_cells)
            for fold in np.unique(self.folds):
                kept = self.folds != fold
                views = seen[kept].sum(axis=0)
                pattern = (means[kept] * seen[kept]).sum(axis=0) / (views + self.rules.held_presses)
                out = ~kept[pixels.press]
                predicted[out, channel] = pattern[cell[out]]
        return predicted

    def _gel_cell(self) -> NDArray[np.int64]:
        u, v, n = self.pixels.position[:, 3], self.pixels.position[:, 4], self.rules.cells
        across, down = (np.clip(((w + 0.5) * n).astype(int), 0, n - 1) for w in (u, v))
        return np.asarray(down * n + across)

    def _contact_cell(self) -> NDArray[np.int64]:
        """Ring and sector around the contact: what a table or a form of gel cannot follow."""
        pixels, rules = self.pixels, self.rules
        place = self.places_mm[pixels.press]
        dx, dy = pixels.x_mm - place[:, 0], pixels.y_mm - place[:, 1]
        radii = np.hypot(dx, dy) / place[:, 2]
        ring = np.minimum((radii / rules.ring_radii).astype(int), rules.n_rings - 1)
        turn = (np.arctan2(dy, dx) + np.pi) / (2 * np.pi)
        sector = (turn * rules.n_sectors).astype(int) % rules.n_sectors
        return np.asarray(ring * rules.n_sectors + sector)

"""What the smooth model misses, bin by bin of slope: least squares shrunk to the smooth model.

In each bin of (slope, direction) six coefficients of a quadratic in image position are fitted to
what the smooth model leaves over. A ridge worth a few presses' pixels holds them near 0, so that a
bin with few pixels stays with the smooth model and an empty one is the smooth model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tacgen.calibrate.lookup.press_fit import JointFit, Sample
from tacgen.calibrate.lookup.smooth_model import N_FEATURES, position_costs
from tacgen.core.arrays import FloatArray

BIN_COUNTS = ((6, 12), (12, 24), (24, 48))
HELD_PRESSES = (1.0, 4.0, 16.0)


@dataclass(frozen=True, slots=True)
class BinSettings:
    """How fine the bins are and how firmly they are held to the smooth model.

    Attributes
    ----------
    n_slope, n_direction : int
        0 for no bins: the smooth model as it is.
    held_presses : float
        The ridge, in presses: a bin seen by as many goes half of the way.
    """

    n_slope: int = 0
    n_direction: int = 0
    held_presses: float = 0.0

    def __str__(self) -> str:
        if not self.n_slope:
            return "smooth model alone"
        return f"{self.n_slope}×{self.n_direction} bins, held by {self.held_presses:g} presses"


NO_BINS = BinSettings()

CANDIDATES = tuple(BinSettings(*count, held) for count in BIN_COUNTS for held in HELD_PRESSES)


@dataclass(frozen=True, slots=True)
class BinSums:
    """Normal equations of every bin: (n_bins, 6, 6) and (n_bins, 6, c)."""

    gram: FloatArray
    moment: FloatArray
    pixels_per_press: float


@dataclass(frozen=True, slots=True)
class Bins:
    """Corrections (n_slope, n_direction, 6, c) at the middles of bins up to ``max_slope_rad``."""

    coefficients: FloatArray
    max_slope_rad: float

    def at(self, slope_rad: FloatArray, direction_rad: FloatArray) -> FloatArray:
        """Coefficients (..., 6, c) between the bins' middles; they die out at slope 0."""
        n_slope, n_direction = self.coefficients.shape[:2]
        level = np.zeros((1, *self.coefficients.shape[1:]))
        nodes = np.concatenate([level, self.coefficients], axis=0)
        i = slope_rad / self.max_slope_rad * n_slope
        # From slope 0 to the first middle is half a bin.
        i = np.clip(np.where(i < 0.5, 2 * i, i + 0.5), 0.0, n_slope)
        j = (direction_rad + np.pi) / (2 * np.pi) * n_direction - 0.5
        low_i, low_j = np.minimum(i.astype(int), n_slope - 1), np.floor(j).astype(int)
        share_i, share_j = (i - low_i)[..., None, None], (j - low_j)[..., None, None]
        here, next_j = low_j % n_direction, (low_j + 1) % n_direction
        below = (1 - share_j) * nodes[low_i, here] + share_j * nodes[low_i, next_j]
        above = (1 - share_j) * nodes[low_i + 1, here] + share_j * nodes[low_i + 1, next_j]
        return np.asarray((1 - share_i) * below + share_i * above)

    def change(self, polar: FloatArray, position: FloatArray) -> FloatArray:
        """Grey levels (n, c) to add at slopes and directions ``polar`` (n, 2)."""
        return np.einsum("nf,nfc->nc", position, self.at(polar[:, 0], polar[:, 1]))


def polar_slopes(sample: Sample, place: FloatArray, fit: JointFit) -> FloatArray:
    """Slope and direction (n, 2), rad, of the gel at a press's pixels."""
    gx, gy = fit.press_model.slopes(place, sample.ball_radius_mm, sample.pixels)
    return np.column_stack([np.arctan(np.hypot(gx, gy)), np.arctan2(gy, gx)])


def bin_sums(
    polar: FloatArray,
    position: FloatArray,
    residual: FloatArray,
    press: NDArray[np.int64],
    settings: BinSettings,
    max_slope_rad: float,
) -> BinSums:
    """Sums over pixels, repeats and all, of the normal equations of every bin.

    Parameters
    ----------
    polar, position, residual : (n, 2), (n, 6), (n, c) float
    press : (n,) int
        Which press a pixel is of.
    """
    n_bins = settings.n_slope * settings.n_direction
    i = (polar[:, 0] / max_slope_rad * settings.n_slope).astype(int)
    j = ((polar[:, 1] + np.pi) / (2 * np.pi) * settings.n_direction).astype(int)
    i = np.minimum(i, settings.n_slope - 1)
    index = i * settings.n_direction + np.minimum(j, settings.n_direction - 1)

    def total(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(index, values, n_bins), dtype=np.float64)

    gram = np.empty((n_bins, N_FEATURES, N_FEATURES))
    for a in range(N_FEATURES):
        for b in range(a, N_FEATURES):
            gram[:, a, b] = gram[:, b, a] = total(position[:, a] * position[:, b])
    moment = np.empty((n_bins, N_FEATURES, residual.shape[1]))
    for a in range(N_FEATURES):
        for c in range(residual.shape[1]):
            moment[:, a, c] = total(position[:, a] * residual[:, c])
    met = len(np.unique(press * n_bins + index))
    return BinSums(gram, moment, len(index) / max(met, 1))


def solve_bins(sums: BinSums, settings: BinSettings, max_slope_rad: float) -> Bins:
    """The shrunken least-squares coefficients of every bin."""
    held = settings.held_presses * sums.pixels_per_press
    ridge = held * np.diag(position_costs())
    found = np.linalg.solve(sums.gram + ridge, sums.moment)
    shape = (settings.n_slope, settings.n_direction, N_FEATURES, sums.moment.shape[2])
    return Bins(found.reshape(shape), max_slope_rad)


def choose_bins(
    samples: Sequence[Sample],
    fit: JointFit,
    targets: Sequence[FloatArray],
    smooth: Sequence[FloatArray],
    folds: NDArray[np.int64],
) -> tuple[BinSettings, dict[str, float]]:
    """The bins with the least error on presses left out; none unless clearly better.

    Parameters
    ----------
    targets : list of (n, 3) float
        Change of grey level of each press.
    smooth : list of (n, 3 · n_folds) float
        What the smooth models without each fold say.
    """
    inside = [sample.pixels.inside for sample in samples]
    polar = _stacked(
        [polar_slopes(s, p, fit) for s, p in zip(samples, fit.geometry, strict=True)], inside
    )
    position = _stacked([sample.pixels.position for sample in samples], inside)
    target, said = _stacked(targets, inside), _stacked(smooth, inside)
    press = np.repeat(np.arange(len(samples)), [int(mask.sum()) for mask in inside])
    fold = folds[press]
    steepest = float(polar[:, 0].max())
    squares = {candidate: np.zeros(len(samples)) for candidate in (NO_BINS, *CANDIDATES)}
    for number in np.unique(folds):
        residual = target - said[:, 3 * number : 3 * number + 3]
        out = fold == number
        for candidate in squares:
            left = residual[out]
            if candidate.n_slope:
                sums = bin_sums(
                    polar[~out], position[~out], residual[~out], press[~out], candidate, steepest
                )
                left = left - solve_bins(sums, candidate, steepest).change(
                    polar[out], position[out]
                )
            squares[candidate] += np.bincount(
                press[out], (left**2).sum(axis=1), minlength=len(samples)
            )
    errors = {
        str(candidate): float(np.sqrt(square.sum() / (3 * len(press))))
        for candidate, square in squares.items()
    }
    best = min(squares, key=lambda candidate: squares[candidate].sum())
    gain = squares[NO_BINS] - squares[best]
    clearly = gain.sum() > np.sqrt(len(gain)) * gain.std(ddof=1)
    return (best if clearly else NO_BINS), errors


def _stacked(parts: Sequence[FloatArray], inside: Sequence[NDArray[np.bool_]]) -> FloatArray:
    return np.concatenate([part[mask] for part, mask in zip(parts, inside, strict=True)])

"""Choosing a table's degree, ridge, background and bins by cross-validation over whole presses.

Bins hold what the smooth model misses: in each bin of (slope, direction) six coefficients of a
quadratic in image position are fitted to the smooth model's residual. A ridge worth a few presses'
pixels holds them near 0, so that a bin with few pixels stays with the smooth model and an empty one
is the smooth model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tacgen.calibrate.lookup.prepared import PreparedPresses, Sample
from tacgen.calibrate.lookup.press_fit import JointFit, sample_design
from tacgen.calibrate.lookup.settings import (
    BackgroundRecipe,
    BinSettings,
    FitSettings,
    LookupRules,
)
from tacgen.calibrate.lookup.smooth_model import N_FEATURES, n_terms, position_costs, solve_ridge
from tacgen.core.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Choice:
    """The chosen settings and the cross-validated RMSE, grey levels, of every candidate.

    ``bin_errors`` compares the smooth model with tables that correct it bin by bin.
    """

    settings: FitSettings
    background: BackgroundRecipe
    errors: dict[str, float]
    bins: BinSettings
    bin_errors: dict[str, float]


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


@dataclass(frozen=True, slots=True)
class InnerPixels:
    """The pixels inside all contact circles, one after the other.

    Attributes
    ----------
    polar : (n, 2) float
        Slope and direction of the gel, rad.
    position : (n, 6) float
        The table's features.
    press : (n,) int
        Which press a pixel is of.
    """

    polar: FloatArray
    position: FloatArray
    press: IntArray

    @classmethod
    def of(cls, samples: Sequence[Sample], fit: JointFit) -> InnerPixels:
        """Those of ``samples`` placed as in ``fit``."""
        polar = []
        for sample, place in zip(samples, fit.geometry, strict=True):
            gx, gy = fit.press_model.slopes(place, sample.ball_radius_mm, sample.pixels)
            polar.append(np.column_stack([np.arctan(np.hypot(gx, gy)), np.arctan2(gy, gx)]))
        counts = [int(sample.pixels.inside.sum()) for sample in samples]
        return cls(
            inside(polar, samples),
            inside([sample.pixels.position for sample in samples], samples),
            np.repeat(np.arange(len(samples)), counts),
        )

    def select(self, mask: BoolArray) -> InnerPixels:
        """The pixels where ``mask`` (n,) holds."""
        return InnerPixels(self.polar[mask], self.position[mask], self.press[mask])


def inside(parts: Sequence[FloatArray], samples: Sequence[Sample]) -> FloatArray:
    """Of arrays over each sample's pixels, the rows inside the contact circles, in one array."""
    return np.concatenate(
        [part[sample.pixels.inside] for part, sample in zip(parts, samples, strict=True)]
    )


def fit_bins(
    pixels: InnerPixels, residual: FloatArray, settings: BinSettings, max_slope_rad: float
) -> Bins:
    """Shrunken least squares in every bin of the smooth model's residual (n, c)."""
    n_bins = settings.n_slope * settings.n_direction
    slope, direction = pixels.polar[:, 0], pixels.polar[:, 1]
    i = (slope / max_slope_rad * settings.n_slope).astype(int)
    j = ((direction + np.pi) / (2 * np.pi) * settings.n_direction).astype(int)
    i = np.minimum(i, settings.n_slope - 1)
    index = i * settings.n_direction + np.minimum(j, settings.n_direction - 1)

    def total(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(index, values, n_bins), dtype=np.float64)

    position, n_channels = pixels.position, residual.shape[1]
    gram = np.empty((n_bins, N_FEATURES, N_FEATURES))
    moment = np.empty((n_bins, N_FEATURES, n_channels))
    for a in range(N_FEATURES):
        for b in range(a, N_FEATURES):
            gram[:, a, b] = gram[:, b, a] = total(position[:, a] * position[:, b])
        for c in range(n_channels):
            moment[:, a, c] = total(position[:, a] * residual[:, c])
    met = len(np.unique(pixels.press * n_bins + index))
    pixels_per_press = len(index) / max(met, 1)
    ridge = settings.held_presses * pixels_per_press * np.diag(position_costs())
    found = np.linalg.solve(gram + ridge, moment)
    shape = (settings.n_slope, settings.n_direction, N_FEATURES, n_channels)
    return Bins(found.reshape(shape), max_slope_rad)


@dataclass(frozen=True, slots=True)
class PressSums:
    """Normal equations of one press inside its circle, and weighted all over.

    Moments hold the three channels of one background after those of another.
    """

    gram_inside: FloatArray
    gram: FloatArray
    moment_inside: FloatArray
    moment: FloatArray
    square_inside: FloatArray
    count: int

    def of_terms(self, index: IntArray) -> PressSums:
        """The same for a model of fewer terms."""
        both = np.ix_(index, index)
        return replace(
            self,
            gram_inside=self.gram_inside[both],
            gram=self.gram[both],
            moment_inside=self.moment_inside[index],
            moment=self.moment[index],
        )


def fold_of(count: int, n_folds: int) -> IntArray:
    """Which fold each of ``count`` presses is in; neighbours in time go to different folds."""
    return np.arange(count) % min(n_folds, count)


def choose(prepared: PreparedPresses, fit: JointFit, settings: FitSettings) -> Choice:
    """The settings with the least error on held-out presses, for presses placed as in ``fit``.

    A background other than the reference image is chosen only where it is better by more than one
    standard error, over the presses, of the difference; bins likewise.
    """
    rules = prepared.rules
    folds = fold_of(len(prepared), rules.n_folds)
    nothing = np.zeros((*prepared.presses.shape_px, 3))
    samples = prepared.samples(nothing, rules.pixels_to_choose)
    highest = max(rules.degrees)
    designs = [
        sample_design(sample, place, fit.press_model, highest)
        for sample, place in zip(samples, fit.geometry, strict=True)
    ]
    backgrounds = [prepared.backgrounds[recipe] for recipe in rules.backgrounds]
    targets = [
        _targets(sample, backgrounds, offset)
        for sample, offset in zip(samples, fit.drift_share * prepared.drift, strict=True)
    ]
    sums = [press_sums(*each) for each in zip(samples, designs, targets, strict=True)]
    count = sum(entry.count for entry in sums)
    squares: dict[tuple[int, float], FloatArray] = {}
    for degree in rules.degrees:
        fewer = [entry.of_terms(_features_of(degree, highest)) for entry in sums]
        for ridge in rules.ridges:
            squares[degree, ridge] = held_out_squares(fewer, folds, ridge, degree)
    errors = {
        f"degree {degree}, ridge {ridge:g}, {recipe}": float(
            np.sqrt(square[:, k].sum() / count / 3)
        )
        for (degree, ridge), square in squares.items()
        for k, recipe in enumerate(rules.backgrounds)
    }
    (degree, ridge), chosen = _best(squares, len(backgrounds))
    index = _features_of(degree, highest)
    fewer = [entry.of_terms(index) for entry in sums]
    channels = slice(3 * chosen, 3 * chosen + 3)
    weights = [
        _weights(fewer, folds != fold, ridge, degree)[:, channels] for fold in np.unique(folds)
    ]
    bins, bin_errors = _choose_bins(
        InnerPixels.of(samples, fit),
        inside([target[:, channels] for target in targets], samples),
        inside([design[:, index] @ np.hstack(weights) for design in designs], samples),
        folds,
        rules,
    )
    best = replace(settings, degree=degree, ridge=ridge)
    return Choice(best, rules.backgrounds[chosen], errors, bins, bin_errors)


def _choose_bins(
    pixels: InnerPixels, target: FloatArray, smooth: FloatArray, folds: IntArray, rules: LookupRules
) -> tuple[BinSettings, dict[str, float]]:
    """The bins with the least error on held-out presses; none unless clearly better.

    Parameters
    ----------
    target : (n, 3) float
        Change of grey level.
    smooth : (n, 3 · n_folds) float
        What the smooth models without each fold predict.
    """
    fold = folds[pixels.press]
    steepest = float(pixels.polar[:, 0].max())
    squares = {candidate: np.zeros(len(folds)) for candidate in rules.bins}
    for number in np.unique(folds):
        out = fold == number
        held_out, train = pixels.select(out), pixels.select(~out)
        residual = target - smooth[:, 3 * number : 3 * number + 3]
        for candidate in squares:
            error = residual[out]
            if candidate.n_slope:
                fitted = fit_bins(train, residual[~out], candidate, steepest)
                error = error - fitted.change(held_out.polar, held_out.position)
            squares[candidate] += np.bincount(
                held_out.press, (error**2).sum(axis=1), minlength=len(folds)
            )
    errors = {
        str(candidate): float(np.sqrt(square.sum() / (3 * len(fold))))
        for candidate, square in squares.items()
    }
    none, best = rules.bins[0], min(squares, key=lambda candidate: squares[candidate].sum())
    return (best if _clearly_better(squares[best], squares[none]) else none), errors


def _clearly_better(squares: FloatArray, than: FloatArray) -> bool:
    """Whether squared errors (N,) of the presses are less by more than one standard error."""
    gain = than - squares
    return bool(gain.sum() > np.sqrt(len(gain)) * gain.std(ddof=1))


def _best(
    squares: dict[tuple[int, float], FloatArray], n_backgrounds: int
) -> tuple[tuple[int, float], int]:
    """Degree and ridge, and which background, from squared errors (N, n_backgrounds) of each."""
    best = [
        min(squares.items(), key=lambda item, k=k: item[1][:, k].sum())  # type: ignore[misc]
        for k in range(n_backgrounds)
    ]
    chosen = 0
    for k in range(1, n_backgrounds):
        if _clearly_better(best[k][1][:, k], best[chosen][1][:, chosen]):
            chosen = k
    return best[chosen][0], chosen


def _features_of(degree: int, highest: int) -> IntArray:
    """Which columns of the design of the highest degree a lower one has: all but high powers."""
    terms = np.append(np.arange(n_terms(degree) - 1), n_terms(highest) - 1)
    return np.asarray((terms[:, None] * N_FEATURES + np.arange(N_FEATURES)).ravel())


def _targets(sample: Sample, backgrounds: Sequence[FloatArray], offset: FloatArray) -> FloatArray:
    """Change (n, 3 · n_backgrounds) of a press against every background."""
    rows, columns = sample.pixels.rows, sample.pixels.columns
    return np.hstack([sample.change - under[rows, columns] - offset for under in backgrounds])


def press_sums(sample: Sample, features: FloatArray, target: FloatArray) -> PressSums:
    """Normal equations of one press: features (n, k) and targets (n, 3 · n_backgrounds)."""
    inside = sample.pixels.inside
    root = np.sqrt(sample.weight)[:, None]
    weighted, within = features * root, features[inside]
    return PressSums(
        gram_inside=within.T @ within,
        gram=weighted.T @ weighted,
        moment_inside=within.T @ target[inside],
        moment=weighted.T @ (target * root),
        square_inside=(target[inside] ** 2).sum(axis=0),
        count=int(inside.sum()),
    )


def _weights(sums: Sequence[PressSums], which: BoolArray, ridge: float, degree: int) -> FloatArray:
    """Weights (k, 3 · n_backgrounds) of the model of the chosen presses."""
    train = np.nonzero(which)[0].tolist()
    gram = np.sum([sums[i].gram for i in train], axis=0)
    moment = np.sum([sums[i].moment for i in train], axis=0)
    return solve_ridge(gram, moment, ridge, degree).weights.reshape(len(gram), -1)


def held_out_squares(
    sums: Sequence[PressSums], folds: IntArray, ridge: float, degree: int
) -> FloatArray:
    """Squared error of each press (N, n_backgrounds) by models that did not see its fold."""
    squares = np.zeros((len(sums), sums[0].moment.shape[1]))
    for fold in np.unique(folds):
        w = _weights(sums, folds != fold, ridge, degree)
        for i in np.nonzero(folds == fold)[0].tolist():
            squares[i] = (
                sums[i].square_inside
                - 2 * (w * sums[i].moment_inside).sum(axis=0)
                + (w * (sums[i].gram_inside @ w)).sum(axis=0)
            )
    return squares.reshape(len(sums), -1, 3).sum(axis=2)

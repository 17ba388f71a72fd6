"""Choosing a table's degree, ridge and background by cross-validation over whole presses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tacgen.calibrate.lookup.background import (
    BackgroundRecipe,
    bare_gel_change,
    make_background,
)
from tacgen.calibrate.lookup.bins import NO_BINS, BinSettings, choose_bins
from tacgen.calibrate.lookup.press_fit import (
    FitSettings,
    JointFit,
    Sample,
    gather,
    press_drift,
    sample_design,
)
from tacgen.calibrate.lookup.smooth_model import N_FEATURES, n_terms, solve_ridge
from tacgen.core.arrays import FloatArray
from tacgen.presses.press_images import PressImages

DEGREES = (3, 5, 7)
RIDGES = (1e-4, 1e-3, 1e-2, 1e-1)
BACKGROUNDS = (
    BackgroundRecipe(),
    BackgroundRecipe(drift=True),
    BackgroundRecipe(smooth=0.02),
    BackgroundRecipe(smooth=0.02, drift=True),
    BackgroundRecipe(smooth=0.05),
    BackgroundRecipe(smooth=0.05, drift=True),
)
"""From what needs no evidence to what needs most: the first is the reference image itself."""

N_FOLDS = 5
PIXELS_FOR_CHOICE = 700


@dataclass(frozen=True, slots=True)
class Choice:
    """The chosen settings and the cross-validated RMSE, grey levels, of every candidate.

    ``bin_errors`` compares the smooth model with tables that correct it bin by bin.
    """

    settings: FitSettings
    background: BackgroundRecipe
    errors: dict[str, float]
    bins: BinSettings = NO_BINS
    bin_errors: dict[str, float] | None = None


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

    def of_terms(self, index: NDArray[np.int64]) -> PressSums:
        """The same for a model of fewer terms."""
        both = np.ix_(index, index)
        return replace(
            self,
            gram_inside=self.gram_inside[both],
            gram=self.gram[both],
            moment_inside=self.moment_inside[index],
            moment=self.moment[index],
        )


def fold_of(count: int, n_folds: int = N_FOLDS) -> NDArray[np.int64]:
    """Which fold each of ``count`` presses is in; neighbours in time go to different folds."""
    return np.arange(count) % min(n_folds, count)


def choose(
    presses: PressImages, fit: JointFit, settings: FitSettings, changes: FloatArray | None = None
) -> Choice:
    """The settings with the least error on presses left out, for presses placed as in ``fit``.

    A background other than the reference image is taken only where it is better by more than one
    standard error, over the presses, of the difference; bins likewise. ``changes`` is what
    ``bare_changes`` gives, where it is already known.
    """
    change = bare_gel_change(presses, changes)
    backgrounds = [
        make_background(presses.background, change, recipe, presses.dots) for recipe in BACKGROUNDS
    ]
    folds = fold_of(len(presses))
    nothing = np.zeros((*presses.shape_px, 3))
    samples = gather(presses, nothing, settings, limit=PIXELS_FOR_CHOICE)
    designs = [
        sample_design(sample, place, fit.press_model, max(DEGREES))
        for sample, place in zip(samples, fit.geometry, strict=True)
    ]
    offsets = fit.drift_share * press_drift(presses, changes)
    targets = [
        _targets(sample, backgrounds, offset)
        for sample, offset in zip(samples, offsets, strict=True)
    ]
    sums = [press_sums(*each) for each in zip(samples, designs, targets, strict=True)]
    counts = np.array([entry.count for entry in sums], dtype=float)
    squares: dict[tuple[int, float], FloatArray] = {}
    for degree in DEGREES:
        fewer = [entry.of_terms(_features_of(degree)) for entry in sums]
        for ridge in RIDGES:
            squares[degree, ridge] = left_out_squares(fewer, folds, ridge, degree)
    errors = {
        f"degree {degree}, ridge {ridge:g}, {_words(recipe)}": float(
            np.sqrt(square[:, k].sum() / counts.sum() / 3)
        )
        for (degree, ridge), square in squares.items()
        for k, recipe in enumerate(BACKGROUNDS)
    }
    (degree, ridge), chosen = _best(squares)
    best = replace(settings, degree=degree, ridge=ridge)
    index = _features_of(degree)
    fewer = [entry.of_terms(index) for entry in sums]
    channels = slice(3 * chosen, 3 * chosen + 3)
    weights = [
        _weights(fewer, folds != fold, ridge, degree)[:, channels] for fold in np.unique(folds)
    ]
    bins, bin_errors = choose_bins(
        samples,
        fit,
        [target[:, channels] for target in targets],
        [design[:, index] @ np.hstack(weights) for design in designs],
        folds,
    )
    return Choice(best, BACKGROUNDS[chosen], errors, bins, bin_errors)


def _best(squares: dict[tuple[int, float], FloatArray]) -> tuple[tuple[int, float], int]:
    """Degree and ridge, and which background, from squared errors (N, n_backgrounds) of each."""
    best = [
        min(squares.items(), key=lambda item, k=k: item[1][:, k].sum())  # type: ignore[misc]
        for k in range(len(BACKGROUNDS))
    ]
    chosen = 0
    for k in range(1, len(BACKGROUNDS)):
        gain = best[chosen][1][:, chosen] - best[k][1][:, k]
        error = np.sqrt(len(gain)) * gain.std(ddof=1)
        if gain.sum() > error:
            chosen = k
    return best[chosen][0], chosen


def _words(recipe: BackgroundRecipe) -> str:
    smooth = f"smoothed {recipe.smooth:g}" if recipe.smooth else "as it is"
    return f"background {smooth}{' with drift' if recipe.drift else ''}"


def _features_of(degree: int) -> NDArray[np.int64]:
    """Which columns of the design of the highest degree a lower one has: all but high powers."""
    terms = np.append(np.arange(n_terms(degree) - 1), n_terms(max(DEGREES)) - 1)
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


def _weights(
    sums: Sequence[PressSums], which: NDArray[np.bool_], ridge: float, degree: int
) -> FloatArray:
    """Weights (k, 3 · n_backgrounds) of the model of the chosen presses."""
    train = np.nonzero(which)[0].tolist()
    gram = np.sum([sums[i].gram for i in train], axis=0)
    moment = np.sum([sums[i].moment for i in train], axis=0)
    return solve_ridge(gram, moment, ridge, degree).weights.reshape(len(gram), -1)


def left_out_squares(
    sums: Sequence[PressSums], folds: NDArray[np.int64], ridge: float, degree: int
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

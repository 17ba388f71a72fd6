"""Choosing a table's degree, ridge and background by cross-validation over whole presses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tacgen.calibration.press_fit import (
    FitSettings,
    JointFit,
    gather,
    press_drift,
    sample_design,
)
from tacgen.calibration.press_images import PressImages
from tacgen.calibration.smooth_model import solve_ridge
from tacgen.calibration.table_background import (
    BackgroundRecipe,
    bare_gel_change,
    make_background,
)

FloatArray = NDArray[np.floating]

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
    """The chosen settings and the cross-validated RMSE, grey levels, of every candidate."""

    settings: FitSettings
    background: BackgroundRecipe
    errors: dict[str, float]


@dataclass(frozen=True, slots=True)
class _Sums:
    """Normal equations of one press inside its circle, and weighted all over."""

    gram_inside: FloatArray
    gram: FloatArray
    moment_inside: list[FloatArray]
    moment: list[FloatArray]
    square_inside: list[FloatArray]
    count: int


def fold_of(count: int, n_folds: int = N_FOLDS) -> NDArray[np.int64]:
    """Which fold each of ``count`` presses is in; neighbours in time go to different folds."""
    return np.arange(count) % min(n_folds, count)


def choose(presses: PressImages, fit: JointFit, settings: FitSettings) -> Choice:
    """The settings with the least error on presses left out, for presses placed as in ``fit``.

    A background other than the reference image is taken only where it is better by more than one
    standard error, over the presses, of the difference.
    """
    change = bare_gel_change(presses)
    backgrounds = [make_background(presses.background, change, recipe) for recipe in BACKGROUNDS]
    folds = fold_of(len(presses))
    squares: dict[tuple[int, float], FloatArray] = {}
    counts = np.zeros(len(presses))
    for degree in DEGREES:
        candidate = replace(settings, degree=degree)
        sums = _sums(presses, fit, candidate, backgrounds)
        counts = np.array([entry.count for entry in sums], dtype=float)
        for ridge in RIDGES:
            squares[degree, ridge] = _left_out(sums, folds, ridge, degree)
    errors = {
        f"degree {degree}, ridge {ridge:g}, {_words(recipe)}": float(
            np.sqrt(square[:, k].sum() / counts.sum() / 3)
        )
        for (degree, ridge), square in squares.items()
        for k, recipe in enumerate(BACKGROUNDS)
    }
    best = [min(squares.items(), key=lambda item, k=k: item[1][:, k].sum()) for k in range(6)]  # type: ignore[misc]
    chosen = 0
    for k in range(1, len(BACKGROUNDS)):
        gain = best[chosen][1][:, chosen] - best[k][1][:, k]
        error = np.sqrt(len(gain)) * gain.std(ddof=1)
        if gain.sum() > error:
            chosen = k
    degree, ridge = best[chosen][0]
    return Choice(replace(settings, degree=degree, ridge=ridge), BACKGROUNDS[chosen], errors)


def _words(recipe: BackgroundRecipe) -> str:
    smooth = f"smoothed {recipe.smooth:g}" if recipe.smooth else "as it is"
    return f"background {smooth}{' with drift' if recipe.drift else ''}"


def _sums(
    presses: PressImages,
    fit: JointFit,
    settings: FitSettings,
    backgrounds: Sequence[FloatArray],
) -> list[_Sums]:
    nothing = np.zeros((*presses.shape_px, 3))
    offsets = fit.drift_share * press_drift(presses)
    entries = []
    samples = gather(presses, nothing, settings, limit=PIXELS_FOR_CHOICE)
    for sample, place, offset in zip(samples, fit.geometry, offsets, strict=True):
        features = sample_design(sample, place, fit.press_model, settings.degree)
        inside = sample.pixels.inside
        weighted = features * sample.weight[:, None]
        moments, moments_inside, squares = [], [], []
        for background in backgrounds:
            under = background[sample.pixels.rows, sample.pixels.columns]
            target = sample.change - under - offset
            moments.append(weighted.T @ target)
            moments_inside.append(features[inside].T @ target[inside])
            squares.append((target[inside] ** 2).sum(axis=0))
        entries.append(
            _Sums(
                gram_inside=features[inside].T @ features[inside],
                gram=weighted.T @ features,
                moment_inside=moments_inside,
                moment=moments,
                square_inside=squares,
                count=int(inside.sum()),
            )
        )
    return entries


def _left_out(
    sums: Sequence[_Sums], folds: NDArray[np.int64], ridge: float, degree: int
) -> FloatArray:
    """Squared error of each press (N, n_backgrounds) by models that did not see its fold."""
    n_backgrounds = len(sums[0].moment)
    squares = np.zeros((len(sums), n_backgrounds))
    for fold in np.unique(folds):
        train, test = np.nonzero(folds != fold)[0].tolist(), np.nonzero(folds == fold)[0].tolist()
        gram = np.sum([sums[i].gram for i in train], axis=0)
        moments = [np.sum([sums[i].moment[k] for i in train], axis=0) for k in range(n_backgrounds)]
        model = solve_ridge(gram, np.hstack(moments), ridge, degree)
        weights = model.weights.reshape(len(gram), n_backgrounds, 3)
        for i in test:
            for k in range(n_backgrounds):
                w = weights[:, k]
                squares[i, k] = (
                    sums[i].square_inside[k].sum()
                    - 2 * (w * sums[i].moment_inside[k]).sum()
                    + (w * (sums[i].gram_inside @ w)).sum()
                )
    return squares

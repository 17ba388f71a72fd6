"""Choosing a table's degrees, ridge and background by cross-validation over whole presses."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from tacgen.calibrate.lookup import press_fit
from tacgen.calibrate.lookup.prepared import PreparedPresses
from tacgen.calibrate.lookup.settings import RULES, BackgroundRecipe, FitSettings
from tacgen.calibrate.lookup.smooth_model import (
    N_CONTACT,
    feature_index,
    n_light_terms,
    n_position_features,
)
from tacgen.core.arrays import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Choice:
    """The chosen settings and the cross-validated RMSE, grey levels, of every candidate."""

    settings: FitSettings
    background: BackgroundRecipe
    errors: dict[str, float]


def fold_of(count: int, n_folds: int = RULES.n_folds) -> IntArray:
    """Which fold each of ``count`` presses is in; neighbours in time go to different folds."""
    return np.arange(count) % min(n_folds, count)


def choose(prepared: PreparedPresses, fit: press_fit.JointFit) -> Choice:
    """The settings with the least error on held-out presses, for presses placed as in ``fit``.

    The error is weighted as the fit is. A background other than the reference image is chosen only
    where it is better by more than one standard error, over the presses, of the difference.
    """
    folds = fold_of(len(prepared))
    nothing = np.zeros((*prepared.presses.shape_px, 3))
    samples = prepared.samples(nothing, RULES.pixels_to_choose)
    highest = FitSettings(max(RULES.degrees), max(RULES.position_degrees))
    backgrounds = [prepared.backgrounds[recipe] for recipe in RULES.backgrounds]
    offsets, sums = fit.drift_share * prepared.drift, []
    for sample, place, offset in zip(samples, fit.geometry, offsets, strict=True):
        at = sample.pixels.rows, sample.pixels.columns
        target = np.hstack([sample.change - under[at] - offset for under in backgrounds])
        design = press_fit.sample_design(sample, place, fit.press_model, highest)
        sums.append(press_fit.press_sums(sample, design, target))
    squares: dict[FitSettings, FloatArray] = {}
    for degree, position_degree in product(RULES.degrees, RULES.position_degrees):
        index = _columns_of(FitSettings(degree, position_degree), highest)
        fewer = [entry.of_columns(index) for entry in sums]
        for ridge in RULES.ridges:
            settings = FitSettings(degree, position_degree, ridge)
            squares[settings] = held_out_squares(fewer, folds, settings)
    weight = 3 * sum(entry.weight for entry in sums)
    errors = {
        f"{settings}, {recipe}": float(np.sqrt(square[:, k].sum() / weight))
        for settings, square in squares.items()
        for k, recipe in enumerate(RULES.backgrounds)
    }
    settings, chosen = _best(squares, len(backgrounds))
    return Choice(settings, RULES.backgrounds[chosen], errors)


def _best(squares: dict[FitSettings, FloatArray], n_backgrounds: int) -> tuple[FitSettings, int]:
    """Settings, and which background, from squared errors (N, n_backgrounds) of each."""
    best = [
        min(squares.items(), key=lambda item, k=k: item[1][:, k].sum())  # type: ignore[misc]
        for k in range(n_backgrounds)
    ]
    chosen = 0
    for k in range(1, n_backgrounds):
        gain = best[chosen][1][:, chosen] - best[k][1][:, k]
        if gain.sum() > np.sqrt(len(gain)) * gain.std(ddof=1):
            chosen = k
    return best[chosen][0], chosen


def _columns_of(settings: FitSettings, highest: FitSettings) -> IntArray:
    """Which columns of the design of the highest degrees lower ones have."""
    n_here, n_all = n_light_terms(settings.degree), n_light_terms(highest.degree)
    terms = np.append(np.arange(n_here - N_CONTACT), np.arange(n_all - N_CONTACT, n_all))
    n_features = n_position_features(highest.position_degree)
    features = feature_index(n_features, settings.position_degree)
    return np.asarray((terms[:, None] * n_features + features).ravel())


def held_out_squares(
    sums: Sequence[press_fit.PressSums], folds: IntArray, settings: FitSettings
) -> FloatArray:
    """Squared error of each press (N, n_backgrounds) by models that did not see its fold."""
    squares = np.zeros((len(sums), sums[0].moment.shape[1]))
    for fold in np.unique(folds):
        train = [sums[i] for i in np.nonzero(folds != fold)[0].tolist()]
        w = press_fit.model_of_sums(train, settings).weights.reshape(len(train[0].gram), -1)
        for i in np.nonzero(folds == fold)[0].tolist():
            squares[i] = (
                sums[i].square
                - 2 * (w * sums[i].moment).sum(axis=0)
                + (w * (sums[i].gram @ w)).sum(axis=0)
            )
    return np.asarray(squares.reshape(len(sums), -1, 3).sum(axis=2))

"""Choosing a table's degrees, ridge and background by cross-validation over whole presses.

The pictures of one press are in one fold and count as one.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import product
from operator import add

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
from tacgen.presses.experiments import per_experiment, ranked


@dataclass(frozen=True, slots=True)
class Choice:
    """The chosen settings and the cross-validated RMSE, grey levels, of every candidate."""

    settings: FitSettings
    background: BackgroundRecipe
    errors: dict[str, float]


def fold_of(experiment: IntArray, n_folds: int = RULES.n_folds) -> IntArray:
    """Which fold each picture (N,) is in, by the press it is of; neighbours in time go apart."""
    number = ranked(experiment)
    return np.asarray(number % min(n_folds, int(number.max()) + 1))


def choose(prepared: PreparedPresses, fit: press_fit.JointFit) -> Choice:
    """The settings with the least error on held-out presses, for presses placed as in ``fit``.

    The error is weighted as the fit is. A background other than the reference image is chosen only
    where it is better by more than one standard error, over the presses, of the difference.
    """
    experiment = prepared.presses.experiment
    folds = fold_of(experiment)
    nothing = np.zeros((*prepared.presses.shape_px, 3))
    samples = prepared.samples(nothing, RULES.pixels_to_choose)
    highest = FitSettings(max(RULES.degrees), max(RULES.position_degrees))
    backgrounds = [prepared.backgrounds[recipe] for recipe in RULES.backgrounds]
    offsets, sums = fit.drift_share * prepared.drift, []
    for sample, place, offset in zip(samples, fit.geometry, offsets, strict=True):
        at = sample.pixels.rows, sample.pixels.columns
        target = np.hstack([sample.change - under[at] - offset for under in backgrounds])
        sums.append(press_fit.press_sums(sample, place, fit.press_model, highest, target))
    in_folds = [reduce(add, (sums[k] for k in np.nonzero(folds == f)[0])) for f in set(folds)]
    squares: dict[FitSettings, FloatArray] = {}
    for degree, position_degree in product(RULES.degrees, RULES.position_degrees):
        index = _columns_of(FitSettings(degree, position_degree), highest)
        fewer = [entry.of_columns(index) for entry in in_folds]
        for ridge in RULES.ridges:
            settings = FitSettings(degree, position_degree, ridge)
            by_fold = held_out_squares(fewer, np.arange(len(fewer)), settings)
            squares[settings] = by_fold.sum(axis=0)
    best = [list(squares)[k] for k in np.argmin(list(squares.values()), axis=0)]
    of_presses = {
        settings: held_out_squares(
            [entry.of_columns(_columns_of(settings, highest)) for entry in sums], folds, settings
        )
        for settings in set(best)
    }
    chosen = 0
    for k in range(1, len(backgrounds)):
        by_picture = of_presses[best[chosen]][:, chosen] - of_presses[best[k]][:, k]
        gain = per_experiment(by_picture, experiment)
        if gain.sum() > np.sqrt(len(gain)) * gain.std(ddof=1):
            chosen = k
    weight = 3 * sum(entry.weight for entry in sums)
    errors = {
        f"{settings}, {recipe}": float(np.sqrt(square / weight))
        for settings, by_background in squares.items()
        for recipe, square in zip(RULES.backgrounds, by_background, strict=True)
    }
    return Choice(best[chosen], RULES.backgrounds[chosen], errors)


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
    squares, total = np.zeros((len(sums), sums[0].moment.shape[1])), reduce(add, sums)
    for fold in np.unique(folds):
        held_out = np.nonzero(folds == fold)[0].tolist()
        seen = total - reduce(add, (sums[i] for i in held_out))
        w = press_fit.model_of_sums(seen, settings).weights.reshape(len(total.gram), -1)
        for i in held_out:
            squares[i] = (
                sums[i].square
                - 2 * (w * sums[i].moment).sum(axis=0)
                + (w * (sums[i].gram @ w)).sum(axis=0)
            )
    return np.asarray(squares.reshape(len(sums), -1, 3).sum(axis=2))

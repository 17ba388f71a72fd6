"""Choosing a table's degrees, ridge and background by cross-validation over whole presses.

The pictures of one press are in one fold and count as one.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, reduce
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
from tacgen.core.types import FloatArray, IntArray
from tacgen.presses.experiments import is_clear, per_experiment, ranked

_HIGHEST = FitSettings(max(RULES.degrees), max(RULES.position_degrees))


@dataclass(frozen=True, slots=True)
class Choice:
    """The chosen settings and the cross-validated RMSE, grey levels, of every candidate."""

    settings: FitSettings
    background: BackgroundRecipe
    drift_share: float  # of each picture's drift, left out of what the table is fitted to
    errors: dict[str, float]


def fold_of(experiment: IntArray, n_folds: int = RULES.n_folds) -> IntArray:
    """Which fold each picture (N,) is in, by the press it is of; neighbours in time go apart."""
    number = ranked(experiment)
    return np.asarray(number % min(n_folds, int(number.max()) + 1))


def choose(prepared: PreparedPresses, fit: press_fit.JointFit) -> Choice:
    """The settings with the least error on held-out presses, for presses placed as in ``fit``.

    The error is weighted as the fit is. A background other than the reference image, or a bent
    normal, is chosen only where it is better by more than one standard error, over the presses, of
    the difference.
    """
    experiment = prepared.presses.experiment
    folds = fold_of(experiment)
    squares: dict[FitSettings, FloatArray] = {}
    sums: dict[float, list[press_fit.PressSums]] = {}
    for bend in RULES.bends:
        sums[bend] = list(_sums(prepared, fit, replace(_HIGHEST, bend=bend)))
        in_folds = _of_folds(sums[bend], folds)
        for degree, position_degree in product(RULES.degrees, RULES.position_degrees):
            index = _columns_of(FitSettings(degree, position_degree))
            fewer = [entry.of_columns(index) for entry in in_folds]
            for ridge in RULES.ridges:
                settings = FitSettings(degree, position_degree, ridge, bend)
                by_fold = held_out_squares(fewer, np.arange(len(fewer)), settings)
                squares[settings] = by_fold[:, :-1].sum(axis=0)

    def best(bend: float, background: int) -> FitSettings:
        of_bend = [settings for settings in squares if settings.bend == bend]
        return min(of_bend, key=lambda settings: squares[settings][background])

    def columns_for(settings: FitSettings) -> list[press_fit.PressSums]:
        index = _columns_of(settings)
        return [entry.of_columns(index) for entry in sums[settings.bend]]

    @cache
    def by_picture(settings: FitSettings) -> FloatArray:
        return held_out_squares(columns_for(settings), folds, settings)

    def clearly_better(candidate: FitSettings, background: int) -> bool:
        less = by_picture(settings)[:, chosen] - by_picture(candidate)[:, background]
        return is_clear(per_experiment(less, experiment))

    plain, *bends = RULES.bends
    settings, chosen = best(plain, 0), 0
    for background in range(1, len(RULES.backgrounds)):
        if clearly_better(candidate := best(plain, background), background):
            settings, chosen = candidate, background
    for bend in bends:
        if clearly_better(candidate := best(bend, chosen), chosen):
            settings = candidate
    weight = 3 * sum(entry.weight for entry in sums[plain])
    errors = {
        f"{settings}, {recipe}": float(np.sqrt(square / weight))
        for settings, by_background in squares.items()
        for recipe, square in zip(RULES.backgrounds, by_background, strict=True)
    }
    share = _drift_share(_of_folds(columns_for(settings), folds), settings, chosen, fit.drift_share)
    return Choice(settings, RULES.backgrounds[chosen], share, errors)


def _sums(
    prepared: PreparedPresses, fit: press_fit.JointFit, settings: FitSettings
) -> Iterator[press_fit.PressSums]:
    """Normal equations of each press for its change against each background, and for its drift."""
    nothing = np.zeros((*prepared.presses.shape_px, 3))
    samples = prepared.samples(nothing, RULES.pixels_to_choose)
    backgrounds = [prepared.backgrounds[recipe] for recipe in RULES.backgrounds]
    for sample, place, drift in zip(samples, fit.geometry, prepared.drift, strict=True):
        at = sample.pixels.rows, sample.pixels.columns
        change = [sample.change - under[at] for under in backgrounds]
        target = np.hstack([*change, np.tile(drift, (len(sample.change), 1))])
        yield press_fit.press_sums(sample, place, fit.press_model, settings, target)


def _of_folds(sums: list[press_fit.PressSums], folds: IntArray) -> list[press_fit.PressSums]:
    return [
        reduce(add, (sums[k] for k in np.nonzero(folds == fold)[0])) for fold in np.unique(folds)
    ]


def _drift_share(
    in_folds: list[press_fit.PressSums], settings: FitSettings, background: int, shown: float
) -> float:
    """The share of the presses' drift that a fit had better leave out, 0 to 1.

    Drift that comes and goes as it likes makes a table worse. What a camera's white balance does
    where a contact is comes again with the next contact there, in presses left out too. The weights
    are linear in the share, so that the least error is known. Unless it is clearly less, the share
    is the one that is ``shown`` in the contacts.
    """
    lines, curves = np.zeros(len(in_folds)), np.zeros(len(in_folds))
    total = reduce(add, in_folds)
    own, drift = slice(3 * background, 3 * background + 3), slice(-3, None)
    for k, held_out in enumerate(in_folds):
        weights = press_fit.model_of_sums(total - held_out, settings).weights
        weights = weights.reshape(len(total.gram), -1)
        of_drift = weights[:, drift]
        left = held_out.moment[:, own] - held_out.gram @ weights[:, own]
        lines[k] = (of_drift * left).sum()
        curves[k] = (of_drift * (held_out.gram @ of_drift)).sum()
    share = float(np.clip(-lines.sum() / max(curves.sum(), 1e-12), 0.0, 1.0))
    gain = 2 * (shown - share) * lines + (shown**2 - share**2) * curves
    return share if is_clear(gain) else shown


def _columns_of(settings: FitSettings, highest: FitSettings = _HIGHEST) -> IntArray:
    """Which columns of the design of the highest degrees lower ones have."""
    n_here, n_all = n_light_terms(settings.degree), n_light_terms(highest.degree)
    terms = np.append(np.arange(n_here - N_CONTACT), np.arange(n_all - N_CONTACT, n_all))
    n_features = n_position_features(highest.position_degree)
    features = feature_index(n_features, settings.position_degree)
    return np.asarray((terms[:, None] * n_features + features).ravel())


def held_out_squares(
    sums: Sequence[press_fit.PressSums], folds: IntArray, settings: FitSettings
) -> FloatArray:
    """Squared error of each press (N, n_targets) by models that did not see its fold."""
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

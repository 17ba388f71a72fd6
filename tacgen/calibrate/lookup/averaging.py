"""Averaging the smooth model with a network of the light, as far as presses left out are for it."""

from dataclasses import dataclass, replace
from functools import reduce
from operator import add

import numpy as np
from scipy import linalg

from tacgen.calibrate.lookup import press_fit
from tacgen.calibrate.lookup.model_choice import fold_of
from tacgen.calibrate.lookup.prepared import PreparedPresses
from tacgen.calibrate.lookup.random_light import N_UNITS, RandomLight
from tacgen.calibrate.lookup.settings import RULES, FitSettings
from tacgen.calibrate.lookup.smooth_model import N_CONTACT, n_position_features
from tacgen.core.arrays import FloatArray, IntArray
from tacgen.presses.experiments import is_clear

NETWORK_RIDGES = (1e-5, 1e-4, 1e-3)
"""Penalty on what a unit adds, relative to the mean square of what it says."""


@dataclass(frozen=True, slots=True)
class Average:
    """The averaged fit, the network's share in it and its cross-validated RMSE, grey levels."""

    fit: press_fit.JointFit
    share: float
    error: float


def averaged(
    prepared: PreparedPresses,
    fit: press_fit.JointFit,
    background: FloatArray,
    settings: FitSettings,
) -> Average:
    """``fit`` with a network averaged into the light of its smooth model.

    The network's ridge and share are those with the least error on whole presses that neither it
    nor the smooth model was fitted to, weighted as the fit is. Unless it is clearly less than the
    smooth model's, the fit stays as it is.
    """
    folds = fold_of(prepared.presses.experiment)
    sums = _sums_of_folds(prepared, fit, background, settings, folds)
    total = reduce(add, sums)
    n_smooth = len(total.gram) - N_UNITS
    square, lines, curves = 0.0, *np.zeros((2, len(sums), len(NETWORK_RIDGES)))
    for fold, held_out in enumerate(sums):
        seen = total - held_out
        smooth = np.zeros((len(total.gram), 3))
        smooth[:n_smooth] = _smooth_weights(seen, n_smooth, settings)
        moment = held_out.moment[:, 3:]
        left = moment - held_out.gram @ smooth
        square += float(held_out.square[3:].sum() - (smooth * (moment + left)).sum())
        for k, ridge in enumerate(NETWORK_RIDGES):
            change = _network(seen, smooth[:n_smooth], settings, ridge) - smooth
            lines[fold, k] = (change * left).sum()
            curves[fold, k] = (change * (held_out.gram @ change)).sum()
    shares = np.clip(lines.sum(axis=0) / np.maximum(curves.sum(axis=0), 1e-12), 0.0, 1.0)
    gains = 2 * shares * lines - shares**2 * curves
    best = int(np.argmax(gains.sum(axis=0)))
    share, gain = float(shares[best]), gains[:, best]
    error = float(np.sqrt((square - gain.sum()) / (3 * total.weight)))
    if not is_clear(gain):
        return Average(fit, 0.0, error)
    network = _network(
        total, fit.model.weights.reshape(n_smooth, 3), settings, NETWORK_RIDGES[best]
    )
    weights = fit.model.weights.copy()
    weights[:-N_CONTACT] *= 1.0 - share
    light = RandomLight(share * network[n_smooth:], settings.bend)
    return Average(
        replace(fit, model=replace(fit.model, weights=weights), network=light), share, error
    )


def _sums_of_folds(
    prepared: PreparedPresses,
    fit: press_fit.JointFit,
    background: FloatArray,
    settings: FitSettings,
    folds: IntArray,
) -> list[press_fit.PressSums]:
    """Normal equations of each fold, of the smooth model's columns and the units together.

    Targets are the changes less the presses' drift, and as they are.
    """
    sums: dict[int, press_fit.PressSums] = {}
    samples = prepared.samples(background, RULES.pixels_to_choose)
    for k, sample in enumerate(samples):
        offset = fit.drift_share * prepared.drift[k]
        target = np.hstack([sample.change - offset, sample.change])
        place = fit.geometry[k]
        of_press = press_fit.press_sums(
            sample, place, fit.press_model, settings, target, with_units=True
        )
        fold = int(folds[k])
        sums[fold] = sums[fold] + of_press if fold in sums else of_press
    return list(sums.values())


def _smooth_weights(sums: press_fit.PressSums, n_smooth: int, settings: FitSettings) -> FloatArray:
    """Weights (n_smooth, 3) of the smooth model alone."""
    own = sums.of_columns(np.arange(n_smooth))
    return press_fit.model_of_sums(own, settings).weights.reshape(n_smooth, -1)[:, :3]


def _network(
    sums: press_fit.PressSums, smooth: FloatArray, settings: FitSettings, ridge: float
) -> FloatArray:
    """Weights (n_smooth + N_UNITS, 3) of the network, with what a contact adds by ``smooth``."""
    n_smooth = len(smooth)
    contact = slice(n_smooth - N_CONTACT * n_position_features(settings.position_degree), n_smooth)
    weights = np.zeros((len(sums.gram), 3))
    weights[contact] = smooth[contact]
    moment = sums.moment[n_smooth:, :3] - sums.gram[n_smooth:, contact] @ smooth[contact]
    gram = sums.gram[n_smooth:, n_smooth:] + ridge * sums.weight * np.eye(N_UNITS)
    weights[n_smooth:] = linalg.solve(gram, moment, assume_a="pos", check_finite=False)
    return weights

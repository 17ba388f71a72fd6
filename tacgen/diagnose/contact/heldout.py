"""Trials that neither fit nor choice sees, errors on them, and a Gaussian process beside the law.

The process is smooth in all covariates: it says how far any smooth model could have come. It has no
physics and is never the answer; its error is only reported.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.distance import cdist

from tacgen.core.types import BoolArray, FloatArray
from tacgen.diagnose.contact.channel import ChannelData
from tacgen.diagnose.contact.residuals import covariates_of
from tacgen.diagnose.evidence import interval_95, resampled_squares
from tacgen.diagnose.rules import ContactRules
from tacgen.presses.press_log import Columns

TRIALS_PER_TEST_TRIAL = 4  # one in so many is held out
_MAX_ROWS = 700  # of the training set: its kernel matrix is factored nine times
_LENGTHS, _NOISES = (1.0, 2.0, 4.0), (0.03, 0.2, 0.8)
"""Tried by marginal likelihood, in standard deviations of the covariates and of the residual."""


@dataclass(frozen=True)
class Errors:
    """Root-mean-square error on held-out trials, and each trial's sum of squares."""

    rmse: float
    squares: FloatArray


def test_trials(columns: Columns, rng: np.random.Generator) -> NDArray[Any]:
    """Trials to hold out: one of every four in the order of the session.

    Neighbours in time are on both sides, and so is every part of the session; the first trial
    stays in the fit, since nothing else tells how the first presses differ.
    """
    trial = np.asarray(columns["trial"])
    numbers, first = np.unique(trial, return_index=True)
    start = np.asarray(columns["time_s"])[first]
    ordered = numbers[np.lexsort((numbers, start))]
    chosen = []
    count = TRIALS_PER_TEST_TRIAL
    for begin in range(0, ordered.size, count):
        group = ordered[begin : begin + count]
        low = 1 if begin == 0 else 0
        if group.size > 1:
            chosen.append(group[int(rng.integers(low, group.size))])
    return np.asarray(chosen)


def select(columns: Columns, mask: BoolArray) -> dict[str, NDArray[Any]]:
    """The rows of ``columns`` where ``mask`` holds."""
    return {name: np.asarray(values)[mask] for name, values in columns.items()}


def errors(residual: FloatArray, trial: FloatArray) -> Errors:
    """Errors of a residual (N, C): RMS over samples and outputs."""
    _, inverse = np.unique(trial, return_inverse=True)
    squares = np.bincount(inverse, (residual**2).mean(axis=1)).astype(np.float64)
    return Errors(float(np.sqrt(squares.sum() / inverse.size)), squares)


def gain_interval(
    before: Errors, after: Errors, rng: np.random.Generator, rules: ContactRules
) -> tuple[float, float]:
    """95 % interval of 1 − error_after/error_before, by resampling the held-out trials."""
    drawn = resampled_squares(before.squares, after.squares, rules.n_shuffles, rng)
    return interval_95(1.0 - np.sqrt(drawn[1] / np.maximum(drawn[0], 1e-300)))


def features(fit_data: ChannelData, test_data: ChannelData) -> tuple[FloatArray, FloatArray]:
    """Covariates (N, D) and (M, D) of both: numbers, NaN if unknown, and the fit's levels."""
    both = covariates_of(fit_data), covariates_of(test_data)
    columns: list[list[FloatArray]] = [[], []]
    for name in (name for name in both[0] if name in both[1]):
        fitted = both[0][name]
        if np.issubdtype(fitted.dtype, np.number):
            for part, covariates in zip(columns, both, strict=True):
                part.append(covariates[name].astype(np.float64))
        else:
            levels = np.unique(fitted)[1:6]
            for part, covariates in zip(columns, both, strict=True):
                part += [(covariates[name] == level).astype(np.float64) for level in levels]
    return np.stack(columns[0], axis=1), np.stack(columns[1], axis=1)


def gp_rmse(
    fit_data: ChannelData,
    fit_residual: FloatArray,
    test_data: ChannelData,
    test_residual: FloatArray,
    rng: np.random.Generator,
) -> float:
    """RMS that is left of the test residual after a GP learned the fit residual.

    The residuals (N, C) are those of the linear law; the kernel is a squared exponential of the
    standardised covariates, its length and noise by marginal likelihood on a subsample. An
    unknown number is put at the fit's mean; a column that the fit has none of is left out.
    """
    x, test = features(fit_data, test_data)
    measured = np.isfinite(x).any(axis=0)
    x, test = x[:, measured], test[:, measured]
    center, scale = np.nanmean(x, axis=0), np.nanstd(x, axis=0) + 1e-12
    rows = rng.permutation(x.shape[0])[:_MAX_ROWS]
    x, test = (np.nan_to_num((part - center) / scale) for part in (x[rows], test))
    y = fit_residual[rows]
    left = test_residual - _predict(x, y - y.mean(axis=0), test) - y.mean(axis=0)
    return float(np.sqrt((left**2).mean()))


def _predict(x: FloatArray, y: FloatArray, test: FloatArray) -> FloatArray:
    """Prediction (M, C) from ``x`` (N, D) and ``y`` (N, C) by the likeliest length and noise."""
    squared, settings = cdist(x, x, "sqeuclidean"), []
    for width in (length**2 * x.shape[1] for length in _LENGTHS):
        correlation = np.exp(-0.5 * squared / width)
        for noise in _NOISES:
            factor = cho_factor(correlation + noise * np.eye(y.shape[0]), lower=True)
            weights = cho_solve(factor, y)
            fitted = max(float((y * weights).sum()) / y.size, 1e-300)
            log_roots = np.log(np.diag(factor[0])).sum() * y.shape[1]
            evidence = -np.log(fitted) * y.size / 2 - log_roots
            settings.append((evidence, width, weights))
    _, width, weights = max(settings, key=lambda setting: setting[0])
    exponent = cdist(test, x, "sqeuclidean")
    exponent *= -0.5 / width
    return np.asarray(np.exp(exponent, out=exponent) @ weights)

"""A Gaussian process on the covariates: how far any smooth model could have come.

It is a baseline and never the answer: it has no physics, and its error is only reported.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.distance import cdist

from tacgen.core.arrays import FloatArray
from tacgen.diagnose.contact.channel import ChannelData
from tacgen.diagnose.contact.residuals import covariates_of

_MAX_ROWS = 700
"""Of the training set: its kernel matrix is factored nine times."""
_LENGTHS, _NOISES = (1.0, 2.0, 4.0), (0.03, 0.2, 0.8)
"""Tried by marginal likelihood, in standard deviations of the covariates and of the residual."""


def features(data: ChannelData) -> FloatArray:
    """Numeric covariates (N, D) and text ones as levels; NaN as the mean."""
    columns = []
    for values in covariates_of(data).values():
        if np.issubdtype(values.dtype, np.number):
            columns.append(np.nan_to_num(values, nan=float(np.nanmean(values))))
        else:
            levels = np.unique(values)
            columns += [(values == level).astype(float) for level in levels[1:6]]
    return np.stack(columns, axis=1)


def gp_rmse(
    fit_data: ChannelData,
    fit_residual: FloatArray,
    test_data: ChannelData,
    test_residual: FloatArray,
    rng: np.random.Generator,
) -> float:
    """RMS that is left of the test residual after a GP learned the fit residual.

    The residuals (N, C) are those of the linear law; the kernel is a squared exponential of the
    standardised covariates, its length and noise by marginal likelihood on a subsample.
    """
    x = features(fit_data)
    test = features(test_data)
    if x.shape[1] != test.shape[1]:
        return float("nan")
    center, scale = x.mean(axis=0), x.std(axis=0) + 1e-12
    rows = rng.permutation(x.shape[0])[:_MAX_ROWS]
    x, test = (x[rows] - center) / scale, (test - center) / scale
    left = np.empty_like(test_residual)
    for axis in range(fit_residual.shape[1]):
        y = fit_residual[rows, axis]
        left[:, axis] = test_residual[:, axis] - _predict(x, y - y.mean(), test) - y.mean()
    return float(np.sqrt((left**2).mean()))


def _predict(x: FloatArray, y: FloatArray, test: FloatArray) -> FloatArray:
    """Prediction (M, D) from ``x`` (N, D) and ``y`` (N,) by the likeliest length and noise."""
    squared, settings = cdist(x, x, "sqeuclidean"), []
    for width in (length**2 * x.shape[1] for length in _LENGTHS):
        correlation = np.exp(-0.5 * squared / width)
        for noise in _NOISES:
            factor = cho_factor(correlation + noise * np.eye(y.size), lower=True)
            weights = cho_solve(factor, y)
            fitted = max(float(y @ weights) / y.size, 1e-300)
            evidence = -np.log(fitted) * y.size / 2 - np.log(np.diag(factor[0])).sum()
            settings.append((evidence, width, weights))
    _, width, weights = max(settings, key=lambda setting: setting[0])
    return np.asarray(np.exp(-0.5 * cdist(test, x, "sqeuclidean") / width) @ weights)

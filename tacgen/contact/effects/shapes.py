"""Shapes that several effects share."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

MIN_GAIN = 0.02
"""Least factor on the compliance: beyond the fitted range a gel stays a gel."""
_MIN_RATIO = 1e-3


def power_shape(ratio: NDArray[np.float64], exponent: float) -> NDArray[np.float64]:
    """(ratio^exponent − 1)/exponent, and log(ratio) at exponent 0: 0 and of slope 1 at ratio 1.

    Source
    ------
    Box & Cox 1964.
    """
    log_ratio = np.log(np.maximum(ratio, _MIN_RATIO))
    if abs(exponent) < 1e-6:
        return log_ratio
    return np.expm1(exponent * log_ratio) / exponent


def with_gain(load: NDArray[np.float64], relative: NDArray[np.float64]) -> NDArray[np.float64]:
    """``load`` (N, C) times 1 + ``relative`` (N,), never turned round; NaN counts as 0."""
    gain = np.maximum(1.0 + np.nan_to_num(relative, nan=0.0), MIN_GAIN)
    return load * gain[:, None]


def finite_mean(values: NDArray[np.float64]) -> float:
    """Mean of the finite values; 0 where there are none."""
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if finite.size else 0.0


def finite_extent(values: NDArray[np.float64]) -> float:
    """Largest finite |value|; 1 where there is none above 0."""
    finite = np.abs(values[np.isfinite(values)])
    return float(finite.max()) if finite.size and finite.max() > 0 else 1.0

"""The noise of single samples along presses: what second differences leave, which no course has."""

from itertools import pairwise

import numpy as np

from tacgen.core.types import BoolArray, FloatArray, IntArray

OUTLIER_SIGMAS = 4.0
"""Second differences beyond so many standard deviations are steps and spikes, not noise: of white
noise one in 16 000. With 2 % of spikes of 20 σ the noise is then found to 1 %, with 7 σ 28 % too
large, by the median of their sizes 8 % (``tests/contact/test_noise.py``)."""
_MEDIAN_OF_CHI2 = 0.455  # of one degree of freedom
_OF_SECOND_DIFFERENCES = 6.0  # 1² + 2² + 1²: their variance in that of a sample


def second_differences(
    values: FloatArray, starts: IntArray, lag: int = 1
) -> tuple[IntArray, FloatArray]:
    """Rows (M,) with neighbours ``lag`` rows away in their press, and squared differences (M,).

    ``values`` (N, C) hold press after press, which ``starts`` (P + 1,) part. The squares are means
    over C, on the scale of one sample's variance.
    """
    inner = [np.arange(i + lag, j - lag, dtype=int) for i, j in pairwise(starts)]
    rows = np.concatenate([np.zeros(0, dtype=int), *inner])
    second = values[rows - lag] - 2.0 * values[rows] + values[rows + lag]
    return rows, (second**2).mean(axis=1) / _OF_SECOND_DIFFERENCES


def is_clean(square: FloatArray, sigmas: float = OUTLIER_SIGMAS) -> BoolArray:
    """Which of the squares (M,) of noise are no outliers."""
    typical = float(np.median(square)) / _MEDIAN_OF_CHI2 or 1e-24
    return square < sigmas**2 * typical


def noise_of(square: FloatArray) -> float:
    """Standard deviation of a sample's noise by the squares (M,); NaN where there are none."""
    square = square[np.isfinite(square)]
    return float(np.sqrt(square[is_clean(square)].mean())) if square.size else float("nan")


def sample_noise(values: FloatArray, starts: IntArray) -> float:
    """Standard deviation of the noise of one of the C values (N, C) of a sample, on average.

    ``starts`` as in ``second_differences``; NaN where no press has three samples.
    """
    return noise_of(second_differences(values, starts)[1])

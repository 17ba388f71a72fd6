"""Oscillations of a residual in the session's clock."""

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len, rfft

from tacgen.core.arrays import FloatArray
from tacgen.diagnose.contact.channel import ChannelData
from tacgen.diagnose.contact.covariates import HOWS, Covariate, How
from tacgen.diagnose.contact.model import Fit

_MAX_POINTS = 1 << 17
"""Of the search's clock; a session that needs more is searched for slower oscillations only."""
_POINTS_PER_PERIOD = 8  # four times what sampling needs: the peak is not missed
_REFINED = 41  # frequencies between the neighbours of the best one that are tried afterwards


def find_oscillations(data: ChannelData, fit: Fit, signs: FloatArray) -> list[Covariate]:
    """The best frequency for an oscillation of the compliance, and for an added one.

    Times are put on a regular clock, so that all frequencies are one Fourier transform: from
    ``min_cycles`` a session up to periods of a few rows, half a cycle apart. ``signs`` (F, U) flip
    the residual of whole trials; how high the highest of all peaks then is says by how much the
    best one must stand out. None where the clock is too coarse.
    """
    history, rules = data.history, data.rules
    start = float(history.time_s.min())
    time = history.time_s - start
    session = max(float(time.max()), history.sample_period_s)
    shortest_s = rules.rows_per_period * history.sample_period_s
    tick_s = max(shortest_s / _POINTS_PER_PERIOD, 2.0 * session / _MAX_POINTS)
    ticks = np.rint(time / tick_s).astype(np.int64)
    n_points = next_fast_len(2 * int(ticks.max() + 1), real=True)
    first = int(np.ceil(rules.min_cycles * n_points * tick_s / session))
    stop = n_points // _POINTS_PER_PERIOD
    if first >= stop:
        return []

    def spectrum(values: FloatArray) -> NDArray[np.complex128]:
        on_clock = np.bincount(ticks, values, minlength=n_points)
        return np.asarray(rfft(on_clock))

    flips = np.vstack([np.ones(signs.shape[1]), signs])[:, data.row_unit]
    total = float(fit.residual @ fit.residual) + 1e-300
    found = []
    for how in HOWS:
        parts = _products(data, fit, how)
        power = np.zeros((stop - first, flips.shape[0]))
        for product, square in parts:
            crossed = np.stack([spectrum(product * flip)[first:stop] for flip in flips], axis=1)
            double = spectrum(square)[2 * first : 2 * stop : 2]
            power += _explained(crossed, double[:, None], float(square.sum()))
        # Of n numbers, a frequency explains a share above x in (1 - x)^((n - 3) / 2) of cases.
        peaks = -np.log1p(-np.minimum(power.max(axis=0) / total, 1.0 - 1e-12))
        best = first + int(np.argmax(power[:, 0]))
        near = (best + np.linspace(-1, 1, _REFINED)) / (n_points * tick_s)
        phase: NDArray[np.complex128] = np.exp(-2j * np.pi * np.outer(near, time))
        exact = np.sum(
            [_explained(phase @ p, phase**2 @ q, float(q.sum())) for p, q in parts], axis=0
        )
        found.append(
            Covariate(
                "time_s",
                "oscillation",
                how,
                center=start,
                frequency_hz=float(near[np.argmax(exact)]),
                p_search=_gumbel_p(peaks[0], peaks[1:]),
            )
        )
    return found


def _products(data: ChannelData, fit: Fit, how: How) -> list[tuple[FloatArray, FloatArray]]:
    """Amplitude times residual, and its square, of each row (N,): added ones for each output."""
    response = fit.model.law_response(data)
    size = response if how == "gain" else np.full_like(response, 0.1 * data.span)
    amplitude = data.reduce(size).reshape(-1, data.n_outputs)
    product, square = fit.residual.reshape(-1, data.n_outputs) * amplitude, amplitude**2
    if how == "gain":
        return [(product.sum(axis=1), square.sum(axis=1))]
    return [(product[:, k], square[:, k]) for k in range(data.n_outputs)]


def _explained(
    spectrum: NDArray[np.complex128], double: NDArray[np.complex128], total: float
) -> FloatArray:
    """Sum of squares that a cosine and a sine explain together, from sums of products with both."""
    cos_cos, sin_sin = (total + double.real) / 2, (total - double.real) / 2
    cos_sin = -double.imag / 2
    a, b = spectrum.real, -spectrum.imag
    determinant = np.maximum(cos_cos * sin_sin - cos_sin**2, 1e-3 * total**2)
    return np.asarray((sin_sin * a**2 - 2 * cos_sin * a * b + cos_cos * b**2) / determinant)


def _gumbel_p(observed: float, null: FloatArray) -> float:
    """Return the p of a largest value by the Gumbel law that has the null's moments."""
    if null.size < 2:
        return 1.0
    scale = max(float(null.std()) * np.sqrt(6.0) / np.pi, 1e-300)
    location = float(null.mean()) - np.euler_gamma * scale
    return float(-np.expm1(-np.exp(min((location - observed) / scale, 700.0))))

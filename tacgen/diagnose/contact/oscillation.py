"""Oscillations of a residual in the session's clock."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len, rfft

from tacgen.core.arrays import FloatArray
from tacgen.diagnose.contact.channel import ChannelData
from tacgen.diagnose.contact.covariates import HOWS, Covariate, How
from tacgen.diagnose.contact.model import Fit

_MAX_POINTS = 1 << 17
"""Of the search's clock; a session that needs more is searched for slower oscillations only."""
_POINTS_PER_PERIOD = 8
_REFINED = 41
"""Frequencies between the neighbours of the best one that are tried afterwards."""


@dataclass(frozen=True)
class _Clock:
    """Times of rows on a regular clock, so that all frequencies are one Fourier transform."""

    ticks: NDArray[np.int64]
    tick_s: float
    n_points: int
    first: int
    stop: int

    def frequency_hz(self, number: float) -> float:
        """Of a term of the transform."""
        return number / (self.n_points * self.tick_s)


def search_clock(data: ChannelData) -> _Clock:
    """A clock for ``min_cycles`` a session up to periods of a few rows, half a cycle apart.

    Where trials are few an oscillation must show in each of them: a slower one fits any few.
    """
    time = data.history.time_s - float(data.history.time_s.min())
    session = max(float(time.max()), data.history.sample_period_s)
    highest = 1.0 / (data.rules.rows_per_period * data.history.sample_period_s)
    tick = max(1.0 / (_POINTS_PER_PERIOD * highest), 2.0 * session / _MAX_POINTS)
    ticks = np.rint(time / tick).astype(np.int64)
    n_points = next_fast_len(2 * int(ticks.max() + 1), real=True)
    slowest = data.history.trial_duration_s if data.few_trials else session
    first = int(np.ceil(data.rules.min_cycles * n_points * tick / slowest))
    return _Clock(ticks, tick, n_points, first, n_points // _POINTS_PER_PERIOD)


def find_oscillations(data: ChannelData, fit: Fit, signs: FloatArray) -> list[Covariate]:
    """The best frequency for an oscillation of the compliance, and for an added one.

    ``signs`` (F, n_units) flip the residual of whole units; how high the highest of all peaks
    then is says by how much the best one must stand out. None where the clock is too coarse.
    """
    clock = search_clock(data)
    if clock.first >= clock.stop:
        return []
    time = data.history.time_s
    start = float(time.min())
    response = fit.model.law_response(data)
    found = []
    for how in HOWS:
        parts = _products(data, fit, response, how)
        signs_of_rows = _row_signs(data, signs)
        power = np.sum([_powers(clock, *part, signs_of_rows) for part in parts], axis=0)
        peaks = power.max(axis=0)
        coarse = clock.first + int(np.argmax(power[:, 0]))
        near = np.array([clock.frequency_hz(coarse + s) for s in np.linspace(-1, 1, _REFINED)])
        exact = np.sum([_power_at(near, time - start, *part) for part in parts], axis=0)
        found.append(
            Covariate(
                "time_s",
                "oscillation",
                how,
                center=start,
                frequency_hz=float(near[np.argmax(exact)]),
                n_outputs=data.n_outputs,
                p_search=_gumbel_p(peaks[0], peaks[1:]),
            )
        )
    return found


def _products(
    data: ChannelData, fit: Fit, response: FloatArray, how: How
) -> list[tuple[FloatArray, FloatArray]]:
    """Amplitude times residual, and its square, of each row (N,): added ones for each output."""
    size = response if how == "gain" else np.full_like(response, 0.1 * data.span)
    amplitude = data.reduce(size).reshape(-1, data.n_outputs)
    product, square = fit.residual.reshape(-1, data.n_outputs) * amplitude, amplitude**2
    if how == "gain":
        return [(product.sum(axis=1), square.sum(axis=1))]
    return [(product[:, k], square[:, k]) for k in range(data.n_outputs)]


def _row_signs(data: ChannelData, signs: FloatArray) -> FloatArray:
    """Signs (N, F + 1) of every row, the first column without a flip."""
    flips = np.vstack([np.ones(signs.shape[1]), signs])
    return flips[:, data.row_unit].T


def _powers(
    clock: _Clock,
    product: FloatArray,
    square: FloatArray,
    signs: FloatArray,
) -> FloatArray:
    """Sum of squares that each frequency explains under each flip: (frequencies, F + 1)."""
    spectrum = np.stack(
        [_spectrum(clock, product * flip)[clock.first : clock.stop] for flip in signs.T]
    )
    double = _spectrum(clock, square)[2 * clock.first : 2 * clock.stop : 2]
    return _explained(spectrum.T, double[:, None], float(square.sum()))


def _spectrum(clock: _Clock, values: FloatArray) -> NDArray[np.complex128]:
    on_clock = np.bincount(clock.ticks, values, minlength=clock.n_points)
    return np.asarray(rfft(on_clock))


def _power_at(
    frequencies: FloatArray,
    time: FloatArray,
    product: FloatArray,
    square: FloatArray,
) -> FloatArray:
    """``_powers`` at frequencies of one's own (F,), at the rows' exact times."""
    phase = np.exp(-2j * np.pi * np.outer(frequencies, time))
    return _explained(phase @ product, phase**2 @ square, float(square.sum()))


def _explained(
    spectrum: NDArray[np.complex128], double: NDArray[np.complex128], total: float
) -> FloatArray:
    """Sum of squares that a cosine and a sine explain together, from sums of products with both."""
    cos_cos, sin_sin, cos_sin = (
        (total + double.real) / 2,
        (total - double.real) / 2,
        -double.imag / 2,
    )
    a, b = spectrum.real, -spectrum.imag
    determinant = np.maximum(cos_cos * sin_sin - cos_sin**2, 1e-3 * total**2)
    return (sin_sin * a**2 - 2 * cos_sin * a * b + cos_cos * b**2) / determinant


def _gumbel_p(observed: float, null: FloatArray) -> float:
    """Return the p of a largest value by the Gumbel law that has the null's moments."""
    if null.size < 2:
        return 1.0
    scale = max(float(null.std()) * np.sqrt(6.0) / np.pi, 1e-300)
    location = float(null.mean()) - 0.5772156649 * scale
    return float(-np.expm1(-np.exp(np.clip(-(observed - location) / scale, -700.0, 50.0))))

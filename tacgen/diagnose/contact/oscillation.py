"""Oscillations of a residual in the session's clock."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len, rfft

from tacgen.core.arrays import FloatArray
from tacgen.diagnose.contact.channel import ChannelData
from tacgen.diagnose.contact.covariates import HOWS, Covariate, How
from tacgen.diagnose.contact.model import Fit
from tacgen.diagnose.contact.scores import floored, score_deviation

_MAX_POINTS = 1 << 17
"""Of the search's clock; a session that needs more is searched for slower oscillations only."""
_POINTS_PER_PERIOD = 8  # four times what sampling needs: the peak is not missed
_AT_ONCE = 8  # flips whose spectra are computed together: faster, and little memory
_HARMONICS = 3  # of one that is no sine, as of what is switched on and off
_REFINED = 41  # frequencies between the neighbours of the best one that are tried afterwards


def find_oscillations(data: ChannelData, fit: Fit, signs: FloatArray) -> list[Covariate]:
    """The best frequencies for an oscillation of the compliance, and for an added one.

    One is slower than every other trial, one faster: few frequencies are slow, so that chance
    reaches less there. Each is offered as a sine and with harmonics.

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
    middle = int(np.ceil(0.5 * history.n_trials * n_points * tick_s / session))
    edges = sorted({first, min(max(first, middle), stop), stop})

    def spectra(rows: FloatArray) -> NDArray[np.complex128]:
        on_clock = [np.bincount(ticks, row, minlength=n_points) for row in rows]
        return np.asarray(rfft(np.asarray(on_clock, dtype=np.float32)), dtype=np.complex128)

    flips = np.vstack([np.ones(signs.shape[1]), signs])[:, data.row_unit]
    found: list[Covariate] = []
    for how in HOWS:
        parts = _products(data, fit, how)
        power, total = np.zeros((flips.shape[0], stop - first)), np.zeros(flips.shape[0])
        for product, square, left in parts:
            (of_square,) = spectra(square[None])
            single, double = of_square[first:stop], of_square[2 * first : 2 * stop : 2]
            constant, size = flips @ product, float(square.sum())
            for some in np.split(np.arange(len(flips)), range(_AT_ONCE, len(flips), _AT_ONCE)):
                crossed = spectra(product * flips[some])[:, first:stop]
                power[some] += _explained(crossed, single, double, constant[some, None], size)
            total += left - constant**2 / size
        for low, high in pairwise(edges):
            in_band = power[:, low - first : high - first]
            shares = np.minimum(in_band.max(axis=1) / (total + 1e-300), 1.0 - 1e-12)
            # Of n numbers, a frequency explains a share above x in (1 - x)^((n - 3) / 2) of cases.
            peaks = -np.log1p(-shares)
            best = low + int(np.argmax(in_band[0]))
            near = (best + np.linspace(-1, 1, _REFINED)) / (n_points * tick_s)
            phase: NDArray[np.complex128] = np.exp(-2j * np.pi * np.outer(near, time))
            exact = np.zeros(_REFINED)
            for product, square, _ in parts:
                sums = phase @ product, phase @ square, phase**2 @ square
                exact += _explained(*sums, product.sum(), float(square.sum()))
            sine = Covariate(
                "time_s",
                "oscillation",
                how,
                center=start,
                frequency_hz=float(near[np.argmax(exact)]),
                p_search=(len(edges) - 1) * _gumbel_p(peaks[0], peaks[1:]),
            )
            found += [sine, replace(sine, degree=_HARMONICS)]
    return found


def _products(data: ChannelData, fit: Fit, how: How) -> list[tuple[FloatArray, FloatArray, float]]:
    """Amplitude times residual (N,), its square (N,), and the residual's sum of squares.

    Added ones have them for each output. Trials are weighted by information over variance, as
    scores are, so that those with the highest loads do not outweigh the others.
    """
    response = fit.model.law_response(data)
    size = response if how == "gain" else np.full_like(response, 0.1 * data.span)
    amplitude = data.reduce(size).reshape(-1, data.n_outputs)
    residual = fit.residual.reshape(-1, data.n_outputs)
    one_each = [slice(k, k + 1) for k in range(data.n_outputs)]
    trial, products = data.history.trial_index, []
    for outputs in [slice(None)] if how == "gain" else one_each:
        column, left = amplitude[:, outputs], residual[:, outputs]
        product, square = (column * left).sum(axis=1), (column**2).sum(axis=1)
        score, own = (np.asarray(np.bincount(trial, one), float) for one in (product, square))
        information = floored(own)
        deviation = score_deviation(score, information)
        weight = (information / deviation**2)[trial]
        products.append((weight * product, weight * square, float(weight @ (left**2).sum(axis=1))))
    return products


def _explained(
    crossed: NDArray[np.complex128],
    single: NDArray[np.complex128],
    double: NDArray[np.complex128],
    constant: FloatArray | float,
    size: float,
) -> FloatArray:
    """Sum of squares that a cosine and a sine explain together, beside a constant.

    ``crossed`` is of the products with the residual, of sum ``constant``, ``single`` and
    ``double`` are of the squares, of sum ``size``, at the frequency and at twice it.
    """
    cos, sin = single.real, -single.imag
    cos_cos = 0.5 * (size + double.real) - cos**2 / size
    sin_sin = 0.5 * (size - double.real) - sin**2 / size
    cos_sin = -0.5 * double.imag - cos * sin / size
    a, b = crossed.real - cos * constant / size, -crossed.imag - sin * constant / size
    determinant = np.maximum(cos_cos * sin_sin - cos_sin**2, 1e-3 * size**2)
    return np.asarray((sin_sin * a**2 - 2 * cos_sin * a * b + cos_cos * b**2) / determinant)


def _gumbel_p(observed: float, null: FloatArray) -> float:
    """Return the p of a largest value by the Gumbel law that has the null's moments."""
    if null.size < 2:
        return 1.0
    scale = max(float(null.std()) * np.sqrt(6.0) / np.pi, 1e-300)
    location = float(null.mean()) - np.euler_gamma * scale
    return float(-np.expm1(-np.exp(min((location - observed) / scale, 700.0))))

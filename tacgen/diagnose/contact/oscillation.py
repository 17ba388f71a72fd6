"""Oscillations of a residual in the session's clock."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len, rfft

from tacgen.core.types import FloatArray
from tacgen.diagnose.contact.channel import ChannelData
from tacgen.diagnose.contact.model import HOWS, Covariate, Fit, How
from tacgen.diagnose.contact.scores import score_weights, sign_flips

_MAX_POINTS = 1 << 17
"""Most ticks of the search's clock; longer sessions are searched for slower oscillations only."""
ROWS_PER_PERIOD = 4  # of the shortest oscillation
_POINTS_PER_PERIOD = 8  # four times what sampling needs: the peak is not missed
_AT_ONCE = 8  # flips whose spectra are computed together: faster, and little memory
_HARMONICS = 3  # of one that is no sine, as of what is switched on and off
_SLOW_FLIPS, _FAST_FLIPS = 200, 40  # of many frequencies, the highest peak by chance varies less
_REFINED = 41  # frequencies between the neighbours of the best one that are tried afterwards

Transform: TypeAlias = Callable[[FloatArray, int], NDArray[np.complex128]]
"""Fourier sums (F, K) of rows (F, N) at so many times each frequency."""


@dataclass(frozen=True)
class _Products:
    """Amplitude times residual (N,), its square (N,), and the residual's sum of squares."""

    product: FloatArray
    square: FloatArray
    left: float

    def of_trials(self, trial: NDArray[np.int64]) -> "_Products":
        """The same with one number a trial (T,), its gain."""
        product, square = (
            np.asarray(np.bincount(trial, one), dtype=np.float64)
            for one in (self.product, self.square)
        )
        return _Products(product, square, float((product**2 / (square + 1e-300)).sum()))


@dataclass(frozen=True)
class _Search:
    """Shares (F + 1, K) that frequencies explain of the residual and of its flips."""

    how: How
    frequencies_hz: FloatArray
    shares: FloatArray
    rows: list[_Products]

    @property
    def heights(self) -> FloatArray:
        """The highest peak (F + 1,) of each, in deviations of the other flips' above their mean.

        Of n numbers, a frequency explains a share above x in (1 - x)^((n - 3) / 2) of cases.
        """
        peaks = -np.log1p(-self.shares.max(axis=1))
        others = np.where(np.eye(peaks.size, dtype=bool), np.nan, peaks)[:, 1:]
        mean, deviation = np.nanmean(others, axis=1), np.nanstd(others, axis=1)
        return np.asarray((peaks - mean) / (deviation + 1e-12))


def find_oscillations(data: ChannelData, fit: Fit, rng: np.random.Generator) -> list[Covariate]:
    """The best frequencies for an oscillation of the compliance, and for an added one.

    One is slower than every other trial and is sought in one number a trial: few frequencies are
    slow, so that chance reaches less there. One is faster, up to periods of a few rows. Each is
    offered as a sine and with harmonics. How high the highest peak of all slow searches, or of all
    fast ones, is when signs of trials are flipped says by how much the best one must stand out.
    """
    history = data.history
    start, trial = float(history.time_s.min()), history.trial_index
    time = history.time_s - start
    session = max(float(time.max()), history.sample_period_s)
    flips = sign_flips(history.n_trials, _SLOW_FLIPS, rng)
    middle = 0.5 * history.n_trials / session
    slow_hz = np.arange(data.rules.min_cycles / session, middle, 0.25 / session)
    slow_waves = _direct(np.bincount(trial, time) / np.bincount(trial), slow_hz)
    fast_hz, fast_waves = _fourier(data, time, max(middle, data.rules.min_cycles / session))
    slow, fast = list[_Search](), list[_Search]()
    for how in HOWS:
        rows = _products(data, fit, how)
        trials = [one.of_trials(trial) for one in rows]
        slow.append(_Search(how, slow_hz, _shares(trials, flips, slow_waves), rows))
        of_rows = _shares(rows, flips[: 1 + _FAST_FLIPS, trial], fast_waves)
        fast.append(_Search(how, fast_hz, of_rows, rows))
    families = [one for one in (slow, fast) if one[0].frequencies_hz.size > 1]
    found: list[Covariate] = []
    for how, family in product(HOWS, families):
        highest = np.max([one.heights[1:] for one in family], axis=0)
        (search,) = (one for one in family if one.how == how)
        step_hz = search.frequencies_hz[1] - search.frequencies_hz[0]
        best_hz = search.frequencies_hz[np.argmax(search.shares[0])]
        near_hz = best_hz + step_hz * np.linspace(-1, 1, _REFINED)
        exact = _shares(search.rows, np.ones((1, time.size)), _direct(time, near_hz))[0]
        p_search = len(families) * _gumbel_p(float(search.heights[0]), highest)
        sine = Covariate(
            "time_s",
            "oscillation",
            how,
            center=start,
            frequency_hz=float(near_hz[np.argmax(exact)]),
            p_search=min(p_search, 1.0),
        )
        found += [sine, replace(sine, degree=_HARMONICS)]
    return found


def _products(data: ChannelData, fit: Fit, how: How) -> list[_Products]:
    """Products for the compliance, or, added, for each output, with trials weighted.

    The weight is information over variance, as scores have it: then no trial outweighs the others.
    """
    response = fit.model.law_response(data)
    size = response if how == "gain" else np.full_like(response, 0.1 * data.span)
    amplitude = data.reduce(size).reshape(-1, data.n_outputs)
    residual = fit.residual.reshape(-1, data.n_outputs)
    one_each = [slice(k, k + 1) for k in range(data.n_outputs)]
    trial, found = data.history.trial_index, list[_Products]()
    for outputs in [slice(None)] if how == "gain" else one_each:
        column, left = amplitude[:, outputs], residual[:, outputs]
        product, square = (column * left).sum(axis=1), (column**2).sum(axis=1)
        whole = _Products(product, square, 0.0).of_trials(trial)
        weight = score_weights(whole.product, whole.square)[trial]
        own = float(weight @ (left**2).sum(axis=1))
        found.append(_Products(weight * product, weight * square, own))
    return found


def _fourier(data: ChannelData, time: FloatArray, first_hz: float) -> tuple[FloatArray, Transform]:
    """Frequencies (K,) from ``first_hz`` on, half a cycle a session apart, and their transform.

    Times are put on a regular clock, so that all frequencies are one Fourier transform. There are
    no frequencies where the clock is too coarse for them.
    """
    shortest_s = ROWS_PER_PERIOD * data.history.sample_period_s
    session = max(float(time.max()), data.history.sample_period_s)
    tick_s = max(shortest_s / _POINTS_PER_PERIOD, 2.0 * session / _MAX_POINTS)
    ticks = np.rint(time / tick_s).astype(np.int64)
    n_points = next_fast_len(2 * int(ticks.max() + 1), real=True)
    first, stop = int(np.ceil(first_hz * n_points * tick_s)), n_points // _POINTS_PER_PERIOD

    def transform(rows: FloatArray, order: int) -> NDArray[np.complex128]:
        found = []
        for some in np.split(rows, range(_AT_ONCE, len(rows), _AT_ONCE)):
            on_clock = [np.bincount(ticks, row, minlength=n_points) for row in some]
            spectra = rfft(np.asarray(on_clock, dtype=np.float32))
            found.append(spectra[:, order * first : order * stop : order])
        return np.concatenate(found, dtype=np.complex128)

    return np.arange(first, stop) / (n_points * tick_s), transform


def _direct(time: FloatArray, frequencies_hz: FloatArray) -> Transform:
    """The transform at any frequencies (K,), term by term."""
    phase: NDArray[np.complex128] = np.exp(-2j * np.pi * np.outer(time, frequencies_hz))
    return lambda rows, order: rows @ phase**order


def _shares(parts: list[_Products], flips: FloatArray, transform: Transform) -> FloatArray:
    """What a cosine and a sine explain together, beside a constant, of each flip: (F, K), below 1.

    As a share of the sum of squares that the constant leaves.
    """
    power, total = np.zeros(1), np.zeros(1)
    for part in parts:
        constant, size = (flips @ part.product)[:, None], float(part.square.sum()) + 1e-300
        (single,), (double,) = (transform(part.square[None], order) for order in (1, 2))
        crossed = transform(part.product * flips, 1)
        cos, sin = single.real, -single.imag
        cos_cos = 0.5 * (size + double.real) - cos**2 / size
        sin_sin = 0.5 * (size - double.real) - sin**2 / size
        cos_sin = -0.5 * double.imag - cos * sin / size
        a, b = crossed.real - cos * constant / size, -crossed.imag - sin * constant / size
        determinant = np.maximum(cos_cos * sin_sin - cos_sin**2, 1e-3 * size**2)
        power = power + (sin_sin * a**2 - 2 * cos_sin * a * b + cos_cos * b**2) / determinant
        total = total + part.left - constant**2 / size
    return np.asarray(np.minimum(power / (total + 1e-300), 1.0 - 1e-12))


def _gumbel_p(observed: float, null: FloatArray) -> float:
    """Return the p of a largest value by the Gumbel law that has the null's moments."""
    scale = max(float(null.std()) * np.sqrt(6.0) / np.pi, 1e-300)
    location = float(null.mean()) - np.euler_gamma * scale
    return float(-np.expm1(-np.exp(min((location - observed) / scale, 700.0))))

"""Oscillations of a residual in the session's clock."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tacgen.loop.channel import ChannelData
from tacgen.loop.model import Fit, trial_duration_s
from tacgen.loop.nuisance import HOWS, Nuisance

MAX_FREQUENCIES = 5000
CHUNK = 256
MIN_CYCLES = 1.5
"""Slower than this within the session is a drift, not an oscillation."""


def frequency_grid_hz(data: ChannelData) -> NDArray[np.float64]:
    """Frequencies from ``MIN_CYCLES`` a session to a quarter of the block rate, finely spaced."""
    time = data.history.time_s
    session = max(float(np.ptp(time)), data.history.sample_period_s)
    highest = min(0.25 / data.history.sample_period_s, 2.5 / trial_duration_s(data))
    count = int(np.ceil((highest - MIN_CYCLES / session) * session * 2.0))
    count = min(max(count, 1), MAX_FREQUENCIES)
    cycles = MIN_CYCLES + 0.5 * np.arange(count, dtype=np.float64)
    grid: NDArray[np.float64] = np.divide(cycles, session)
    return grid


def find_waves(data: ChannelData, fit: Fit, signs: NDArray[np.float64]) -> list[Nuisance]:
    """The best frequency for an oscillation of the compliance, and for an added one.

    ``signs`` (F, n_units) flip the residual of whole units; how high the highest of all peaks
    then is says by how much the best one must stand out.
    """
    frequencies = frequency_grid_hz(data)
    time = data.history.time_s
    start = float(time.min())
    response = fit.model.law_response(data)
    found = []
    for how in HOWS:
        size = response if how == "gain" else np.full_like(response, 0.1 * data.span)
        amplitude = data.reduce(size)
        best, p_value = _strongest(
            frequencies, time - start, fit.residual, amplitude, _row_signs(data, signs)
        )
        found.append(
            Nuisance(
                "time_s",
                "wave",
                how,
                center=start,
                frequency_hz=best,
                n_outputs=data.n_outputs,
                p_search=p_value,
            )
        )
    return found


def _row_signs(data: ChannelData, signs: NDArray[np.float64]) -> NDArray[np.float32]:
    """Signs (N, F + 1) of every row, the first column without a flip."""
    unit = np.zeros(data.history.n_samples, dtype=np.int64)
    unit[data.pairs[0]] = data.pair_unit
    unit[data.pairs[1]] = data.pair_unit
    flips = np.vstack([np.ones(signs.shape[1]), signs])
    return flips[:, unit].T.astype(np.float32)


def _strongest(
    frequencies: NDArray[np.float64],
    time: NDArray[np.float64],
    residual: NDArray[np.float64],
    amplitude: NDArray[np.float64],
    signs: NDArray[np.float32],
) -> tuple[float, float]:
    """Frequency whose pair of waves takes most from the residual, and the p of the peak."""
    n_outputs = residual.size // time.size
    weighted = (residual * amplitude).reshape(-1, n_outputs).sum(axis=1)
    square = (amplitude**2).reshape(-1, n_outputs).sum(axis=1)
    scale = float(np.abs(square).max()) or 1.0
    flipped = (weighted[:, None] / scale * signs).astype(np.complex64)
    square = (square / scale).astype(np.float32)
    total = float(square.sum())
    phase = np.exp(-2j * np.pi * np.outer(frequencies[:CHUNK], time)).astype(np.complex64)
    spacing = frequencies[1] - frequencies[0] if frequencies.size > 1 else 0.0
    onward = np.exp(-2j * np.pi * spacing * CHUNK * time).astype(np.complex64)
    powers = []
    for first in range(0, frequencies.size, CHUNK):
        part = phase[: frequencies.size - first]
        wave, double = part @ flipped, (part**2) @ square
        cos_cos = ((total + double.real) / 2)[:, None]
        sin_sin = ((total - double.real) / 2)[:, None]
        cos_sin = (-double.imag / 2)[:, None]
        a, b = wave.real, -wave.imag
        determinant = np.maximum(cos_cos * sin_sin - cos_sin**2, 1e-3 * total**2)
        powers.append((sin_sin * a**2 - 2 * cos_sin * a * b + cos_cos * b**2) / determinant)
        phase = phase * onward
    power = np.concatenate(powers)
    peaks = power.max(axis=0)
    return float(frequencies[int(np.argmax(power[:, 0]))]), _gumbel_p(peaks[0], peaks[1:])


def _gumbel_p(observed: float, null: NDArray[np.float32]) -> float:
    """Return the p of a largest value by the Gumbel law that has the null's moments."""
    if null.size < 2:
        return 1.0
    scale = max(float(null.std()) * np.sqrt(6.0) / np.pi, 1e-300)
    location = float(null.mean()) - 0.5772156649 * scale
    return float(-np.expm1(-np.exp(np.clip(-(observed - location) / scale, -700.0, 50.0))))

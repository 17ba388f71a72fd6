"""One channel of a press log, thinned, weighed and split into halves for fitting.

The force is measured with noise too, and a fit that takes it as exact finds curvature near 0 N
and a compliance that seems to vanish where there is no load. So neighbouring rows are put into
two halves, A and B, whose noise is independent: a product of what is seen in A and what is left
in B has no share of the noise, be it of the volume or of the force. Sums of such products stand
wherever a sum of squares would be judged.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.contact.effects import Channel, LoadHistory
from tacgen.contact.effects.kernels import moving_mean
from tacgen.core.arrays import BoolArray, FloatArray

TARGETS: dict[Channel, tuple[str, ...]] = {
    "normal": ("volume_mm3",),
    "shear": ("shear_x_mm", "shear_y_mm"),
}
UNITS: dict[Channel, str] = {"normal": "mm3", "shear": "mm"}
ROWS_PER_TRIAL = 60
MIN_ROWS = 1200
MIN_UNITS = 36
"""With few trials, parts of trials are the units that tests resample: about so many."""
MIN_TRIALS_AS_UNITS = 12
MIN_TRIALS_AS_FOLDS = 4
OUTLIER_SIGMAS = 7.0
MAX_SPIKES = 0.12
"""Share of samples that stick out of their neighbours beyond which it is the signal that jumps."""

Columns = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class ChannelData:
    """Rows of one channel, ready to fit.

    Attributes
    ----------
    channel : str
    history : LoadHistory
    target : (N, C) float64
        Measured volume (C = 1) or shear motion (C = 2), in the history's order.
    noise : float
        Standard deviation of one sample's noise, from the high-frequency content.
    n_samples : int
        Samples of the log that the rows were averaged from.
    weight : (N,) float64
        Number of samples times their relative precision; 0 for what sticks out of its trial.
    pairs : (2, M) int64
        Rows of half A and of half B, neighbours in the same trial.
    pair_unit : (M,) int64
        The unit (trial, or part of one where trials are few) that each pair belongs to.
    """

    channel: Channel
    history: LoadHistory
    columns: Columns
    target: FloatArray
    noise: float
    n_samples: int
    weight: FloatArray
    pairs: NDArray[np.int64]
    pair_unit: NDArray[np.int64]

    @property
    def n_outputs(self) -> int:
        """1 for the normal channel, 2 for shear."""
        return self.target.shape[1]

    @property
    def n_units(self) -> int:
        """Number of units."""
        return int(self.pair_unit.max()) + 1

    def folds(self, count: int) -> NDArray[np.int64]:
        """Fold of each unit (U,): whole trials stay together unless there are hardly any."""
        unit_trial = np.zeros(self.n_units, dtype=np.int64)
        unit_trial[self.pair_unit] = self.history.trial_index[self.pairs[0]]
        n_trials = self.history.n_trials
        if n_trials < MIN_TRIALS_AS_FOLDS:
            return np.arange(self.n_units) % min(count, self.n_units)
        return unit_trial % min(count, n_trials)

    @property
    def span(self) -> float:
        """A high quantile of |target|: the scale of what is measured."""
        return float(np.quantile(np.abs(self.target), 0.99)) or 1.0

    @property
    def noise_loss(self) -> float:
        """Sum of squares of the noise alone, on the scale of a sum over pairs."""
        return 0.5 * self.noise**2 * self.n_samples * self.n_outputs

    def reduce(self, values: FloatArray) -> FloatArray:
        """``values`` (N, C) times the root of their weight, as (N·C,)."""
        return (values * np.sqrt(self.weight)[:, None]).ravel()

    def halves(self, reduced: FloatArray) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
        """Rows A and B of ``reduced`` (N·C, …), each (M·C, …), and the unit of each."""
        shaped = reduced.reshape(-1, self.n_outputs, *reduced.shape[1:])
        flat = (-1, *reduced.shape[1:])
        unit = np.repeat(self.pair_unit, self.n_outputs)
        return shaped[self.pairs[0]].reshape(flat), shaped[self.pairs[1]].reshape(flat), unit


def channel_data(columns: Columns, channel: Channel, *, rows_per_trial: int = 0) -> ChannelData:
    """Prepare one channel of a press log's columns (finite where they are used).

    ``rows_per_trial`` 0 keeps ``ROWS_PER_TRIAL``, and more where trials are few.
    """
    history = LoadHistory(columns)
    rows_per_trial = rows_per_trial or max(ROWS_PER_TRIAL, MIN_ROWS // max(history.n_trials, 1))
    target = np.stack([history.column(name) for name in TARGETS[channel]], axis=1)
    load = history.force_normal_n[:, None] if channel == "normal" else history.force_shear_n
    rough_k = float((load * target).sum() / max(float((load**2).sum()), 1e-12))
    # Smoothed, since weights that follow a sample's own noise would bias every fit.
    size = np.linalg.norm(_smoothed(load, history.starts), axis=1)
    noise, precision = noise_and_weight(target - rough_k * load, size, history.starts)
    n_samples = history.n_samples
    columns, weight = _thinned(columns, history, precision, rows_per_trial)
    history = LoadHistory(columns)
    target = np.stack([history.column(name) for name in TARGETS[channel]], axis=1)
    pairs, pair_unit = _pairs(history.starts)
    return ChannelData(
        channel, history, columns, target, noise, n_samples, weight, pairs, pair_unit
    )


def _thinned(
    columns: Columns, history: LoadHistory, precision: FloatArray, rows: int
) -> tuple[dict[str, NDArray[Any]], FloatArray]:
    """Means over neighbouring samples so that a trial has at most ``rows`` rows, in order."""
    starts = [
        np.arange(first, stop, max(1, int(np.ceil((stop - first) / rows))), dtype=np.int64)
        for first, stop in pairwise(history.starts)
    ]
    edges = np.concatenate(starts)
    weight = np.add.reduceat(precision, edges)
    share = np.where(np.repeat(weight, np.diff([*edges, precision.size])) > 0, precision, 1.0)
    total = np.add.reduceat(share, edges)
    thinned: dict[str, NDArray[Any]] = {}
    for name, values in columns.items():
        ordered = np.asarray(values)[history.order]
        if name == "trial" or not np.issubdtype(ordered.dtype, np.number):
            thinned[name] = ordered[edges]
        else:
            thinned[name] = np.add.reduceat(ordered * share, edges) / total
    return thinned, weight


def _pairs(starts: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Neighbouring rows of each trial, which of the two is A in turn, and the unit of each."""
    n_trials = starts.size - 1
    parts = 1 if n_trials >= MIN_TRIALS_AS_UNITS else int(np.ceil(MIN_UNITS / max(n_trials, 1)))
    first_rows, units = [], []
    for trial, (first, stop) in enumerate(pairwise(starts)):
        here = np.arange(first, stop - 1, 2, dtype=np.int64)
        first_rows.append(here)
        units.append(trial * parts + np.arange(here.size) * parts // max(here.size, 1))
    left = np.concatenate(first_rows)
    swap = (np.arange(left.size) % 2).astype(np.int64)
    unit = np.unique(np.concatenate(units), return_inverse=True)[1].astype(np.int64)
    return np.stack([left + swap, left + 1 - swap]), unit


def noise_and_weight(
    rough: FloatArray, load: FloatArray, starts: NDArray[np.int64]
) -> tuple[float, FloatArray]:
    """Noise of one sample, and each sample's precision, from differences along each trial.

    Second differences do not see what varies slowly. Their square is fitted by a + b·load², so
    that noise that grows with the load weighs less where it is large.
    """
    n = load.size
    inside = np.ones(n, dtype=bool)
    inside[starts[:-1]] = False
    inside[starts[1:] - 1] = False
    rows = np.flatnonzero(inside)
    if rows.size < 8:
        return float(rough.std()) or 1e-12, np.ones(n)
    second = rough[rows - 1] - 2.0 * rough[rows] + rough[rows + 1]
    square = (second**2).mean(axis=1) / 6.0
    typical = float(np.median(square)) / 0.455 or 1e-24
    clean = square < OUTLIER_SIGMAS**2 * typical
    noise = float(np.sqrt(square[clean].mean()))
    weight = _precision(square[clean], load[rows[clean]], load)
    weight[_spikes(rough, starts, noise / np.sqrt(weight))] = 0.0
    return max(noise, 1e-12), weight


def _precision(square: FloatArray, load: FloatArray, everywhere: FloatArray) -> FloatArray:
    """1/variance by a + b·load², the mean at 1 and the ratio of extremes at most 25."""
    from scipy.optimize import nnls

    scale = float(np.mean(load**2)) or 1.0
    design = np.stack([np.ones_like(load), load**2 / scale], axis=1)
    (base, slope), _ = nnls(design, square)
    variance = base + slope * everywhere**2 / scale
    variance = np.maximum(variance, max(variance.max() / 25.0, 1e-24))
    weight = 1.0 / variance
    return weight / weight.mean()


def _spikes(rough: FloatArray, starts: NDArray[np.int64], noise: FloatArray) -> BoolArray:
    """Single samples far from the median of their neighbours on both sides."""
    sticks = np.zeros(rough.shape[0], dtype=bool)
    for first, stop in pairwise(starts):
        if stop - first < 5:
            continue
        part = rough[first:stop]
        padded = np.pad(part, ((2, 2), (0, 0)), mode="edge")
        windows = np.lib.stride_tricks.sliding_window_view(padded, 5, axis=0)
        distance = np.abs(part - np.median(windows, axis=-1)).max(axis=1)
        sticks[first:stop] = distance > OUTLIER_SIGMAS * noise[first:stop]
    if sticks.mean() > MAX_SPIKES:
        return np.zeros_like(sticks)
    return sticks


def _smoothed(values: FloatArray, starts: NDArray[np.int64]) -> FloatArray:
    """Means (N, C) over nine neighbouring samples of a trial."""
    parts = [
        moving_mean(np.ascontiguousarray(values[:, k]), starts, 4) for k in range(values.shape[1])
    ]
    return np.stack(parts, axis=1)

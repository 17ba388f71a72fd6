"""One channel of a press log, thinned and weighed for fitting.

The force is measured with noise too, and a fit that takes it as exact finds curvature near 0 N
and a compliance that seems to vanish where there is no load. But the noise of neighbouring rows
is independent: a product of the column in the one and the residual in the other has no share of
the noise, be it of the volume or of the force. Sums of such products take the place of every sum
of squares that is judged.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.optimize import nnls

from tacgen.contact.effects import Channel, LoadHistory
from tacgen.contact.effects.kernels import moving_mean
from tacgen.contact.noise import is_clean, second_differences
from tacgen.core.types import BoolArray, FloatArray
from tacgen.diagnose.rules import CONTACT, ContactRules
from tacgen.presses.press_log import SHEAR_MOTIONS, Columns

TARGETS: dict[Channel, tuple[str, ...]] = {"normal": ("volume_mm3",), "shear": SHEAR_MOTIONS}
FLOOR_LAGS = (1, 2, 4, 8)  # samples, for second differences
MAX_FLOOR_RISE = 1.1  # from one to the next: a load's course rises more than noise
OUTLIER_SIGMAS = 7.0  # so far from its neighbours a sample has no weight
MAX_VARIANCE_RATIO = 25.0  # of the weights that noise growing with the load gives
_CHANCES = 3.0  # standard deviations that noise seldom reaches


@dataclass(frozen=True)
class ChannelData:
    """Rows of one channel, ready to fit.

    ``target`` (N, C) is the measured volume (C = 1) or shear motion (C = 2) in the history's order;
    ``noise`` the standard deviation of one sample's noise, from the high-frequency content;
    ``n_samples`` how many samples of the log the rows were averaged from; ``weight`` (N,) the
    number of samples times their relative precision, 0 for what sticks out of its trial. ``first``
    (M,) are the rows that another of their trial follows, and ``pair_unit`` (M,) the unit (trial,
    or part of one where trials are few) that each such pair belongs to, ascending; ``few_trials``
    says that the whole log has so few trials that parts of them are the units.
    """

    channel: Channel
    rules: ContactRules
    history: LoadHistory
    columns: Columns
    target: FloatArray
    noise: float
    n_samples: int
    weight: FloatArray
    first: NDArray[np.int64]
    pair_unit: NDArray[np.int64]
    few_trials: bool

    @property
    def n_outputs(self) -> int:
        """1 for the normal channel, 2 for shear."""
        return int(self.target.shape[1])

    @property
    def n_units(self) -> int:
        """Number of units."""
        return int(self.pair_unit.max()) + 1

    @property
    def min_gain(self) -> float:
        """Least share of the held-out sum of squares that an effect explains."""
        return self.rules.few_min_gain if self.few_trials else self.rules.min_gain

    @property
    def row_unit(self) -> NDArray[np.int64]:
        """The unit of each row (N,)."""
        unit = np.zeros(self.history.n_samples, dtype=np.int64)
        unit[self.first + 1] = self.pair_unit
        unit[self.first] = self.pair_unit
        return unit

    @property
    def unit_rows(self) -> NDArray[np.int64]:
        """How many rows each unit (U,) has."""
        return np.bincount(self.pair_unit, minlength=self.n_units)

    @property
    def unit_trial(self) -> NDArray[np.int64]:
        """The trial of each unit (U,)."""
        trial = np.zeros(self.n_units, dtype=np.int64)
        trial[self.pair_unit] = self.history.trial_index[self.first]
        return trial

    def folds(self) -> NDArray[np.int64]:
        """Fold of each unit (U,): whole trials stay together unless there are hardly any."""
        count, n_trials = self.rules.n_folds, self.history.n_trials
        if n_trials < self.rules.min_trials_of_part:
            return np.arange(self.n_units) % min(count, self.n_units)
        return self.unit_trial % min(count, n_trials)

    def memory_rows(self, reduced: FloatArray) -> float:
        """Over how many rows a residual (R,) correlates, as noise with a memory does.

        0 where units are trials. Else twice its integrated autocorrelation time: so far apart, rows
        hardly correlate.
        Source: Geyer 1992, Statistical Science 7: the sum ends where the correlation does.
        """
        if not self.few_trials:
            return 0.0
        rows = reduced.reshape(-1, self.n_outputs)
        lengths = np.diff(self.history.starts)
        within = self.history.trial_index
        square, time = float((rows**2).sum()), 1.0
        for lag in range(1, int(lengths.max())):
            same = within[lag:] == within[:-lag]
            correlation = float((rows[lag:] * rows[:-lag])[same].sum()) / max(square, 1e-300)
            if correlation < 0.05:
                break
            time += 2.0 * correlation
        return 2.0 * time

    @cached_property
    def span(self) -> float:
        """A high quantile of |target|: the scale of what is measured."""
        return float(np.quantile(np.abs(self.target), 0.99)) or 1.0

    @property
    def noise_loss(self) -> float:
        """Sum of squares of the noise alone, on the scale of a sum over pairs."""
        return 0.5 * self.noise**2 * self.n_samples * self.n_outputs

    @property
    def least_loss(self) -> float:
        """How far below 0 chance takes a sum of products of neighbours, of noise a row long."""
        deviation = self.noise_loss / np.sqrt(self.first.size * self.n_outputs)
        return -self.rules.negative_loss_in_sd * float(deviation)

    @property
    def is_loaded(self) -> bool:
        """Whether the load is more than noise of the force: else no compliance can be fitted.

        Products of neighbours have one sign where it is; of n of normal noise the sum is 0, give or
        take π/(2√n) of the sum of their sizes.
        """
        a, b = self.neighbours(self.reduce(self.history.load(self.channel)))
        least = min(0.5, _CHANCES * 0.5 * np.pi / np.sqrt(a.size))
        return bool(a @ b > least * np.abs(a * b).sum())

    def reduce(self, values: FloatArray) -> FloatArray:
        """``values`` (N, C) times the root of their weight, as (N·C,)."""
        return (values * np.sqrt(self.weight)[:, None]).ravel()

    @property
    def ones(self) -> FloatArray:
        """A constant along each axis, reduced: (R, C)."""
        one = np.ones((self.history.n_samples, 1))
        return np.stack([self.reduce(one * axis) for axis in np.eye(self.n_outputs)], axis=1)

    def neighbours(self, reduced: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Both rows of each pair of ``reduced`` (N·C, …), each (M·C, …): outputs stay together."""
        shaped = reduced.reshape(-1, self.n_outputs, *reduced.shape[1:])
        flat = (-1, *reduced.shape[1:])
        return shaped[self.first].reshape(flat), shaped[self.first + 1].reshape(flat)


class ChannelSamples:
    """Every sample of one channel, from which rows are averaged.

    ``columns`` (N,) each are a press log's, finite where they are used; ``precision`` (N,), in the
    history's order, is 0 where a sample sticks out of its trial. ``session`` are the samples of
    the whole log, if these are a part of it.
    """

    def __init__(
        self,
        columns: Columns,
        channel: Channel,
        rules: ContactRules = CONTACT,
        session: "ChannelSamples | None" = None,
    ) -> None:
        self.columns, self.channel, self.rules = columns, channel, rules
        self.history = history = LoadHistory(columns)
        self._session = session
        target, load = self._target(history), history.load(channel)
        # Smoothed, since weights that follow a sample's own noise would bias every fit.
        parts = [moving_mean(np.ascontiguousarray(axis), history.starts, 4) for axis in load.T]
        size = np.linalg.norm(np.stack(parts, axis=1), axis=1)
        residual = target - linear_compliance(load, target) * load
        self.noise, self.precision = noise_and_weight(residual, size, history.starts)
        self._kept: dict[int, ChannelData] = {}

    def _target(self, history: LoadHistory) -> FloatArray:
        return np.stack([history.column(name) for name in TARGETS[self.channel]], axis=1)

    def thinned(self, rows_per_trial: int | None = None) -> ChannelData:
        """Means over neighbouring samples, at most so many rows a trial, in order; made once.

        Without a number, as many as choosing among effects needs.
        """
        least = self.rules.min_rows // max(self.history.n_trials, 1)
        rows = rows_per_trial or max(self.rules.rows_per_trial, least)
        if rows not in self._kept:
            self._kept[rows] = self._thinned(rows)
        return self._kept[rows]

    def _thinned(self, rows: int) -> ChannelData:
        history = self.history
        starts = [
            np.arange(first, stop, max(1, int(np.ceil((stop - first) / rows))), dtype=np.int64)
            for first, stop in pairwise(history.starts)
        ]
        edges = np.concatenate(starts)
        precision = self.precision
        weight = np.add.reduceat(precision, edges)
        share = np.where(np.repeat(weight, np.diff([*edges, precision.size])) > 0, precision, 1.0)
        total = np.add.reduceat(share, edges)
        columns: dict[str, NDArray[Any]] = {}
        for name, values in self.columns.items():
            ordered = np.asarray(values)[history.order]
            if name == "trial" or not np.issubdtype(ordered.dtype, np.number):
                columns[name] = ordered[edges]
            else:
                columns[name] = np.add.reduceat(ordered * share, edges) / total
        session = self._session.thinned(rows).history if self._session else None
        thinned = LoadHistory(columns, session)
        log = self._session.history if self._session else history
        few = log.n_trials < self.rules.min_trials_as_units
        return ChannelData(
            self.channel,
            self.rules,
            thinned,
            columns,
            self._target(thinned),
            self.noise,
            history.n_samples,
            weight,
            *_pairs(thinned, self.rules, few_trials=few),
            few,
        )

    def every_sample(self) -> ChannelData:
        """A row a sample."""
        return self.thinned(int(np.diff(self.history.starts).max()))


def linear_compliance(load: FloatArray, target: FloatArray) -> float:
    """Least-squares compliance of ``target`` on ``load``, both (N, C): where a fit starts."""
    return float((load * target).sum() / max(float((load**2).sum()), 1e-12))


def _pairs(
    history: LoadHistory, rules: ContactRules, *, few_trials: bool
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The rows (M,) that another of their trial follows, and the unit (M,) of each such pair.

    Where trials are few, units are parts of them in which as much happens: half of it is time, half
    the way that the smoothed load goes.
    """
    starts, n_trials = history.starts, history.n_trials
    parts = int(np.ceil(rules.min_units / max(n_trials, 1))) if few_trials else 1
    loads = np.column_stack([history.normal_smooth_n, history.force_shear_n])
    firsts, units = [], []
    for trial, (start, stop) in enumerate(pairwise(starts)):
        firsts.append(np.arange(start, stop - 1, dtype=np.int64))
        count = firsts[-1].size
        way = np.linalg.norm(np.diff(loads[start:stop], axis=0), axis=1) + 1e-12
        share = 0.5 * np.arange(count) / max(count, 1) + 0.5 * (np.cumsum(way) - way) / way.sum()
        units.append(trial * parts + (share * parts).astype(np.int64))
    unit = np.unique(np.concatenate(units), return_inverse=True)[1].astype(np.int64)
    return np.concatenate(firsts), unit


def noise_and_weight(
    rough: FloatArray, load: FloatArray, starts: NDArray[np.int64]
) -> tuple[float, FloatArray]:
    """Noise of one sample, and each sample's precision, from differences along each trial.

    Second differences do not see what varies slowly. Their square is fitted by a + b·load², so
    that noise that grows with the load weighs less where it is large.
    """
    rows, square = second_differences(rough, starts)
    if rows.size < 8:
        return float(rough.std()) or 1e-12, np.ones(load.size)
    clean = is_clean(square, OUTLIER_SIGMAS)
    noise = float(np.sqrt(square[clean].mean()))
    weight = _precision(square[clean], load[rows[clean]], load)
    weight[_spikes(rough, starts, noise / np.sqrt(weight))] = 0.0
    return max(noise, 1e-12), weight


def noise_floor(residual: FloatArray, starts: NDArray[np.int64]) -> float:
    """Standard deviation of one sample's noise, from the residual of every sample (N, C).

    Second differences along each trial: what varies slowly is not seen. Noise that goes on from
    one sample to the next is seen whole by differences over 2, 4 and 8 samples, which are taken
    as long as they rise little. Single samples that stick out do not count.
    """
    floor = float("nan")
    for lag in FLOOR_LAGS:
        _, square = second_differences(residual, starts, lag)
        if not square.size:
            break
        wider = float(np.sqrt(square[is_clean(square, OUTLIER_SIGMAS)].mean()))
        if lag > 1 and not wider <= MAX_FLOOR_RISE * floor:
            break
        floor = float(np.fmax(wider, floor))
    return floor if np.isfinite(floor) else float(residual.std())


def _precision(square: FloatArray, load: FloatArray, everywhere: FloatArray) -> FloatArray:
    """1/variance by a + b·load², its mean 1 and the ratio of its extremes bounded."""
    scale = float(np.mean(load**2)) or 1.0
    design = np.stack([np.ones_like(load), load**2 / scale], axis=1)
    (base, slope), _ = nnls(design, square)
    variance = base + slope * everywhere**2 / scale
    variance = np.maximum(variance, max(variance.max() / MAX_VARIANCE_RATIO, 1e-24))
    weight = 1.0 / variance
    return np.asarray(weight / weight.mean())


def _spikes(rough: FloatArray, starts: NDArray[np.int64], noise: FloatArray) -> BoolArray:
    """Single samples far from the median of their neighbours on both sides."""
    sticks = np.zeros(rough.shape[0], dtype=bool)
    for first, stop in pairwise(starts):
        if stop - first >= 5:
            part = rough[first:stop]
            distance = np.abs(part - median_filter(part, (5, 1), mode="nearest")).max(axis=1)
            sticks[first:stop] = distance > OUTLIER_SIGMAS * noise[first:stop]
    return sticks

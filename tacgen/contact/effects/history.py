"""The load history of a press log, or of one simulated grasp, as the effects see it."""

from collections.abc import Callable, Hashable, Mapping
from functools import cached_property
from typing import Any, Literal, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tacgen.contact.effects import kernels
from tacgen.core.errors import ContactError
from tacgen.core.types import BoolArray, FloatArray

Made = TypeVar("Made")
Memory: TypeAlias = Mapping[Hashable, tuple[float, Any]]
"""State of each recursion of each effect, and the trial that it belongs to; never changed."""
Channel = Literal["normal", "shear"]
CHANNELS: tuple[Channel, ...] = ("normal", "shear")

REQUIRED = ("trial", "time_s", "force_normal_n")
SHEAR_FORCE = ("force_shear_x_n", "force_shear_y_n")
CONTACT_SHARE = 0.05
"""Share of a law's span of load above which a load counts as contact, and by which it must fall to
count as unloading: above the noise of any usable gauge."""

LEAST_WAY_BACK = 0.02  # of all rows: of fewer no way back shows
HELD_SHARE = 0.1  # of the largest: what varies by less is held
RESPONSES: dict[Channel, tuple[str, ...]] = {
    "normal": ("volume_mm3",),
    "shear": ("shear_x_mm", "shear_y_mm"),
}

LEAST_KEPT, NUMBERS_KEPT = 8, 400_000
"""Results of one operator that are kept at least, and how many numbers in all beyond that."""

ROWS_PER_SMOOTHED = 80
"""Rows of a trial for each row of smoothing either way: so few are no peak of a press."""


class LoadHistory:
    """Samples of a log sorted by trial and time, with what the effects derive from them.

    Trial k, of ``n_trials``, is rows ``starts[k]`` to ``starts[k + 1]`` of the ``n_samples``.
    ``trial`` (N,) is its number in the log, ``trial_index`` (N,) k, ``time_s`` (N,) the session's
    clock, ``force_normal_n`` (N,) the force into the gel.

    ``columns`` are a press log's in tacgen's units, (N,) each: ``trial``, ``time_s`` and
    ``force_normal_n`` are required. Nothing is written to them. ``session`` is the history of the
    whole log where these rows are a part of it; forces that are not ``measured`` have no noise of a
    gauge to smooth. Raises ``ContactError`` if a required column is missing or not finite, or
    columns differ in length.
    """

    def __init__(
        self,
        columns: Mapping[str, ArrayLike],
        session: "LoadHistory | None" = None,
        *,
        measured: bool = True,
    ) -> None:
        arrays = {str(name): np.asarray(columns[name]) for name in columns}
        _require_usable(arrays)
        self.order = np.lexsort((arrays["time_s"], arrays["trial"]))
        self._columns = arrays
        self._sorted: dict[str, FloatArray] = {}
        self._reversals: dict[tuple[Channel, float], tuple[NDArray[np.int64], BoolArray]] = {}
        self._since_contact: dict[tuple[Channel, float], FloatArray] = {}
        self._kept: dict[str, tuple[FloatArray, dict[float, FloatArray]]] = {}
        self._made: dict[Hashable, Any] = {}
        self.session = session or self
        self._measured = measured
        trial = arrays["trial"][self.order]
        edges = np.flatnonzero(trial[1:] != trial[:-1]) + 1
        self.starts = np.unique([0, *edges, trial.size]).astype(np.int64)
        self.n_samples, self.n_trials = int(trial.size), int(self.starts.size - 1)
        self.trial_index = np.repeat(np.arange(self.n_trials), np.diff(self.starts))
        self.trial, self.time_s = self.column("trial"), self.column("time_s")
        self.force_normal_n = self.column("force_normal_n")

    def has(self, *names: str) -> bool:
        """Whether every one of these columns is there."""
        return all(name in self._columns for name in names)

    def column(self, name: str) -> FloatArray:
        """A numeric column (N,), sorted, read-only."""
        if name not in self._sorted:
            if name not in self._columns:
                msg = f"the log has no column {name!r}; it has {', '.join(self._columns)}"
                raise ContactError(msg)
            self._sorted[name] = self._columns[name][self.order].astype(np.float64)
            self._sorted[name].setflags(write=False)
        return self._sorted[name]

    def means_of_trials(self, name: str) -> FloatArray:
        """Mean (T,) of a numeric column over each trial."""
        sums = np.add.reduceat(self.column(name), self.starts[:-1])
        return np.asarray(sums / np.diff(self.starts))

    def text(self, name: str) -> NDArray[np.str_]:
        """A text column (N,), sorted."""
        return self._columns[name][self.order].astype(str)

    def is_text(self, name: str, text: str) -> BoolArray:
        """Where a text column is ``text`` (N,)."""
        return self.once((name, text), lambda: np.asarray(self.text(name) == text))

    def once(self, key: Hashable, make: Callable[[], Made]) -> Made:
        """What ``make`` returned for ``key`` when it was first asked for; not to be changed."""
        if key not in self._made:
            self._made[key] = make()
        made: Made = self._made[key]
        return made

    def unsorted(self, values: FloatArray) -> FloatArray:
        """``values`` (N, …) back in the order of the rows that were given."""
        result = np.empty_like(values)
        result[self.order] = values
        return result

    @cached_property
    def time_in_trial_s(self) -> FloatArray:
        """Time since the first sample of the trial."""
        first = self.time_s[self.starts[:-1]] if self.n_samples else np.zeros(0)
        return np.asarray(self.time_s - np.repeat(first, np.diff(self.starts)))

    @cached_property
    def force_shear_n(self) -> FloatArray:
        """Force along the gel (N, 2); 0 where it was not measured."""
        if not self.has(*SHEAR_FORCE):
            return np.zeros((self.n_samples, 2))
        force_n = np.stack([self.column(name) for name in SHEAR_FORCE], axis=1)
        return np.where(np.isnan(force_n), 0.0, force_n)

    @cached_property
    def shear_size_n(self) -> FloatArray:
        """|F_s| of a lightly smoothed shear force (N,)."""
        x, y = (self.smooth(self.force_shear_n[:, k]) for k in (0, 1))
        return np.hypot(x, y)

    @cached_property
    def normal_smooth_n(self) -> FloatArray:
        """A lightly smoothed normal force (N,), for what noise would bias: peaks and ratios."""
        return self.smooth(self.force_normal_n)

    def smooth(self, values: FloatArray) -> FloatArray:
        """``values`` (N,) averaged over neighbours where trials have enough samples for that."""
        if not self._measured:
            return values
        rows = int(np.median(np.diff(self.starts))) if self.n_samples else 0
        reach = min(2, rows // ROWS_PER_SMOOTHED)
        return kernels.moving_mean(np.ascontiguousarray(values), self.starts, reach)

    @cached_property
    def normal_span_n(self) -> float:
        """A high quantile of |force|: the scale of the log's loads."""
        return _span(self.normal_smooth_n)

    @cached_property
    def shear_span_n(self) -> float:
        """A high quantile of |shear force|."""
        return _span(self.shear_size_n)

    def load(self, channel: Channel) -> FloatArray:
        """The force that drives a channel: (N, 1) normal, or (N, 2) shear."""
        return self.force_shear_n if channel == "shear" else self._normal_load_n

    @cached_property
    def _normal_load_n(self) -> FloatArray:
        return self.force_normal_n[:, None]

    def play(self, load: FloatArray, width_n: float, isotropic: bool = False) -> FloatArray:
        """The play operator of half-width ``width_n`` on ``load`` (N, C), or on its every axis."""
        return self._of_parts("play", load, width_n, isotropic, kernels.play)

    def low_pass(self, load: FloatArray, tau_s: float) -> FloatArray:
        """``load`` (N, C) through a low-pass of time constant ``tau_s`` that starts at rest."""
        return self._of_axes(
            "low_pass",
            load,
            tau_s,
            lambda axis: kernels.low_pass(axis, self.time_s, self.starts, tau_s, True),
        )

    def left_over(self, channel: Channel, tau_s: float) -> FloatArray:
        """What such a low-pass of a channel's force still has (N, C) of the trials before."""
        return self._keep(
            f"low-pass before the trial, {channel}",
            self.load(channel),
            tau_s,
            lambda _: self._left_over(channel, tau_s),
        )

    def _left_over(self, channel: Channel, tau_s: float) -> FloatArray:
        session = self.session
        trial = np.searchsorted(session.trial[session.starts[:-1]], self.trial)
        since_s = self.time_s - session.time_s[session.starts[trial]]
        left = session._left_at_starts(channel, tau_s)[trial]
        return np.asarray(left * np.exp(-since_s / tau_s)[:, None])

    def _left_at_starts(self, channel: Channel, tau_s: float) -> FloatArray:
        trials, rows, starts = self._in_time
        axes = self.load(channel)[rows].T
        left = np.empty((self.n_trials, len(axes)))
        for axis, own in zip(left.T, axes, strict=True):
            own = np.ascontiguousarray(own)
            axis[trials] = kernels.left_over(own, self.time_s[rows], starts, tau_s)
        return left

    @cached_property
    def _in_time(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """The trials in the order of time, their rows, and where each begins among these."""
        trials = np.argsort(self.time_s[self.starts[:-1]], kind="stable")
        rows = np.argsort(np.argsort(trials)[self.trial_index], kind="stable")
        starts = np.cumsum([0, *np.diff(self.starts)[trials]])
        return trials, rows, starts

    @cached_property
    def pause_s(self) -> float:
        """Median time between trials of the session; infinite where the clock goes back."""
        _, rows, starts = self.session._in_time
        time_s = self.session.time_s[rows]
        pauses = time_s[starts[1:-1]] - time_s[starts[1:-1] - 1]
        return float(np.median(pauses)) if pauses.size and pauses.min() >= 0.0 else np.inf

    def dahl(self, load: FloatArray, width_n: float, isotropic: bool = False) -> FloatArray:
        """Dahl's friction on a lightly smoothed ``load`` (N, C), or on its every axis."""
        smooth = self._of_axes("smooth", load, 0.0, self.smooth)
        return self._of_parts("dahl", smooth, width_n, isotropic, kernels.dahl)

    def _of_parts(
        self,
        name: str,
        load: FloatArray,
        width_n: float,
        isotropic: bool,
        kernel: Callable[[FloatArray, NDArray[np.int64], float], FloatArray],
    ) -> FloatArray:
        """``kernel`` of that width on ``load``, or on its every axis, kept."""

        def of(load: FloatArray) -> FloatArray:
            parts = [load[:, part] for part in _parts(load.shape[1], isotropic)]
            own = [kernel(np.ascontiguousarray(one), self.starts, width_n) for one in parts]
            return np.concatenate(own, axis=1)

        return self._keep(f"{name}, {isotropic}", load, width_n, of)

    def _of_axes(
        self,
        name: str,
        load: FloatArray,
        number: float,
        kernel: Callable[[FloatArray], FloatArray],
    ) -> FloatArray:
        """``kernel`` of every axis of ``load``, kept."""
        return self._keep(
            name,
            load,
            number,
            lambda own: np.stack([kernel(np.ascontiguousarray(axis)) for axis in own.T], axis=1),
        )

    def _keep(
        self,
        name: str,
        load: FloatArray,
        number: float,
        kernel: Callable[[FloatArray], FloatArray],
    ) -> FloatArray:
        """``kernel`` of ``load``, kept until another load comes.

        A fit changes one number of a model at a time, and most leave the load as it is.
        """
        last, kept = self._kept.get(name, (None, {}))
        if last is not load or len(kept) >= max(LEAST_KEPT, NUMBERS_KEPT // max(load.size, 1)):
            kept = {}
            self._kept[name] = load, kept
        if number not in kept:
            kept[number] = kernel(load)
            kept[number].setflags(write=False)
        return kept[number]

    def span_n(self, channel: Channel) -> float:
        """A high quantile of the force that drives a channel."""
        return self.shear_span_n if channel == "shear" else self.normal_span_n

    def _smooth_n(self, channel: Channel) -> FloatArray:
        return self.shear_size_n if channel == "shear" else self.normal_smooth_n

    def reversal(
        self, channel: Channel, span_n: float | None = None
    ) -> tuple[NDArray[np.int64], BoolArray]:
        """Row of the largest load so far in the trial, and whether the load has turned back.

        The load counts as turned once it is below its last local maximum by more than a twentieth
        of ``span_n``, the log's span by default, so that noise on a hold is not taken for
        unloading.
        """
        key = channel, self.span_n(channel) if span_n is None else span_n
        if key not in self._reversals:
            margin = CONTACT_SHARE * key[1]
            self._reversals[key] = kernels.reversal(self._smooth_n(channel), self.starts, margin)
        return self._reversals[key]

    def is_unloaded(self, channel: Channel) -> bool:
        """Whether the load turns back in enough rows, and what it moves with it."""
        return self._turn_back(channel) == (True, True)

    def is_relaxing(self, channel: Channel) -> bool:
        """Whether it does so alone: a displacement is held, and the force falls by itself."""
        return self._turn_back(channel) == (True, False)

    def _turn_back(self, channel: Channel) -> tuple[bool, bool]:
        """Whether the load turns back for long enough, and whether its response does meanwhile."""
        turned, size = self.reversal(channel)[1], self._response(channel)
        both = turned
        if size is not None:
            margin = CONTACT_SHARE * _span(size)
            both = turned & kernels.reversal(size, self.starts, margin)[1]
        return bool(turned.mean() > LEAST_WAY_BACK), bool(both.mean() > LEAST_WAY_BACK)

    def is_moved(self, channel: Channel) -> bool:
        """Whether the response is of several loads, not of holds at one displacement alone."""
        size = self._response(channel)
        if size is None:
            return True
        low, high = np.quantile(size, [0.01, 0.99])
        return bool(high - low > HELD_SHARE * high)

    def is_hold(self, channel: Channel) -> bool:
        """Whether trials are mostly holds: most rows are near their trial's largest of either."""
        load, size = self._smooth_n(channel), self._response(channel)
        return any(
            float((one > (1.0 - HELD_SHARE) * self._peaks(one)).mean()) > 0.5
            for one in (load, size)
            if one is not None
        )

    def _peaks(self, values: FloatArray) -> FloatArray:
        return np.maximum.reduceat(values, self.starts[:-1])[self.trial_index]

    def _response(self, channel: Channel) -> FloatArray | None:
        """Size (N,) of a lightly smoothed response of a log; None where there is no log."""
        if not self.has(*RESPONSES[channel]):
            return None
        axes = [np.nan_to_num(self.smooth(self.column(name))) for name in RESPONSES[channel]]
        return np.asarray(np.linalg.norm(axes, axis=0))

    def peak_load(
        self, load: FloatArray, channel: Channel, span_n: float
    ) -> tuple[FloatArray, BoolArray]:
        """``load`` (N, C) at the channel's largest force so far, and whether it has turned back."""
        rows, unloading = self.reversal(channel, span_n)
        return load[rows], unloading

    def peak_since_contact(self, load: FloatArray, channel: Channel, span_n: float) -> FloatArray:
        """``load`` (N, C) at the largest force since the trial's last contact began."""
        least = CONTACT_SHARE * span_n
        return load[kernels.peak_since_contact(self._smooth_n(channel), self.starts, least)]

    def time_since_contact_s(self, channel: Channel, span_n: float) -> FloatArray:
        """Time since the load first stood above a twentieth of ``span_n``, trial by trial (N,).

        0 before, and in trials where it never did.
        """
        key = channel, span_n
        if key not in self._since_contact:
            loaded = self._smooth_n(channel) > CONTACT_SHARE * span_n
            start = np.full(self.n_trials, np.inf)
            np.minimum.at(start, self.trial_index[loaded], self.time_s[loaded])
            since = np.maximum(self.time_s - start[self.trial_index], 0.0)
            self._since_contact[key] = since
        return self._since_contact[key]

    def seen_by(self, effect: Hashable) -> "LoadHistory":
        """The history as one effect of a law sees it, kept by ``effect``."""
        return self

    @cached_property
    def trial_duration_s(self) -> float:
        """Median duration of a trial, at least one sampling period."""
        ends = self.time_in_trial_s[self.starts[1:] - 1]
        return max(float(np.median(ends)), self.sample_period_s)

    @cached_property
    def sample_period_s(self) -> float:
        """Median time between samples of a trial; 1 where no trial has two."""
        steps = np.delete(np.diff(self.time_s), self.starts[1:-1] - 1)
        steps = steps[steps > 0]
        return float(np.median(steps)) if steps.size else 1.0


class Reading(LoadHistory):
    """The newest sample of a load: the history of one row, whose operators go on from a state.

    ``row`` has the columns of a press log; ``before`` is the ``memory`` that the reading before it
    left, empty for the first one. An operator gives the same numbers as that of the whole history,
    and its state passes from trial to trial where that of the history does.
    """

    def __init__(self, row: Mapping[str, float], before: Memory) -> None:
        columns = {name: np.array([value]) for name, value in row.items()}
        super().__init__(columns, measured=False)
        self._before = before
        self._effect: Hashable = None
        self._trial, self._now_s = float(self.trial[0]), float(self.time_s[0])
        self.memory: dict[Hashable, tuple[float, Any]] = {}

    def seen_by(self, effect: Hashable) -> "Reading":
        """The same reading, with the memory of one effect."""
        self._effect = effect
        return self

    def _next(self, *key: Hashable, of: Callable[[Any], Any]) -> Any:
        """The state after this reading: ``of`` the one before it, None at a trial's first."""
        whole = (self._effect, *key)
        if whole not in self.memory:
            trial, state = self._before.get(whole, (self._trial, None))
            self.memory[whole] = self._trial, of(state if trial == self._trial else None)
        return self.memory[whole][1]

    def low_pass(self, load: FloatArray, tau_s: float) -> FloatArray:
        """As of ``LoadHistory``."""

        def step(state: Any) -> Any:
            then_s, last, filtered = state or (self._now_s, load[0], np.zeros(load.shape[1]))
            gone_s = self._now_s - then_s
            axes = zip(filtered, last, load[0], strict=True)
            passed = [kernels.next_low_pass(*axis, gone_s, tau_s) for axis in axes]
            return self._now_s, load[0], np.array(passed)

        return np.asarray(self._next("low_pass", tau_s, of=step)[2][None])

    def left_over(self, channel: Channel, tau_s: float) -> FloatArray:
        """As of ``LoadHistory``: what the trials that were read before this one left."""
        load = self.load(channel)[0]
        key = (self._effect, "left_over", channel, tau_s)
        trial, state = self._before.get(key, (self._trial, None))
        if state is None:
            state = self._now_s, np.zeros(load.size), self._now_s, load, np.zeros(load.size)
        start_s, left, then_s, last, filtered = state
        gone_s = self._now_s - then_s
        if trial == self._trial:
            axes = zip(filtered, last, load, strict=True)
            passed = [kernels.next_low_pass(*axis, gone_s, tau_s) for axis in axes]
            filtered = np.array(passed)
        else:
            start_s = self._now_s
            left = filtered = filtered * (np.exp(-gone_s / tau_s) if gone_s >= 0.0 else 0.0)
        self.memory[key] = self._trial, (start_s, left, self._now_s, load, filtered)
        return np.asarray(left * np.exp(-(self._now_s - start_s) / tau_s))[None]

    def play(self, load: FloatArray, width_n: float, isotropic: bool = False) -> FloatArray:
        """As of ``LoadHistory``."""

        def step(state: Any) -> Any:
            rows = np.concatenate([load, load])
            at = np.zeros_like(rows) if state is None else np.array([state, state])
            for part in _parts(load.shape[1], isotropic):
                kernels.next_play(at[:, part], rows[:, part], 1, 0, width_n)
            return at[1]

        return np.array([self._next("play", width_n, isotropic, of=step)])

    def dahl(self, load: FloatArray, width_n: float, isotropic: bool = False) -> FloatArray:
        """As of ``LoadHistory``."""

        def step(state: Any) -> Any:
            if state is None:
                return load[0], np.zeros(load.shape[1])
            rows, at = np.array([state[0], load[0]]), np.array([state[1], state[1]])
            for part in _parts(load.shape[1], isotropic):
                kernels.next_dahl(at[:, part], rows[:, part], 1, width_n)
            return load[0], at[1]

        return np.array([self._next("dahl", width_n, isotropic, of=step)[1]])

    def peak_load(
        self, load: FloatArray, channel: Channel, span_n: float
    ) -> tuple[FloatArray, BoolArray]:
        """As of ``LoadHistory``."""
        size = float(self._smooth_n(channel)[0])

        def step(state: Any) -> Any:
            top, peak, turn, back = state or (size, load[0], size, False)
            if size > top:
                top, peak = size, load[0]
            return top, peak, *kernels.next_turn(turn, back, size, CONTACT_SHARE * span_n)

        _, peak, _, back = self._next("peak", channel, span_n, of=step)
        return peak[None], np.array([back])

    def peak_since_contact(self, load: FloatArray, channel: Channel, span_n: float) -> FloatArray:
        """As of ``LoadHistory``."""
        size, least = float(self._smooth_n(channel)[0]), CONTACT_SHARE * span_n

        def step(state: Any) -> Any:
            is_peak = state is None or kernels.is_new_peak(state[0], size, least)
            return (size, load[0]) if is_peak else state

        return np.asarray(self._next("peak since contact", channel, span_n, of=step)[1][None])

    def time_since_contact_s(self, channel: Channel, span_n: float) -> FloatArray:
        """As of ``LoadHistory``."""
        loaded = bool(self._smooth_n(channel)[0] > CONTACT_SHARE * span_n)

        def step(start_s: Any) -> Any:
            return self._now_s if start_s is None and loaded else start_s

        start_s = self._next("contact", channel, span_n, of=step)
        return np.array([0.0 if start_s is None else max(self._now_s - start_s, 0.0)])


def _parts(size: int, isotropic: bool) -> list[slice]:
    """All axes of a vector together, or one each."""
    return [slice(0, size)] if isotropic else [slice(k, k + 1) for k in range(size)]


def _span(load: FloatArray) -> float:
    return (float(np.quantile(np.abs(load), 0.99)) if load.size else 0.0) or 1.0


def _require_usable(arrays: Mapping[str, NDArray[Any]]) -> None:
    missing = [name for name in REQUIRED if name not in arrays]
    if missing:
        msg = f"the log lacks {', '.join(missing)}; a contact law needs {', '.join(REQUIRED)}"
        raise ContactError(msg)
    length = arrays["trial"].size
    problems = [
        f"column {name!r} has shape {array.shape}, not ({length},) as 'trial' has"
        for name, array in arrays.items()
        if array.shape != (length,)
    ]
    problems += [
        f"column {name!r} holds a value that is not a finite number; drop those rows"
        for name in REQUIRED
        if not np.issubdtype(arrays[name].dtype, np.number) or not np.isfinite(arrays[name]).all()
    ]
    ContactError.raise_if(problems)

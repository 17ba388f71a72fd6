"""Rows of a press log that are independent readings, of all that were written down.

Laboratories join a slow device to a fast one by its last value, write rows twice, resample to
another rate, smooth. The rows are then more than the readings, and whatever counts rows, or takes
the noise of neighbours as independent, is wrong. Here each reading is left in one row:

* A reading *stands* in several rows where, while the load moves, its column repeats a value and
  then changes by more than its resolution. The first row of each is kept: there it is fresh.
* Noise *goes on* from row to row where second and fourth differences of what functions of the
  load leave in each trial, which no smooth course has, are smaller between neighbours than
  between rows further apart. Every n-th row is kept, n the least distance beyond which they no
  longer grow: of a moving average over n rows, or of an n-fold interpolation, these have all that
  was measured.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.core.types import BoolArray, FloatArray, IntArray
from tacgen.presses.rules import LOG

CHANNELS = (
    (("force_normal_n", "volume_mm3"),),
    (("force_shear_x_n", "shear_x_mm"), ("force_shear_y_n", "shear_y_mm")),
)
"""A force and its response each, by channel and axis."""


def independent_rows(columns: Mapping[str, NDArray[Any]]) -> tuple[BoolArray, list[str]]:
    """Which rows (N,) of a press log to keep, and what was found, a sentence each.

    ``columns`` (N,) each hold whole trials in one block; values may be NaN.
    """
    keep = np.ones(len(columns["trial"]), dtype=bool)
    notes = []
    for find in (_repeated_rows, _standing_readings, _correlated_noise):
        kept = np.flatnonzero(keep)
        own, note = find(_Rows({name: values[kept] for name, values in columns.items()}))
        if note:
            keep[kept[~own]] = False
            notes.append(f"{note} ({int(own.sum())} of {own.size} rows)")
    return keep, notes


@dataclass(frozen=True)
class _Rows:
    columns: Mapping[str, NDArray[Any]]

    @property
    def starts(self) -> IntArray:
        """First row of each trial, and the number of rows: (T + 1,)."""
        trial = np.asarray(self.columns["trial"])
        first = np.flatnonzero(np.diff(trial)) + 1
        return np.concatenate([[0], first, [trial.size]]).astype(np.int64)

    @property
    def names(self) -> list[str]:
        """Measured columns, forces and responses."""
        pairs = (pair for channel in CHANNELS for pair in channel)
        return [name for pair in pairs for name in pair if name in self.columns]

    @property
    def most_rows(self) -> int:
        """Most rows that noise may go on for, so that a typical trial keeps enough."""
        return min(LOG.most_rows, int(np.median(np.diff(self.starts))) // LOG.least_rows)

    def changes(self, name: str) -> BoolArray:
        """Rows (N,) with another value than the one before them, and first ones of trials."""
        values = np.asarray(self.columns[name])
        changed = np.ones(values.size, dtype=bool)
        is_number = values.dtype.kind == "f"
        same = values[1:] == values[:-1]
        if is_number:
            same |= np.isnan(values[1:]) & np.isnan(values[:-1])
        changed[1:] = ~same
        changed[self.starts[:-1]] = True
        return changed


def _repeated_rows(rows: _Rows) -> tuple[BoolArray, str]:
    """Rows that are, with their time, the row before."""
    keep = np.logical_or.reduce([rows.changes(name) for name in ("time_s", *rows.names)])
    return keep, "" if keep.all() else "rows repeat the row before them; each is used once"


def _standing_readings(rows: _Rows) -> tuple[BoolArray, str]:
    """One row for each reading of the column whose readings stand longest."""
    found: dict[str, float] = {}
    for channel in CHANNELS:
        for pair in channel:
            if all(name in rows.columns for name in pair):
                for name, other in (pair, pair[::-1]):
                    if count := _rows_of_a_reading(rows, name, other):
                        found[name] = count
    if not found:
        return np.ones(len(rows.columns["trial"]), dtype=bool), ""
    name, count = max(found.items(), key=lambda one: one[1])
    fresh = np.flatnonzero(rows.changes(name))
    keep = np.zeros(len(rows.columns["trial"]), dtype=bool)
    step = max(round(count), 1)
    for first, stop in pairwise([*fresh, keep.size]):
        # A reading that is the same as the one before it is one of its own.
        keep[first : max(stop - step // 2, first + 1) : step] = True
    same = [one for one, other_count in found.items() if other_count > 0.8 * count]
    every = len(found) == len(rows.names) and len(same) == len(found)
    what = "every row" if every else f"each reading of {', '.join(same)}"
    rate = _rate_words(rows, count)
    return keep, f"{what} stands in {count:.3g} rows{rate}; the first of each is used"


def _rate_words(rows: _Rows, count: float) -> str:
    steps = np.diff(np.asarray(rows.columns["time_s"], dtype=np.float64))
    steps = steps[steps > 0]
    return f" ({1.0 / (count * float(np.median(steps))):.3g} Hz)" if steps.size else ""


def _rows_of_a_reading(rows: _Rows, name: str, other: str) -> float:
    """In how many rows a reading of ``name`` stands; 0 if it does not, or that is not clear.

    Not where the ``other`` of its channel stands still as well while the rest of the rows changes:
    a commanded force that is held is no reading that stands.
    """
    values, others = (np.asarray(rows.columns[one], dtype=np.float64) for one in (name, other))
    first = np.flatnonzero(rows.changes(name))
    last = np.r_[first[1:], values.size] - 1
    trial = np.searchsorted(rows.starts, first, side="right")
    inner = np.flatnonzero((trial[1:-1] == trial[:-2]) & (trial[1:-1] == trial[2:])) + 1
    before, after = values[first[inner]] - values[first[inner - 1]], np.zeros(inner.size)
    after = values[first[inner + 1]] - values[first[inner]]
    sizes = np.abs(np.r_[before, after])
    if not np.any(sizes > 0):
        return 0.0
    least = LOG.clear_steps * float(np.nanmin(sizes[sizes > 0]))
    length = last - first + 1
    common = np.unique(values[np.isfinite(values)], return_counts=True)
    rest = common[0][np.argmax(common[1])]  # no contact, say: exactly the same for long
    clear = (np.abs(before) > least) & (np.abs(after) > least) & (values[first[inner]] != rest)
    inner, moved = inner[clear], 0.5 * (before + after)[clear]
    count = length[inner]
    if inner.size < LOG.least_runs or (count > 1).mean() < LOG.standing_share:
        return 0.0
    alone = rows.changes(other)
    inside = np.ones(values.size, dtype=bool)
    inside[first] = False
    if alone[inside].mean() > 0.1:  # else the other stands with it: doubled rows
        went = others[last[inner]] - others[first[inner]]
        expected = moved * (count - 1) / count
        slope = _slope(values, others)
        share = float(np.nansum(went * expected)) / max(float(np.nansum(expected**2)), 1e-300)
        if not share * np.sign(slope) > LOG.moving_share * abs(slope):
            return 0.0
    return float(np.mean(count[count <= 2 * np.median(count)]))


def _slope(values: FloatArray, others: FloatArray) -> float:
    known = np.isfinite(values) & np.isfinite(others)
    square = float(values[known] @ values[known])
    return float(values[known] @ others[known]) / max(square, 1e-300)


def _correlated_noise(rows: _Rows) -> tuple[BoolArray, str]:
    """Every n-th row of each trial, where noise goes on for n rows."""
    count = max(_memory(_residuals(rows, channel), rows.most_rows) for channel in CHANNELS)
    keep = np.ones(len(rows.columns["trial"]), dtype=bool)
    if count == 1 or rows.starts.size <= LOG.least_trials:
        return keep, ""
    place = np.arange(keep.size) - np.repeat(rows.starts[:-1], np.diff(rows.starts))
    keep = place % count == 0
    note = (
        f"the noise of neighbouring rows is not independent, as of readings that were smoothed or "
        f"resampled: it goes on for {count} rows; every {count}{_ordinal(count)} row is used"
    )
    return keep, note


def _ordinal(count: int) -> str:
    return {2: "nd", 3: "rd"}.get(count, "th")


def _residuals(rows: _Rows, channel: Sequence[tuple[str, str]]) -> Sequence[FloatArray]:
    """What functions of the cleaner of two columns leave of the other in each trial, in order.

    The noise of the column that functions are of would be spread over neighbours by the fit.
    """
    found = list[FloatArray]()
    for pair in channel:
        if not all(name in rows.columns for name in pair):
            continue
        force, response = (np.asarray(rows.columns[one], dtype=np.float64) for one in pair)
        slope = _slope(force, response)
        if _jitter(rows, force) * abs(slope) > _jitter(rows, response):
            force, response = response, force
        for first, stop in pairwise(rows.starts):
            known = np.isfinite(force[first:stop]) & np.isfinite(response[first:stop])
            if known.sum() > 2 * _N_FUNCTIONS:
                load, answer = force[first:stop][known], response[first:stop][known]
                design = _functions(load)
                found.append(answer - design @ np.linalg.lstsq(design, answer, rcond=1e-6)[0])
    return found


def _jitter(rows: _Rows, values: FloatArray) -> float:
    """Noise of a column and what bends its course: the median size of fourth differences."""
    factors = np.array(_DIFFERENCES[4])
    bends = [
        np.abs(np.convolve(values[first:stop], factors, mode="valid"))
        for first, stop in pairwise(rows.starts)
        if stop - first >= len(factors)
    ]
    return float(np.nanmedian(np.concatenate([np.zeros(1), *bends])))


_N_FUNCTIONS = 7


def _functions(load: FloatArray) -> FloatArray:
    """What a response may follow in a trial (N, 7): the load's size, past and course, and time."""
    time = np.linspace(-1.0, 1.0, load.size)
    before, after = np.r_[load[:1], load[:-1]], np.r_[load[1:], load[-1:]]
    highest = np.maximum.accumulate(np.abs(load))
    columns = [np.ones_like(load), load, load * np.abs(load), before, after, highest, time]
    return np.stack([one / (float(np.abs(one).max()) or 1.0) for one in columns], axis=1)


def _memory(residuals: Sequence[FloatArray], most: int) -> int:
    """Over how many rows the noise of ``residuals`` goes on: 1 where rows are independent.

    Noise is the same between neighbours as between rows further apart, once they are: of every
    n-th row alone, as of what was interpolated, or of all rows, as of what was smoothed.
    """

    def share(near: tuple[int, int], far: tuple[int, int], step: int = 1) -> float:
        return _noise_ratio([one[::step] for one in residuals], near, far)

    is_correlated = max(share((1, order), (3, order)) for order in (2, 4)) < LOG.correlated_share
    if not (is_correlated and share((2, 4), (2, 2)) > LOG.noise_share):
        return 1
    for count in range(2, most + 1):
        further = -(-7 * count // 5)
        of_all = [share((count, order), (further, order)) for order in (2, 4)]
        shares = share((1, 2), (2, 2), count), float(np.mean(of_all))
        if any(one >= LOG.white_share for one in shares):
            return count
    return max(most, 1)


_DIFFERENCES = {2: (1.0, -2.0, 1.0), 4: (1.0, -4.0, 6.0, -4.0, 1.0)}


def _noise_ratio(
    residuals: Sequence[FloatArray], near: tuple[int, int], far: tuple[int, int]
) -> float:
    """Variance of noise by ``near`` differences over that by ``far`` ones, NaN if it is not known.

    Each is a number of rows between neighbours and an order, and both are taken about the same
    rows. Variances are medians, since corners of the load are few.
    """
    reach = max(lag * order // 2 for lag, order in (near, far))
    squares: list[FloatArray] = []
    for lag, order in (near, far):
        factors = np.array(_DIFFERENCES[order])
        found = [np.zeros(0)]
        for values in residuals:
            rows = values.size - 2 * reach
            if rows > 0:
                offsets = reach + lag * (np.arange(order + 1) - order // 2)
                found.append(factors @ np.stack([values[i : i + rows] for i in offsets]))
        squares.append(np.concatenate(found) ** 2 / float(factors @ factors))
    if squares[0].size < LOG.least_runs or not np.median(squares[1]) > 0:
        return float("nan")
    return float(np.median(squares[0]) / np.median(squares[1]))

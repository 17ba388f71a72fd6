"""Rows of a press log that are independent readings, of all that were written down.

Laboratories join a slow device to a fast one by its last value, and write rows twice. The rows
are then more than the readings, and whatever counts rows is wrong. Here each reading is left in
one row:

* A reading *stands* in several rows where, while the load moves, its column repeats a value and
  then changes by more than its resolution. The first row of each is kept: there it is fresh.

Noise that goes on from row to row, of readings that were smoothed or interpolated as of a gel, is
left as it is: a diagnosis counts trials, or parts of them that are longer than it.
"""

from collections.abc import Mapping
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
    for find in (_repeated_rows, _standing_readings):
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

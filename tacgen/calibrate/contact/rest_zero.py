"""The zero of gauge and gel, stated by the rows at rest before each press.

V = k_n F_n goes through the origin. A gauge that was not tared, a volume or a shear that is not 0
where nothing touches, bends that line, and the calibration would take it for another k.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from tacgen.core.arrays import FloatArray, IntArray
from tacgen.core.records import frozen_array
from tacgen.presses.press_log import SHEAR, PressLog

LEAST_ROWS = 3  # at rest before a press
LEAST_TRIALS = 3  # that have them
REACH = 5.0  # standard deviations of a sample's noise that a row at rest may be off
APART = 2.0  # times the noise of their means that zeros of trials differ by where they wander
CLEAR = 5.0  # standard errors that a zero must be off
LEAST_SHARE = 0.005  # of a column's span: less does not matter beside any interval
PRESSED = 10.0  # standard deviations of the noise that a press rises above its rest


@dataclass(frozen=True, slots=True)
class _Zero:
    """What a column reads at rest: pooled, and what each trial's samples are off by (T,)."""

    pooled: float
    offset: FloatArray
    wanders: bool


def without_zero(log: PressLog) -> PressLog:
    """``log`` less what each measured column reads at rest, with warnings that say so.

    Where zeros differ from trial to trial, each trial's own is subtracted. Nothing changes where
    too few presses begin at rest, or all is 0 there.
    """
    trial = log["trial"]
    first = np.flatnonzero(np.diff(trial)) + 1
    bounds: IntArray = np.concatenate([[0], first, [len(trial)]]).astype(np.int64)
    rests = _rows_at_rest(log, bounds)
    if sum(rows.size > 0 for rows in rests) < LEAST_TRIALS:
        return log
    columns, notes = dict(log.columns), list(log.warnings)
    for name in ("force_normal_n", "volume_mm3", *SHEAR):
        if name in log and (zero := _zero(log[name], rests)):
            columns[name] = frozen_array(log[name] - np.repeat(zero.offset, np.diff(bounds)))
            notes.append(f"{log.path}: {_sentence(name, zero)}")
    return replace(log, columns=columns, warnings=tuple(notes))


def _rows_at_rest(log: PressLog, bounds: IntArray) -> list[IntArray]:
    """The first rows of each trial, for as long as neither force nor volume leaves its lowest."""
    measured = [log["force_normal_n"], log["volume_mm3"]]
    noise = [_noise(values, bounds) for values in measured]
    return [_rest(start, stop, measured, noise) for start, stop in pairwise(bounds)]


def _rest(
    start: int, stop: int, measured: Sequence[FloatArray], noise: Sequence[float]
) -> IntArray:
    count = stop - start
    for values, sigma in zip(measured, noise, strict=True):
        own = values[start:stop]
        level = float(np.median(own[:LEAST_ROWS]))
        reach = REACH * sigma + 1e-9 * float(np.ptp(own))
        is_lowest = level - float(np.quantile(own, 0.05)) <= reach
        if not is_lowest or own.max() - level <= PRESSED * sigma:
            return np.zeros(0, dtype=np.int64)
        away = np.flatnonzero(np.abs(own - level) > reach)
        count = min(count, int(away[0]) if away.size else count)
    return np.arange(start, start + count if count >= LEAST_ROWS else start, dtype=np.int64)


def _noise(values: FloatArray, bounds: IntArray) -> float:
    """Robust standard deviation of a sample's noise, from second differences within trials."""
    bends = [np.diff(values[start:stop], 2) for start, stop in pairwise(bounds)]
    return float(1.4826 * np.median(np.abs(np.concatenate(bends))) / np.sqrt(6.0))


def _zero(values: FloatArray, rests: Sequence[IntArray]) -> _Zero | None:
    """The zero of a column (N,) by the rows at rest of each trial; None where it is 0 anyway."""
    seen = np.array([float(values[rows].mean()) if rows.size else np.nan for rows in rests])
    known = np.flatnonzero(np.isfinite(seen))
    if known.size < LEAST_TRIALS:
        return None
    pooled = float(np.median(seen[known]))
    own_rows = [rests[int(k)] for k in known]
    scatter = [values[rows] - values[rows].mean() for rows in own_rows]
    counts = np.array([rows.size for rows in own_rows])
    freedom = max(int((counts - 1).sum()), 1)
    sample = float(np.sqrt((np.concatenate(scatter) ** 2).sum() / freedom))
    span = float(np.nanquantile(np.abs(values - pooled), 0.99))
    between = float(seen[known].std())
    by_noise = sample / np.sqrt(float(counts.mean()))
    wanders = between > max(APART * by_noise, LEAST_SHARE * span)
    error = max(between, by_noise) / np.sqrt(known.size)
    if not wanders and abs(pooled) <= max(CLEAR * error, LEAST_SHARE * span):
        return None
    own = np.where(np.isfinite(seen), seen, pooled) if wanders else np.full(seen.size, pooled)
    return _Zero(pooled, own, wanders)


def _sentence(name: str, zero: _Zero) -> str:
    unit = {"n": "N", "mm3": "mm³", "mm": "mm"}[name.rsplit("_", 1)[1]]
    if not zero.wanders:
        return (
            f"{name} is {zero.pooled:.3g} {unit} at rest, before the presses: that is subtracted; "
            "tare the gauge, or the volume of a bare gel, before you record"
        )
    low, high = float(zero.offset.min()), float(zero.offset.max())
    return (
        f"{name} at rest differs from press to press, {low:.3g} to {high:.3g} {unit}: each "
        "press's own zero is subtracted"
    )

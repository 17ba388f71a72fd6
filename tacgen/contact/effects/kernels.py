"""Recursions along time, trial by trial: the state that effects with memory carry.

Every function takes values (N,) sorted by trial and time and ``starts`` (n_trials + 1,), where
trial k is rows ``starts[k]`` to ``starts[k + 1]``; no state passes from one trial to the next.
Those called ``next_…`` are one step of such a recursion, from a state to the one after it.
"""

import numpy as np
from numpy.typing import NDArray

from tacgen.core.compiled import njit
from tacgen.core.types import BoolArray, FloatArray


@njit(cache=True)
def next_low_pass(state: float, before: float, value: float, step_s: float, tau_s: float) -> float:
    """The q of τ q' = value − q a step after it was ``state``, the value linear meanwhile."""
    if step_s <= 0.0:
        return state
    decay: float = np.exp(-step_s / tau_s)
    lag = (value - before) / step_s * tau_s
    return value - lag + (state - before + lag) * decay


@njit(cache=True)
def low_pass(
    values: FloatArray, time_s: FloatArray, starts: NDArray[np.int64], tau_s: float, from_rest: bool
) -> FloatArray:
    """Solution q of τ q' = values − q, exact for values linear between samples.

    q starts at 0 (``from_rest``: nothing had been loaded before) or at the first value.
    """
    result = np.empty(values.size)
    for k in range(starts.size - 1):
        first, stop = starts[k], starts[k + 1]
        state = 0.0 if from_rest else values[first]
        result[first] = state
        for i in range(first + 1, stop):
            step_s = time_s[i] - time_s[i - 1]
            state = result[i] = next_low_pass(state, values[i - 1], values[i], step_s, tau_s)
    return result


@njit(cache=True)
def left_over(
    values: FloatArray, time_s: FloatArray, starts: NDArray[np.int64], tau_s: float
) -> FloatArray:
    """What ``low_pass``, from rest, still has (T,) of the trials before as each of them starts.

    Between trials, which are in the order of time here, nothing is loaded; where the clock goes
    back nothing is left.
    """
    result = np.zeros(starts.size - 1)
    for k in range(starts.size - 2):
        state, last = result[k], starts[k + 1] - 1
        for i in range(starts[k] + 1, last + 1):
            step_s = time_s[i] - time_s[i - 1]
            state = next_low_pass(state, values[i - 1], values[i], step_s, tau_s)
        pause_s = time_s[last + 1] - time_s[last]
        result[k + 1] = state * np.exp(-pause_s / tau_s) if pause_s >= 0.0 else 0.0
    return result


@njit(cache=True)
def smoothed(
    values: FloatArray, time_s: FloatArray, starts: NDArray[np.int64], tau_s: float
) -> FloatArray:
    """Exponential smoothing of the samples, as software does it: q += (1 − exp(−Δt/τ))(value − q).

    q starts at the first value.
    """
    result = np.empty(values.size)
    for k in range(starts.size - 1):
        state = values[starts[k]]
        result[starts[k]] = state
        for i in range(starts[k] + 1, starts[k + 1]):
            state -= np.expm1((time_s[i - 1] - time_s[i]) / tau_s) * (values[i] - state)
            result[i] = state
    return result


@njit(cache=True)
def delayed(
    values: FloatArray, time_s: FloatArray, starts: NDArray[np.int64], delay_s: float
) -> FloatArray:
    """values(t − delay) by linear interpolation, the ends of each trial held."""
    # numba takes 3 s to compile ``np.interp``, as long as a first diagnosis takes otherwise.
    result = np.empty(values.size)
    for k in range(starts.size - 1):
        first, last = starts[k], starts[k + 1] - 1
        after = first
        for i in range(first, last + 1):
            wanted_s = time_s[i] - delay_s
            while after < last and time_s[after] <= wanted_s:
                after += 1
            before = max(after - 1, first)
            step_s = time_s[after] - time_s[before]
            share = (wanted_s - time_s[before]) / step_s if step_s > 0.0 else 1.0
            share = min(max(share, 0.0), 1.0)
            result[i] = values[before] + share * (values[after] - values[before])
    return result


@njit(cache=True)
def next_play(result: FloatArray, values: FloatArray, row: int, before: int, width: float) -> None:
    """Fill a row of the play operator of ``values`` (N, C) from the row before it."""
    square = 0.0
    for axis in range(values.shape[1]):
        square += (values[row, axis] - result[before, axis]) ** 2
    share = 1.0 - width / np.sqrt(square) if square > width**2 else 0.0
    for axis in range(values.shape[1]):
        at = result[before, axis]
        result[row, axis] = at + share * (values[row, axis] - at)


@njit(cache=True)
def play(values: FloatArray, starts: NDArray[np.int64], width: float) -> FloatArray:
    """The play (backlash) operator of half-width ``width`` on vectors (N, C), starting at rest.

    A ball of that radius drags along what is in it.
    Source: Krasnosel'skii & Pokrovskii 1989, Systems with Hysteresis: the Prandtl play; of
    vectors, Visintin 1994, Differential Models of Hysteresis, ch. III.
    """
    result = np.zeros(values.shape)
    for k in range(starts.size - 1):
        for i in range(starts[k], starts[k + 1]):
            next_play(result, values, i, max(i - 1, starts[k]), width)
    return result


@njit(cache=True)
def next_dahl(result: FloatArray, values: FloatArray, row: int, width: float) -> None:
    """Fill a row of Dahl's friction of ``values`` (N, C) from the row before it."""
    square = 0.0
    for axis in range(values.shape[1]):
        square += (values[row, axis] - values[row - 1, axis]) ** 2
    size = np.sqrt(square)
    decay = np.exp(-size / width)
    for axis in range(values.shape[1]):
        step = values[row, axis] - values[row - 1, axis]
        end = width / size * step if size > 0.0 else 0.0
        result[row, axis] = end + (result[row - 1, axis] - end) * decay


@njit(cache=True)
def dahl(values: FloatArray, starts: NDArray[np.int64], width: float) -> FloatArray:
    """Friction (N, C) that saturates at ``width`` exponentially with the way since the last turn.

    Source: Dahl 1968, A solid friction model, with exponent 1, along the way of a vector:
    dz = dx − |dx|·z/width.
    """
    result = np.zeros(values.shape)
    for k in range(starts.size - 1):
        for i in range(starts[k] + 1, starts[k + 1]):
            next_dahl(result, values, i, width)
    return result


@njit(cache=True)
def moving_mean(values: FloatArray, starts: NDArray[np.int64], reach: int) -> FloatArray:
    """Mean over the samples from i − reach to i + reach, symmetric and narrower at the ends."""
    result = np.empty(values.size)
    for k in range(starts.size - 1):
        first, stop = starts[k], starts[k + 1]
        for i in range(first, stop):
            half = min(reach, i - first, stop - 1 - i)
            result[i] = values[i - half : i + half + 1].mean()
    return result


@njit(cache=True)
def is_new_peak(peak: float, value: float, least: float) -> bool:
    """Whether the next value is the largest since the load last stood above ``least``."""
    return value > peak or value < least or peak < least


@njit(cache=True)
def peak_since_contact(
    load: FloatArray, starts: NDArray[np.int64], least: float
) -> NDArray[np.int64]:
    """Row of the largest load since it last stood above ``least``, in contact; else the row."""
    peak_row = np.empty(load.size, dtype=np.int64)
    for k in range(starts.size - 1):
        best = starts[k]
        for i in range(starts[k], starts[k + 1]):
            if is_new_peak(load[best], load[i], least):
                best = i
            peak_row[i] = best
    return peak_row


@njit(cache=True)
def next_turn(turn: float, back: bool, value: float, margin: float) -> tuple[float, bool]:
    """The last turning point, and whether the load is on its way back, after the next value."""
    turn = min(turn, value) if back else max(turn, value)
    if abs(value - turn) > margin:
        return value, not back
    return turn, back


@njit(cache=True)
def reversal(
    load: FloatArray, starts: NDArray[np.int64], margin: float
) -> tuple[NDArray[np.int64], BoolArray]:
    """Row of the largest load so far in the trial, and whether the load is on its way back."""
    peak_row = np.empty(load.size, dtype=np.int64)
    unloading = np.zeros(load.size, dtype=np.bool_)
    for k in range(starts.size - 1):
        best = starts[k]
        turn = load[starts[k]]
        back = False
        for i in range(starts[k], starts[k + 1]):
            if load[i] > load[best]:
                best = i
            turn, back = next_turn(turn, back, load[i], margin)
            peak_row[i] = best
            unloading[i] = back
    return peak_row, unloading

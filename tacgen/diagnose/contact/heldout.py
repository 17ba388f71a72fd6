"""Trials that neither fit nor choice sees, and errors on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.core.arrays import BoolArray, FloatArray, IntArray
from tacgen.diagnose.contact.channel import Columns
from tacgen.diagnose.contact.rules import SelectionRules


@dataclass(frozen=True)
class Errors:
    """Root-mean-square error on held-out trials, and each trial's sum of squares and count."""

    rmse: float
    nrmse: float
    squares: FloatArray
    counts: IntArray


def test_trials(columns: Columns, rng: np.random.Generator, rules: SelectionRules) -> NDArray[Any]:
    """Trials to hold out: one of every four in the order of the session.

    Neighbours in time are on both sides, and so is every part of the session; the first trial
    stays in the fit, since nothing else tells how the first presses differ.
    """
    trial = np.asarray(columns["trial"])
    numbers, first = np.unique(trial, return_index=True)
    start = np.asarray(columns["time_s"])[first]
    ordered = numbers[np.lexsort((numbers, start))]
    chosen = []
    count = rules.trials_per_test_trial
    for begin in range(0, ordered.size, count):
        group = ordered[begin : begin + count]
        low = 1 if begin == 0 else 0
        if group.size > 1 + low:
            chosen.append(group[int(rng.integers(low, group.size))])
    return np.asarray(chosen)


def select(columns: Columns, mask: BoolArray) -> dict[str, NDArray[Any]]:
    """The rows of ``columns`` where ``mask`` holds."""
    return {name: np.asarray(values)[mask] for name, values in columns.items()}


def errors(residual: FloatArray, trial: FloatArray, scale: float) -> Errors:
    """Errors of a residual (N, C): RMS over samples and outputs, and the same over ``scale``."""
    _, inverse = np.unique(trial, return_inverse=True)
    squares = np.bincount(inverse, (residual**2).mean(axis=1)).astype(np.float64)
    return _errors(squares, np.bincount(inverse), scale)


def _errors(squares: FloatArray, counts: IntArray, scale: float) -> Errors:
    rmse = float(np.sqrt(squares.sum() / counts.sum()))
    return Errors(rmse, rmse / scale, squares, counts)


def pooled(parts: Sequence[Errors]) -> Errors:
    """Errors of several folds as one."""
    squares = np.concatenate([part.squares for part in parts])
    counts = np.concatenate([part.counts for part in parts])
    return _errors(squares, counts, parts[0].rmse / parts[0].nrmse if parts[0].nrmse else 1.0)


def gain_interval(
    before: Errors, after: Errors, rng: np.random.Generator, rules: SelectionRules
) -> tuple[float, float]:
    """95 % interval of 1 − error_after/error_before, by resampling the held-out trials."""
    n = before.squares.size
    drawn = rng.integers(0, n, size=(rules.n_bootstrap, n))
    ratio = after.squares[drawn].sum(axis=1) / np.maximum(before.squares[drawn].sum(axis=1), 1e-300)
    low, high = np.quantile(1.0 - np.sqrt(ratio), [0.025, 0.975])
    return float(low), float(high)

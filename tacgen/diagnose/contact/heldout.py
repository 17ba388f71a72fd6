"""Trials that neither fit nor choice sees, and errors on them."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.core.types import BoolArray, FloatArray
from tacgen.diagnose.rules import ContactRules
from tacgen.presses.press_log import Columns


@dataclass(frozen=True)
class Errors:
    """Root-mean-square error on held-out trials, and each trial's sum of squares."""

    rmse: float
    squares: FloatArray


def test_trials(columns: Columns, rng: np.random.Generator, rules: ContactRules) -> NDArray[Any]:
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
        if group.size > 1:
            chosen.append(group[int(rng.integers(low, group.size))])
    return np.asarray(chosen)


def select(columns: Columns, mask: BoolArray) -> dict[str, NDArray[Any]]:
    """The rows of ``columns`` where ``mask`` holds."""
    return {name: np.asarray(values)[mask] for name, values in columns.items()}


def errors(residual: FloatArray, trial: FloatArray) -> Errors:
    """Errors of a residual (N, C): RMS over samples and outputs."""
    _, inverse = np.unique(trial, return_inverse=True)
    squares = np.bincount(inverse, (residual**2).mean(axis=1)).astype(np.float64)
    return Errors(float(np.sqrt(squares.sum() / inverse.size)), squares)

"""Notes of a diagnosis on the data that it was given."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from tacgen.diagnose.contact.candidates import follows_load, known_columns
from tacgen.diagnose.contact.channel import ChannelData
from tacgen.diagnose.contact.covariates import max_levels
from tacgen.diagnose.contact.result import ChannelDiagnosis
from tacgen.presses.press_log import PressLog


def log_notes(log: PressLog) -> list[str]:
    """Warnings and dropped presses of the log."""
    return [*log.warnings, *(str(dropped) for dropped in log.dropped)]


def channel_notes(found: ChannelDiagnosis) -> list[str]:
    """What a channel cannot show, and why."""
    name = found.data.channel
    return [*_column_notes(found), *_few_trials_notes(found, name), *_spike_notes(found, name)]


def _column_notes(found: ChannelDiagnosis) -> list[str]:
    """What is not taken as a covariate, and why."""
    data, notes = found.data, []
    for column, values in data.columns.items():
        if column in known_columns():
            continue
        array = np.asarray(values)
        levels = np.unique(array)
        if levels.size == 1:
            notes.append(
                f"column {column!r} is constant: whether anything follows it cannot be seen"
            )
        elif not np.issubdtype(array.dtype, np.number):
            per_trial = np.unique(data.history.text(column)[data.history.starts[:-1]])
            if levels.size > max_levels(data):
                notes.append(
                    f"column {column!r} has {levels.size} values for {data.history.n_trials} "
                    f"trials ({per_trial.size} at their starts): too many to compare"
                )
        elif follows_load(data, column):
            notes.append(
                f"column {column!r} follows load and time within each trial: it is taken for "
                "another reading of the press, not for a condition that may change the law"
            )
    return notes + _equal_columns(data)


def _spike_notes(found: ChannelDiagnosis, name: str) -> list[str]:
    if not found.n_spikes:
        return []
    sigmas = found.data.rules.outlier_sigmas
    return [
        f"{name} channel: {found.n_spikes} samples stick out of their neighbours by more than "
        f"{sigmas:g} times the noise; neither the fit nor the errors count them"
    ]


def _equal_columns(data: ChannelData) -> list[str]:
    names = [n for n, v in data.columns.items() if np.issubdtype(np.asarray(v).dtype, np.number)]
    values = {n: np.nan_to_num(data.history.column(n)) for n in names}
    return [
        f"columns {a!r} and {b!r} are equal: what follows one follows the other"
        for a, b in combinations(names, 2)
        if b not in known_columns() and np.array_equal(values[a], values[b])
    ]


def _few_trials_notes(found: ChannelDiagnosis, name: str) -> list[str]:
    if found.n_test == 0:
        return [
            f"{name} channel: one trial only; the errors are those on the trial that was fitted. "
            "Press at least twice, better twelve times"
        ]
    if found.n_test == 1:
        return [
            f"{name} channel: {found.n_fit + 1} trials are too few to set some aside; each was "
            "left out in turn, and parts of trials stood in for trials in the tests, whose "
            "p-values say little. Press at least twelve times"
        ]
    return []

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
    data, name = found.data, found.data.channel
    notes = [note for column in data.columns if (note := _column_note(data, column))]
    notes += _equal_columns(data)
    if found.n_test == 0:
        notes.append(
            f"{name} channel: one trial only; the errors are those on the trial that was fitted. "
            "Press at least twice, better twelve times"
        )
    elif found.n_test == 1:
        notes.append(
            f"{name} channel: {found.n_fit + 1} trials are too few to set some aside; each was "
            "held out in turn, and the tests use parts of trials in place of trials, so that "
            "their p-values mean little. Press at least twelve times"
        )
    if found.n_spikes:
        notes.append(
            f"{name} channel: {found.n_spikes} samples stick out of their neighbours by more than "
            f"{data.rules.outlier_sigmas:g} times the noise; neither the fit nor the errors count "
            "them"
        )
    return notes


def _column_note(data: ChannelData, column: str) -> str:
    """Why a column is not taken as a covariate; empty where it is."""
    if column in known_columns():
        return ""
    array = np.asarray(data.columns[column])
    levels = np.unique(array)
    if levels.size == 1:
        return f"column {column!r} is constant: whether anything follows it cannot be seen"
    if np.issubdtype(array.dtype, np.number):
        return (
            f"column {column!r} follows load and time within each trial: it is taken for "
            "another reading of the press, not for a condition that may change the law"
            if follows_load(data, column)
            else ""
        )
    if levels.size <= max_levels(data):
        return ""
    per_trial = np.unique(data.history.text(column)[data.history.starts[:-1]])
    return (
        f"column {column!r} has {levels.size} values for {data.history.n_trials} trials "
        f"({per_trial.size} at their starts): too many to compare"
    )


def _equal_columns(data: ChannelData) -> list[str]:
    names = [n for n, v in data.columns.items() if np.issubdtype(np.asarray(v).dtype, np.number)]
    values = {n: np.nan_to_num(data.history.column(n)) for n in names}
    return [
        f"columns {a!r} and {b!r} are equal: what follows one follows the other"
        for a, b in combinations(names, 2)
        if b not in known_columns() and np.array_equal(values[a], values[b])
    ]

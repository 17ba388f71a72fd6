"""Which presses to make next: those that separate the leading explanations most.

Each explanation is a law fitted to the log. For two of them, i and j, the separation of a press
is how far j, refitted to the log and the press, would stay from what i predicts there:

    T_ij = rᵀ A r + tr(A D C_i Dᵀ),  A = (σ² I + J_j C_j J_jᵀ)⁻¹

r is the difference of the two predictions, σ the noise, J the derivatives of a prediction by the
law's parameters, C their covariance after the log, and D what an error in i's parameters changes
that j's cannot follow. The chance of mistaking one for the other is at most exp(−T/8) of what it
was, and presses are chosen one by one so that the sum of these bounds over all pairs falls most.

Source: Box & Hill 1967, "Discrimination among mechanistic models"; the bound is Bhattacharyya's.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from tacgen.contact.effects import LoadHistory
from tacgen.core.types import FloatArray
from tacgen.diagnose.contact.candidates import effect_candidates
from tacgen.diagnose.contact.channel import TARGETS, ChannelData
from tacgen.diagnose.contact.model import prediction_and_jacobian
from tacgen.diagnose.contact.result import Diagnosis
from tacgen.diagnose.contact.search import Attribution, ContactProblem, FittedSet
from tacgen.presses.press_log import Columns

SEED = 0x9E55  # of shuffles on which no proposal depends
ROWS_PER_PRESS = 30  # that a press is averaged to: its loading, hold and unloading in ten each
MOST_EXPLANATIONS = 8  # explanations of a channel, the best by held-out score, that are separated


@dataclass(frozen=True)
class Proposal:
    """A press, by its place among the candidates, and the two laws that it separates most."""

    index: int
    between: tuple[str, str]


@dataclass(frozen=True)
class _Explanation:
    """An explanation: its prediction of the presses (K, S) and the derivatives there (K, S, P).

    ``seen`` holds the derivatives (R, P) on the log and on every press chosen so far. All in units
    of the noise.
    """

    name: str
    prediction: FloatArray
    at_presses: FloatArray
    seen: list[FloatArray]


def propose_presses(
    diagnosis: Diagnosis, candidates: Sequence[Columns], count: int
) -> list[Proposal]:
    """The ``count`` presses among ``candidates`` that best separate the explanations of a log.

    ``candidates`` are the columns of presses that the rig can make, without a response. They
    follow the log; columns that they lack keep the log's last value.
    """
    groups = [
        _fitted_explanations(found.data, found.attribution, candidates, diagnosis.session_clock)
        for found in diagnosis.channels.values()
    ]
    pairs = [(group, i, j) for group in groups for i, j in permutations(range(len(group)), 2)]
    explanations = [explanation for group in groups for explanation in group]
    bound = np.ones(len(pairs))
    proposals: list[Proposal] = []
    for _ in range(min(count, len(candidates) if pairs else 0)):
        apart = np.stack([_separations(group[i], group[j]) for group, i, j in pairs], axis=1)
        falls = bound * (1.0 - np.exp(-apart / 8.0))
        falls[[one.index for one in proposals]] = -1.0
        best = int(np.argmax(falls.sum(axis=1)))
        group, i, j = pairs[int(np.argmax(falls[best]))]
        first, second = sorted((group[i].name, group[j].name))
        proposals.append(Proposal(best, (first, second)))
        bound *= np.exp(-apart[best] / 8.0)
        for explanation in explanations:
            explanation.seen.append(explanation.at_presses[best])
    return proposals


def _separations(own: _Explanation, other: _Explanation) -> FloatArray:
    """T_ij of every press (K,); the terms of A by Woodbury's identity.

    The prior of every parameter is as wide as its own size: what the log cannot show stays finite.
    """
    at_i, at_j = (np.concatenate(explanation.seen) for explanation in (own, other))
    known_i, known_j = (rows.T @ rows + np.eye(rows.shape[1]) for rows in (at_i, at_j))
    followed = np.linalg.solve(known_j, at_j.T @ at_i)
    difference = (own.prediction - other.prediction)[..., None]
    change = np.concatenate([difference, own.at_presses - other.at_presses @ followed], axis=2)
    turned = other.at_presses.transpose(0, 2, 1)
    across = turned @ change
    apart = change.transpose(0, 2, 1) @ change
    refit = turned @ other.at_presses + known_j
    apart = apart - across.transpose(0, 2, 1) @ np.linalg.solve(refit, across)
    spread = (np.linalg.inv(known_i) * apart[:, 1:, 1:]).sum(axis=(1, 2))
    return np.asarray(apart[:, 0, 0] + spread)


def _fitted_explanations(
    data: ChannelData, attribution: Attribution, candidates: Sequence[Columns], session_clock: bool
) -> list[_Explanation]:
    rng = np.random.default_rng(SEED)
    sets = ContactProblem(data, rng, session_clock=session_clock)
    extended, rows = _with_presses(data, candidates)
    found = []
    for one in _explanations(sets, attribution):
        prediction, jacobian = prediction_and_jacobian(extended, one.fit)
        prediction, jacobian = prediction / data.noise, jacobian / data.noise
        at_log = jacobian[: data.target.size]
        at_presses = np.where(rows[..., None] >= 0, jacobian[rows], 0.0)
        here = np.where(rows >= 0, prediction[rows], 0.0)
        name = " and ".join(sorted(one.names)).replace("_", " ") or "the law alone"
        found.append(_Explanation(name, here, at_presses, [at_log]))
    return found


def _explanations(sets: ContactProblem, attribution: Attribution) -> list[FittedSet]:
    """The law that was found, without each of its effects, and with one other or one more."""
    base = sets.fitted((), attribution.base.fit.model)
    final = base
    for member in attribution.accepted.members:
        if member.effect is not None:
            same = effect_candidates(sets.data, final.fit.model, [member.effect])
            final = sets.add(final, [one for one in same if one.label == member.label])
    smaller = [sets.without(final, member) for member in final.members]
    found = {one.names: one for one in (final, *smaller)}
    for one in (final, *smaller):
        best = {candidate.name: candidate for candidate, _ in reversed(sets.pool(one))}
        for candidate in (candidate for candidate in best.values() if candidate.is_effect):
            larger = sets.add(one, [candidate])
            found.setdefault(larger.names, larger)
    return sorted(found.values(), key=sets.score)[:MOST_EXPLANATIONS]


def _with_presses(
    data: ChannelData, candidates: Sequence[Columns]
) -> tuple[ChannelData, FloatArray]:
    """The log's rows with those of every press after them, and the reduced rows (K, S) of each.

    Every press is the next one, by its clock: they follow the log, not each other. Shorter
    presses are filled up with −1.
    """
    first, clock_s = int(data.history.trial.max()) + 1, float(data.history.time_s.max())
    parts, weights, lengths = [], [data.weight], []
    for number, press in enumerate(candidates):
        n = len(press["time_s"])
        edges = np.arange(0, n, -(-n // ROWS_PER_PRESS))
        counts = np.diff([*edges, n])
        part = {}
        for name, values in data.columns.items():
            given = np.asarray(press.get(name, np.repeat(values[-1:], n)))
            numeric = np.issubdtype(given.dtype, np.number)
            part[name] = np.add.reduceat(given, edges) / counts if numeric else given[edges]
        part["trial"] = np.full(edges.size, first + number)
        part["time_s"] = part["time_s"] - part["time_s"][0] + clock_s
        for response in TARGETS[data.channel]:
            part[response] = np.zeros(edges.size)
        parts.append(part)
        weights.append(counts.astype(np.float64))
        lengths.append(edges.size)
    columns = {
        name: np.concatenate([data.columns[name], *(part[name] for part in parts)])
        for name in data.columns
    }
    history = LoadHistory(columns)
    target = np.stack([history.column(name) for name in TARGETS[data.channel]], axis=1)
    extended = replace(
        data, history=history, columns=columns, target=target, weight=np.concatenate(weights)
    )
    outputs = data.n_outputs
    rows = np.full((len(parts), ROWS_PER_PRESS * outputs), -1)
    start = data.target.size
    for number, length in enumerate(lengths):
        rows[number, : length * outputs] = np.arange(start, start + length * outputs)
        start += length * outputs
    return extended, rows

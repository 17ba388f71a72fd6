"""Candidates against the declared world and each other: which one the labels are evidence for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from tacgen.diagnose.grasps.hypothesis import (
    SUCCESS,
    Evidence,
    ForceReading,
    Hypothesis,
    on_top,
    one_hot,
)

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

FALSE_ALARM = 0.03
"""Promised share of clean data in which anything at all is named."""
N_DRAWS = 500
MAX_EFFECTS = 3
LEAST_MENDED = 2
RIVAL_SHARE = 0.2
EQUAL_FIT = 1.0
"""Log-likelihoods nearer than this are equal: the labels do not tell the two apart."""


@dataclass(frozen=True, slots=True)
class Labels:
    """Real labels as the models need them: what is known of each grasp, and of the force."""

    known: NDArray[np.int64]
    modes: BoolArray
    reading: ForceReading

    @property
    def success(self) -> BoolArray:
        """Whether each grasp succeeded."""
        found: BoolArray = self.known == SUCCESS
        return found


@dataclass(frozen=True, slots=True)
class Standing:
    """How one name stands in a contest.

    ``gain`` is the log-evidence over the declared world's; ``fit`` the largest log-likelihood of
    the labels over it; ``hypothesis`` the name's best one, with the posterior ``coordinate`` and
    its standard deviation; ``elsewhere`` the likeliest value apart from it, where one has at
    least ``RIVAL_SHARE`` of the posterior.
    """

    name: str
    gain: float
    fit: float
    hypothesis: Hypothesis
    coordinate: float
    deviation: float
    elsewhere: float | None = None

    @property
    def value(self) -> float:
        """The posterior value of the parameter."""
        candidate = self.hypothesis.candidate
        return self.coordinate if candidate is None else candidate.parameter.value(self.coordinate)

    @property
    def stderr(self) -> float:
        """Its standard error, in the parameter's unit."""
        candidate = self.hypothesis.candidate
        factor = candidate is not None and candidate.parameter.is_factor
        return self.deviation * (self.value if factor else 1.0)

    @property
    def nearest(self) -> int:
        """Number of the value nearest to the posterior one."""
        return int(np.argmin(np.abs(self.hypothesis.coordinate - self.coordinate)))


class Contest:
    """The declared world and everything that could be wrong with it, for one set of grasps."""

    def __init__(self, declared: Hypothesis, hypotheses: Sequence[Hypothesis]) -> None:
        self.declared = Evidence(declared)
        self.others = [Evidence(hypothesis) for hypothesis in hypotheses]
        names = [e.hypothesis.candidate.name for e in self.others if e.hypothesis.candidate]
        self.names = tuple(dict.fromkeys(names))

    def after(self, chosen: Standing) -> Contest:
        """The contest in a world where what was chosen holds."""
        at, declared = chosen.nearest, self.declared.hypothesis
        best = chosen.hypothesis
        base = Hypothesis(
            None,
            np.zeros(1),
            np.zeros(1),
            best.slack[at][None],
            best.turning[at][None],
            best.log_force[at][None],
        )
        rest = [
            on_top(e.hypothesis, best, at, declared)
            for e in self.others
            if e.hypothesis.candidate is not best.candidate
        ]
        return Contest(base, rest)

    def gains(self, known: FloatArray, log_scale: FloatArray, stderr: float) -> FloatArray:
        """Log-evidence of every name over the declared world (names, B), for B sets of labels."""
        base = self.declared.log_evidence(known, log_scale, stderr)
        by_name: dict[str, list[FloatArray]] = {name: [] for name in self.names}
        for evidence in self.others:
            candidate = evidence.hypothesis.candidate
            if candidate is not None:
                found = evidence.log_evidence(known, log_scale, stderr)
                by_name[candidate.name].append(found + np.log(candidate.share))
        return np.stack([logsumexp(by_name[name], axis=0) - base for name in self.names])

    def standings(self, labels: Labels, used: BoolArray | None = None) -> list[Standing]:
        """Every name, the one with most evidence first; ``used`` (N,) leaves grasps out."""
        known, log_scale, stderr = _arguments(labels, used)
        gains = self.gains(known, log_scale, stderr)[:, 0]
        base_fit = self.declared.best_fit(known, log_scale, stderr)
        found = []
        for name, gain in zip(self.names, gains, strict=True):
            own = [e for e in self.others if e.hypothesis.candidate and _name_of(e) == name]
            scores = [
                float(e.log_evidence(known, log_scale, stderr)[0]) + np.log(_share_of(e))
                for e in own
            ]
            best = own[int(np.argmax(scores))]
            weights = best.posterior(known, log_scale, stderr).sum(axis=1)
            axis = best.hypothesis.coordinate
            mean, deviation, rest = _mean_of_best_mode(axis, weights)
            elsewhere = None
            if rest.sum() > RIVAL_SHARE * weights.sum() and best.hypothesis.candidate is not None:
                second = _mean_of_best_mode(axis, rest)[0]
                elsewhere = best.hypothesis.candidate.parameter.value(second)
            fit = max(e.best_fit(known, log_scale, stderr) for e in own) - base_fit
            found.append(
                Standing(name, float(gain), fit, best.hypothesis, mean, deviation, elsewhere)
            )
        return sorted(found, key=lambda standing: -standing.gain)

    def null_gains(self, labels: Labels, rng: np.random.Generator) -> FloatArray:
        """The largest gain (N_DRAWS,) in labels that the declared world itself would give."""
        known, log_scale, stderr = _arguments(labels, None)
        weights = self.declared.posterior(known, log_scale, stderr)
        drawn = one_hot(self.declared.drawn(weights, labels.modes, N_DRAWS, rng))
        spread = stderr if np.isfinite(stderr) else 0.0
        log_force = self.declared.hypothesis.log_force[0]
        readings = log_force + spread * rng.standard_normal(N_DRAWS)
        largest: FloatArray = self.gains(drawn, readings, stderr).max(axis=0)
        return largest

    def success_probability(self, labels: Labels, used: BoolArray | None = None) -> FloatArray:
        """Probability (N,) of success in the declared world."""
        weights = self.declared.posterior(*_arguments(labels, used))
        probability: FloatArray = self.declared.predicted(weights)[SUCCESS]
        return probability


def success_of(standing: Standing, labels: Labels, used: BoolArray | None = None) -> FloatArray:
    """Probability (N,) of success where that candidate holds, averaged over its posterior."""
    evidence = Evidence(standing.hypothesis)
    probability: FloatArray = evidence.predicted(evidence.posterior(*_arguments(labels, used)))[
        SUCCESS
    ]
    return probability


@dataclass(frozen=True, slots=True)
class Choice:
    """One step of the choice: the standings, the p-value of the first, and whether it was taken.

    What was taken on top of another must also be confirmed by simulating both together.
    """

    standings: list[Standing]
    p_value: float
    critical_gain: float
    taken: bool


def choose(contest: Contest, labels: Labels, rng: np.random.Generator) -> list[Choice]:
    """Take candidates one by one, while clean labels would hardly ever give as much evidence."""
    steps: list[Choice] = []
    while len(steps) <= MAX_EFFECTS and contest.others:
        standings = contest.standings(labels)
        null = contest.null_gains(labels, rng)
        p_value = float((1 + (null >= standings[0].gain).sum()) / (1 + len(null)))
        critical = float(np.quantile(null, 1 - FALSE_ALARM))
        taken = p_value <= FALSE_ALARM and standings[0].gain > 0 and len(steps) < MAX_EFFECTS
        steps.append(Choice(standings, p_value, max(critical, 0.0), taken))
        if not taken:
            break
        contest = contest.after(standings[0])
    return steps


def confirmed(steps: Sequence[Choice], mislabels: Sequence[int]) -> list[Choice]:
    """The steps, ended before the first addition that simulation does not confirm.

    Parameters
    ----------
    mislabels : (K + 1,) int
        Of the worlds simulated with none, one, two … of the K choices that were taken. An
        addition to an effect must mend at least two.
    """
    kept: list[Choice] = []
    for number, step in enumerate(steps):
        added = step.taken and number > 0
        if added and mislabels[number] - mislabels[number + 1] < LEAST_MENDED:
            kept.append(replace(step, taken=False))
            break
        kept.append(step)
    return kept


def heldout_success(
    contest: Contest, labels: Labels, steps: Sequence[Choice], folds: NDArray[np.int64]
) -> FloatArray:
    """Probability (N,) of success of each grasp, from a choice and a fit without its fold.

    The whole choice is made anew on the other folds, by the gains that ``steps`` asked for.
    """
    predicted = np.zeros(len(folds))
    for fold in np.unique(folds):
        used, current = folds != fold, contest
        probability = current.success_probability(labels, used)
        best: Standing | None = None
        for step in steps:
            current = current.after(best) if best is not None else current
            best = current.standings(labels, used)[0]
            if best.gain <= step.critical_gain:
                break
            probability = success_of(best, labels, used)
        predicted[~used] = probability[~used]
    return predicted


def confusable(standings: Sequence[Standing]) -> tuple[str, ...]:
    """Names that fit the labels as well as the first: only the prior speaks for it."""
    first = standings[0]
    return tuple(
        other.name
        for other in standings[1:]
        if other.fit > first.fit - EQUAL_FIT and other.gain > first.gain - np.log(100)
    )


def _mean_of_best_mode(axis: FloatArray, weights: FloatArray) -> tuple[float, float, FloatArray]:
    """Mean and deviation about the highest mode, out to where it is all but over, and the rest.

    A centre of mass that is off to either side may explain the same labels; the mean of both
    would explain none.
    """
    top = int(np.argmax(weights))
    low = weights < 0.02 * weights[top]
    left = int(np.flatnonzero(low[:top])[-1]) + 1 if low[:top].any() else 0
    right = top + int(np.flatnonzero(low[top:])[0]) if low[top:].any() else len(axis)
    own, part = axis[left:right], weights[left:right] / weights[left:right].sum()
    mean = float(part @ own)
    rest = weights.copy()
    rest[left:right] = 0.0
    return mean, float(np.sqrt(part @ (own - mean) ** 2)), rest


def _arguments(labels: Labels, used: BoolArray | None) -> tuple[FloatArray, FloatArray, float]:
    reading = labels.reading
    return one_hot(labels.known[None], used), np.array([reading.log_scale]), reading.stderr


def _name_of(evidence: Evidence) -> str:
    candidate = evidence.hypothesis.candidate
    return candidate.name if candidate is not None else ""


def _share_of(evidence: Evidence) -> float:
    candidate = evidence.hypothesis.candidate
    return candidate.share if candidate is not None else 1.0

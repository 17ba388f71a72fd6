"""One search for what a model lacks: candidates are added, exchanged and dropped by held-out loss.

A set of candidates grows by its score alone and then loses the members that its tests do not call
for, so that of two effects that hide each other neither need be found alone. What is fitted, scored
and tested is the business of a ``Problem``: press logs, marker tracks, pictures, labels of grasps.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

from tacgen.diagnose.rules import SearchRules


class Fitted(Protocol):
    """A set of candidates that was fitted."""

    @property
    def members(self) -> tuple[Any, ...]:
        """The candidates, in the order in which they were added."""

    @property
    def loss(self) -> float:
        """What is not explained, on held-out units."""


C = TypeVar("C")
S = TypeVar("S", bound=Fitted)


class Problem(ABC, Generic[C, S]):
    """Data with the models that may explain it, as the search needs them."""

    rules: SearchRules

    @abstractmethod
    def pool(self, current: S) -> list[tuple[C, float]]:
        """Candidates beside ``current`` and the loss that each promises to explain, best first.

        A promise is infinite where only a fit can tell.
        """

    @abstractmethod
    def add(self, current: S, more: Sequence[C]) -> S:
        """``current`` with ``more`` members, fitted."""

    @abstractmethod
    def without(self, full: S, member: C) -> S:
        """``full`` less ``member``, fitted again."""

    @abstractmethod
    def accepts(self, full: S, member: C) -> bool:
        """Whether the tests call for ``member`` beside the others."""

    def admits(self, _found: S) -> bool:
        """Whether the data fix what was fitted: a set with free numbers is not taken."""
        return True

    def form(self, candidate: C) -> object:
        """Its function: candidates of one form differ only in where their fit starts."""
        return id(candidate)

    def score(self, fitted: S) -> float:
        """The loss that compares sets, with the prices of their members."""
        return fitted.loss

    def least_gain(self, _current: S) -> float:
        """What one member more gains at least, or it is not looked at."""
        return 0.0

    def least_lead(self, _current: S) -> float:
        """By how much another set must be better to take the place of ``current``."""
        return 0.0

    def opens(self, _current: S) -> bool:
        """Whether anything could be found beside ``current``."""
        return True

    def ordered(self, ends: Sequence[S]) -> list[S]:
        """Sets in the order in which they are tested: the first that passes is taken."""
        return sorted(ends, key=self.score)

    def settled(self, found: S) -> S:
        """What was found, as the next step begins with it."""
        return found

    def elsewhere(self, _current: S) -> S | None:
        """A better set of candidates that are too many for a pool; None if none is."""
        return None


@dataclass(frozen=True, slots=True)
class Step(Generic[S]):
    """One step: ``current`` with one member more each, the best first, and the set it led to."""

    current: S
    tried: tuple[S, ...]
    found: S | None


def search(problem: Problem[C, S], start: S) -> list[Step[S]]:
    """Better and better sets of accepted members from ``start`` on; the last step found none."""
    steps = [step(problem, start)]
    while (found := steps[-1].found) is not None:
        steps.append(step(problem, problem.settled(found)))
    return steps


def reached(steps: Sequence[Step[S]]) -> S:
    """The set at which a search ended."""
    return steps[-1].current


def step(problem: Problem[C, S], current: S) -> Step[S]:
    """The best set that grows from ``current``, exchanged and pruned, if it is better."""
    if not problem.opens(current):
        return Step(current, (), problem.elsewhere(current))
    levels, path = grown(problem, [current])
    ends = [*(levels[0] if levels else ()), *path, *(swapped(problem, end) for end in path[-1:])]
    least = problem.score(current) - problem.least_lead(current)
    found = first_accepted(problem, ends, least)
    if found is None and (exchanged := swapped(problem, current)) is not current:
        found = first_accepted(problem, [exchanged], least)
    tried = tuple(levels[0] if levels else ())
    return Step(current, tried, found or problem.elsewhere(current))


def first_accepted(problem: Problem[C, S], ends: Sequence[S], least: float) -> S | None:
    """The first of ``ends``, in their order, that when pruned still scores below ``least``."""
    for end in problem.ordered(ends):
        if problem.score(end) < least:
            remaining = pruned(problem, end)
            if problem.score(remaining) < least and problem.admits(remaining):
                return remaining
    return None


def grown(problem: Problem[C, S], level: Sequence[S]) -> tuple[list[list[S]], list[S]]:
    """Sets with ever one member more, the best first, and the best of each level that is better.

    None of them is tested. The first ``width`` sets of a level are extended.
    """
    rules, levels, path = problem.rules, list[list[S]](), list[S]()
    size = len(level[0].members)
    for _ in range(min(rules.max_growth, rules.max_members - size)):
        larger = [one for leader in level[: rules.width] for one in _tried(problem, leader)]
        if not larger:
            break
        larger = sorted({id(one): one for one in larger}.values(), key=problem.score)
        levels.append(larger)
        if problem.score(larger[0]) > problem.score(level[0]) - problem.least_gain(level[0]):
            break
        path.append(larger[0])
        level = larger
    return levels, path


def swapped(problem: Problem[C, S], fitted: S) -> S:
    """Exchange members, and their forms, for others as long as held-out units gain."""
    for _ in range(problem.rules.max_exchanges):
        best = fitted
        for member in fitted.members:
            rest = problem.without(fitted, member)
            for other in worth_a_fit(problem, problem.pool(rest), problem.rules.fitted_share):
                trial = problem.add(rest, [other])
                if problem.score(trial) < problem.score(best) - problem.least_lead(best):
                    best = trial
        if best is fitted:
            return fitted
        fitted = best
    return fitted


def pruned(problem: Problem[C, S], fitted: S) -> S:
    """Drop members that are not accepted beside the others, the least useful first."""
    while idle := [one for one in fitted.members if not problem.accepts(fitted, one)]:
        rests = [problem.without(fitted, member) for member in idle]
        fitted = min(rests, key=lambda rest: rest.loss)
    return fitted


def _tried(problem: Problem[C, S], current: S) -> list[S]:
    """``current`` with each candidate that may be the best one more, fitted."""
    least = problem.least_gain(current)
    promising = [one for one in problem.pool(current) if one[1] > least]
    tried = list[S]()
    for promise, best in _in_turn(problem, promising):
        if any(promise < current.loss - one.loss for one in tried):
            break  # the rest promises less than what was found explains
        tried += [problem.add(current, [candidate]) for candidate in best]
    return tried


def _in_turn(
    problem: Problem[C, S], pool: list[tuple[C, float]]
) -> Iterator[tuple[float, list[C]]]:
    """The most that is promised, and what is worth a fit; then the same of the rest, and so on.

    A form that promises most may fail when it is fitted: linear, it knows no bounds.
    """
    while best := worth_a_fit(problem, pool, problem.rules.fitted_share):
        yield max(gain for _, gain in pool), best
        tried = {problem.form(candidate) for candidate in best}
        pool = [one for one in pool if problem.form(one[0]) not in tried]


def worth_a_fit(problem: Problem[C, S], pool: Sequence[tuple[C, float]], share: float) -> list[C]:
    """The best start of each form that promises at least ``share`` of what the best one does."""
    best: dict[object, C] = {}
    most = max((gain for _, gain in pool), default=0.0)
    for candidate, gain in pool:
        if gain >= share * most:
            best.setdefault(problem.form(candidate), candidate)
    return list(best.values())

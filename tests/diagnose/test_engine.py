"""The one search on a problem whose answer is known: which columns a sum is made of."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from tacgen.diagnose.engine import Problem, grown, reached, search
from tacgen.diagnose.evidence import followed_by_rank, gain_interval_95
from tacgen.diagnose.record import Summary
from tacgen.diagnose.rules import SearchRules


@dataclass(frozen=True)
class Columns:
    """Numbers of columns, and what their best sum leaves of the target."""

    members: tuple[int, ...]
    loss: float


class Sums(Problem[int, Columns]):
    """Least squares of a target (N,) on columns (N, K); a member gains at least ``least``."""

    def __init__(self, columns, target, least, rules=SearchRules()):  # noqa: B008
        self.columns, self.target, self.least, self.rules = columns, target, least, rules
        self.n_fits = 0

    def of(self, members):
        self.n_fits += 1
        columns = self.columns[:, list(members)]
        left = self.target - columns @ np.linalg.lstsq(columns, self.target, rcond=None)[0]
        return Columns(tuple(members), float(left @ left))

    def pool(self, current):
        return [(k, np.inf) for k in range(self.columns.shape[1]) if k not in current.members]

    def form(self, candidate):
        return candidate

    def add(self, current, more):
        return self.of((*current.members, *more))

    def without(self, full, member):
        return self.of(tuple(k for k in full.members if k != member))

    def accepts(self, full, member):
        return self.without(full, member).loss - full.loss > self.least

    def least_lead(self, _current):
        return 1e-9


ORTHOGONAL = np.eye(6)


def members(problem):
    return set(reached(search(problem, problem.of(()))).members)


def test_the_columns_of_a_sum_are_found_and_no_others():
    target = ORTHOGONAL @ [2.0, 0.0, 1.0, 0.0, 0.3, 0.0]
    assert members(Sums(ORTHOGONAL, target, least=0.05)) == {0, 2, 4}
    assert members(Sums(ORTHOGONAL, target, least=0.5)) == {0, 2}
    assert members(Sums(ORTHOGONAL, 0 * target, least=0.05)) == set()


def hidden_pair():
    """Two columns whose difference is the target, nearly the same: each alone explains 1 %."""
    common = np.array([0.0, 10.0, 0.0])
    wanted = np.array([1.0, 0.0, 0.0])
    columns = np.stack([common + wanted, common, np.array([0.0, 0.0, 1.0])], axis=1)
    return columns, wanted


def test_a_pair_is_found_where_neither_is_enough_alone():
    columns, target = hidden_pair()
    problem = Sums(columns, target, least=0.5)
    singles = [problem.of((k,)).loss for k in range(3)]
    assert min(singles) > 1.0 - 0.5
    assert members(problem) == {0, 1}


def test_no_more_members_than_the_rules_allow():
    rules = SearchRules(max_members=2)
    found = members(Sums(ORTHOGONAL, ORTHOGONAL @ np.arange(6.0), least=0.01, rules=rules))
    assert found == {4, 5}


def test_the_widest_sets_of_a_level_are_extended():
    target = ORTHOGONAL @ np.arange(6.0)
    problem = Sums(ORTHOGONAL, target, least=0.0, rules=replace(SearchRules(), width=2))
    singles = sorted((problem.of((k,)) for k in range(6)), key=problem.score)
    levels, path = grown(problem, singles)
    # Two sets of one, each with five others; then the best two of those with four others.
    assert [len(level) for level in levels[:2]] == [10, 8]
    assert [len(one.members) for one in path] == [2, 3, 4, 5]
    assert path[0].loss == pytest.approx(0 + 1 + 4 + 9)


def test_what_residuals_follow_by_rank_and_what_they_do_not():
    rng = np.random.default_rng(0)
    n = 60
    covariates = {"order": np.arange(n, dtype=float), "other": rng.normal(size=n)}
    residual = np.where(np.arange(n) > 40, 1.0, 0.0) + 0.1 * rng.normal(size=n)
    (found,) = followed_by_rank(residual, covariates, [np.arange(n)], 0.01, 999, rng)
    assert found.covariate == "order"
    assert found.p_value == 2 / 1000  # the least of 999 shuffles, for two covariates
    shuffled = rng.permutation(residual)
    assert followed_by_rank(shuffled, covariates, [np.arange(n)], 0.01, 999, rng) == ()


def test_an_interval_of_a_mean_is_that_of_its_standard_error():
    rng = np.random.default_rng(0)
    before, after = rng.normal(5.0, 1.0, 400), np.zeros(400)
    low, high = gain_interval_95(before, after, lambda one, other: one**2 - other**2, 4000, rng)
    assert (high - low) / 2 == pytest.approx(1.96 * before.std() / 20, rel=0.05)
    assert low < before.mean() < high


@pytest.mark.parametrize(
    ("lacking", "remaining", "verdict", "words"),
    [
        ([], [], "sufficient", "The law is sufficient: nothing that was looked at"),
        (["creep"], [], "effect_found", "The law lacks creep: with it, the error on held-out"),
        (["creep"], ["x_mm"], "unexplained", "and a residual that follows x_mm remains."),
        ([], ["x_mm"], "unexplained", "that no listed effect explains (1.2 mm³ on held-out"),
    ],
)
def test_verdict_and_sentence_agree(lacking, remaining, verdict, words):
    errors = {"before": 1.2, "after": 1.0, "floor": 1.0}
    found = Summary("The law", lacking, remaining, **errors, unit="mm3", held="held-out presses")
    assert found.verdict == verdict
    assert words in found.sentence

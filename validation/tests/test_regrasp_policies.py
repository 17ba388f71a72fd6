"""Policies of regrasping: thresholds and beliefs against closed forms, paths against the truth."""

import numpy as np
import pytest

from tacgen.core.errors import LearningError
from tests.messages import refused

pytest.importorskip("torch")

from tacgen.envs.regrasp import LOOK_SPREAD, Belief, Costs
from validation.regrasp.policies import (
    POLICIES,
    Rate,
    play,
    resampled_episodes,
)

COSTS = Costs(drop=1.0, regrasp=0.1)


def test_with_one_regrasp_left_the_threshold_is_what_the_other_holds_by_less_its_price():
    assert Costs(2.0, 0.3).threshold(0.7, 1) == pytest.approx(0.7 - 0.3 / 2.0)


@pytest.mark.parametrize("left", [1, 2, 3])
def test_at_the_threshold_a_lift_costs_what_regrasping_does_on_average(left):
    """Played many times: grasps that hold with 0.6, looks that tell for certain."""
    rng = np.random.default_rng(left)
    holds = rng.random((200_000, left)) < 0.6
    tried = np.where(holds.any(axis=1), holds.argmax(axis=1) + 1, left)
    cost = 0.1 * tried + 1.0 * ~holds.any(axis=1)
    # The spread of a mean of 200 000 costs is below 0.001.
    assert 1 - COSTS.threshold(0.6, left) == pytest.approx(cost.mean(), abs=0.004)


@pytest.mark.parametrize("costs", [(0.0, 0.1), (-1.0, 0.1), (1.0, -0.1), (float("nan"), 0.1)])
def test_costs_that_cannot_be_are_refused(costs):
    with refused(LearningError):
        Costs(*costs)


def belief_of(*worlds: tuple[float, ...]) -> Belief:
    """Worlds in which the network sees the truth with those probabilities."""
    look = np.array(worlds)
    return Belief(look > 0.5, look)


def test_worlds_are_weighed_as_bayes_has_it():
    belief = belief_of((0.9, 0.2), (0.3, 0.8))
    weights = belief.weights([(0, 0.6)])
    odds = [np.log(p / (1 - p)) for p in (0.9, 0.3, 0.6)]
    off = [(odds[k] - odds[2]) ** 2 / (2 * LOOK_SPREAD**2) for k in range(2)]
    assert weights[0] / weights[1] == pytest.approx(np.exp(off[1] - off[0]))
    assert weights.sum() == pytest.approx(1.0)


def test_a_certain_network_rules_no_world_out_for_ever():
    belief = belief_of((1.0, 0.0), (0.0, 1.0))
    assert belief.weights([(0, 1.0)])[1] > 0


CENTERS = np.arange(7)


def place(center: int) -> np.ndarray:
    """Seven grasps in a row, of which the one at the centre of mass and its neighbours hold."""
    return np.where(np.abs(CENTERS - center) <= 1, 0.95, 0.05 + 0.01 * CENTERS)


ROW = Belief(np.stack([place(c) > 0.5 for c in CENTERS]), np.stack([place(c) for c in CENTERS]))


def played(policy: str, first: int, center: int, regrasps: int, seed: int = 0):
    look = place(center)
    rng = np.random.default_rng(seed)
    steps = play(policy, first, look, look > 0.5, ROW, COSTS, regrasps, rng)
    return [one.grasp for one in steps], bool(look[steps[-1].grasp] > 0.5)


@pytest.mark.parametrize("policy", POLICIES)
def test_without_a_regrasp_every_policy_lifts_the_first_grasp(policy):
    assert played(policy, 5, 1, 0)[0] == [5]


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("first", range(7))
def test_no_policy_moves_more_often_than_it_may(policy, first):
    for allowed in range(4):
        path, _ = played(policy, first, 6, allowed)
        assert path[0] == first
        assert len(path) <= allowed + 1


def test_by_touch_every_place_is_found_and_by_chance_it_is_not():
    pairs = [(first, center) for first in CENTERS for center in CENTERS]
    by_touch = [played("touch", *pair, 3)[1] for pair in pairs]
    by_chance = [played("random", *pair, 3, seed)[1] for pair in pairs for seed in range(20)]
    assert all(by_touch)
    assert np.mean(by_chance) < 0.95


def test_blind_goes_to_the_grasp_that_holds_in_most_worlds_whatever_it_would_see():
    skewed = Belief(ROW.holds[:4], ROW.look[:4])
    best = int(np.argmax(skewed.holds.mean(axis=0)))
    look = place(6)
    steps = play("blind", 6, look, look > 0.5, skewed, COSTS, 3, np.random.default_rng(0))
    assert [one.grasp for one in steps] == [6, best]
    assert np.isnan(steps[0].probability)


def test_the_oracle_moves_only_where_it_must():
    assert played("oracle", 2, 2, 3) == ([2], True)
    assert played("oracle", 6, 2, 3) == ([6, 1], True)
    none = np.zeros(7)
    steps = play("oracle", 3, none, none > 0.5, ROW, COSTS, 3, np.random.default_rng(0))
    assert [one.grasp for one in steps] == [3]


def test_the_interval_of_a_rate_is_that_of_the_binomial():
    rng = np.random.default_rng(1)
    held = np.arange(400) < 280
    drawn = resampled_episodes(np.full(400, "a"), rng)
    rate = Rate.of(float(held.mean()), held[drawn].mean(axis=1))
    half = 1.96 * np.sqrt(0.7 * 0.3 / 400)
    assert rate.value == 0.7
    # The percentiles of 2000 resamples are off by some 4 % of the half width.
    assert rate.high - rate.low == pytest.approx(2 * half, rel=0.12)

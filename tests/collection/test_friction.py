"""Friction from labels, against outcomes by closed form: a block held by two fingers.

It holds exactly when 2 μ F ≥ m g, so that labels at a true μ* are known without a simulator.
"""

import numpy as np
import pytest

from tacgen.collection.friction import best_mu, best_run, fit_friction

MU = np.round(np.arange(0, 1.0001, 0.05), 10)
WEIGHT_N = 0.4 * 9.80665


def holds(mu, force_n):
    return (2 * np.multiply.outer(mu, force_n) >= WEIGHT_N).astype(np.int64)


def forces_around(mu_star, rng, count=20):
    """Forces that span the threshold of mu_star, evenly from ×1/√2 to ×√2 with a random phase.

    Neighbours differ by 3.5 %: at μ* = 0.9 they tell μ apart by 0.03, less than a step of 0.05.
    """
    threshold = WEIGHT_N / (2 * mu_star)
    places = (np.arange(count) + rng.uniform()) / count
    return threshold * 2.0 ** (places - 0.5)


@pytest.mark.parametrize("mu_star", np.round(np.arange(0.15, 0.901, 0.05), 10))
def test_the_true_friction_is_found_within_a_step(mu_star):
    rng = np.random.default_rng(int(100 * mu_star))
    forces = forces_around(mu_star, rng)
    fit = fit_friction(MU, holds(MU, forces), holds(mu_star, forces), rng)
    assert fit.mislabels.min() == 0
    assert abs(fit.mu - mu_star) <= 0.05
    assert fit.interval[0] <= mu_star + 0.05
    assert fit.interval[1] >= mu_star - 0.05


def test_ties_go_to_the_middle_of_the_longest_run():
    counts = np.array([3, 1, 2, 1, 1, 1, 2, 1, 1])
    assert list(best_run(counts)) == [3, 4, 5]
    assert best_mu(np.arange(9) / 10, counts) == pytest.approx(0.4)


@pytest.mark.parametrize(("label", "bounded", "open_end"), [(1, "below", 1.0), (0, "above", 0.0)])
def test_equal_labels_bound_friction_from_one_side_only(label, bounded, open_end):
    forces = np.full(20, WEIGHT_N / (2 * 0.5))
    fit = fit_friction(MU, holds(MU, forces), np.full(20, label), np.random.default_rng(0))
    assert fit.bounded == bounded
    assert open_end in fit.interval
    inner = fit.interval[0] if label else fit.interval[1]
    assert abs(inner - 0.5) <= 0.05


def test_a_grasp_that_was_not_executed_matches_no_label():
    simulated = np.array([[-1, 0], [1, 0]])
    fit = fit_friction(np.array([0.1, 0.2]), simulated, np.array([1, 0]), np.random.default_rng(0))
    assert fit.mislabels.tolist() == [1, 0]


def spanning(mu_star, rng, span, count=20):
    """Forces from 1/span to span times the threshold, evenly by ratio with a random jitter."""
    places = (np.arange(count) + rng.uniform(size=count)) / count
    return WEIGHT_N / (2 * mu_star) * span ** (2 * places - 1)


@pytest.mark.exhaustive
@pytest.mark.slow
@pytest.mark.parametrize(("span", "flipped"), [(2.0, 0), (1.4, 1)])
def test_forces_at_any_spacing_find_the_friction_in_19_of_20_draws(span, flipped):
    found = 0
    for draw in range(100):
        rng = np.random.default_rng([draw, 7])
        mu_star = rng.uniform(0.15, 0.9)
        forces = spanning(mu_star, rng, span)
        real = holds(mu_star, forces)
        real[rng.choice(len(real), flipped, replace=False)] ^= 1
        fit = fit_friction(MU, holds(MU, forces), real, rng)
        found += abs(fit.mu - mu_star) <= 0.05
    assert found >= 95

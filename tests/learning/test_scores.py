"""Scores against closed forms and other ways to compute them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import expit, logit
from scipy.stats import norm

from tacgen.learning.scores import (
    expected_calibration_error,
    score,
    wilson_interval,
)

Z = 1.959963984540054


@given(n=st.integers(1, 2000), share=st.floats(0, 1))
def test_wilson_bounds_are_where_the_normal_test_just_rejects(n, share):
    """The interval's definition: (p̂ − p)² = z² p(1 − p)/n at both ends."""
    n_right = round(share * n)
    for p in wilson_interval(n_right, n):
        assert (n_right / n - p) ** 2 == pytest.approx(Z**2 * p * (1 - p) / n, abs=1e-12)


def test_scores_of_a_small_example_by_hand():
    labels = np.array([0, 0, 0, 0, 1, 1])
    probabilities = np.array([0.1, 0.2, 0.3, 0.9, 0.4, 0.8])
    scores = score(labels, probabilities)
    assert scores["accuracy"] == pytest.approx(4 / 6)
    assert scores["balanced_accuracy"] == pytest.approx((3 / 4 + 1 / 2) / 2)
    assert scores["confusion"] == [[3, 1], [1, 1]]
    # Pairs (failure, success) in the right order: 0.4 beats 3 of 4, 0.8 beats 3 of 4.
    assert scores["auroc"] == pytest.approx(6 / 8)
    assert scores["n"] == 6


def test_balanced_accuracy_does_not_depend_on_how_common_success_is():
    """One sees x ~ N(±1, 1): right of each outcome in Φ(1) = 0.841 of cases, weighing both alike.

    With 95 % successes its calibrated probabilities hardly ever fall below one half.
    """
    rng = np.random.default_rng(4)
    labels = (rng.random(40_000) < 0.95).astype(np.int64)
    ratio = 2 * (rng.normal(0, 1, 40_000) + np.where(labels == 1, 1, -1))
    calibrated = expit(ratio + logit(0.95))
    # Of 2000 failures the standard error is 0.008.
    found = score(labels, calibrated, 0.95)["balanced_accuracy"]
    assert found == pytest.approx(norm.cdf(1), abs=0.02)
    assert score(labels, calibrated)["balanced_accuracy"] < found - 0.1
    assert score(labels, calibrated, 0.95)["accuracy"] == score(labels, calibrated)["accuracy"]


@pytest.mark.slow
@given(seed=st.integers(0, 1000))
def test_auroc_is_the_share_of_pairs_in_the_right_order(seed):
    rng = np.random.default_rng(seed)
    labels = np.r_[0, 1, rng.integers(0, 2, 30)]
    probabilities = np.round(rng.random(32), 1)
    success, failure = probabilities[labels == 1], probabilities[labels == 0]
    difference = success[:, None] - failure[None]
    expected = np.mean((difference > 0) + 0.5 * (difference == 0))
    assert score(labels, probabilities)["auroc"] == pytest.approx(expected)


def test_one_class_has_no_auroc_and_its_recall_as_balanced_accuracy():
    scores = score(np.ones(4, int), np.array([0.9, 0.8, 0.4, 0.7]))
    assert scores["auroc"] is None
    assert scores["balanced_accuracy"] == pytest.approx(0.75)


def test_calibration_error_of_known_predictions():
    """Ten grasps said to succeed at 0.75 of which six do: |0.75 − 0.6|."""
    labels = np.array([1] * 6 + [0] * 4)
    assert expected_calibration_error(labels, np.full(10, 0.75)) == pytest.approx(0.15)
    both = np.r_[np.full(10, 0.75), np.full(10, 0.05)]
    error = expected_calibration_error(np.r_[labels, np.zeros(10, int)], both)
    assert error == pytest.approx((0.15 + 0.05) / 2)


def test_predictions_drawn_from_their_own_probabilities_are_calibrated():
    rng = np.random.default_rng(0)
    probabilities = rng.random(200_000)
    labels = (rng.random(200_000) < probabilities).astype(int)
    # The error of a bin of 20 000 is about √(¼/20 000) = 0.0035.
    assert expected_calibration_error(labels, probabilities) < 0.005

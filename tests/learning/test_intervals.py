"""Intervals over seeds and objects: closed forms, published values, and how often they hold."""

import numpy as np
import pytest
from scipy.stats import binomtest, t

from tacgen.learning.intervals import (
    interval_over_seeds,
    over_seeds,
    paired_gain,
    standardised_gap,
)
from tacgen.learning.scores import wilson_interval


def scores(right: int, n: int) -> dict[str, float]:
    return {"accuracy": right / n, "n": n}


def test_wilson_is_scipys_and_takes_means():
    for right, n in ((0, 5), (3, 7), (96, 100), (40, 40)):
        found = binomtest(right, n).proportion_ci(0.95, method="wilson")
        assert wilson_interval(right, n) == pytest.approx((found.low, found.high))
    for n in range(1, 200):
        assert wilson_interval(n, n)[1] == 1.0
        assert wilson_interval(0, n)[0] == 0.0
    assert wilson_interval(3, 7)[0] < wilson_interval(3.5, 7)[0] < wilson_interval(4, 7)[0]


def test_the_gap_of_one_object_is_newcombes_published_interval():
    """Newcombe 1998, Statistics in Medicine 17, table II (a): 56 of 70 against 48 of 80."""
    simulated, real, interval = standardised_gap({"can": scores(56, 70)}, {"can": scores(48, 80)})
    assert simulated - real == pytest.approx(0.2)
    assert interval == pytest.approx((0.0524, 0.3339), abs=5e-5)


def test_the_gaps_interval_is_that_of_resampled_grasps():
    """Away from 0 and 1 and with many grasps a bootstrap within objects says the same."""
    simulated = {"can": scores(140, 200), "cup": scores(90, 150)}
    real = {"can": scores(110, 200), "cup": scores(120, 240)}
    *_, interval = standardised_gap(simulated, real)
    rng = np.random.default_rng(0)
    drawn = [
        [rng.binomial(one["n"], one["accuracy"], 20_000) / one["n"] for one in side.values()]
        for side in (simulated, real)
    ]
    gaps = np.mean(drawn[0], axis=0) - np.mean(drawn[1], axis=0)
    # 20 000 resamples tell a quantile to about 0.0005; Wilson's own shift is of order 1/n.
    assert interval == pytest.approx(np.quantile(gaps, (0.025, 0.975)), abs=0.004)


def test_both_sources_are_in_the_interval_over_seeds():
    assert interval_over_seeds([0.9, 0.9, 0.9], 50) == pytest.approx(wilson_interval(45, 50))
    assert interval_over_seeds([0.9], 50) == pytest.approx(wilson_interval(45, 50))
    # Of countless grasps the seeds alone are left: Student's interval.
    accuracies = np.array([0.80, 0.85, 0.90])
    half = t.ppf(0.975, 2) * accuracies.std(ddof=1) / np.sqrt(3)
    low, high = interval_over_seeds(list(accuracies), 10**9)
    assert (low, high) == pytest.approx((0.85 - half, 0.85 + half), abs=1e-4)
    assert interval_over_seeds([1.0, 0.5, 1.0], 10)[1] == 1.0


@pytest.mark.parametrize(("spread", "n"), [(0.0, 100), (0.03, 100), (0.03, 1000)])
def test_the_interval_over_seeds_holds_the_truth_as_often_as_it_says(spread, n):
    """Three networks of differing skill on the same grasps, some hard for all of them."""
    rng, held, trials = np.random.default_rng(1), 0, 600
    for _ in range(trials):
        skill = 0.85 + spread * rng.standard_normal(3)
        hard = rng.random(n)
        right = [(0.5 * hard + 0.5 * rng.random(n) < _quantile(one)).mean() for one in skill]
        low, high = interval_over_seeds(right, n)
        held += low <= 0.85 <= high
    # Two standard errors of 600 trials are 0.018.
    assert held / trials > 0.95 - 0.018


def _quantile(share: float) -> float:
    """Below which so large a share of (u + v) / 2 lies, with u and v uniform on 0 to 1."""
    return 1 - np.sqrt((1 - share) / 2)


def test_the_results_of_seeds_become_one():
    results = [
        {"accuracy": a, "n": 20, "until": "lift", "by_object": {"can": {"accuracy": a, "n": 20}}}
        for a in (0.8, 0.9, 1.0)
    ]
    found = over_seeds(results)
    assert found["accuracy"] == found["by_object"]["can"]["accuracy"] == pytest.approx(0.9)
    assert found["seeds"] == [0.8, 0.9, 1.0]
    assert found["until"] == "lift"
    low, high = wilson_interval(18, 20)
    assert found["accuracy_interval"][0] < low
    assert found["accuracy_interval"][1] >= high


def test_a_paired_gain_is_agresti_and_mins():
    """Of 100 grasps one alone is right of 20, the other of 8: by hand."""
    right = np.repeat([True, False, True, False], [60, 12, 20, 8])
    other = np.repeat([True, False, False, True], [60, 12, 20, 8])
    gain, interval = paired_gain(right, other)
    assert gain == pytest.approx(0.12)
    half = 1.959964 * np.sqrt(29 - 12**2 / 102) / 102
    assert interval == pytest.approx((12 / 102 - half, 12 / 102 + half))


def test_a_paired_gain_never_shrinks_to_a_point():
    always = np.ones(50, bool)
    gain, (low, high) = paired_gain(always, always)
    assert gain == 0.0
    assert low == pytest.approx(-high)
    assert 0.02 < high < 0.06


@pytest.mark.parametrize("difference", [0.0, 0.1])
def test_the_paired_interval_holds_the_truth_as_often_as_it_says(difference):
    rng = np.random.default_rng(2)
    both, one = 0.7, 0.1 + difference
    held = 0
    for _ in range(2000):
        kinds = rng.choice(4, 80, p=[both, one, 0.1, 1 - both - one - 0.1])
        low, high = paired_gain(np.isin(kinds, (0, 1)), np.isin(kinds, (0, 2)))[1]
        held += low <= difference <= high
    assert 0.93 < held / 2000 < 0.985


def test_the_gain_over_seeds_holds_for_other_seeds_too():
    def result(accuracy, gain):
        baseline = {
            "accuracy": 0.8,
            "n": 100,
            "gain": gain,
            "gain_interval": [gain - 0.05, gain + 0.05],
        }
        return {"accuracy": accuracy, "n": 100, "by_object": {}, "without_touch": baseline}

    found = over_seeds([result(0.9, 0.1), result(0.92, 0.12), result(0.88, 0.08)])["without_touch"]
    assert found["gain"] == pytest.approx(0.1)
    of_seeds = t.ppf(0.975, 2) * 0.02 / np.sqrt(3)
    half = np.hypot(0.05, of_seeds)
    assert found["gain_interval"] == pytest.approx([0.1 - half, 0.1 + half])

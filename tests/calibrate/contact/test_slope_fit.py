"""The compliance fit: closed forms, gauge noise, outliers, and intervals that hold."""

from __future__ import annotations

import numpy as np
import pytest

from tacgen.calibrate.contact.slope_fit import fit_slope


def presses(seed, n_trials=20, n_samples=60, k=5.0, noise=0.2, gauge=0.0, between=0.0):
    """Triangles of various heights: (load, response, trial)."""
    rng = np.random.default_rng(seed)
    ramp = 1.0 - np.abs(np.linspace(-1.0, 1.0, n_samples))
    peaks = rng.uniform(3.0, 8.0, n_trials)
    true = (peaks[:, None] * ramp).ravel()
    trial = np.repeat(np.arange(n_trials), n_samples)
    gain = np.repeat(k * (1.0 + between * rng.standard_normal(n_trials)), n_samples)
    response = gain * true + noise * rng.standard_normal(len(true))
    return true + gauge * rng.standard_normal(len(true)), response, trial


def test_exact_data_gives_the_exact_slope():
    load, response, trial = presses(0, noise=0.0)
    fit = fit_slope(load, response, trial)
    assert fit.value == pytest.approx(5.0, rel=1e-12)
    assert fit.stderr == pytest.approx(0.0, abs=1e-12)
    assert fit.r_squared == pytest.approx(1.0)


def test_gauge_noise_does_not_pull_the_slope_down():
    """Least squares loses the share of the load's power that is noise: 12 % here."""
    fitted, naive = [], []
    for seed in range(20):
        load, response, trial = presses(seed, gauge=1.2, noise=0.05)
        fitted.append(fit_slope(load, response, trial).value)
        naive.append((load @ response) / (load @ load))
    assert np.mean(naive) < 0.92 * 5.0
    assert np.mean(fitted) == pytest.approx(5.0, rel=0.01)


def test_outliers_and_a_whole_bad_press_do_not_move_it():
    load, response, trial = presses(3)
    clean = fit_slope(load, response, trial)
    rng = np.random.default_rng(0)
    spoiled = response.copy()
    spoiled[rng.choice(len(load), 60, replace=False)] += 30.0
    spoiled[trial == 7] *= 1.6
    fit = fit_slope(load, spoiled, trial)
    assert fit.value == pytest.approx(clean.value, abs=3.0 * clean.stderr)
    assert fit.outlying_trials == (7,)
    assert fit.outliers >= 60


def test_presses_that_all_differ_are_no_outliers():
    load, response, trial = presses(4, n_trials=3)
    response = response * np.repeat([1.0, 1.0, 0.8], 60)
    fit = fit_slope(load, response, trial)
    assert fit.outlying_trials == ()
    assert fit.interval[0] < 4.2, "the interval must span what the presses differ by"


def test_one_press_has_no_error():
    load, response, trial = presses(5, n_trials=1)
    assert np.isnan(fit_slope(load, response, trial).stderr)


@pytest.mark.exhaustive
@pytest.mark.slow
@pytest.mark.parametrize(
    ("n_trials", "between", "gauge"), [(8, 0.0, 0.0), (12, 0.03, 0.1), (40, 0.0, 0.3)]
)
def test_the_interval_holds_the_truth_as_often_as_it_says(n_trials, between, gauge):
    """400 repetitions of 95 %: within 3.5 standard deviations of the binomial, 91.2 to 98.8 %."""
    inside = 0
    for seed in range(400):
        data = presses(seed, n_trials=n_trials, n_samples=30, between=between, gauge=gauge)
        low, high = fit_slope(*data).interval
        inside += low < 5.0 < high
    assert 0.912 <= inside / 400 <= 0.988


def test_samples_that_hang_together_widen_the_interval():
    load, response, trial = presses(6, noise=0.02, between=0.0)
    _, moody, _ = presses(6, noise=0.02, between=0.05)
    assert fit_slope(load, moody, trial).stderr > 5.0 * fit_slope(load, response, trial).stderr

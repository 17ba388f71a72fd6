"""Oscillations in the session's clock are found at any period, and not where there are none."""

import numpy as np
import pytest

from tacgen.diagnose.contact.channel import ChannelSamples
from tacgen.diagnose.contact.model import Covariate, Model, fit_model
from tacgen.diagnose.contact.oscillation import _direct, _Products, _shares, find_oscillations

K_N = 4.0


def log(period_s, amplitude, n_trials=30, n_samples=50, seed=0, wave=np.sin, loads=0.0):
    """Half-sine presses of 5 s, 20 s apart, whose compliance oscillates by ``amplitude``.

    ``loads`` is the standard deviation of the logarithm of the trials' loads.
    """
    rng = np.random.default_rng(seed)
    phase = np.linspace(0.0, 5.0, n_samples)
    time = (np.arange(n_trials)[:, None] * 20.0 + rng.uniform(0, 5, (n_trials, 1)) + phase).ravel()
    size = np.exp(loads * np.random.default_rng([seed, 2]).standard_normal((n_trials, 1)))
    force = (size * 8.0 * np.sin(np.pi * phase / 5.0)).ravel()
    volume = K_N * force * (1.0 + amplitude * wave(2 * np.pi * time / period_s + 0.7))
    return {
        "trial": np.repeat(np.arange(n_trials), n_samples),
        "time_s": time,
        "force_normal_n": force,
        "volume_mm3": volume + 0.3 * rng.standard_normal(time.size),
    }


def waves_in(columns):
    data = ChannelSamples(columns, "normal").thinned()
    return find_oscillations(data, fit_model(data, Model(K_N)), np.random.default_rng(1))


def best_wave(columns):
    waves = waves_in(columns)
    return min(waves, key=lambda wave: wave.p_search) if waves else None


@pytest.mark.parametrize("period_s", [1.3, 4.0, 17.0, 90.0, 300.0])
def test_the_period_is_found_whether_shorter_than_a_press_or_as_long_as_the_session(period_s):
    wave = best_wave(log(period_s, 0.03))
    session_s = 30 * 20.0
    within = 0.1 * period_s**2 / session_s  # a tenth of a cycle over the session
    assert 1.0 / wave.frequency_hz == pytest.approx(period_s, abs=max(within, 0.01 * period_s))
    assert wave.p_search < 1e-3


def on_and_off(phase):
    return np.sign(np.sin(phase))


def test_shares_of_flipped_trials_are_those_of_weighted_least_squares():
    """A gain for each trial, of unequal information, and its flips."""
    rng = np.random.default_rng(0)
    time, information = np.sort(rng.uniform(0.0, 100.0, 14)), rng.uniform(0.5, 2.0, 14)
    gain, hz = rng.normal(size=14), np.array([0.02, 0.033, 0.05])
    flips = np.vstack([np.ones(14), rng.choice([-1.0, 1.0], (6, 14))])
    trials = _Products(information * gain, information, float(information @ gain**2))
    shares = _shares([trials], flips, _direct(time, hz))
    for k, frequency_hz in enumerate(hz):
        phase = 2.0 * np.pi * frequency_hz * time
        root = np.sqrt(information)
        constant, both = (
            np.stack(columns, axis=1) * root[:, None]
            for columns in ([np.ones(14)], [np.ones(14), np.cos(phase), np.sin(phase)])
        )
        for flip, share in zip(flips, shares[:, k], strict=True):
            of_flip = root * flip * gain
            left = [
                ((of_flip - basis @ np.linalg.lstsq(basis, of_flip, rcond=None)[0]) ** 2).sum()
                for basis in (constant, both)
            ]
            assert share == pytest.approx(1.0 - left[1] / left[0], abs=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_what_is_switched_on_and_off_is_found_in_twenty_trials_of_unequal_loads(seed):
    waves = waves_in(log(130.0, 0.05, n_trials=20, seed=seed, wave=on_and_off, loads=0.5))
    waves = [wave for wave in waves if wave.how == "gain"]
    slow = min(waves, key=lambda wave: wave.frequency_hz)
    assert 1.0 / slow.frequency_hz == pytest.approx(130.0, rel=0.05)
    assert slow.p_search < 2e-3
    fast = max(waves, key=lambda wave: wave.frequency_hz)
    assert 1.0 / fast.frequency_hz < 40.0, "it has its own search"


@pytest.mark.parametrize(("degree", "share"), [(1, 8 / np.pi**2), (3, 8 / np.pi**2 * (1 + 1 / 9))])
def test_harmonics_explain_as_much_of_a_square_wave_as_its_fourier_series(degree, share):
    columns = log(5.0, 0.0, n_trials=40)
    columns["time_s"] = np.linspace(0.0, 100.0, columns["time_s"].size)
    data = ChannelSamples(columns, "normal").thinned()
    wave = Covariate("time_s", "oscillation", "gain", degree=degree, frequency_hz=0.2)
    basis = np.stack(wave.basis(data), axis=1)
    square = on_and_off(2.0 * np.pi * 0.2 * data.history.time_s + 0.7)
    left = square - basis @ np.linalg.lstsq(basis, square, rcond=None)[0]
    # Two jumps in each of 20 periods, each within a row: a part in a hundred.
    assert 1.0 - (left @ left) / (square @ square) == pytest.approx(share, abs=0.02)


@pytest.mark.parametrize("n_trials", [8, 12, 30])
def test_the_p_of_the_best_wave_keeps_its_level_where_trials_differ(n_trials):
    """Of 40 logs, 4 below 0.1 are expected, more than 10 in 1 of 500 cases; 20 below a half."""
    found = []
    for seed in range(40):
        columns = log(50.0, 0.0, n_trials=n_trials, seed=seed)
        gains = 1.0 + 0.04 * np.random.default_rng([seed, 1]).standard_normal(n_trials)
        columns["volume_mm3"] = columns["volume_mm3"] * gains[columns["trial"]]
        found.append(best_wave(columns).p_search)
    assert sum(p < 0.02 for p in found[:16]) <= 3
    assert sum(p < 0.1 for p in found) <= 10
    assert 10 <= sum(p < 0.5 for p in found) <= 30


def test_a_session_over_nights_is_no_reason_to_fail():
    columns = log(50.0, 0.0, n_trials=9)
    columns["time_s"] = columns["time_s"] + 3e5 * (columns["trial"] > 4)
    assert best_wave(columns).p_search > 0.02

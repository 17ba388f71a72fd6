"""Noise of single samples, found beside what presses do."""

from __future__ import annotations

import numpy as np
import pytest

from tacgen.contact.noise import sample_noise

N_PRESSES, N_ROWS, SIGMA = 8, 400, 0.3
STARTS = np.arange(0, N_PRESSES * N_ROWS + 1, N_ROWS)
SHARE = np.tile(np.linspace(0.0, 1.0, N_ROWS), N_PRESSES)


def white() -> np.ndarray:
    return SIGMA * np.random.default_rng(4).standard_normal((SHARE.size, 1))


def spikes() -> np.ndarray:
    hit = np.random.default_rng(5).random((SHARE.size, 1)) < 0.02
    return 20.0 * SIGMA * hit


@pytest.mark.parametrize(
    ("beside", "true"),
    [
        (0.0, SIGMA),
        (100.0 * SIGMA * np.sin(np.pi * SHARE)[:, None], SIGMA),
        (100.0 * SIGMA * (1.0 - np.abs(2.0 * SHARE - 1.0))[:, None], SIGMA),
        (spikes(), SIGMA),
    ],
    ids=["nothing", "a slow course", "a ramp with a kink", "one sample in 50 is a spike"],
)
def test_noise_is_found_beside_what_a_press_does(beside, true):
    # 3 200 samples tell a standard deviation to 2 %.
    assert sample_noise(white() + beside, STARTS) == pytest.approx(true, rel=0.05)


def test_noise_that_grows_with_the_load_counts_as_its_mean_square():
    growing = white() * (1.0 + 2.0 * SHARE[:, None])
    true = SIGMA * np.sqrt(((1.0 + 2.0 * SHARE) ** 2).mean())
    assert sample_noise(growing, STARTS) == pytest.approx(true, rel=0.05)


def test_steps_between_presses_are_no_noise():
    levels = np.repeat(np.arange(N_PRESSES), N_ROWS)[:, None] * 50.0
    expected = pytest.approx(sample_noise(white(), STARTS), rel=1e-9)
    assert sample_noise(white() + levels, STARTS) == expected

"""Coefficients by bin: sums with repeats, shrinkage, and what is between the bins."""

from __future__ import annotations

import numpy as np
import pytest

from tacgen.calibrate.lookup.model_choice import Bins, InnerPixels, fit_bins
from tacgen.calibrate.lookup.settings import BinSettings
from tacgen.calibrate.lookup.smooth_model import position_costs, position_terms

STEEPEST = 1.0


def pixels(seed, n=4000):
    """Pixels of eight presses, all over slopes, directions and the picture."""
    rng = np.random.default_rng(seed)
    polar = np.column_stack([rng.uniform(0, STEEPEST, n), rng.uniform(-np.pi, np.pi, n)])
    position = position_terms(*rng.uniform(-0.5, 0.5, (2, n)))
    return InnerPixels(polar, position, np.repeat(np.arange(8), n // 8))


def test_every_bin_is_the_least_squares_of_its_own_pixels():
    """Against a plain solve of one bin at a time: no pixel is lost where bins repeat."""
    data = pixels(0)
    polar, position = data.polar, data.position
    residual = np.random.default_rng(1).normal(size=(len(polar), 3))
    found = fit_bins(data, residual, BinSettings(3, 4, 2.0), STEEPEST).coefficients
    # Each of the eight presses reaches each of the twelve bins.
    ridge = 2.0 * (len(polar) / (8 * 12)) * np.diag(position_costs())
    for i in range(3):
        for j in range(4):
            low, left = i / 3, -np.pi + j * np.pi / 2
            mine = (polar[:, 0] >= low) & (polar[:, 0] < low + 1 / 3)
            mine &= (polar[:, 1] >= left) & (polar[:, 1] < left + np.pi / 2)
            wanted = np.linalg.solve(
                position[mine].T @ position[mine] + ridge, position[mine].T @ residual[mine]
            )
            np.testing.assert_allclose(found[i, j], wanted, atol=1e-10)


def test_an_empty_bin_adds_nothing():
    data = pixels(2)
    data.polar[:, 1] = np.abs(data.polar[:, 1])
    residual = np.ones((len(data.polar), 3))
    found = fit_bins(data, residual, BinSettings(4, 8, 1.0), STEEPEST).coefficients
    assert np.abs(found[:, :4]).max() == 0
    assert found[:, 4:, 5].min() > 0.5


def test_a_firmer_hold_shrinks_the_correction():
    data = pixels(3)
    residual = np.ones((len(data.polar), 3))
    added = []
    for held in (0.01, 1.0, 100.0):
        bins = fit_bins(data, residual, BinSettings(2, 3, held), STEEPEST)
        added.append(bins.change(data.polar, data.position).mean())
    assert added[0] > added[1] > added[2] > 0
    # Eight presses in every bin, held by a hundredth of one: nearly all of it.
    assert added[0] == pytest.approx(1.0, abs=0.2)


def test_between_bins_it_is_continuous_and_level_gel_is_unchanged():
    coefficients = np.random.default_rng(4).normal(size=(5, 8, 6, 3))
    bins = Bins(coefficients, STEEPEST)
    assert np.abs(bins.at(np.zeros(3), np.array([-3.0, 0.0, 2.0]))).max() == 0
    ends = bins.at(np.full(2, 0.4), np.array([-np.pi, np.pi]))
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-12)
    middle = bins.at(np.array([0.5]), np.array([-np.pi + 2.5 * 2 * np.pi / 8]))
    np.testing.assert_allclose(middle[0], coefficients[2, 2], atol=1e-12)
    fine = bins.at(np.linspace(0, 1, 2001), np.full(2001, 0.3))
    assert np.abs(np.diff(fine, axis=0)).max() < 0.03

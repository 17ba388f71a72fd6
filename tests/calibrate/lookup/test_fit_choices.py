"""Bent normals, labels and drift that are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tacgen.calibrate.lookup.model_choice import _drift_share
from tacgen.calibrate.lookup.press_fit import (
    PressSums,
    expected_by_label,
    learn_labels,
    plain_press_model,
)
from tacgen.calibrate.lookup.settings import FitSettings
from tacgen.calibrate.lookup.smooth_model import (
    n_light_terms,
    n_position_features,
)
from tacgen.presses.press_images import label_mm
from tests.virtual_presses import repeated, virtual_presses


def test_labels_that_scatter_more_than_the_presses_lead_to_their_middle():
    rng = np.random.default_rng(4)
    geometry = np.column_stack([*rng.normal([1.0, -2.0], 0.02, (24, 2)).T, np.full(24, 0.8)])
    labels = (
        geometry + np.array([0.0, 0.0, 0.5]) + np.pad(rng.normal(0, 0.2, (24, 2)), ((0, 0), (0, 1)))
    )
    learnt = learn_labels(labels, geometry)
    off = learnt.geometry(labels) - geometry
    assert np.abs(off[:, :2]).max() < 0.1
    far = learnt.geometry(np.array([[8.0, 8.0, 1.3]]))[0]
    assert np.abs(far[:2] - 8.0).max() <= 0.5 * 1.3 + 1e-9  # no press has told of there


def test_labels_of_presses_all_over_the_gel_keep_their_places():
    rng = np.random.default_rng(5)
    geometry = np.column_stack([rng.uniform(-6, 6, (24, 2)), np.full(24, 0.8)])
    labels = geometry - [0.3, -0.1, 0.0] + np.pad(rng.normal(0, 0.1, (24, 2)), ((0, 0), (0, 1)))
    off = learn_labels(labels, geometry).geometry(labels) - geometry
    assert np.abs(off[:, :2].mean(axis=0)).max() < 0.02
    assert off[:, :2].std() < 0.13


@pytest.mark.parametrize(
    ("scatter_radii", "trial", "closer"),
    [(0.1, False, True), (1.0, False, False), (0.1, True, False)],
    ids=["labels scatter", "the ball moved", "named trials"],
)
def test_pictures_of_a_press_are_expected_where_all_their_labels_say(scatter_radii, trial, closer):
    """Four labels with errors of their own: their middle is off by half as much as one is."""
    alone = virtual_presses(3, count=12)
    presses = repeated(alone, 4)
    off_px = np.random.default_rng(0).normal(0, scatter_radii * alone.radius_px.mean(), (48, 2))
    number = np.repeat(np.arange(12), 4)
    presses = replace(
        presses,
        center_px=presses.center_px + off_px,
        experiment=number,
        trial=number.astype(float) if trial else None,
    )
    model = plain_press_model(1.3).labels
    true = model.geometry(label_mm(repeated(alone, 4)))[:, :2]
    error = expected_by_label(presses, model)[:, :2] - true
    alone_error = off_px * presses.mm_per_px
    expected = 0.5 if closer else 1.0
    assert error.std() / alone_error.std() == pytest.approx(expected, abs=0.15)


@pytest.mark.parametrize("comes_again", [True, False])
def test_drift_that_comes_again_is_kept_other_drift_is_left_out(comes_again):
    """Drift that is the same function of what is pressed where, or noise of each press."""
    rng = np.random.default_rng(6)
    settings = FitSettings(degree=1, position_degree=1, ridge=1e-9)
    n_columns = n_light_terms(1) * n_position_features(1)
    light, again = rng.normal(size=(2, n_columns, 3))
    sums = []
    for _ in range(5):
        columns = rng.normal(size=(60, n_columns))
        drift = columns @ again if comes_again else 3 * rng.normal(size=(60, 3))
        target = np.hstack([columns @ light + drift, drift])
        sums.append(
            PressSums(columns.T @ columns, columns.T @ target, (target**2).sum(axis=0), 60.0)
        )
    share = _drift_share(sums, settings, 0, float(comes_again))
    assert share < 0.01 if comes_again else share > 0.9

"""Tracks in other axes than the gel's are refused with those that fit; so is a fit of nothing."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from tacgen.calibrate.contact.marker_fit import field_data, fit_field
from tacgen.core.errors import PressError
from tacgen.core.records import Estimate
from tacgen.presses.marker_tracks import AXES, read_marker_tracks
from tests.marker_sessions import K_N, K_S, SENSOR, make_session, read_session
from tests.messages import refused

FIGURES = r"(?<=: )shear field of .* noise [\d.]+ µm"
"""What a fit to noise comes to, which no two machines need to give alike."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return make_session(tmp_path_factory.mktemp("session"), presses=5)


@pytest.fixture(scope="module")
def tracks(folder):
    return read_session(folder)[1]


def in_axes(tracks, matrix):
    """Tracks that ``matrix`` turns back into the gel's axes."""
    return replace(tracks, places_mm=tracks.places_mm @ matrix, rest_mm=tracks.rest_mm @ matrix)


@pytest.mark.slow
@pytest.mark.parametrize("axes", list(AXES)[::3])
def test_each_symmetry_of_the_grid_is_named(tracks, axes):
    matrix = np.array(AXES[axes])
    np.testing.assert_array_equal(matrix @ matrix.T, np.eye(2))
    with refused(PressError):
        field_data(in_axes(tracks, matrix), SENSOR, K_N, 4)


def test_a_grid_written_with_x_for_y_is_named(folder, tmp_path):
    log, _ = read_session(folder)
    dots = pd.read_csv(folder / "markers.csv")
    path = tmp_path / "markers.csv"
    dots.rename(columns={"x_px": "y_px", "y_px": "x_px"}).to_csv(path, index=False)
    with refused(PressError):
        read_marker_tracks(path, SENSOR, log)


@pytest.mark.slow
def test_a_fit_that_explains_nothing_is_refused(tracks):
    noise = np.random.default_rng(0).normal(0.0, 0.02, tracks.places_mm.shape)
    data = field_data(replace(tracks, places_mm=tracks.rest_mm + noise), SENSOR, K_N, 4)
    with refused(PressError, hide=FIGURES):
        fit_field(data)


@pytest.mark.slow
def test_a_fit_that_contradicts_the_log_is_refused(tracks):
    data = field_data(tracks, SENSOR, K_N, 4)
    assert fit_field(data, Estimate(K_S, 0.01)).k_s.value == pytest.approx(K_S, rel=0.05)
    with refused(PressError, hide=FIGURES):
        fit_field(data, Estimate(0.4, 0.01))

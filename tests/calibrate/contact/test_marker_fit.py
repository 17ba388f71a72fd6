"""The shear field fitted to marker tracks of the virtual rig: its parameters come back."""

from __future__ import annotations

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from tacgen.calibrate.contact.marker_fit import (
    FieldFit,
    Slip,
    field_data,
    fit_field,
    fit_slip,
    load_tracks,
)
from tacgen.cli import app
from tacgen.contact.ball_shear import Place
from tacgen.contact.law import load_law
from tacgen.core.errors import PressError
from tests.marker_sessions import K_N, K_S, SENSOR, make_session, read_session
from tests.messages import refused


def fitted(folder, frames=16) -> FieldFit:
    return fit_field(field_data(read_session(folder)[1], SENSOR, K_N, frames))


@pytest.mark.slow
def test_k_s_decay_and_friction_come_back_through_the_command(tmp_path):
    make_session(tmp_path, presses=12, decay_mm=1.8, friction=0.6)
    out = tmp_path / "contact.yaml"
    result = CliRunner().invoke(
        app,
        ["calibrate", "contact", str(tmp_path / "press_log.csv"), "--out", str(out), "--json",
         "--markers", str(tmp_path / "markers.csv"), "--sensor", "virtual_gelsight",
         "--report", str(tmp_path / "report")],
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    law = load_law(out)
    assert law.k_s_mm_per_n.value == pytest.approx(K_S, rel=0.03)
    assert law.decay_mm.value == pytest.approx(1.8, rel=0.05)
    assert law.friction.value == pytest.approx(0.6, rel=0.05)
    assert law.marker_pitch_mm == SENSOR.markers.pitch_mm
    field = json.loads(result.stdout)["field"]
    assert field["friction"]["value"] == law.friction.value
    # The gauge's noise and the steps of the load between frames are no more than a tenth of it.
    assert field["rmse_mm"] < 1.1 * field["noise_mm"]
    page = (tmp_path / "report" / "index.html").read_text()
    assert "Motion of the dots at the largest shear" in page


@pytest.mark.slow
def test_a_contact_that_sticks_gives_no_friction_but_how_much_there_is_at_least(tmp_path):
    found = fitted(make_session(tmp_path, presses=10), frames=8)
    assert found.friction is None
    assert found.least_friction > 0.6  # the pull goes up to 0.5 of the force
    assert found.k_s.value == pytest.approx(K_S, rel=0.03)
    assert "no slip shows" in found.sentence()


def test_too_few_presses_or_no_sensor_are_refused(tmp_path):
    make_session(tmp_path, presses=3)
    log, tracks = read_session(tmp_path)
    with refused(PressError):
        field_data(tracks, SENSOR, K_N)
    with refused(PressError):
        load_tracks(tmp_path / "markers.csv", None, log)


@pytest.mark.exhaustive
@pytest.mark.slow
def test_intervals_hold_the_truth_as_often_as_they_say(tmp_path):
    """Of 20 sessions × 3 parameters at 95 %: binomially at least 52 of 60 (p < 0.01 of fewer)."""
    held = 0
    for seed in range(20):
        folder = make_session(tmp_path / str(seed), presses=10, seed=seed, friction=0.6)
        found = fitted(folder, frames=10)
        assert found.friction is not None
        for estimate, true in ((found.k_s, K_S), (found.decay, 1.5), (found.friction, 0.6)):
            held += abs(estimate.value - true) <= 1.96 * estimate.stderr
    assert held >= 52


def test_a_place_that_no_press_reaches_is_nothing(tmp_path):
    data = field_data(read_session(make_session(tmp_path, presses=4))[1], SENSOR, K_N, 3)
    far = Slip(place=Place(40.0, 40.0, 1.0, 0.1))
    np.testing.assert_array_equal(data.strain(0, far), data.strain(0, Slip()))
    assert fit_slip(data, range(4), Slip(), ("decay",)).decay_mm == pytest.approx(1.5, rel=0.1)

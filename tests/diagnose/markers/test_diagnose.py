"""What the field of marker motion lacks, named; and nothing where it lacks nothing."""

from __future__ import annotations

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from tacgen.cli import app
from tacgen.contact.law import load_law
from tacgen.diagnose.markers.diagnose import diagnose_markers
from tests.marker_sessions import K_N, SENSOR, make_session, read_session


def diagnosed(folder, **markers):
    make_session(folder, presses=16, **markers)
    return diagnose_markers(read_session(folder)[1], SENSOR, K_N)


@pytest.mark.slow
def test_nothing_is_sufficient(tmp_path):
    found = diagnosed(tmp_path, seed=3)
    assert found.verdict == "sufficient"
    assert not found.effects
    assert found.before_mm == found.after_mm == pytest.approx(found.data.noise_mm, rel=0.05)


@pytest.mark.exhaustive
@pytest.mark.slow
def test_a_grid_that_is_turned_or_shifted(tmp_path):
    found = diagnosed(tmp_path / "both", grid_turn_deg=1.0, grid_shift_mm=(0.1, -0.05))
    assert list(found.effects) == ["grid_turned", "grid_shifted"]
    turn = found.effects["grid_turned"]["turn_rad"]
    assert turn.value == pytest.approx(np.radians(1.0), abs=4 * turn.stderr)
    assert turn.unit == "rad"
    assert found.effects["grid_shifted"]["shift_y_mm"].value == pytest.approx(-0.05, abs=0.003)
    assert found.after_mm < 1.05 * found.data.noise_mm < 0.1 * found.before_mm
    one = diagnosed(tmp_path / "one", grid_shift_mm=(0.0, 0.05))
    assert list(one.effects) == ["grid_shifted"]


@pytest.mark.exhaustive
@pytest.mark.slow
def test_a_place_with_other_friction_where_the_rest_sticks(tmp_path):
    place = {"x_mm": 1.0, "y_mm": -1.0, "radius_mm": 2.0, "friction": 0.15}
    found = diagnosed(tmp_path, place=place)
    assert list(found.effects) == ["friction_place"]
    parameters = found.effects["friction_place"]
    for name, error in (("x_mm", 0.4), ("y_mm", 0.4), ("radius_mm", 0.4), ("friction", 0.06)):
        assert parameters[name].value == pytest.approx(place[name], abs=error)
    assert found.gains["friction_place"] > 0


@pytest.mark.slow
def test_partial_slip_is_a_channel_of_the_diagnosis_and_goes_into_the_law(tmp_path):
    make_session(tmp_path, presses=16, friction=0.7)
    out = tmp_path / "diagnosis"
    result = CliRunner().invoke(
        app,
        ["diagnose", "contact", str(tmp_path / "press_log.csv"), "--out", str(out),
         "--markers", str(tmp_path / "markers.csv"), "--sensor", "virtual_gelsight"],
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    channels = json.loads((out / "diagnosis.json").read_text())["channels"]
    assert list(channels) == ["normal", "shear", "markers"]
    # The sum cannot show it: D = k_s F_s, however the contact slips.
    assert channels["shear"]["verdict"] == "sufficient"
    found = channels["markers"]
    assert found["verdict"] == "effect_found"
    (effect,) = found["effects"]
    assert effect["name"] == "partial_slip"
    friction = effect["parameters"]["friction"]
    assert friction["value"] == pytest.approx(0.7, abs=4 * friction["stderr"])
    assert effect["heldout_gain"] > 0.01
    assert found["error_after"]["rmse"] < found["error_before"]["rmse"]
    assert set(found["noise_floor"]) == {"rmse", "how"}
    assert found["trials"]["fit"] + found["trials"]["test"] == 16
    law = load_law(out / "contact.yaml")
    assert law.friction.value == pytest.approx(friction["value"])
    assert law.decay_mm.value == pytest.approx(1.5, rel=0.05)
    assert "partial slip" in result.output
    assert "the field with the effects that were found" in (out / "report.html").read_text()

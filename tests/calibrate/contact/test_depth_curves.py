"""Curves of force against depth: the ball and the k_n behind them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from tacgen.calibrate.contact.depth_curves import (
    DepthCurve,
    depth_warnings,
    explain_curves,
    read_depth_curves,
)
from tacgen.cli import app
from tacgen.core.errors import PressError
from tacgen.presses.geometry import ball_volume_mm3


def curve(name, radius_mm, k_n, deepest_mm, *, late_mm=0.0, seed=0):
    depth = np.linspace(0.0, deepest_mm, 40)
    force = ball_volume_mm3(depth - late_mm, radius_mm) / k_n
    noise = 0.003 * force.max() * np.random.default_rng(seed).standard_normal(40)
    return DepthCurve(name, depth, force + noise)


@pytest.mark.slow
def test_the_ball_and_k_n_are_found_where_the_curve_bends():
    """Deep enough that the cap is no parabola: radius and k_n part."""
    found = explain_curves((curve("a", 2.0, 4.0, 2.5, late_mm=0.1),)).curves["a"]
    assert found.radius_mm == pytest.approx(2.0, rel=0.05)
    assert found.k_n == pytest.approx(4.0, rel=0.05)
    assert found.contact_point_mm == pytest.approx(-0.1, abs=0.02)
    assert found.r_squared > 0.999


@pytest.mark.slow
def test_a_shallow_curve_says_that_it_cannot_tell_the_radius():
    """V ≈ π R d² for d ≪ R: only R / k_n is known, and the interval is open above."""
    found = explain_curves((curve("a", 5.0, 4.0, 0.3),)).curves["a"]
    assert found.radius_interval_mm[1] > 99.0
    assert found.radius_mm / found.k_n == pytest.approx(5.0 / 4.0, rel=0.1)


@pytest.mark.slow
def test_one_k_n_or_not():
    same = explain_curves((curve("a", 2.0, 4.0, 2.5), curve("b", 4.0, 4.0, 3.0, seed=1)))
    assert same.one_k_n_will_do
    assert same.shared_k_n == pytest.approx(4.0, rel=0.05)
    other = explain_curves((curve("a", 2.0, 4.0, 2.5), curve("b", 4.0, 8.0, 3.0, seed=1)))
    assert not other.one_k_n_will_do


@pytest.mark.slow
def test_what_is_no_ball_is_said():
    """A cone: F grows as d³ and no ball's curve does."""
    made = curve("a", 2.0, 4.0, 2.5)
    cone = DepthCurve("cone", made.depth_mm, made.depth_mm**3)
    found = explain_curves((cone,))
    assert found.curves["cone"].residual_correlation > 0.5
    assert any("the residual is not noise" in text for text in depth_warnings(Path("c.csv"), found))
    assert abs(explain_curves((made,)).curves["a"].residual_correlation) < 0.5


def test_a_known_radius_is_kept():
    found = explain_curves((curve("a", 5.0, 4.0, 0.3),), radius_mm=5.0).curves["a"]
    assert found.radius_mm == pytest.approx(5.0)
    assert found.k_n == pytest.approx(4.0, rel=0.03)


def test_what_is_wrong_with_a_file_is_said(tmp_path):
    path = tmp_path / "curves.csv"
    pd.DataFrame({"curve": "a", "force_normal_n": [1.0, 2.0], "depth_mm": [0.1, None]}).to_csv(path)
    with pytest.raises(PressError, match="row 3: curve a: depth_mm or force_normal_n is empty"):
        read_depth_curves(path)


@pytest.mark.slow
def test_the_page_shows_the_curves(tmp_path):
    path = tmp_path / "curves.csv"
    made = curve("a", 2.0, 4.0, 2.5)
    pd.DataFrame({"curve": "a", "force_normal_n": made.force_n, "depth_mm": made.depth_mm}).to_csv(
        path, index=False
    )
    arguments = ["calibrate", "contact", str(path), "--out", str(tmp_path / "c.yaml")]
    result = CliRunner().invoke(app, [*arguments, "--report", str(tmp_path / "report")])
    assert result.exit_code == 0, result.output
    page = (tmp_path / "report" / "contact.html").read_text()
    assert "data:image/png" in page
    assert "the volume is that of a ball whose radius was fitted" in page


@pytest.mark.slow
def test_measured_curves_by_the_command(measured_data, tmp_path):
    path = measured_data / "force_depth_curves" / "force_depth.csv"
    out = tmp_path / "contact.yaml"
    result = CliRunner().invoke(
        app, ["calibrate", "contact", str(path), "--out", str(out), "--json"]
    )
    assert result.exit_code == 0, result.output
    assert "one constant k_n does not explain these curves" in result.stderr
    curves = json.loads(result.stdout)["curves"]
    assert len(curves) == 2
    assert all(found["r_squared"] > 0.998 for found in curves.values())
    assert out.exists()

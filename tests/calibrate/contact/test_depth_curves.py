"""Curves of force against depth: the ball and the k_n behind them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from tacgen.calibrate.contact.command import calibrate_contact
from tacgen.calibrate.contact.depth_curves import (
    DepthCurve,
    Pooled,
    _zero_n,
    check_identified,
    depth_warnings,
    explain_curves,
    law_of,
    read_depth_curves,
)
from tacgen.cli import app
from tacgen.core.errors import PressError
from tacgen.presses.geometry import ball_volume_mm3
from tacgen.presses.lab_table import LogFormat, read_log_table
from tacgen.presses.press_log import press_log_of


def curve(name, radius_mm, k_n, deepest_mm, *, late_mm=0.0, power=1.0, seed=0):
    depth = np.linspace(0.0, deepest_mm, 40)
    force = (ball_volume_mm3(depth - late_mm, radius_mm) / k_n) ** (1.0 / power)
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
    assert same.k_interval[0] < 4.0 < same.k_interval[1]
    other = explain_curves((curve("a", 2.0, 4.0, 2.5), curve("b", 4.0, 8.0, 3.0, seed=1)))
    assert not other.one_k_n_will_do


@pytest.mark.slow
def test_what_is_no_ball_is_said():
    """A cone: F grows as d³ and no ball's curve does."""
    made = curve("a", 2.0, 4.0, 2.5)
    cone = DepthCurve("cone", made.depth_mm, made.depth_mm**3)
    found = explain_curves((cone,))
    assert found.curves["cone"].residual_correlation > 0.5
    assert any(
        "the residual is not noise" in text for text in depth_warnings(Path("c.csv"), found, None)
    )
    assert abs(explain_curves((made,)).curves["a"].residual_correlation) < 0.5


def test_a_known_radius_is_kept():
    found = explain_curves((curve("a", 5.0, 4.0, 0.3),), radius_mm=5.0).curves["a"]
    assert found.radius_mm == pytest.approx(5.0)
    assert found.k_n == pytest.approx(4.0, rel=0.03)


def test_a_power_of_the_force_is_found_where_the_radius_is_known():
    made = [curve(str(k), 4.0, 5.0, 1.5, late_mm=0.2, power=1.3, seed=k) for k in range(3)]
    found = explain_curves(tuple(made), radius_mm=4.0)
    # V = 5 F^1.3.
    assert found.power == pytest.approx(1.3, abs=0.02)
    expected = 5.0 * found.reference_n**0.3
    assert found.shared_k_n == pytest.approx(expected, rel=0.02)
    first = found.curves["0"]
    assert first.contact_point_mm == pytest.approx(-0.2, abs=0.02)
    assert first.rmse_linear_n > 2 * first.rmse_n
    # The written law answers with the same power.
    force = np.array([0.5, 1.0, 2.0])
    columns = {"trial": [0, 1, 2], "time_s": [0.0] * 3, "force_normal_n": force}
    volume, _ = law_of(found, {}).predict(columns)
    np.testing.assert_allclose(volume, 5.0 * force**1.3, rtol=0.03)


def test_a_linear_gel_has_no_power_of_the_force():
    made = tuple(curve(str(k), 4.0, 5.0, 1.5, late_mm=0.2, seed=k) for k in range(3))
    found = explain_curves(made, radius_mm=4.0)
    assert found.power == 1.0
    assert law_of(found, {}).effects == ()


def test_the_interval_holds_another_sessions_curve():
    compliances = (173.0, 250.0, 310.0, 404.0)
    made = [curve(str(k), 4.0, k, 1.5, seed=int(k)) for k in compliances]
    found = explain_curves(tuple(made), radius_mm=4.0)
    assert not found.one_k_n_will_do
    assert found.k_interval[0] < 173.0
    assert found.k_interval[1] > 404.0
    law = law_of(found, {}).k_n_mm3_per_n
    assert law.value + 1.96 * law.stderr > 404.0


def test_the_interval_of_one_curve_of_a_known_ball_holds_its_k_n():
    made = [curve("a", 4.0, 5.0, 1.5, late_mm=0.2, seed=seed) for seed in range(60)]
    intervals = [explain_curves((one,), radius_mm=4.0).k_interval for one in made]
    held = np.mean([low < 5.0 < high for low, high in intervals])
    # 95 % of 60 draws: three standard errors are 8 %.
    assert held >= 0.87
    widths = [np.log(high / low) for low, high in intervals]
    # The same fit by least squares: both columns of F = c V(d + s), noise of 0.3 % of the largest.
    depth = made[0].depth_mm
    volume = ball_volume_mm3(depth - 0.2, 4.0)
    columns = np.column_stack([volume, np.gradient(volume, depth) / 5.0])
    noise = 0.003 * volume.max() / 5.0
    stderr = 5.0 * noise * np.sqrt(np.linalg.inv(columns.T @ columns)[0, 0])
    assert np.median(widths) == pytest.approx(2 * 1.96 * stderr, rel=0.25)


def test_pooling_of_equal_errors_is_the_mean_and_the_scatter_between():
    # With equal errors DerSimonian and Laird's variance is the sample's less the errors'.
    pooled = Pooled.of([1.0, 2.0, 6.0], [0.5, 0.5, 0.5])
    between = np.var([1.0, 2.0, 6.0], ddof=1) - 0.25
    assert pooled.value == pytest.approx(3.0)
    assert pooled.scatter == pytest.approx(np.sqrt((between + 0.25) / 3 + between))
    alone = Pooled.of([2.0], [0.5])
    assert (alone.value, alone.scatter, alone.p_value) == (2.0, 0.5, 1.0)


def test_curves_that_bound_no_ball_are_refused():
    # A cap's volume is π d² (R − d/3): a pure parabola is that of a ball without end.
    depth = np.linspace(0.0, 1.0, 40)
    with pytest.raises(PressError, match="give the ball's radius with --radius-mm"):
        check_identified(Path("c.csv"), explain_curves((DepthCurve("a", depth, 3.0 * depth**2),)))


def test_a_contact_point_before_the_force_rises_is_said():
    depth = np.linspace(0.0, 1.5, 40)
    sudden = DepthCurve("a", depth, np.where(depth < 0.5, 0.0, 2.0 + 3.0 * (depth - 0.5)))
    texts = depth_warnings(Path("c.csv"), explain_curves((sudden,)), None)
    assert any("but the force rises at 0.50 mm only" in text for text in texts)
    prompt = explain_curves((curve("a", 2.0, 4.0, 2.5, late_mm=0.1),))
    assert not any("rises" in text for text in depth_warnings(Path("c.csv"), prompt, None))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"depth_mm": [0.1, None]}, "only 1 of 2 samples can be used"),
        ({"depth_mm": [0.1, 0.2]}, "row 2: curve a has 2 samples in contact; at least 8"),
    ],
)
def test_what_is_wrong_with_a_file_is_said(tmp_path, change, words):
    path = tmp_path / "curves.csv"
    pd.DataFrame({"curve": "a", "force_normal_n": [1.0, 2.0], **change}).to_csv(path)
    with pytest.raises(PressError, match=words):
        read_depth_curves(press_log_of(read_log_table(path, LogFormat())))


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
    page = (tmp_path / "report" / "index.html").read_text()
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


@pytest.mark.parametrize("zero_n", [0.0, 0.1, -0.3])
def test_an_untared_gauge_is_subtracted_and_said(tmp_path, zero_n):
    """Curves that begin at rest state their zero; k_n is then that of a gauge that was tared."""
    rng = np.random.default_rng(4)
    parts = []
    for curve in range(5):
        depth = np.concatenate([np.zeros(10), np.linspace(0.0, rng.uniform(0.6, 1.0), 60)])
        force = np.pi * depth**2 * (4.0 - depth / 3) / 5.135 + zero_n
        noisy = force + 0.01 * rng.normal(size=len(depth))
        rows = {"curve": curve, "force_normal_n": noisy, "depth_mm": depth, "radius_mm": 4.0}
        parts.append(pd.DataFrame(rows))
    pd.concat(parts).to_csv(tmp_path / "curves.csv", index=False)
    found = calibrate_contact(tmp_path / "curves.csv", tmp_path / "contact.yaml")
    assert found.law.k_n_mm3_per_n.value == pytest.approx(5.135, rel=0.02)
    assert any("at rest: that is subtracted" in warning for warning in found.warnings) == bool(
        zero_n
    )


@pytest.mark.slow
def test_clean_curves_of_one_gel_share_their_k_n_whatever_the_gauges_zero():
    """Twenty logs of 12 presses; each curve's error covers what its noise and its zero do."""
    shared, covered, off = 0, 0, []
    for seed in range(1000, 1020):
        rng = np.random.default_rng(seed)
        zero_n, curves = rng.choice([0.0, 0.005, 0.02, 0.05]), []
        for press in range(12):
            swing = (0.6 + 0.05 * press) * np.sin(np.pi * np.arange(80) / 79)
            depth = np.maximum(0.0, swing - 0.05)
            force = np.pi * depth**2 * (4.0 - depth / 3) / 5.2 + zero_n + rng.normal(0, 0.01, 80)
            table = DepthCurve(str(press), depth, force - _zero_n(depth, force), 4.0)
            curves.append(table)
        report = explain_curves(tuple(curves))
        shared += report.one_k_n_will_do
        covered += report.k_interval[0] <= 5.2 <= report.k_interval[1]
        for fit in report.curves.values():
            low, high = np.log(fit.k_interval)
            off.append(np.log(fit.k_n / 5.2) / ((high - low) / 3.92))
    assert shared >= 17  # Cochran's Q is tested at 5 %
    assert covered >= 17  # of 20 intervals of 95 %, three out have a chance of 7 %
    assert np.std(off) == pytest.approx(0.95, abs=0.15)  # 240 standardised errors
    assert abs(np.mean(off)) < 0.25  # of which those of one log share nothing but the design

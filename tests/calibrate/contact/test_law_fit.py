"""From a press log to contact.yaml, as a user runs it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from typer.testing import CliRunner

from tacgen.calibrate.contact.align import limits_of
from tacgen.calibrate.contact.law_fit import agreement_of, fit_contact
from tacgen.calibrate.contact.slope_fit import fit_slope
from tacgen.cli import app
from tacgen.contact.law import load_law
from tacgen.core.errors import PressError
from tacgen.presses.geometry import ball_depth_mm, ball_volume_mm3, cap_volume_from_circle_mm3
from tacgen.presses.press_log import read_press_log
from tests.messages import refused

K_N, K_S = 5.0, 0.8
COLUMNS = ("force_normal_n", "volume_mm3", "trial")


def session(seed=0, n_trials=16, k_by_ball=(K_N, K_N)) -> pd.DataFrame:
    """Load, hold, shear and unload with two balls over the gel."""
    rng = np.random.default_rng(seed)
    course_s = np.linspace(0.0, 4.0, 50)
    shape = np.interp(course_s, [0.0, 1.0, 3.0, 4.0], [0.0, 1.0, 1.0, 0.0])
    slide = np.interp(course_s, [0.0, 1.2, 2.0, 2.8, 4.0], [0.0, 0.0, 1.0, 0.0, 0.0])
    parts = []
    for trial in range(n_trials):
        ball = trial % 2
        force, angle = rng.uniform(3.0, 8.0) * shape, rng.uniform(-np.pi, np.pi)
        shear = 2.0 * slide[:, None] * [np.cos(angle), np.sin(angle)]
        noise = rng.standard_normal((50, 6))
        parts.append(
            pd.DataFrame(
                {
                    "trial": trial,
                    "time_s": 10.0 * trial + course_s,
                    "indenter": ["small", "large"][ball],
                    "radius_mm": [2.0, 4.0][ball],
                    "x_mm": rng.uniform(-4, 4),
                    "y_mm": rng.uniform(-4, 4),
                    "force_normal_n": force + 0.02 * noise[:, 0],
                    "force_shear_x_n": shear[:, 0] + 0.01 * noise[:, 1],
                    "force_shear_y_n": shear[:, 1] + 0.01 * noise[:, 2],
                    "volume_mm3": k_by_ball[ball] * force + 0.2 * noise[:, 3],
                    "shear_x_mm": K_S * shear[:, 0] + 0.02 * noise[:, 4],
                    "shear_y_mm": K_S * shear[:, 1] + 0.02 * noise[:, 5],
                }
            )
        )
    return pd.concat(parts, ignore_index=True)


def write(frame: pd.DataFrame, folder: Path) -> Path:
    path = folder / "log.csv"
    frame.to_csv(path, index=False)
    return path


def calibrate(*arguments: object):
    return CliRunner().invoke(app, ["calibrate", "contact", *map(str, arguments)])


@pytest.mark.slow
def test_the_law_is_recovered_and_loads(tmp_path):
    log, out = write(session(), tmp_path), tmp_path / "contact.yaml"
    result = calibrate(log, "--out", out, "--report", tmp_path / "report", "--marker-pitch-mm", 1.5)
    assert result.exit_code == 0, result.output
    law = load_law(out)
    assert abs(law.k_n_mm3_per_n.value - K_N) < 3.0 * law.k_n_mm3_per_n.stderr < 0.1
    assert abs(law.k_s_mm_per_n.value - K_S) < 3.0 * law.k_s_mm_per_n.stderr < 0.1
    assert law.marker_pitch_mm == 1.5
    provenance = yaml.safe_load(out.read_text())["provenance"]
    assert provenance["trials"] == {"fit": 16, "left_out": 0}
    assert len(provenance["data"]["log.csv"]) == 64
    assert provenance["held_out_error"]["normal"]["rmse"] == pytest.approx(0.22, rel=0.1), (
        "volume noise 0.2 and gauge noise 0.02 N × 5 mm³/N"
    )
    page = (tmp_path / "report" / "index.html").read_text()
    assert "data:image/png" in page
    assert "://" not in page.replace("http://www.w3.org", "")


def test_balls_that_agree_and_balls_that_do_not(tmp_path):
    same = fit_contact(read_press_log(write(session(), tmp_path))).normal
    assert same.by == "indenter"
    assert same.agreement.p_value > 0.05
    other = fit_contact(read_press_log(write(session(k_by_ball=(5.0, 5.5)), tmp_path)))
    assert other.normal.agreement.p_value < 1e-6
    assert other.normal.agreement.spread == pytest.approx(0.095, abs=0.02)
    assert other.normal.groups["large"].value == pytest.approx(5.5, rel=0.01)
    assert any("k differs between values of 'indenter'" in text for text in other.warnings)


@pytest.mark.exhaustive
@pytest.mark.slow
def test_agreement_is_rejected_as_often_as_it_says():
    """5 % of 100 true hypotheses, within 3.5 standard deviations of the binomial."""
    rejected = 0
    for seed in range(100):
        frame = session(seed, n_trials=10)
        groups = {
            name: fit_slope(*(ball[column].to_numpy() for column in COLUMNS))
            for name, ball in frame.groupby("indenter")
        }
        rejected += agreement_of(groups, K_N).p_value < 0.05
    assert rejected <= 0.05 * 100 + 3.5 * np.sqrt(100 * 0.05 * 0.95)


def test_held_out_trials_had_no_part(tmp_path):
    """A press of twice the compliance is predicted by the others' law, not by its own."""
    frame = session()
    odd = frame["trial"] == 5
    frame.loc[odd, "volume_mm3"] *= 2.0
    held = fit_contact(read_press_log(write(frame, tmp_path))).normal.held_out
    force = frame.loc[odd, "force_normal_n"]
    assert held.by_trial[str(5)] == pytest.approx(K_N * np.sqrt((force**2).mean()), rel=0.03)


def test_too_few_presses(tmp_path):
    result = calibrate(write(session(n_trials=2), tmp_path), "--out", tmp_path / "c.yaml")
    assert isinstance(result.exception, PressError)
    assert "2 usable presses, fewer than 3" in str(result.exception)
    assert not (tmp_path / "c.yaml").exists()


def test_left_out_presses_are_said_where_the_user_looks(tmp_path):
    frame = session()
    frame.loc[120, "time_s"] -= 9.0
    result = calibrate(write(frame, tmp_path), "--out", tmp_path / "c.yaml", "--json")
    assert result.exit_code == 0
    assert "trial 2 is dropped: time_s goes backwards at row 122" in result.stderr
    content = json.loads(result.stdout)
    assert [entry["trial"] for entry in content["left_out"]] == [2]
    assert content["trials"] == {"fit": 15, "left_out": 1}


def test_a_log_without_shear_has_no_k_s(tmp_path):
    frame = session().drop(columns=["shear_x_mm", "shear_y_mm"])
    result = calibrate(write(frame, tmp_path), "--out", tmp_path / "c.yaml")
    assert np.isnan(load_law(tmp_path / "c.yaml").k_s_mm_per_n.value)
    assert "k_s is unknown" in result.stderr


def test_what_a_schedule_leaves_open(tmp_path):
    full = read_press_log(write(session(), tmp_path))
    assert limits_of(full) == ()
    rising = session().query("time_s % 10 < 0.9")[
        ["trial", "time_s", "force_normal_n", "volume_mm3"]
    ]
    subjects = {limit.subject for limit in limits_of(read_press_log(write(rising, tmp_path)))}
    assert subjects == {"geometry", "shear", "unloading", "hold", "position"}


def test_signs_that_cannot_be(tmp_path):
    frame = session()
    frame["volume_mm3"] *= -1.0
    with refused(PressError):
        fit_contact(read_press_log(write(frame, tmp_path)))


def test_structure_that_a_line_leaves_over_is_said(tmp_path):
    clean = fit_contact(read_press_log(write(session(), tmp_path)))
    assert clean.warnings == ()
    assert clean.normal.noise == pytest.approx(0.22, rel=0.15)
    frame = session()
    frame["volume_mm3"] *= 1.0 - 0.03 * frame["force_normal_n"]
    bent = fit_contact(read_press_log(write(frame, tmp_path)))
    assert any("an effect is missing; `tacgen diagnose" in text for text in bent.warnings)


def test_an_unknown_group(tmp_path):
    with refused(PressError):
        fit_contact(read_press_log(write(session(), tmp_path)), by="colour")


def test_ball_volumes_against_closed_forms():
    assert ball_volume_mm3(2.0, 2.0) == pytest.approx(2.0 / 3.0 * np.pi * 8.0)
    assert ball_volume_mm3(3.0, 2.0) == pytest.approx(2.0 / 3.0 * np.pi * 8.0 + np.pi * 4.0)
    assert ball_volume_mm3(-1.0, 2.0) == 0.0
    depths = np.linspace(0.0, 5.0, 40)
    np.testing.assert_allclose(ball_depth_mm(ball_volume_mm3(depths, 2.5), 2.5), depths, atol=1e-12)
    height = 0.5
    circle = np.sqrt(2.0 * 4.0 * height - height**2)
    assert cap_volume_from_circle_mm3(circle, 4.0) == pytest.approx(ball_volume_mm3(height, 4.0))


def test_without_a_ball_the_force_begins_where_the_imprint_does(tmp_path):
    """Gauges that are 0.3 N above zero and 0.2 N below it; noise of 0.02 N and 0.1 mm³."""
    frame, rng = session(n_trials=4), np.random.default_rng(0)
    zero = np.array([0.3, -0.2, 0.3, -0.2])[frame["trial"]]
    frame["volume_mm3"] = 5.0 * frame["force_normal_n"] + 0.1 * rng.standard_normal(len(frame))
    frame["force_normal_n"] += zero + 0.02 * rng.standard_normal(len(frame))
    log = read_press_log(write(frame.drop(columns="radius_mm"), tmp_path))
    fit = fit_contact(log, free_contact_point=True)
    found = [point.force_n for point in fit.contact_points]
    np.testing.assert_allclose(found, (0.3, -0.2, 0.3, -0.2), atol=0.02)
    assert fit.normal.pooled.value == pytest.approx(5.0, rel=0.01)


def test_measured_ball_indentations(measured_data, tmp_path):
    path = measured_data / "asmi_ball_indentation" / "press_log.csv"
    fit = fit_contact(read_press_log(path))
    assert fit.normal.by == "sample"
    assert all(group.r_squared >= 0.999 for group in fit.normal.groups.values())
    assert len(fit.normal.groups) == 3


def stage_log(path, seed, zero_mm=0.0):
    """Presses of one ball as a stage and a gauge record them: exact depth, white noise of force.

    The depth of each press begins ``zero_mm`` of scatter from the logged zero.
    """
    rng = np.random.default_rng(seed)
    parts = []
    for trial in range(12):
        ramp = np.linspace(0.0, rng.uniform(0.5, 1.1), 36)
        depth = np.concatenate([np.zeros(8), ramp, ramp[::-1]])
        true = np.where(depth > 0, np.maximum(depth + zero_mm * rng.normal(), 0.0), 0.0)
        force = np.pi * true**2 * (4.0 - true / 3) / 5.135 + 0.03 * rng.normal(size=len(depth))
        rows = {"trial": trial, "time_s": 60.0 * trial + 0.05 * np.arange(len(depth))}
        parts.append(pd.DataFrame({**rows, "force_normal_n": force, "depth_mm": depth}))
    frame = pd.concat(parts, ignore_index=True).assign(radius_mm=4.0)
    frame["volume_mm3"] = np.pi * frame.depth_mm**2 * (4.0 - frame.depth_mm / 3)
    frame.to_csv(path, index=False)
    return read_press_log(path)


def test_contact_points_are_fitted_where_presses_begin_elsewhere(tmp_path):
    """Of one trial, k is then as uncertain as it is together with its contact point."""
    logs = [stage_log(tmp_path / f"{seed}.csv", seed, zero_mm=0.05) for seed in range(6)]
    fits = [fit_contact(log) for log in logs]
    assert all(fit.contact_points for fit in fits)
    assert (
        sum(bool(fit_contact(stage_log(tmp_path / "0.csv", s)).contact_points) for s in range(6))
        < 3
    )
    assert sum(fit.normal.agreement.p_value < 0.01 for fit in fits) <= 1
    errors = [
        (group.value - 5.135) / group.stderr for fit in fits for group in fit.normal.groups.values()
    ]
    # 72 presses: their k scatters by its standard error.
    assert 0.5 < np.std(errors) < 1.5

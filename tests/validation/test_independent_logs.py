"""The independent generator says the truth about what it makes."""

from __future__ import annotations

import numpy as np
import pytest

import validation.blind.evaluate as study
from validation.blind.independent.effects import UNLISTED
from validation.blind.independent.generator import draw_case
from validation.blind.independent.memory import dahl, play, relaxed, running_mean
from validation.blind.independent.normal_effects import NORMAL
from validation.blind.independent.shear_effects import SHEAR

SHEAR_FORCE = ["force_shear_x_n", "force_shear_y_n"]
SHEAR_MM = ["shear_x_mm", "shear_y_mm"]


def left_over(response, load):
    k = (load * response).sum() / (load**2).sum()
    return np.sqrt(((response - k * load) ** 2).mean())


def drawn_with_a_quiet_gauge(seeds, **wanted):
    """Cases, one after the other, whose logged forces are the true ones."""
    for seed in seeds:
        case = draw_case(seed, **wanted)
        if case.floor_mm3 == case.noise_mm3 and set(SHEAR_FORCE) <= set(case.frame):
            yield case


def test_the_same_seed_gives_the_same_log():
    wanted = {"normal": [("creep", 1.5)], "shear": [("slip", 2.0)]}
    first, second = draw_case(3, **wanted), draw_case(3, **wanted)
    assert first.frame.equals(second.frame)
    np.testing.assert_array_equal(first.volume_mm3, second.volume_mm3)
    assert not first.frame.equals(draw_case(4, **wanted).frame)


@pytest.mark.parametrize("name", sorted(NORMAL | UNLISTED))
@pytest.mark.parametrize("seed", [1, 2])
def test_normal_effects_have_the_strength_they_were_asked_for(name, seed):
    case = draw_case(seed, normal=[(name, 1.0)])
    assert case.reached == {("normal", name): pytest.approx(1.0, rel=0.02)}
    assert case.normal == (() if name in UNLISTED else (name,))
    assert case.unexplained == {"normal": name if name in UNLISTED else "", "shear": ""}
    assert name not in UNLISTED or name in case.frame


@pytest.mark.parametrize("name", sorted(SHEAR | UNLISTED))
@pytest.mark.parametrize("seed", [1, 2])
def test_shear_effects_have_the_strength_they_were_asked_for(name, seed):
    case = draw_case(seed, shear=[(name, 1.0)])
    assert case.reached == {("shear", name): pytest.approx(1.0, rel=0.02)}
    assert case.shear == (() if name in UNLISTED else (name,))
    assert set(SHEAR_MM) <= set(case.frame)


@pytest.mark.parametrize("name", ["creep", "latency", "position", "saturation", "stiffening"])
def test_the_strength_is_what_the_compliance_alone_leaves_over(name):
    case = next(drawn_with_a_quiet_gauge(range(60), normal=[(name, 2.0)]))
    force = case.frame["force_normal_n"].to_numpy()
    assert left_over(case.volume_mm3, force) / case.noise_mm3 == pytest.approx(2.0, rel=0.02)


@pytest.mark.parametrize("seed", [20018, 20032, 20053])
def test_a_blurred_frame_is_no_stronger_than_asked_for(seed):
    """Windows shorter than a step of the fine clock, in which the volume must not vanish."""
    case = draw_case(seed, normal=[("latency", 1.0)])
    assert case.form_names == ("latency:frame_averaging",)
    assert case.reached["normal", "latency"] == pytest.approx(1.0, rel=0.02)
    assert case.volume_mm3.min() > 0.0


def test_clean_logs_are_the_law_and_noise():
    cases = list(drawn_with_a_quiet_gauge(range(20)))
    assert len(cases) >= 3
    for case in cases:
        force = case.frame["force_normal_n"].to_numpy()
        np.testing.assert_allclose(case.volume_mm3, case.k_n_mm3_per_n * force, rtol=1e-12)
        shear = case.frame[SHEAR_FORCE].to_numpy()
        np.testing.assert_allclose(case.shear_mm, case.k_s_mm_per_n * shear, rtol=1e-12)


def test_no_strength_is_no_effect():
    """Nor a division by nothing: some forms divide by their amplitude."""
    wanted = {"normal": [("stiffening", 0.0), ("latency", 0.0)], "shear": [("slip", 0.0)]}
    forms = set()
    for case in drawn_with_a_quiet_gauge(range(40), **wanted):
        force = case.frame["force_normal_n"].to_numpy()
        np.testing.assert_allclose(case.volume_mm3, case.k_n_mm3_per_n * force, rtol=1e-12)
        assert set(case.reached.values()) == {0.0}
        forms |= set(case.form_names)
    assert {"stiffening:exponential", "latency:frame_averaging"} <= forms


def test_the_noise_is_as_large_as_is_said():
    for seed in range(12):
        case = draw_case(seed)
        noise = case.frame["volume_mm3"].to_numpy() - case.volume_mm3
        assert np.std(noise) == pytest.approx(case.noise_mm3, rel=0.1)
        gauge = case.frame["force_normal_n"].to_numpy() - case.volume_mm3 / case.k_n_mm3_per_n
        assert np.hypot(np.std(gauge) * case.k_n_mm3_per_n, case.noise_mm3) == pytest.approx(
            case.floor_mm3, rel=0.02
        )
        if set(SHEAR_MM) <= set(case.frame):
            noise = case.frame[SHEAR_MM].to_numpy() - case.shear_mm
            assert np.std(noise) == pytest.approx(case.noise_mm, rel=0.1)


def test_closed_loops_of_the_force_lose_work():
    """The work of the force on the gel, sum F dV, over presses that end where they began."""
    works, forms = [], set()
    for case in drawn_with_a_quiet_gauge(range(40), normal=[("hysteresis", 2.0)]):
        forms |= set(case.form_names)
        force = case.frame["force_normal_n"].to_numpy()
        for rows in case.frame.groupby("trial").indices.values():
            press, volume = force[rows], case.volume_mm3[rows]
            if abs(press[-1] - press[0]) < 1e-9:
                middle = 0.5 * (press[1:] + press[:-1])
                works.append((middle * np.diff(volume)).sum() / (press.max() * volume.max()))
    assert len(forms) == 3
    assert len(works) > 50
    assert min(works) > 0.0


@pytest.mark.parametrize("seed", range(8))
def test_the_frame_has_the_columns_of_a_press_log(seed):
    wanted = {"normal": [("geometry", 1.0), ("position", 1.0)], "shear": [("creep", 1.0)]}
    case = draw_case(seed, **wanted)
    columns = {"trial", "time_s", "indenter", "radius_mm", "x_mm", "y_mm", "force_normal_n"}
    columns |= {"volume_mm3", *SHEAR_FORCE, *SHEAR_MM}
    assert columns <= set(case.frame)
    assert not case.frame.drop(columns="radius_mm").isna().any(axis=None)
    flat = case.frame["indenter"].str.startswith("flat")
    assert (case.frame["radius_mm"].isna() == flat).all()
    assert (case.frame["force_normal_n"] > 0).all()
    assert (case.frame["time_s"].diff().dropna() > 0).all()
    assert case.frame.groupby("trial").size().between(20, 300).all()
    assert case.volume_mm3.shape == (len(case.frame),)
    assert case.shear_mm.shape == (len(case.frame), 2)


def test_a_kelvin_body_creeps_exponentially():
    """Under a constant load x = 1 - exp(-t / tau), and under a ramp x = t - tau (1 - exp(...))."""
    time_s = np.linspace(0.0, 3.0, 17)[None]
    grown = relaxed(time_s, np.ones_like(time_s), 0.7)
    np.testing.assert_allclose(grown, 1 - np.exp(-time_s / 0.7), rtol=1e-12, atol=1e-15)
    ramp = relaxed(time_s, time_s, 0.7)
    np.testing.assert_allclose(ramp, time_s - 0.7 * (1 - np.exp(-time_s / 0.7)), atol=1e-12)


@pytest.mark.parametrize("window_s", [1e-6, 0.03, 0.1, 0.35, 5.0])
def test_the_mean_of_a_ramp_is_its_middle(window_s):
    """Held at 0 before the start: t - w / 2 once the window is full, t^2 / 2 w before."""
    time_s = np.linspace(0.0, 2.0, 21)[None]
    expected = np.where(time_s >= window_s, time_s - window_s / 2, time_s**2 / 2 / window_s)
    np.testing.assert_allclose(running_mean(time_s, time_s, window_s), expected, atol=1e-9)


def test_play_and_friction_lag_by_their_width():
    course = np.concatenate([np.linspace(0, 4, 41), np.linspace(4, 0, 41)])[None]
    assert play(course, 0.5)[0, [40, 81]] == pytest.approx([3.5, 0.5])
    state = dahl(course, 0.5)[0]
    assert state[40] == pytest.approx(1 - np.exp(-8))
    assert state[81] == pytest.approx(-1 + (1 + state[40]) * np.exp(-8))


def test_the_study_diagnoses_the_logs_of_the_source_named(monkeypatch):
    monkeypatch.setattr(study, "run", lambda case, seed: {"channels": {}})
    wanted = {"normal": [("creep", 1.0)]}
    blind = study.evaluate("single", 2, wanted)
    independent = study.evaluate("single", 2, wanted, "independent")
    assert independent["forms"] == draw_case(2, **wanted).form_names
    assert independent["reached"]
    assert blind["forms"] != independent["forms"]


def test_both_sources_hold_the_effects_that_the_study_asks_for():
    assert set(study.ALL_NORMAL) == set(NORMAL)
    assert set(study.ALL_SHEAR) == set(SHEAR)
    assert set(study.ALL_UNLISTED) == set(UNLISTED)

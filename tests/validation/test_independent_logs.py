"""The independent generator says the truth about what it makes."""

from __future__ import annotations

import numpy as np
import pytest

import validation.blind.evaluate as study
from validation.blind.independent import NORMAL, SHEAR, UNLISTED, draw_case

SHEAR_FORCE = ["force_shear_x_n", "force_shear_y_n"]
SHEAR_MM = ["shear_x_mm", "shear_y_mm"]


def test_the_same_seed_gives_the_same_log():
    wanted = {"normal": [("creep", 1.5)], "shear": [("slip", 2.0)]}
    first, second = draw_case(3, **wanted), draw_case(3, **wanted)
    assert first.frame.equals(second.frame)
    np.testing.assert_array_equal(first.volume_mm3, second.volume_mm3)
    assert not first.frame.equals(draw_case(4, **wanted).frame)


@pytest.mark.parametrize(
    ("channel", "name"),
    [("normal", name) for name in NORMAL | UNLISTED] + [("shear", name) for name in SHEAR],
)
def test_effects_have_the_strength_they_were_asked_for(channel, name):
    """Of what the best compliance leaves of the response without noise, for the force as it is."""
    case = draw_case(1, **{channel: [(name, 1.0)]})
    assert case.reached == {(channel, name): pytest.approx(1.0, rel=0.02)}
    assert getattr(case, channel) == (() if name in UNLISTED else (name,))
    assert case.unexplained[channel] == (name if name in UNLISTED else "")
    assert name not in UNLISTED or name in case.frame


def test_clean_logs_are_the_law_and_noise_as_large_as_is_said():
    for seed in range(6):
        case = draw_case(seed)
        noise = case.frame["volume_mm3"] - case.volume_mm3
        assert np.std(noise) == pytest.approx(case.noise_mm3, rel=0.05)
        gauge = case.frame["force_normal_n"] - case.volume_mm3 / case.k_n_mm3_per_n
        floor = np.hypot(np.std(gauge) * case.k_n_mm3_per_n, case.noise_mm3)
        assert floor == pytest.approx(case.floor_mm3, rel=0.02)
        noise = case.frame[SHEAR_MM].to_numpy() - case.shear_mm
        assert np.std(noise) == pytest.approx(case.noise_mm, rel=0.05)


def test_closed_loops_of_the_force_lose_work():
    """The work of the force on the gel, sum F dV, over presses that end where they began."""
    case = draw_case(2, normal=[("hysteresis", 2.0)])
    force = case.frame["force_normal_n"].to_numpy()  # its noise has no part in the mean
    works = []
    for rows in case.frame.groupby("trial").indices.values():
        press, volume = force[rows], case.volume_mm3[rows]
        middle = 0.5 * (press[1:] + press[:-1])
        works.append((middle * np.diff(volume)).sum() / (press.max() * volume.max()))
    assert len(works) >= 24
    assert np.mean(works) > 0.0


def test_the_frame_has_the_columns_of_a_press_log():
    frame = draw_case(5).frame
    columns = {"trial", "time_s", "indenter", "radius_mm", "x_mm", "y_mm", "force_normal_n"}
    assert columns | {"volume_mm3", *SHEAR_FORCE, *SHEAR_MM} <= set(frame)
    assert not frame.isna().any(axis=None)
    assert (frame["time_s"].diff().dropna() > 0).all()


def test_both_sources_hold_the_effects_that_the_study_asks_for():
    assert set(study.ALL_NORMAL) == set(NORMAL)
    assert set(study.ALL_SHEAR) == set(SHEAR)
    assert set(study.ALL_UNLISTED) == set(UNLISTED)

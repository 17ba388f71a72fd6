"""The independent generator says the truth about what it makes."""

from __future__ import annotations

import numpy as np
import pytest

from validation.blind.independent import NORMAL, SHEAR, UNLISTED, draw_case

SHEAR_MM = ["shear_x_mm", "shear_y_mm"]


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

"""The radial profiles of the gel against the same surfaces in the plane."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from tacgen.diagnose.optics.surface import Profiles
from tacgen.optics import deform
from tacgen.presses.geometry import Membrane

MM, BALL, CONTACT = 0.04, 2.0, 1.2
ROWS, COLUMNS = np.mgrid[-80:81, -80:81] * MM
R = np.hypot(COLUMNS, ROWS)
CAP = np.where(
    CONTACT > R, np.sqrt(np.maximum(BALL**2 - R**2, 0)) - np.sqrt(BALL**2 - CONTACT**2), 0
)


def radial_slope(form, r, effects=(), decay_mm=0.3):
    """What the profile gives at distances r."""
    one = np.ones(len(r))
    membrane = Membrane(decay_mm, sharpness=20.0)
    profiles = Profiles(np.array([CONTACT]), 0.0)
    return profiles.slopes(form, membrane, r, CONTACT * one, BALL * one, effects)[0]


@pytest.mark.parametrize(
    ("effects", "surface"),
    [
        ((), -deform(CAP, MM)),
        ((("blur", (("sigma_mm", 0.3),)),), gaussian_filter(-deform(CAP, MM), 0.3 / MM)),
    ],
    ids=["the simulation's pyramid", "blurred"],
)
def test_a_profile_is_the_slope_of_the_surface_in_the_plane(effects, surface):
    r = np.linspace(0.1, 2.0, 60)
    slope = np.interp(r, COLUMNS[80, 80:], np.gradient(surface[80], MM)[80:])
    # Differences over a pixel of a surface that bends within three: a percent of the steepest.
    np.testing.assert_allclose(radial_slope("pyramid", r, effects), slope, atol=0.015 * slope.max())


def test_under_the_ball_the_gel_has_the_balls_slope_and_outside_it_falls_off():
    inside = np.linspace(0.05, 0.8 * CONTACT, 20)
    ball = inside / np.sqrt(BALL**2 - inside**2)
    for form in ("skirt", "elastic"):
        # Linear between grid points a fiftieth of a radius apart.
        np.testing.assert_allclose(radial_slope(form, inside), ball, rtol=0.01)
        outside = radial_slope(form, np.linspace(1.1 * CONTACT, 2.5 * CONTACT, 20))
        assert (np.diff(outside) < 0).all()
        assert (outside > 0).all()


def test_an_elastic_half_space_falls_off_as_hertz_says():
    # Far away the surface is that under a point load, w ~ 1/r: its slope falls as 1/r².
    near, far = radial_slope("elastic", np.array([2.2, 2.9]) * CONTACT)
    # The next term, 0.3 (a/r)², is still worth 2.5 % between the two.
    assert near / far == pytest.approx((2.9 / 2.2) ** 2, rel=0.04)

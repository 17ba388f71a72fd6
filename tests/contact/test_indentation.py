"""V → δ: exact, monotone, and true to the volumes of geometry."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import bisect

from tacgen.contact import contact_depth, solve_indentation
from tacgen.contact.indentation import solve_grains
from tacgen.core.errors import ContactError
from tests.messages import refused

MM_PER_PX = 0.0295
AREA = MM_PER_PX**2


def grid_mm(height_px=480, width_px=640, mm_per_px=MM_PER_PX):
    x = (np.arange(width_px) + 0.5 - width_px / 2) * mm_per_px
    y = (np.arange(height_px) + 0.5 - height_px / 2) * mm_per_px
    return np.meshgrid(x, y)


def ball_gap(radius_mm):
    x, y = grid_mm()
    inside = radius_mm**2 - x**2 - y**2
    with np.errstate(invalid="ignore"):
        return np.where(inside >= 0, radius_mm - np.sqrt(np.maximum(inside, 0)), np.inf)


def cylinder_gap(radius_mm, half_length_mm):
    """A cylinder lying along x."""
    x, y = grid_mm()
    inside = radius_mm**2 - y**2
    gap = np.where(inside >= 0, radius_mm - np.sqrt(np.maximum(inside, 0)), np.inf)
    return np.where(abs(x) <= half_length_mm, gap, np.inf)


def dome_gap(radius_mm):
    """A flat face on a domed gel: the gap is the dome's sag."""
    x, y = grid_mm()
    return radius_mm - np.sqrt(radius_mm**2 - x**2 - y**2)


@pytest.mark.parametrize("radius_mm", [2.0, 4.0, 10.0])
@pytest.mark.parametrize("depth_mm", [0.3, 0.8, 1.5])
def test_ball_volume_is_the_sphere_cap(radius_mm, depth_mm):
    volume = math.pi * depth_mm**2 * (radius_mm - depth_mm / 3)
    assert contact_depth(ball_gap(radius_mm), depth_mm).sum() * AREA == pytest.approx(
        volume, rel=1e-3
    )
    delta = solve_indentation(ball_gap(radius_mm), volume, AREA)
    assert delta == pytest.approx(depth_mm, rel=1e-3)


@pytest.mark.parametrize("depth_mm", [0.3, 0.8, 1.5])
def test_cylinder_volume_is_the_segment_times_its_length(depth_mm):
    radius_mm, pixels = 5.0, 200
    angle = 2 * math.acos(1 - depth_mm / radius_mm)
    volume = pixels * MM_PER_PX * 0.5 * radius_mm**2 * (angle - math.sin(angle))
    gap = cylinder_gap(radius_mm, 0.5 * pixels * MM_PER_PX)
    assert contact_depth(gap, depth_mm).sum() * AREA == pytest.approx(volume, rel=1e-3)
    assert solve_indentation(gap, volume, AREA) == pytest.approx(depth_mm, rel=1e-3)


@pytest.mark.parametrize("volume_mm3", [2.0, 10.0, 60.0])
def test_a_flat_face_on_a_dome_leaves_a_patch_that_grows_with_force(volume_mm3):
    """V = πRδ² − πδ³/3 and a patch of radius √(2Rδ − δ²)."""
    radius_mm = 30.0
    delta = solve_indentation(dome_gap(radius_mm), volume_mm3, AREA)
    exact = bisect(lambda d: math.pi * d**2 * (radius_mm - d / 3) - volume_mm3, 0, 5, xtol=1e-14)
    assert delta == pytest.approx(exact, rel=1e-3)
    patch_mm2 = (contact_depth(dome_gap(radius_mm), delta) > 0).sum() * AREA
    # The rim is as sharp as a pixel: a percent of the area of a patch of a hundred pixels.
    assert patch_mm2 == pytest.approx(math.pi * (2 * radius_mm * exact - exact**2), rel=0.01)


gaps = st.integers(0, 2**32 - 1).map(
    lambda seed: np.random.default_rng(seed).uniform(-1, 3, (17, 23)).astype(np.float32)
)


@settings(max_examples=60, deadline=None)
@given(gap=gaps, volume_mm3=st.floats(1e-6, 1.0), misses=st.floats(0, 0.9))
def test_solving_agrees_with_bisection(gap, volume_mm3, misses):
    gap = np.where(np.random.default_rng(0).random(gap.shape) < misses, np.inf, gap)
    gap[3, 4] = 0.5
    delta = solve_indentation(gap, volume_mm3, AREA)

    def excess(d):
        return float(np.maximum(0, d - gap.astype(np.float64)).sum()) * AREA - volume_mm3

    low, high = float(gap.min()), float(gap.min()) + 1 + volume_mm3 / AREA
    assert delta == pytest.approx(bisect(excess, low, high, xtol=1e-13), abs=1e-9)


@settings(max_examples=40, deadline=None)
@given(gap=gaps, first=st.floats(0, 1.0), more=st.floats(1e-6, 1.0))
def test_more_volume_is_deeper_and_leaves_no_less_contact(gap, first, more):
    less_deep = solve_indentation(gap, first, AREA)
    deeper = solve_indentation(gap, first + more, AREA)
    assert deeper > less_deep
    assert ((deeper - gap > 0) | (less_deep - gap <= 0)).all()


@settings(max_examples=40, deadline=None)
@given(gap=gaps, volume_mm3=st.floats(1e-6, 2.0), deepest_mm=st.floats(0.01, 4.0))
def test_whole_grains_give_the_same_or_the_limit(gap, volume_mm3, deepest_mm):
    grain = 2.0**-19
    grains = np.floor((gap - gap.min()) / grain + 0.5).astype(np.int32)
    exact = solve_indentation(grains * grain, volume_mm3, AREA)
    found = (
        solve_grains(
            grains, volume_mm3 / AREA / grain, deepest_mm / grain, np.empty(0, np.int32), 1.0
        )
        * grain
    )
    assert found == pytest.approx(min(exact, deepest_mm), abs=1e-9)


def test_contact_only_at_the_rim():
    """A cup's rim: a ring touches, the middle never does."""
    x, y = grid_mm()
    radius = np.hypot(x, y)
    gap = np.where(abs(radius - 5) < 0.3, 0.0, np.where(radius < 5, 30.0, np.inf))
    ring_mm2 = (abs(radius - 5) < 0.3).sum() * AREA
    delta = solve_indentation(gap, 4.0, AREA)
    assert delta == pytest.approx(4.0 / ring_mm2, rel=1e-9)
    assert not contact_depth(gap, delta)[radius < 4].any()


def test_no_force_is_first_touch():
    assert solve_indentation(ball_gap(4.0) + 7, 0.0, AREA) == pytest.approx(7, abs=1e-3)


@pytest.mark.parametrize(
    ("gap", "volume_mm3"),
    [
        (np.full((4, 4), np.inf), 1.0),
        (np.full((4, 4), np.nan), 1.0),
        (np.zeros((4, 4)), -1.0),
        (np.zeros((4, 4)), math.nan),
        (np.zeros(4), 1.0),
    ],
)
def test_what_cannot_be_solved_is_said(gap, volume_mm3):
    with refused(ContactError):
        solve_indentation(gap, volume_mm3, AREA)

"""D → s: the field sums to the law's motion, whatever the patch."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tacgen.contact.shear import MarkerField, ShearMotion, marker_grid_mm
from tacgen.core.records import Markers, Sensor

SENSOR = Sensor("s", 120, 160, 0.1, 4.0, markers=Markers(9, 12, 1.25, 0.2))
POINTS = marker_grid_mm(SENSOR)


def field(x_mm=0.0, y_mm=0.0, radius_mm=2.0, step_mm=0.1, depth=1.0):
    side = np.arange(-radius_mm, radius_mm + step_mm / 2, step_mm)
    x, y = (grid.ravel() for grid in np.meshgrid(side, side))
    inside = x**2 + y**2 <= radius_mm**2
    patch = np.stack([x[inside] + x_mm, y[inside] + y_mm], axis=1)
    return MarkerField(POINTS, patch, np.full(len(patch), depth), step_mm**2)


@settings(max_examples=40, deadline=None)
@given(
    x_mm=st.floats(-7, 7),
    y_mm=st.floats(-5, 5),
    radius_mm=st.floats(0.3, 5),
    shear=st.tuples(st.floats(-20, 20), st.floats(-20, 20)),
    turn=st.floats(-50, 50),
)
def test_the_markers_motion_sums_to_the_laws(x_mm, y_mm, radius_mm, shear, turn):
    around = field(x_mm, y_mm, radius_mm)
    motion = around.motion(np.array(shear), turn)
    np.testing.assert_allclose(around.shear_mm(motion).sum(axis=0), shear, atol=1e-9)


def test_a_marker_in_the_patch_goes_with_the_object_and_one_far_away_stays():
    around = field()
    motion = ShearMotion(np.array([0.2, -0.1]), 0.0, np.zeros(2))
    moved = around.shear_mm(motion)
    distance = np.hypot(*POINTS.T)
    np.testing.assert_allclose(
        moved[distance < 1.9], np.tile([0.2, -0.1], (len(moved[distance < 1.9]), 1)), rtol=1e-6
    )
    far = np.linalg.norm(moved[distance > 7], axis=1)
    assert far.max() < 0.2 * np.hypot(0.2, 0.1)


def test_twice_the_motion_is_twice_the_shift():
    around = field(1, 1)
    once, twice = (around.motion(np.array([k * 1.5, 0.0])).shift_mm for k in (1, 2))
    np.testing.assert_allclose(twice, 2 * once)
    assert once[0] > 0
    assert once[1] == 0


def test_a_turn_leaves_the_middle_and_turns_the_pose_about_the_patch():
    around = field(2.0, -1.0)
    motion = around.motion(np.zeros(2), 10.0)
    assert motion.turn_rad > 0
    pose = np.eye(4)
    pose[:3, 3] = 2.0, -1.0, 5.0
    np.testing.assert_allclose(motion.moved(pose)[:3, 3], [2.0, -1.0, 5.0], atol=1e-3)
    beside = np.eye(4)
    beside[:3, 3] = 3.0, -1.0, 5.0
    step = motion.moved(beside)[:2, 3] - [3.0, -1.0]
    # A positive turn takes x towards y.
    assert step[1] == pytest.approx(np.sin(motion.turn_rad), rel=1e-2)


def test_an_indentation_pushes_the_markers_apart():
    around = field(depth=1.0)
    still = ShearMotion(np.zeros(2), 0.0, np.zeros(2))
    outwards = ((around.displaced_mm(still) - POINTS) * POINTS).sum(axis=1)
    near = np.hypot(*POINTS.T) < 4
    assert (outwards[near] > 0).all()
    assert 0.02 < np.linalg.norm(around.displaced_mm(still) - POINTS, axis=1).max() < 0.5


def test_the_marker_grid_is_centred_and_as_the_sensor_says():
    assert POINTS.shape == (108, 2)
    np.testing.assert_allclose(POINTS.mean(axis=0), 0, atol=1e-12)
    assert np.diff(np.unique(POINTS[:, 0])) == pytest.approx(1.25)
    plain = marker_grid_mm(Sensor("plain", 120, 160, 0.1, 4.0))
    assert len(plain) == 6 * 8

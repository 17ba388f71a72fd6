"""The markers: their grid, and how an indentation pushes them apart."""

import numpy as np
import pytest

from tacgen.contact.shear import ShearMotion, dilation_mm, marker_grid_mm
from tacgen.core.records import Markers, Sensor

SENSOR = Sensor("s", 120, 160, 0.1, 4.0, markers=Markers(9, 12, 1.25, 0.2))
POINTS = marker_grid_mm(SENSOR)


def test_a_turn_leaves_the_middle_and_turns_the_pose_about_the_patch():
    motion = ShearMotion(np.zeros(2), 0.02, np.array([2.0, -1.0]))
    pose = np.eye(4)
    pose[:3, 3] = 2.0, -1.0, 5.0
    np.testing.assert_allclose(motion.moved(pose)[:3, 3], [2.0, -1.0, 5.0], atol=1e-12)
    pose[:3, 3] = 3.0, -1.0, 5.0
    step = motion.moved(pose)[:2, 3] - [3.0, -1.0]
    # A positive turn takes x towards y.
    assert step[1] == pytest.approx(np.sin(0.02), rel=1e-9)


def test_an_indentation_pushes_the_markers_apart():
    side = np.arange(-2.0, 2.05, 0.1)
    patch = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    patch = patch[np.hypot(*patch.T) <= 2.0]
    moved = dilation_mm(POINTS, patch, np.ones(len(patch)), 0.01)
    near = np.hypot(*POINTS.T) < 4
    assert ((moved * POINTS).sum(axis=1)[near] > 0).all()
    assert 0.02 < np.linalg.norm(moved, axis=1).max() < 0.5


def test_the_marker_grid_is_centred_and_as_the_sensor_says():
    assert POINTS.shape == (108, 2)
    np.testing.assert_allclose(POINTS.mean(axis=0), 0, atol=1e-12)
    assert np.diff(np.unique(POINTS[:, 0])) == pytest.approx(1.25)
    plain = marker_grid_mm(Sensor("plain", 120, 160, 0.1, 4.0))
    assert len(plain) == 6 * 8

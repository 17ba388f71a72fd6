"""The markers: their grid, and how an indentation pushes them apart."""

import numpy as np
import pytest

from tacgen.contact.shear import ShearMotion, depth_at, dilation_mm, marker_grid_mm
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


def test_an_indentation_pushes_the_markers_beside_it_apart():
    side = np.arange(-2.0, 2.05, 0.1)
    patch = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    away = np.hypot(*patch.T)
    patch, depth = patch[away < 2.0], 1.0 - away[away < 2.0] ** 2 / 4.0
    under = np.maximum(0.0, 1.0 - (POINTS**2).sum(axis=1) / 4.0)
    moved = dilation_mm(POINTS, patch, depth, 0.01, 4.0, under)
    outwards = (moved * POINTS).sum(axis=1) / np.maximum(np.hypot(*POINTS.T), 1e-9)
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1), np.abs(outwards), atol=1e-3)
    assert (outwards >= 0).all()
    assert 0.01 < outwards.max() < 0.2
    # The ball holds what is under it: what moves most lies beside the contact.
    assert np.hypot(*POINTS[outwards.argmax()]) > 2.0
    # A gel of half the thickness is pushed aside by less far, and more beside the contact.
    thin = dilation_mm(POINTS, patch, depth, 0.01, 2.0, under)
    near, far = np.abs(np.hypot(*POINTS.T) - 2.5) < 0.5, np.hypot(*POINTS.T) > 6.0
    ratio = np.linalg.norm(thin, axis=1) / np.linalg.norm(moved, axis=1)
    assert ratio[near].min() > 1.5
    assert ratio[far].max() < 1.0


def test_the_depth_under_a_point_is_between_those_of_its_pixels():
    depth = np.arange(12.0).reshape(3, 4)
    points = np.array([[-0.75, -0.5], [0.25, 0.0], [0.0, 0.25], [9.0, 0.0]])
    np.testing.assert_allclose(depth_at(depth, points, 0.5), [0.0, 6.0, 7.5, 0.0])


def test_the_marker_grid_is_centred_and_as_the_sensor_says():
    assert POINTS.shape == (108, 2)
    np.testing.assert_allclose(POINTS.mean(axis=0), 0, atol=1e-12)
    assert np.diff(np.unique(POINTS[:, 0])) == pytest.approx(1.25)
    plain = marker_grid_mm(Sensor("plain", 120, 160, 0.1, 4.0))
    assert len(plain) == 6 * 8

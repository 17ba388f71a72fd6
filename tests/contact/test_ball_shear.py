"""The contact of a ball on the lattice, and friction at a place of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tacgen.contact.ball_shear import BallShear, Place
from tacgen.contact.shear import marker_grid_mm
from tests.marker_sessions import SENSOR

FLAT = replace(SENSOR, dome_radius_mm=0.0)


def test_the_indentation_has_the_volume_of_the_balls_cap():
    gel = BallShear(FLAT, 1.5)
    radius, depth = 4.0, 0.6
    volume = np.pi * depth**2 * (radius - depth / 3.0)
    found = gel.depth_mm(radius, np.array([1.0, -0.5]), volume)
    assert found.sum() * gel.cell_mm2 == pytest.approx(volume, rel=1e-6)
    assert found.max() == pytest.approx(depth, rel=0.03)  # a mean over a cell is a little less
    np.testing.assert_allclose(gel.middle_mm(found), [1.0, -0.5], atol=0.02)


def test_dots_are_spread_away_from_the_ball():
    gel, points = BallShear(FLAT, 1.5), marker_grid_mm(FLAT)
    motion = gel.dilation_mm(points, gel.depth_mm(4.0, np.zeros(2), 8.0))
    assert ((motion * points).sum(axis=1) >= -1e-6).all()
    # The grid is symmetric about the middle.
    np.testing.assert_allclose(motion.sum(axis=0), 0.0, atol=0.01 * np.abs(motion).max())


def test_a_place_with_the_same_friction_is_no_place_and_a_slippery_one_moves_less():
    gel, points = BallShear(FLAT, 1.5), marker_grid_mm(FLAT)
    pressure = [gel.depth_mm(5.0, np.zeros(2), 20.0) / 5.0] * 3
    force = np.array([[0.0, 0.0], [0.5, 0.0], [1.0, 0.0]])
    plain = gel.strain(points, pressure, force, 0.6)
    same = gel.strain(points, pressure, force, 0.6, Place(1.0, 0.0, 1.5, 0.6))
    np.testing.assert_allclose(same, plain, atol=1e-9)
    other = gel.strain(points, pressure, force, 0.6, Place(1.2, 0.0, 1.2, 0.05))
    inside = np.hypot(*(points - [1.2, 0.0]).T) < 0.8
    opposite = np.hypot(*(points - [-1.2, 0.0]).T) < 0.8
    assert other[-1, inside, 0].mean() < 0.95 * plain[-1, inside, 0].mean()
    assert other[-1, opposite, 0].mean() > plain[-1, opposite, 0].mean()

"""The finite elements that judge the shear field, against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("skfem")

from validation.shear.ball import BallContact, BallPose
from validation.shear.checks import layer_press
from validation.shear.dilation import fitted, press, proposed
from validation.shear.gel_block import GelBlock
from validation.shear.referee import Foundation, rms_shares

FRICTION = 0.5
RADIUS_MM, DEPTH_MM = 4.0, 0.3
BLOCK = GelBlock(3.0, 0.2, 10.0, 10.0, knots_mm=(1.4, 2.0))


@pytest.fixture(scope="module")
def pressed():
    """A smooth ball on a small block, then with friction."""
    ball = BallContact(BLOCK, RADIUS_MM, 0.0, 1.9)
    touch = ball.to(ball.start(), BallPose(DEPTH_MM), 3)
    ball.friction = FRICTION
    return ball, touch


@pytest.mark.exhaustive
@pytest.mark.slow
def test_a_press_obeys_the_bonded_layer(pressed):
    ball, touch = pressed
    # Six elements along the contact's radius.
    assert ball.normal_n(touch) == pytest.approx(
        layer_press(BLOCK, RADIUS_MM, DEPTH_MM)[0], rel=0.06
    )
    assert (touch.force_n[:, 2] <= 0).all()
    inside = touch.force_n[:, 2] < 0
    sag = RADIUS_MM - np.sqrt(RADIUS_MM**2 - (ball.points_mm**2).sum(axis=1))
    assert np.allclose(touch.motion_mm[inside, 2], (sag - DEPTH_MM)[inside], atol=1e-4)
    assert (touch.motion_mm[~inside, 2] <= (sag - DEPTH_MM)[~inside] + 1e-4).all()


@pytest.mark.exhaustive
@pytest.mark.slow
def test_forces_are_mutual_and_the_quarters_make_a_whole(pressed):
    ball, touch = pressed
    matrix = BLOCK.between(ball.index, ball.sides)
    assert np.allclose(matrix, matrix.T, atol=1e-9 * np.abs(matrix).max())
    surface = BLOCK.surface(ball.index, ball.sides, touch.force_n)
    assert np.allclose(surface.at(ball.points_mm), touch.motion_mm, atol=1e-4)
    # A unit pull on one node off the axes moves its mirror's mirror the same way.
    force = np.zeros_like(touch.force_n)
    node = int(np.argmax(ball.points_mm @ [1.0, 0.7]))
    force[node] = 1.0, 0.0, 0.0
    moved = BLOCK.surface(ball.index, ball.sides, force)
    force[node], mirror = 0.0, int(np.argmin(ball.points_mm @ [1.0, 0.7]))
    force[mirror] = 1.0, 0.0, 0.0
    back = BLOCK.surface(ball.index, ball.sides, force).motion_mm[::-1, ::-1]
    assert np.allclose(back[..., 0], moved.motion_mm[..., 0], atol=1e-9)
    assert np.allclose(back[..., 2], -moved.motion_mm[..., 2], atol=1e-9)


@pytest.mark.exhaustive
@pytest.mark.slow
def test_a_shear_sticks_in_the_middle_and_obeys_coulomb(pressed):
    ball, touch = pressed
    sheared = ball.sheared_to(touch, np.array([1.0, 0.0]), 0.6, 16)
    assert ball.shear_n(sheared)[0] == pytest.approx(
        0.6 * FRICTION * ball.normal_n(sheared), rel=0.01
    )
    limit = -FRICTION * sheared.force_n[:, 2]
    assert (np.hypot(*sheared.force_n[:, :2].T) <= limit + 1e-9).all()
    away = np.hypot(*ball.points_mm.T)
    sticks, slips = (away[ball.slipping(sheared) == kind] for kind in (1, 2))
    # Cattaneo–Mindlin of a half-space; on a layer and this mesh to a node's distance.
    radius = ball.contact_radius_mm(touch)
    assert sticks.max() == pytest.approx(radius * 0.4 ** (1 / 3), abs=0.2)
    assert slips.min() > sticks.max() - 0.3
    slid = ball.sheared_to(touch, np.array([1.0, 0.0]), 1.0, 8)
    assert not (ball.slipping(slid) == 1).any()


@pytest.mark.exhaustive
@pytest.mark.slow
def test_a_wide_block_moves_by_the_layers_compliance():
    block = GelBlock(1.0, 0.25, 12.0, 12.0, knots_mm=(0.5, 1.0))
    _points, index, sides, _area = block.contact_nodes(0.1)
    surface = block.surface(index, sides, np.array([[1.0, 0.0, 0.0]]))
    area = np.outer(np.gradient(surface.x_mm), np.gradient(surface.y_mm))
    total = float((area * surface.motion_mm[..., 0]).sum())
    shear = block.young_n_mm2 / (2 * (1 + block.poisson))
    assert total == pytest.approx(block.thickness_mm / shear, rel=0.03)  # ∫ u dA = F T / G


def test_the_foundation_has_the_volume_asked_for():
    ball = Foundation(4.0, 6.0)
    axis = (np.arange(31) - 15) * 0.4
    nodes = np.stack(np.meshgrid(axis, axis), axis=-1)
    assert ball.over(nodes, 0.4).sum() * 0.4**2 == pytest.approx(6.0, rel=1e-3)
    assert ball.at(np.zeros(2)) == pytest.approx(ball.depth_mm)


def test_errors_are_shares_of_the_largest_motion_of_each_part():
    truth, inside = np.zeros((4, 2)), np.array([True, True, False, False])
    truth[0], truth[2] = (3.0, 4.0), (0.0, 2.0)
    assert rms_shares(truth, truth, inside) == (0.0, 0.0)
    assert rms_shares(np.zeros((4, 2)), truth, inside) == pytest.approx((0.5**0.5, 0.5**0.5))
    assert rms_shares(0 * truth, truth, inside, 2 * truth)[0] == pytest.approx(0.5**1.5)


def test_the_dilation_s_constants_are_found_again():
    axis = np.arange(-7, 7.1, 1.0)
    points = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    made = []
    for thickness, volume in ((4.0, 2.0), (2.5, 5.0)):
        one = press("", thickness, points, points, Foundation(4.0, volume), 2.0)
        made.append(replace(one, motion_mm=proposed(one, 1.3, 0.25)))
    assert fitted(made) == pytest.approx((1.3, 0.25), rel=1e-3)
    # Away from the patch, and nothing at its middle.
    outward = (made[0].motion_mm * points).sum(axis=1)
    assert (outward >= -1e-12).all()
    assert np.allclose(made[0].motion_mm[np.hypot(*points.T) == 0], 0.0, atol=1e-12)


def test_the_layer_s_press_is_the_half_space_s_and_its_first_correction():
    # Dimitriadis et al. 2002, Eq. 12: of an incompressible bonded layer, 1 + 1.133 √(Rδ)/h + …
    thick = GelBlock(5000.0, poisson=0.5)
    force, contact = layer_press(thick, 400.0, 0.01)
    hertz = 4 / 3 * thick.young_n_mm2 / 0.75 * np.sqrt(400.0) * 0.01**1.5
    assert force == pytest.approx(hertz, rel=2e-3)
    assert contact == pytest.approx(2.0, rel=2e-3)
    layer = GelBlock(100.0, poisson=0.5)
    assert layer_press(layer, 400.0, 0.01)[0] / hertz - 1 == pytest.approx(1.133 * 0.02, rel=0.03)

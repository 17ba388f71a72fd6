"""Shear of the pads while an object stands between them: closed forms, and the grasps of both."""

from __future__ import annotations

import numpy as np
import pytest

from tacgen.core.records import PADS, GraspConfig
from tacgen.objects import load_object
from tacgen.physics import FrameRequest, GelModel, GraspSimulator, PhysicsSettings, run_grasp
from tacgen.physics.standing import PadLoad, Table, least_shear
from tests.physics.conftest import GRAVITY_M_S2, block, grasp

AXIS = np.array([1.0, 0.0, 0.0])
CORNERS_M = np.array([[x, y, 0.0] for x in (-0.03, 0.03) for y in (-0.03, 0.03)])


def pads_of(*forces_n, slope=0.0, moment_n_m=0.0):  # type: ignore[no-untyped-def]
    """Two pads 60 mm apart and 50 mm up, whose touches slant upwards by ``slope``, rad."""
    pads = []
    for side, force_n in zip((1.0, -1.0), forces_n, strict=True):
        normal = np.array([side * np.cos(slope), 0.0, np.sin(slope)])
        center_m = np.array([-0.03 * side, 0.0, 0.05])
        pads.append(PadLoad(center_m, normal, np.array(force_n), moment_n_m))
    return pads


def found_of(pads, table_m, table_n, friction=0.5):  # type: ignore[no-untyped-def]
    """Shears (2, 2), along y and up, and moments (2,), the table acting with ``table_n`` (3,)."""
    table = Table(0.4, table_m, np.zeros((1, 3)), np.array([table_n]))
    found = least_shear(pads, AXIS, friction, table)
    for pad, before in zip(found, pads, strict=True):
        assert pad.force_n[0] == pytest.approx(before.force_n[0], abs=1e-6)
    return np.array([p.force_n[1:] for p in found]), np.array([p.moment_n_m for p in found])


@pytest.mark.parametrize("held_n", [(0.0, 0.0), (0.9, -0.2), (-0.6, 0.5)])
def test_the_table_carries_what_stands_on_it(held_n):
    """Whatever share of 3 N and of which moments the solver found at the pads."""
    pads = pads_of((10.0, 0.3, held_n[0]), (-10.0, -0.3, held_n[1]), moment_n_m=0.002)
    # The table's wrench in its middle balances no more than the force: both pads' are its moments.
    shear_n, moment_n_m = found_of(pads, CORNERS_M, (0.0, 0.0, 3.0 - sum(held_n)))
    np.testing.assert_allclose(shear_n, 0.0, atol=1e-6)
    np.testing.assert_allclose(moment_n_m, 0.0, atol=1e-8)


def test_on_an_edge_the_pads_hold_as_springs_do():
    """Of mg on an edge at x = a the table carries mg/(1 + (a/b)²), b half of the pads' distance."""
    weight_n, at_m = 3.0, 0.02
    edge_m = np.array([[at_m, y, 0.0] for y in (-0.03, 0.03)])
    # No table: both pads hold half of it.
    pads = pads_of((10.0, 0.0, weight_n / 2), (-10.0, 0.0, weight_n / 2))
    shear_n, _ = found_of(pads, edge_m, (0.0, 0.0, 0.0))
    table_n = weight_n / (1 + (at_m / 0.03) ** 2)
    assert shear_n.sum() == pytest.approx(weight_n - table_n, rel=1e-4)
    # About the middle: the pads' difference at b against the table's force at a.
    assert (shear_n[0, 1] - shear_n[1, 1]) * 0.03 == pytest.approx(table_n * at_m, rel=1e-4)


@pytest.mark.parametrize("slope", [0.3, -0.3])
def test_a_slanted_face_shears_by_what_friction_does_not_hold(slope):
    """N tan(θ − φ) down the slope, and nothing within the friction angle φ."""
    for friction in (0.5, 0.1):
        beyond = max(0.0, abs(slope) - np.arctan(friction))
        up_n = np.sign(slope) * 10.0 * np.tan(beyond)
        pads = pads_of((10.0, 0.0, up_n + 0.2), (-10.0, 0.0, up_n - 0.2), slope=slope)
        shear_n, _ = found_of(pads, CORNERS_M, (0.0, 0.0, 9.0 - 2 * up_n), friction)
        np.testing.assert_allclose(shear_n[:, 1], up_n, atol=1e-4)


def test_one_finger_that_pushes_is_stopped_by_the_table():
    """1 N against a table's 0.4 of 3 N: no shear, and the moment is the table's too."""
    (pad, _) = pads_of((1.0, 0.1, 0.3), (0.0, 0.0, 0.0))
    pressed_m, pressed_n = np.array([[0.03, 0.0, 0.0]]), np.array([[-1.0, -0.1, 2.7]])
    (found,) = least_shear([pad], AXIS, 0.5, Table(0.4, CORNERS_M, pressed_m, pressed_n))
    np.testing.assert_allclose(found.force_n, [1.0, 0.0, 0.0], atol=1e-5)


def settings_of(simulator: GraspSimulator, **figures: float) -> PhysicsSettings:
    return PhysicsSettings(engine=simulator.engine, tactile_pads="both", **figures)


@pytest.mark.parametrize("closing_speed_mm_s", [40.0, 420.0])
@pytest.mark.parametrize("x_mm", [0.0, 3.0])
def test_closing_on_flat_faces_leaves_no_shear(
    simulator: GraspSimulator, closing_speed_mm_s: float, x_mm: float
) -> None:
    """The block stands on the table, which carries its weight at any speed of the fingers."""
    settings = settings_of(simulator, closing_speed_mm_s=closing_speed_mm_s)
    trace = grasp(simulator, block(), force_n=10.0, x_mm=x_mm, settings=settings)
    for pad in PADS:
        assert trace.frames[pad][0].force_shear_n == pytest.approx([0.0, 0.0], abs=0.01)


def test_a_standing_can_weighs_on_no_pad_and_a_lifted_one_on_both(
    simulator: GraspSimulator,
) -> None:
    """At its lip, where the pads' rigid touches slant by 0.2 rad, within the friction angle."""
    obj, settings = load_object("tomato_soup_can"), settings_of(simulator)
    config, weight_n = GraspConfig(0, obj.name, 12.0, 0.0, -6.0, 92.0), obj.mass_kg * GRAVITY_M_S2
    frames = FrameRequest("sequence", 25, 3.0)
    for keeps_past in (False, True):
        trace = run_grasp(
            simulator, obj, config, settings, frames=frames, gel=GelModel(keeps_past=keeps_past)
        )
        lift_s = trace.grasp_time_s + settings.hold_s
        for frame in range(trace.grasp_frame, 25):
            left, right = (trace.frames[pad][frame] for pad in PADS)
            shear_n = np.array([left.force_shear_n, right.force_shear_n])
            if left.time_s <= lift_s:
                np.testing.assert_allclose(shear_n, 0.0, atol=0.01)
            elif lift_s + 1.1 < left.time_s < lift_s + 1.4:  # at a constant speed
                # Columns run along world −y on the left pad, +y on the right one.
                held_n = shear_n[1, 0] - shear_n[0, 0], shear_n[:, 1].sum()
                np.testing.assert_allclose(held_n, [0.0, weight_n], atol=0.005)
    past = trace.frames["left"][-1].past
    assert past is not None
    standing = (past[:, 0] > trace.grasp_time_s) & (past[:, 0] < lift_s)
    assert standing.sum() > 20
    np.testing.assert_allclose(past[standing, 2:], 0.0, atol=0.01)

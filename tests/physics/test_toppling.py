"""Objects whose centre of mass is not over what they stand on: a status of their own."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import Delaunay

from tacgen.core.records import GraspConfig, GraspObject, Mesh
from tacgen.core.resources import object_folders, packaged
from tacgen.core.types import turn_rad
from tacgen.objects import load_object
from tacgen.physics import FrameRequest, GraspSimulator, PhysicsSettings, run_grasp
from tacgen.physics.rest import toppled, topples_deg

FOOT, SLAB = (20.0, 30.0, 40.0), (100.0, 30.0, 10.0)


def box(size, at):
    corners = (np.indices((2, 2, 2)).reshape(3, -1).T - 0.5) * size + np.array(at)
    faces = [
        *([0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]),
        *([2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]),
    ]
    return Mesh.fixed(corners, faces)


def overhang(reach_mm):
    """A foot below a slab whose middle is ``reach_mm`` beside the foot's."""
    parts = box(FOOT, (0, 0, 20.0)), box(SLAB, (0, reach_mm, 45.0))
    masses = np.array([np.prod(FOOT), np.prod(SLAB)])
    center = masses @ np.array([[0, 0, 20.0], [0, reach_mm, 45.0]]) / masses.sum()
    return GraspObject(
        name="overhang",
        surface=parts[0],
        collision=parts,
        mass_kg=0.1,
        center_of_mass_mm=center,
        inertia_kg_mm2=np.eye(3) * 40.0,
        friction=0.5,
        spinning_friction_mm=None,
        grasp_ranges={},
    )


# The foot's edge is 15 mm from its middle; the slab has 5/9 of the mass.
@pytest.mark.parametrize(("reach_mm", "falls"), [(0.0, False), (26.0, False), (28.0, True)])
def test_an_overhang_topples_where_its_centre_is_beyond_the_foot(reach_mm, falls):
    angle = topples_deg(overhang(reach_mm))
    assert (angle > 0) is falls
    if falls:  # onto the edge of the slab, 5 mm over the foot's top …
        rise, run = 40.0, reach_mm + 15.0 - 15.0
        assert angle == pytest.approx(np.degrees(np.arctan2(rise, run)), abs=0.5)


def test_a_lone_ball_stands():
    ball = load_object("golf_ball")
    assert topples_deg(ball) == 0.0


@pytest.mark.parametrize("name", sorted(object_folders()))
def test_shipped_objects_stand(name):
    if object_folders()[name].resolve().parent == packaged("objects").resolve():
        assert topples_deg(load_object(name)) == 0.0


def test_a_grasp_of_it_has_the_status_toppled_and_says_why():
    with GraspSimulator() as simulator:
        settings = PhysicsSettings(engine=simulator.engine, lift_mm=20.0, success_rise_mm=10.0)
        config = GraspConfig(0, "overhang", 5.0, 0.0, 0.0, 25.0)
        stands, falls = (
            run_grasp(simulator, overhang(reach), config, settings, frames=FrameRequest())
            for reach in (0.0, 40.0)
        )
    assert stands.status == "executed"
    assert (falls.status, falls.label, falls.frames["left"]) == ("toppled", -1, ())
    assert "topples by 45° before the grasp" in falls.reason
    assert len(falls.reason.encode()) <= 160


def test_a_measured_centre_of_mass_counts():
    """A box with lead in one corner outside of its foot does not stand, whatever its shape."""
    obj = overhang(0.0)
    assert topples_deg(replace(obj, center_of_mass_mm=np.array([0.0, 20.0, 40.0]))) > 0


@pytest.mark.parametrize("seed", range(20))
def test_what_has_toppled_rests_on_corners_around_its_centre_of_mass(seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(30, 3)) * rng.uniform(5.0, 60.0, size=3)
    center = points[rng.choice(30, 8)].mean(axis=0)  # within their hull
    turn = toppled(points, center)
    turn = np.eye(3) if turn is None else turn
    assert np.linalg.det(turn) == pytest.approx(1.0)
    lying, over = points @ turn.T, turn @ center
    assert toppled(lying, over) is None
    assert over[2] - lying[:, 2].min() <= center[2] - points[:, 2].min() + 1e-9
    feet = lying[lying[:, 2] < lying[:, 2].min() + 1e-3, :2]
    if not np.array_equal(turn, np.eye(3)):
        assert Delaunay(feet).find_simplex(over[:2]) >= 0


def test_a_body_on_two_tips_in_a_line_rolls_on_to_a_third():
    """A ridge below a body that is wider to both sides: it is balanced on it, but not for long."""
    tips = [[0, -40, 0], [0, 40, 0], [25, 0, 8], [-25, 0, 8], [0, 0, 40]]
    turn = toppled(np.array(tips, dtype=float), np.array([0.0, 0.0, 15.0]))
    assert np.degrees(turn_rad(turn)) == pytest.approx(np.degrees(np.arctan2(8, 25)), abs=1e-6)

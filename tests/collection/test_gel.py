"""The gel's torsion against closed forms and independently integrated patches."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import trimesh
from scipy.special import ellipe

from tacgen.collection.gel import gel_patch
from tacgen.contact.indenter import Indenter
from tacgen.contact.law import ContactLaw
from tacgen.core.records import ContactFrame, GraspConfig, GraspObject, Mesh
from tacgen.core.sensors import load_sensor
from tacgen.core.types import STANDARD_GRAVITY_M_S2
from tacgen.physics import FrameRequest, GelModel, GraspSimulator, PhysicsSettings, run_grasp
from tacgen.physics.margins import torsion_limit

GEL_MM = np.array([24.0, 19.0])
SENSOR = replace(load_sensor("gelsight"), gel_size_mm=tuple(GEL_MM))
DOME_MM = 30.0
K_N = 5.135
SOLIDS = {
    "flat": trimesh.creation.box((60.0, 60.0, 100.0)),
    "cylinder": trimesh.creation.cylinder(radius=25.0, height=100.0, sections=720),
    "sphere": trimesh.creation.icosphere(subdivisions=5, radius=25.0),
}
TOUCH_MM = {"flat": 50.0, "cylinder": 50.0, "sphere": 25.0}
CURVATURE = {"flat": (0.0, 0.0), "cylinder": (1 / 25.0, 0.0), "sphere": (1 / 25.0, 1 / 25.0)}
"""Of the objects along the gel's x and y, 1/mm."""


def mesh_of(solid):
    return Mesh(np.asarray(solid.vertices, float), np.asarray(solid.faces, np.int32))


def standing(name, **figures):
    """The solid on the table, touched by the pads at ``TOUCH_MM``."""
    up = [0, 0, TOUCH_MM[name]]
    mesh = mesh_of(SOLIDS[name].copy().apply_translation(up))
    return GraspObject(
        name=name,
        surface=mesh,
        collision=(mesh,),
        grasp_ranges={},
        **{"spinning_friction_mm": None, "inertia_kg_mm2": 400.0 * np.eye(3), **figures},
    )


def frame(force_n, pose):
    return ContactFrame(0.0, force_n, np.zeros(2), 0.0, pose)


def from_the_left(height_mm):
    """Object to gel frame: x is −y, y is down, z is x of an object 25 mm or more away."""
    pose = np.eye(4)
    pose[:3, :3] = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]
    pose[:3, 3] = [0, height_mm, 40.0]
    return pose


def integrated(name, force_n, k_n=K_N, half_gel_mm=GEL_MM / 2):
    """Points and pressure shares of the paraboloid foundation, cut at the gel's rim, on a grid.

    Bisects the depth to V = k_n F; independent of the gap map and of its solver.
    """
    along = [np.linspace(-h, h, 401) * (1 - 1 / 401) for h in half_gel_mm]
    x, y = np.meshgrid(*along)
    round_x, round_y = (1 / DOME_MM + one for one in CURVATURE[name])
    gap = (round_x * x**2 + round_y * y**2) / 2
    area = 4 * np.prod(half_gel_mm) / x.size
    low, high = 0.0, 10.0
    for _ in range(30):
        middle = (low + high) / 2
        volume = np.maximum(0, middle - gap).sum() * area
        low, high = (middle, high) if volume < k_n * force_n else (low, middle)
    depth = np.maximum(0, low - gap)
    used = depth > 0
    return x[used], y[used], depth[used] / depth.sum()


def integrated_limit_mm(x, y, share, friction_share):
    """Moment arm at a tangential force along y: the patch slides about a centre on the x axis."""

    def force_and_moment(c):
        distance = np.hypot(x - c, y) + 1e-12
        force = share @ ((c - x) / distance)
        return force, share @ ((x * (x - c) + y**2) / distance)

    low, high = 0.0, 1e4
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (
            (middle, high) if force_and_moment(middle)[0] < friction_share else (low, middle)
        )
    return force_and_moment(low)[1]


def turns(simulator, name, force_n, friction_share, ratio, *, friction=0.5):
    """Whether the solid turns in the grip with its centre of mass beside the pads.

    By ``ratio`` times the offset at which the integrated patches of both pads slide.
    """
    mass_kg = friction_share * 2 * friction * force_n / STANDARD_GRAVITY_M_S2
    x, y, share = integrated(name, force_n)
    offset_mm = ratio * integrated_limit_mm(x, y, share, friction_share) / friction_share
    height_mm = TOUCH_MM[name]
    obj = standing(
        name,
        mass_kg=mass_kg,
        friction=friction,
        center_of_mass_mm=np.array([0.0, offset_mm, height_mm]),
        # So slow to turn that the ball has hardly rolled on the table until it is held.
        inertia_kg_mm2=mass_kg * 2e4 * np.eye(3),
    )
    config = GraspConfig(0, name, force_n, 0.0, 0.0, height_mm)
    patch_of = partial(gel_patch, Indenter(SENSOR), ContactLaw.linear(K_N, 1.0), obj.surface)
    settings = PhysicsSettings(clearance_mm=0.5)
    trace = run_grasp(
        simulator, obj, config, settings, frames=FrameRequest(), gel=GelModel(patch_of)
    )
    return trace.turn_rad > settings.success_turn_rad


@pytest.fixture(scope="module")
def simulator():
    with GraspSimulator() as opened:
        yield opened


def patch_of_gel(name, force_n):
    surface = standing(name, mass_kg=0.3, center_of_mass_mm=np.zeros(3), friction=0.5).surface
    load = frame(force_n, from_the_left(TOUCH_MM[name]))
    return gel_patch(Indenter(SENSOR), ContactLaw.linear(K_N, 1.0), surface, load)


@pytest.mark.parametrize("force_n", [2.0, 8.0])
@pytest.mark.parametrize("name", SOLIDS)
def test_a_pads_moment_has_its_closed_form(name, force_n):
    """Of a paraboloid over an ellipse of half axes a ≥ b: 16 a E(1 − b²/a²)/(15 π); 8/15 a."""
    round_x, round_y = (1 / DOME_MM + one for one in CURVATURE[name])
    depth_mm = np.sqrt(K_N * force_n * np.sqrt(round_x * round_y) / np.pi)
    long_mm, short_mm = (np.sqrt(2 * depth_mm / one) for one in (round_y, round_x))
    closed_mm = 16 * long_mm * ellipe(1 - (short_mm / long_mm) ** 2) / (15 * np.pi)
    assert torsion_limit(patch_of_gel(name, force_n))(0.0) == pytest.approx(closed_mm, rel=0.01)


@pytest.mark.parametrize("force_n", [2.0, 10.0, 30.0])
@pytest.mark.parametrize("name", SOLIDS)
def test_the_limits_are_those_of_the_integrated_patch(name, force_n):
    """To the rim of the gel, beyond the window, whose edge a flat face reaches at 13 N."""
    x, y, share = integrated(name, force_n)
    patch = patch_of_gel(name, force_n)
    for friction_share in (0.0, 0.3, 0.6, 0.9):
        expected_mm = integrated_limit_mm(x, y, share, friction_share)
        assert torsion_limit(patch)(friction_share) == pytest.approx(expected_mm, rel=0.01)


@pytest.mark.parametrize("tilt_rad", [0.02, 0.06])
@pytest.mark.parametrize("name", ["flat", "sphere"])
def test_a_tilted_objects_pressure_moves_as_its_touch_does(name, tilt_rad):
    """By R θ, with 1/R the sum of the curvatures: rigid domes rock as the elastic gel does."""
    c, s = np.cos(tilt_rad), np.sin(tilt_rad)
    pose = from_the_left(TOUCH_MM[name])
    touch = np.array([-30.0 if name == "flat" else -25.0, 0.0, TOUCH_MM[name], 1.0])
    tilt = np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    tilt[:3, 3] = touch[:3] - tilt[:3, :3] @ touch[:3]
    surface = standing(name, mass_kg=0.3, center_of_mass_mm=np.zeros(3), friction=0.5).surface
    law, indenter = ContactLaw.linear(K_N, 1.0), Indenter(SENSOR)
    patch = gel_patch(indenter, law, surface, frame(5.0, pose @ tilt))
    round_x = 1 / DOME_MM + CURVATURE[name][0]
    assert abs(patch.share @ patch.points_mm[:, 0]) == pytest.approx(tilt_rad / round_x, rel=0.03)


def test_no_contact_holds_no_moment():
    surface = mesh_of(trimesh.creation.box((10.0, 10.0, 10.0)).apply_translation([0, 90, 0]))
    load = frame(5.0, from_the_left(0.0))
    patch = gel_patch(Indenter(SENSOR), ContactLaw.linear(K_N, 1.0), surface, load)
    assert torsion_limit(patch)(0.0) == 0.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "force_n", "friction_share"),
    [
        (name, *load)
        for name, load in zip(SOLIDS, ((2.0, 0.7), (10.0, 0.3), (30.0, 0.7)), strict=True)
    ],
)
def test_a_grasp_turns_where_the_integrated_patch_slides(simulator, name, force_n, friction_share):
    assert not turns(simulator, name, force_n, friction_share, 0.95)
    assert turns(simulator, name, force_n, friction_share, 1.05)

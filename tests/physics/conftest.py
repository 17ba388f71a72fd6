"""Objects with known closed forms, and simulators that a module's tests share."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, get_args

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from tacgen.core.records import GraspConfig, GraspObject, GraspTrace, Mesh
from tacgen.physics import FrameRequest, GraspSimulator, PhysicsSettings, run_grasp
from tacgen.physics.settings import EngineName

GRAVITY_M_S2 = 9.80665
LIFT_LOAD = 1 + 0.12 / GRAVITY_M_S2  # of the weight, at the default acceleration of the lift
SEQUENCE = FrameRequest("sequence", 25, 3.0)


def hull_mesh(vertices_mm: np.ndarray) -> Mesh:
    hull = ConvexHull(vertices_mm)
    return Mesh(np.asarray(vertices_mm, dtype=float), hull.simplices.astype(np.int32))


def block(
    *,
    size_mm: tuple[float, float, float] = (60.0, 60.0, 100.0),
    mass_kg: float = 0.3,
    friction: float = 0.5,
    spinning_friction_mm: float = 2.0,
    center_of_mass_offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0),
    yaw_rad: float = 0.0,
) -> GraspObject:
    """A box on the table whose side faces the left finger at the same yaw."""
    x, y, z = size_mm
    corners = np.array(
        [[i * x / 2, j * y / 2, k * z] for i in (-1, 1) for j in (-1, 1) for k in (0, 1)]
    )
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    mesh = hull_mesh(corners @ turn.T)
    moments = mass_kg / 12 * np.diag([y**2 + z**2, x**2 + z**2, x**2 + y**2])
    return GraspObject(
        name="block",
        surface=mesh,
        collision=(mesh,),
        mass_kg=mass_kg,
        center_of_mass_mm=turn @ (np.array([0.0, 0.0, z / 2]) + center_of_mass_offset_mm),
        inertia_kg_mm2=turn @ moments @ turn.T,
        friction=friction,
        spinning_friction_mm=spinning_friction_mm,
        grasp_ranges={},
    )


def solid(shape: str) -> GraspObject:
    """A cylinder of 256 sections on its base, or a ball, of 0.3 kg."""
    if shape == "cylinder":
        mesh = trimesh.creation.cylinder(radius=33.0, height=100.0, sections=256)
    else:
        mesh = trimesh.creation.icosphere(subdivisions=3, radius=25.0)
    mesh.apply_translation([0.0, 0.0, -mesh.bounds[0, 2]])
    part = hull_mesh(mesh.vertices)
    return replace(
        block(),
        surface=part,
        collision=(part,),
        center_of_mass_mm=mesh.center_mass,
        inertia_kg_mm2=mesh.moment_inertia * 0.3 / mesh.mass,
    )


def dumbbell() -> GraspObject:
    """Two plates joined by a bar: three convex parts, concave as a whole."""

    def box(x: tuple[float, float], y: tuple[float, float], z: tuple[float, float]) -> Mesh:
        return hull_mesh(np.array([[i, j, k] for i in x for j in y for k in z]))

    parts = (
        box((-30, 30), (-40, -25), (0, 60)),
        box((-30, 30), (25, 40), (0, 60)),
        box((-10, 10), (-25, 25), (20, 40)),
    )
    return replace(
        block(mass_kg=0.2), collision=parts, center_of_mass_mm=np.array([0.0, 0.0, 30.0])
    )


def grasp(
    simulator: GraspSimulator,
    obj: GraspObject,
    *,
    force_n: float = 10.0,
    x_mm: float = 0.0,
    y_mm: float = 0.0,
    z_mm: float = 50.0,
    yaw_rad: float = 0.0,
    settings: PhysicsSettings | None = None,
    frames: FrameRequest | None = None,
) -> GraspTrace:
    return run_grasp(
        simulator,
        obj,
        GraspConfig(0, obj.name, force_n, x_mm, y_mm, z_mm, yaw_rad),
        replace(settings or PhysicsSettings(tactile_pads="both"), engine=simulator.engine),
        frames=frames or FrameRequest(),
    )


def threshold(holds: Callable[[float], bool], low: float, high: float, halvings: int) -> float:
    """Where ``holds`` turns from True at ``low`` to False at ``high``."""
    assert holds(low), f"does not hold at {low}"
    assert not holds(high), f"still holds at {high}"
    for _ in range(halvings):
        middle = (low + high) / 2
        low, high = (middle, high) if holds(middle) else (low, middle)
    return (low + high) / 2


@contextmanager
def opened(robot: str, engine: EngineName) -> Iterator[GraspSimulator]:
    """A simulator of an engine that is installed."""
    pytest.importorskip(engine)
    with GraspSimulator(robot, engine) as simulator:
        yield simulator


@pytest.fixture(scope="module", params=get_args(EngineName))
def engine(request: pytest.FixtureRequest) -> EngineName:
    found: EngineName = request.param
    return found


@pytest.fixture(scope="module")
def simulator(engine: EngineName) -> Iterator[GraspSimulator]:
    with opened("wsg50", engine) as found:
        yield found


@pytest.fixture(scope="module")
def arm_simulator(engine: EngineName) -> Iterator[GraspSimulator]:
    with opened("ur5e_wsg50", engine) as found:
        yield found


@pytest.fixture(scope="module")
def bullet_world() -> Iterator[Any]:
    """What only PyBullet has: its functions, and a world without a robot."""
    with opened("wsg50", "pybullet") as found:
        yield found.world

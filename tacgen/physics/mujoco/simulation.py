"""The scene of one grasp in MuJoCo. Lengths are in metres, quaternions x, y, z, w."""

from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any

import numpy as np

from tacgen.core.engine_contacts import ContactPoint, mujoco_points
from tacgen.core.errors import PhysicsError
from tacgen.core.records import PADS, GraspObject, Mesh
from tacgen.core.types import (
    M_PER_MM,
    STANDARD_GRAVITY_M_S2,
    FloatArray,
    IntArray,
    cross,
    pose,
    quaternion_from_rotation,
    rotation_of,
)
from tacgen.physics import engine
from tacgen.physics.engine import TABLE, Place, Touch, Vector
from tacgen.physics.gripper import outline_of
from tacgen.physics.margins import torsion_factor
from tacgen.physics.mujoco.model import (
    BASE,
    DRIVEN_MASS,
    HAND,
    OBJECT,
    Scene,
    carrying_joint,
    motor_of,
    pair_of,
)
from tacgen.physics.robots import RobotSpec
from tacgen.physics.settings import PhysicsSettings
from tacgen.physics.world import principal_axes

LARGEST_STIFFNESS_N_M = 1e6  # of a pad
SLIP_DAMPING_1_S = 100.0
"""Friction's: a slide decays in 10 ms or sooner. More needs softer pads (0.3 mm at μ = 0.5)."""
POINTS_ON_TABLE = 4  # at which an object that is no ball stands: a box's
SLIDE_RESERVE = 1.5  # of the force that keeps a sliding touch: 0.6 of it slide faster than the lift
RESPONSE_STEPS = 2.4  # time constant of a contact; below two it is unstable
LARGEST_IMPEDANCE = 0.9999  # Source: MuJoCo's documentation, solver parameters


class MujocoEngine:
    """MuJoCo with one kind of robot; an arm's motors follow their path, whatever they carry."""

    def __init__(self, robot: RobotSpec) -> None:
        try:
            self._mujoco: Any = import_module("mujoco")
        except ImportError as error:
            msg = (
                f"MuJoCo cannot be imported ({error}); install it with `pip install mujoco`, or "
                "simulate in PyBullet: `physics: {engine: pybullet}`"
            )
            raise PhysicsError(msg) from error
        self._robot = robot
        self._model: Any = None
        self._data: Any = None

    def __enter__(self) -> "MujocoEngine":
        return self

    def __exit__(self, *raised: object) -> None:
        """Nothing to close."""

    def build(
        self,
        obj: GraspObject,
        settings: PhysicsSettings,
        force_n: float,
        met: Sequence[Mesh] | None = None,
    ) -> tuple["ObjectBody", engine.Robot]:
        """A new scene: the table, the object in its rest pose and the robot."""
        moments, axes = principal_axes(obj.inertia_kg_mm2)
        inertial, moments_kg_m2 = (
            pose(axes, obj.center_of_mass_mm * M_PER_MM),
            moments * M_PER_MM**2,
        )
        scene = Scene(self._mujoco, settings)
        scene.add_object(obj, inertial, moments_kg_m2, met)
        friction = obj.friction * settings.pad_friction
        scene.add_robot(self._robot, friction)
        self._model = model = scene.compiled()
        self._data = data = self._mujoco.MjData(model)
        _set_compliance(model, settings, friction, settings.delivered_force_n(force_n))
        _soften_table(self._mujoco.mjtGeom, model, settings, obj.mass_kg)
        geoms = range(model.ngeom)
        self._names = [model.geom(geom).name for geom in geoms]
        self._of_object = (model.geom_bodyid == model.body(OBJECT).id).tolist()
        hand = model.body(HAND).id
        self._gripper = [  # and the fingers, with the pads' outlines
            k for k in geoms if model.geom_bodyid[k] >= hand and self._names[k] not in PADS
        ]
        self._parts = [model.geom(name).id for name in scene.parts]
        self._met = [model.geom(name).id for name in scene.met]
        self._joints = Joints(self._mujoco, model, data, self._robot)
        self._fingers = Fingers(model, data)
        self._driven = [*self._joints.dofs.tolist(), *self._fingers.motors.tolist()]
        robot = self._robot.mounted(settings, self._joints, self._fingers)
        return ObjectBody(model, data, inertial, moments_kg_m2), robot

    def step(self, count: int) -> None:
        """Advance by ``count`` time steps."""
        model, data, advance = self._model, self._data, self._mujoco.mj_step
        speeds, applied, gain = data.qvel, data.qfrc_applied, DRIVEN_MASS / model.opt.timestep
        for _ in range(count):
            # By a force: friction does not lag behind a motion that the solver knows of.
            wanted = [*self._joints.next_speeds(), *self._fingers.speeds_m_s]
            for dof, speed in zip(self._driven, wanted, strict=True):
                applied[dof] = (speed - speeds[dof]) * gain
            advance(model, data)

    def contacts(self) -> list[ContactPoint[str]]:
        """All contact points of the last step on the object, by the name of what touches it."""
        names, of_object = self._names, self._of_object
        return mujoco_points(
            self._mujoco,
            self._model,
            self._data,
            lambda one, other: names[other] if of_object[one] else None,
        )

    def distances(self, limit_m: float) -> list[tuple[str, float]]:
        """Parts of the gripper and how near they are to the object, within ``limit_m``."""
        model, data = self._model, self._data
        self._mujoco.mj_kinematics(model, data)
        found = []
        for geom in self._gripper:
            margin_m = float(model.geom_margin[geom])
            most_m = limit_m + margin_m
            pairs = ((model, data, geom, part, most_m, None) for part in self._parts)
            nearest_m = min(self._mujoco.mj_geomDistance(*pair) for pair in pairs)
            if nearest_m < most_m:
                found.append((self._names[geom], nearest_m - margin_m))
        return found

    def touches(self, pad: str, limit_m: float) -> list[Touch]:
        """Where what a pad can touch of the object is nearest to it, within ``limit_m``."""
        model, data, geom = self._model, self._data, self._model.geom(pad).id
        self._mujoco.mj_kinematics(model, data)
        margin_m, found = float(model.geom_margin[geom]), []
        most_m = limit_m + margin_m
        for part in self._met:
            ends = np.zeros(6)
            distance_m = self._mujoco.mj_geomDistance(model, data, geom, part, most_m, ends)
            if distance_m < most_m:
                on_pad, on_object = ends[:3], ends[3:]
                normal = (on_object - on_pad) / distance_m
                normal /= np.linalg.norm(normal)
                place = tuple(on_object.tolist())
                found.append(Touch(place, tuple(normal.tolist()), distance_m - margin_m))
        return found


def _soften_table(kinds: Any, model: Any, settings: PhysicsSettings, mass_kg: float) -> None:
    """The table's softness, so that an object that the fingers push keeps its touch."""
    pairs = _pairs(model, TABLE)
    ball = int(kinds.mjGEOM_SPHERE) in model.geom_type[model.pair_geom2[pairs]]
    force_n = mass_kg * STANDARD_GRAVITY_M_S2 / (1 if ball else POINTS_ON_TABLE)
    speed_m_s = settings.closing_speed_mm_s * M_PER_MM
    stiffness = 1 / (RESPONSE_STEPS * settings.time_step_s) ** 2
    pushed_off = SLIDE_RESERVE * settings.table_friction * speed_m_s
    inverse_mass = max(stiffness / LARGEST_STIFFNESS_N_M, SLIP_DAMPING_1_S * pushed_off / force_n)
    _set_spring(model, TABLE, stiffness, inverse_mass, 2 * stiffness**0.5, SLIP_DAMPING_1_S)
    model.pair_margin[pairs] += inverse_mass * force_n / stiffness


def _set_compliance(model: Any, settings: PhysicsSettings, friction: float, force_n: float) -> None:
    """Stiffness and damping of the pads in N/m and N s/m, whatever the object's mass.

    A contact of MuJoCo is a spring of k = K R for each kilogram, R the reciprocal mass by which its
    impedance d = A/(A + R) lets the constraint yield; A is that of the two bodies.

    Its friction is a relaxed one: a touch that slides at v is pushed off by μ b v, b the damping of
    its friction, and is lost where that is more than the R F by which the force F presses it in. So
    rigid pads are as soft as it takes to keep the touch at the lift's speed, and stand out by what
    they sink in; with a given stiffness the friction's damping gives way.

    Source: Todorov 2014, Convex and analytically-invertible dynamics with contacts and constraints.
    """
    response_s = RESPONSE_STEPS * settings.time_step_s
    damping = 2 / response_s
    pushed_off = SLIDE_RESERVE * friction * settings.lift_speed_mm_s * M_PER_MM  # at b = 1
    slip_damping, sunk_m = SLIP_DAMPING_1_S, 0.0
    if settings.pad_stiffness_n_mm:
        inverse_mass = M_PER_MM / (settings.pad_stiffness_n_mm * response_s**2)
        if settings.pad_damping_n_s_mm:
            damping_n_s_m = settings.pad_damping_n_s_mm / M_PER_MM
            inverse_mass = min(inverse_mass, damping / damping_n_s_m)
            damping = damping_n_s_m * inverse_mass
        stiffness = settings.pad_stiffness_n_mm / M_PER_MM * inverse_mass
        if pushed_off > 0:
            slip_damping = min(slip_damping, inverse_mass * force_n / pushed_off)
    else:
        stiffness = 1 / response_s**2
        inverse_mass = stiffness / LARGEST_STIFFNESS_N_M
        if force_n > 0:
            inverse_mass = max(inverse_mass, slip_damping * pushed_off / force_n)
        sunk_m = inverse_mass * force_n / stiffness
    for pad in PADS:
        _set_spring(model, pad, stiffness, inverse_mass, damping, slip_damping)
        model.pair_margin[_pairs(model, pad)] += sunk_m
        model.geom_margin[model.geom(outline_of(pad)).id] += sunk_m


def _set_spring(
    model: Any,
    touched: str,
    stiffness: float,
    inverse_mass: float,
    damping: float,
    slip_damping: float,
) -> None:
    """The springs of the object's pairs with a geom: stiffness 1/s², R 1/kg, dampings 1/s."""
    bodies = model.geom_bodyid[model.geom(touched).id], model.body(OBJECT).id
    of_bodies = float(sum(model.body_invweight0[body, 0] for body in bodies))
    impedance = min(of_bodies / (of_bodies + inverse_mass), LARGEST_IMPEDANCE)
    pairs = _pairs(model, touched)
    # MuJoCo multiplies the first by 1/d and divides the second by it.
    model.pair_solref[pairs] = [-stiffness * impedance, -damping * impedance]
    model.pair_solreffriction[pairs] = [-stiffness * impedance, -slip_damping * impedance]
    model.pair_solimp[pairs, :2] = impedance


def _pairs(model: Any, touched: str) -> list[int]:
    """Numbers of the pairs of a pad or the table and a part of the object."""
    return [k for k in range(model.npair) if model.pair(k).name.startswith(pair_of(touched, ""))]


class ObjectBody:
    """The object."""

    def __init__(
        self, model: Any, data: Any, inertial: FloatArray, moments_kg_m2: FloatArray
    ) -> None:
        self.inertial, self.principal_moments_kg_m2 = inertial, moments_kg_m2
        joint = model.joint(OBJECT)
        self._data, self._place, self._speed = data, joint.qposadr[0], joint.dofadr[0]
        self._first_m = data.qpos[self._place : self._place + 2].copy()

    def _pose(self) -> FloatArray:
        x, y, z, qw, qx, qy, qz = self._data.qpos[self._place : self._place + 7].tolist()
        return pose(rotation_of((qx, qy, qz, qw)), (x, y, z))

    def inertial_position(self) -> Place:
        """The centre of mass and the principal axes."""
        frame = self._pose() @ self.inertial
        return tuple(frame[:3, 3].tolist()), tuple(quaternion_from_rotation(frame[:3, :3]).tolist())

    def velocity(self) -> Place:
        """Linear velocity (m/s) of the centre of mass and angular velocity (rad/s)."""
        # The spin is in the object's axes.
        linear, spin = self._data.qvel[self._speed : self._speed + 6].reshape(2, 3)
        rotation = self._pose()[:3, :3]
        linear = linear + rotation @ cross(spin, self.inertial[:3, 3])
        return tuple(linear.tolist()), tuple((rotation @ spin).tolist())

    def keep_place(self) -> None:
        """Stand at rest where it was to begin with, however it has come to rest on the table."""
        self._data.qpos[self._place : self._place + 2] = self._first_m
        self._data.qvel[self._speed : self._speed + 6] = 0.0


class Joints:
    """The joints of the links that carry the hand, which move at the commanded speeds."""

    def __init__(self, mujoco: Any, model: Any, data: Any, robot: RobotSpec) -> None:
        self._mujoco, self._model, self._data = mujoco, model, data
        driven = [k for k, link in enumerate(robot.links()) if link.joint != "fixed"]
        names = [carrying_joint(number) for number in driven]
        self._places, self.dofs = _addresses(model, names)
        self._base, self._hand = model.body(BASE).id, model.body(HAND).id
        self._speeds = self._first_speeds = [0.0] * len(names)

    def place(self, base: Place, positions: Sequence[float]) -> None:
        """Put the robot's base and its joints there, at rest."""
        position_m, quaternion = base
        self._model.body_pos[self._base] = position_m
        self._model.body_quat[self._base] = np.roll(quaternion, 1)
        self._data.qpos[self._places] = positions

    def drive(self, positions: Sequence[float], speeds: Sequence[float]) -> None:
        """Move at ``speeds`` from now on, making up for what ``positions`` differ by in a step."""
        now, time_step_s = self._data.qpos, self._model.opt.timestep
        self._speeds = list(speeds)
        self._first_speeds = [
            (position - now[place]) / time_step_s + speed
            for position, place, speed in zip(positions, self._places, speeds, strict=True)
        ]

    def next_speeds(self) -> list[float]:
        """The speeds of the step that follows."""
        speeds, self._first_speeds = self._first_speeds, self._speeds
        return speeds

    def positions(self) -> Vector:
        """Where the joints are."""
        return tuple(self._data.qpos[self._places].tolist())

    def hand(self) -> Place:
        """The gripper frame."""
        self._mujoco.mj_kinematics(self._model, self._data)
        w, x, y, z = self._data.xquat[self._hand].tolist()
        return tuple(self._data.xpos[self._hand].tolist()), (x, y, z, w)


class Fingers:
    """The two fingers and their motors."""

    def __init__(self, model: Any, data: Any) -> None:
        self._model, self._data = model, data
        self._pairs = {pad: _pairs(model, pad) for pad in PADS}
        self._places, self._dofs = _addresses(model, PADS)
        self._motor_places, self.motors = _addresses(model, [motor_of(pad) for pad in PADS])
        self.speeds_m_s = [0.0, 0.0]

    def place(self, travel_m: float) -> None:
        """Put both fingers ``travel_m`` in, at rest."""
        self._data.qpos[self._motor_places], self._data.qpos[self._places] = travel_m, 0.0

    def drive(self, speed_m_s: float, force_n: float) -> None:
        """Close at ``speed_m_s``, pressing with ``force_n`` at most."""
        self.speeds_m_s = [speed_m_s, speed_m_s]
        self._model.dof_frictionloss[self._dofs] = force_n

    def set_spinning_friction(
        self, spinning_friction_m: Mapping[str, float], friction_share: float
    ) -> None:
        """Moment about its normal that each pad resists beside that share of its friction.

        The elliptic cone reduces the moment by the share itself, so what it takes off is added.
        """
        factor = torsion_factor(friction_share)
        for pad, pairs in self._pairs.items():
            alone_m = spinning_friction_m[pad] / factor if factor > 0 else 0.0
            self._model.pair_friction[pairs, 2] = alone_m

    def couple(self) -> None:
        """From now on the fingers move by equal amounts, about where they are."""
        left_m, right_m = self._data.qpos[self._places].tolist()
        self._model.eq_data[0, :2] = left_m - right_m, 1.0
        self._data.eq_active[0] = 1

    def travel_m(self) -> tuple[float, float]:
        """How far the left and the right finger are in."""
        left_m, right_m = self._data.qpos[self._motor_places] + self._data.qpos[self._places]
        return float(left_m), float(right_m)


def _addresses(model: Any, joints: Sequence[str]) -> tuple[IntArray, IntArray]:
    """Where the positions and the speeds of the joints of those names stand."""
    found = [model.joint(name) for name in joints]
    return np.array([j.qposadr[0] for j in found]), np.array([j.dofadr[0] for j in found])

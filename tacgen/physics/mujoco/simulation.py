"""The scene of one grasp in MuJoCo. Lengths are in metres, quaternions x, y, z, w."""

import math
from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any

import numpy as np

from tacgen.core.arrays import FloatArray
from tacgen.core.errors import PhysicsError
from tacgen.core.records import GraspObject, Mesh
from tacgen.core.units import M_PER_MM
from tacgen.physics.bodies import principal_axes
from tacgen.physics.frames import pose, quaternion_from_rotation, rotation_of
from tacgen.physics.margins import torsion_factor
from tacgen.physics.mujoco.model import scene_xml
from tacgen.physics.robots import GripperTarget
from tacgen.physics.settings import PAD_NAMES, PhysicsSettings, RobotName
from tacgen.physics.world import Collides

Place = tuple[tuple[float, ...], tuple[float, ...]]  # position and quaternion
OBJECT, ROBOT = 1, 2  # numbers of the bodies; the table is 0
HEIGHT = 7  # of the hand in ``qpos``, after the object's position and quaternion
MOTORS, FINGERS = (8, 10), (9, 11)  # in ``qpos``, left and right
SPEED_OFFSET = -1  # of ``qvel`` to ``qpos``: a quaternion has four numbers, a spin three
CONTACT_STIFFNESS_N_MM = 1000.0  # of rigid pads: they sink in by 0.04 mm under 40 N
RESPONSE_STEPS = 2.4  # time constant of a contact; below two it is unstable
LARGEST_IMPEDANCE = 0.9999  # Source: MuJoCo's documentation, solver parameters


class Engine:
    """MuJoCo with the floating gripper; its methods are those of ``bullet.Engine``."""

    def __init__(self, robot: RobotName) -> None:
        if robot != "wsg50":
            msg = (
                f"the engine 'mujoco' has no robot {robot!r}; set `robot: {{name: wsg50}}`, or "
                "simulate in PyBullet alone: `physics: {engine: pybullet}`"
            )
            raise PhysicsError(msg)
        try:
            self._mujoco: Any = import_module("mujoco")
        except ImportError as error:
            msg = (
                f"MuJoCo cannot be imported ({error}); install it with `pip install "
                "'tacgen[mujoco]'`, or simulate in PyBullet: `physics: {engine: pybullet}`"
            )
            raise PhysicsError(msg) from error

    def __enter__(self) -> "Engine":
        return self

    def __exit__(self, *raised: object) -> None:
        """Nothing to close."""

    def build(
        self,
        obj: GraspObject,
        settings: PhysicsSettings,
        force_n: float,
        met: Sequence[Mesh] | None = None,
    ) -> tuple["ObjectBody", "FloatingGripper"]:
        """A new scene: the table, the object in its rest pose and the gripper.

        The pads can touch ``met`` of the object alone, else the whole object.
        """
        moments, axes = principal_axes(obj.inertia_kg_mm2)
        inertial = pose(axes, obj.center_of_mass_mm * M_PER_MM)
        xml = scene_xml(
            obj, settings, inertial, moments * M_PER_MM**2, obj.collision if met is None else met
        )
        self.model = self._mujoco.MjModel.from_xml_string(xml)
        self.data = self._mujoco.MjData(self.model)
        _set_compliance(self.model, settings)
        self._owner = np.minimum(self.model.geom_bodyid, ROBOT).tolist()
        of_object = self.model.geom_bodyid == OBJECT
        self._parts = np.flatnonzero(of_object)[: len(obj.collision)].tolist()  # its whole parts
        self._robot = FloatingGripper(self.model, self.data)
        body = ObjectBody(self.data, inertial, moments * M_PER_MM**2)
        return body, self._robot

    def step(self, count: int) -> None:
        """Advance by ``count`` time steps."""
        driven = np.array([HEIGHT, *MOTORS]) + SPEED_OFFSET
        finger_m_s = self._robot.fingers.speed_m_s
        speeds_m_s = self._robot.speed_m_s, finger_m_s, finger_m_s
        for _ in range(count):
            self.data.qvel[driven] = speeds_m_s
            self._mujoco.mj_step(self.model, self.data)

    def contacts(self) -> tuple[tuple[Any, ...], ...]:
        """All contact points of the last step on the object, as PyBullet lays them out."""
        found, force_n = self.data.contact, self.data.efc_force
        rows = []
        for k in np.flatnonzero(found.efc_address >= 0).tolist():
            first, other = found.geom[k].tolist()
            # MuJoCo's normal and force act on the second of the two.
            sign = 1.0 if self._owner[other] == OBJECT else -1.0
            other = first if sign > 0 else other
            normal, along, across = (sign * found.frame[k].reshape(3, 3)).tolist()
            start = found.efc_address[k]
            push_n, along_n, across_n = force_n[start : start + 3].tolist()
            place = tuple(found.pos[k].tolist())
            friction = along_n, along, across_n, across
            link = other if self._owner[other] == ROBOT else -1
            bodies = OBJECT, self._owner[other], -1, link
            rows.append((0, *bodies, place, place, normal, float(found.dist[k]), push_n, *friction))
        return tuple(rows)

    def touches(self, robot: int, link: int, body: int, limit_m: float) -> list[tuple[Any, ...]]:
        """Where each part of the object is nearest to a pad, within ``limit_m``, as contact points.

        Between the object's and the pad's own surfaces, whatever compliance lets them overlap.
        """
        self._mujoco.mj_kinematics(self.model, self.data)
        margin_m, rows = float(self.model.geom_margin[link]), []
        touched = self.model.geom_conaffinity & int(Collides.GRIPPER)
        for part in np.flatnonzero(touched).tolist():
            ends = np.zeros(6)
            distance_m = self._mujoco.mj_geomDistance(
                self.model, self.data, link, part, limit_m + margin_m, ends
            )
            if distance_m < limit_m + margin_m:
                normal = tuple((math.copysign(1, distance_m) * _unit(ends[:3] - ends[3:])).tolist())
                place, gap_m = tuple(ends[3:].tolist()), distance_m - margin_m
                rows.append((0, robot, body, link, -1, place, place, normal, gap_m))
        return rows

    def distances(self, robot: int, body: int, limit_m: float) -> list[tuple[int, float]]:
        """Links of the robot and how near they are to the object, within ``limit_m``."""
        self._mujoco.mj_kinematics(self.model, self.data)
        found = []
        for link in (geom for geom, owner in enumerate(self._owner) if owner == robot):
            margin_m = float(self.model.geom_margin[link])
            most_m = limit_m + margin_m
            pairs = ((self.model, self.data, link, part, most_m, None) for part in self._parts)
            nearest_m = min(self._mujoco.mj_geomDistance(*pair) for pair in pairs)
            if nearest_m < most_m:
                found.append((link, nearest_m - margin_m))
        return found


def _unit(vector: FloatArray) -> FloatArray:
    return np.asarray(vector / np.linalg.norm(vector))


def _set_compliance(model: Any, settings: PhysicsSettings) -> None:
    """Stiffness and damping of the pads in N/m and N s/m, whatever the object's mass.

    A contact of MuJoCo is a spring of k = K R for each kilogram, R the reciprocal mass by which its
    impedance d = A/(A + R) lets the constraint yield; A is that of the two bodies.
    """
    stiffness_n_m = (settings.pad_stiffness_n_mm or CONTACT_STIFFNESS_N_MM) / M_PER_MM
    response_s = RESPONSE_STEPS * settings.time_step_s
    inverse_mass, damping = 1 / response_s**2 / stiffness_n_m, 2 / response_s
    if settings.pad_stiffness_n_mm and settings.pad_damping_n_s_mm:
        damping_n_s_m = settings.pad_damping_n_s_mm / M_PER_MM
        inverse_mass = min(inverse_mass, damping / damping_n_s_m)
        damping = damping_n_s_m * inverse_mass
    for pad in PAD_NAMES:
        bodies = model.body(pad), model.body("object")
        of_bodies = sum(float(body.invweight0[0]) for body in bodies)
        impedance = min(of_bodies / (of_bodies + inverse_mass), LARGEST_IMPEDANCE)
        # MuJoCo multiplies the first by 1/d and divides the second by it.
        spring = stiffness_n_m * inverse_mass * impedance, damping * impedance
        geom = model.geom(pad).id
        model.geom_solref[geom] = [-one for one in spring]
        model.geom_solimp[geom, :2] = impedance


class ObjectBody:
    """The object; as ``bodies.ObjectBody``."""

    body = OBJECT

    def __init__(self, data: Any, inertial: FloatArray, moments_kg_m2: FloatArray) -> None:
        self._data = data
        self.inertial = inertial
        self.principal_moments_kg_m2 = moments_kg_m2

    def _pose(self) -> FloatArray:
        x, y, z, qw, qx, qy, qz = self._data.qpos[:HEIGHT].tolist()
        return pose(rotation_of((qx, qy, qz, qw)), (x, y, z))

    def inertial_position(self) -> Place:
        """The centre of mass and the principal axes."""
        frame = self._pose() @ self.inertial
        return tuple(frame[:3, 3].tolist()), tuple(quaternion_from_rotation(frame[:3, :3]).tolist())

    def velocity(self) -> Place:
        """Linear velocity (m/s) of the centre of mass and angular velocity (rad/s)."""
        linear, spin = self._data.qvel[:3], self._data.qvel[3:6]  # spin: in the object's axes
        rotation = self._pose()[:3, :3]
        linear = linear + rotation @ np.cross(spin, self.inertial[:3, 3])
        return tuple(linear.tolist()), tuple((rotation @ spin).tolist())


class FloatingGripper:
    """The gripper, moving at the commanded speed; as ``robots.FloatingGripper``."""

    body = ROBOT

    def __init__(self, model: Any, data: Any) -> None:
        self._model, self._data = model, data
        self.palm: int = model.geom("palm").id
        self.fingers = Fingers(model, data)
        self.speed_m_s = 0.0

    def place(self, target: GripperTarget) -> str:
        """Put the gripper at ``target`` at rest; every place can be reached."""
        self._quaternion = (0.0, 0.0, math.sin(target.yaw_rad / 2), math.cos(target.yaw_rad / 2))
        hand = self._model.body("hand").id
        self._model.body_pos[hand] = (target.x_m, target.y_m, 0.0)
        self._model.body_quat[hand] = np.roll(self._quaternion, 1)
        self._base = (target.x_m, target.y_m)
        self._data.qpos[HEIGHT] = target.z_m
        return ""

    def prepare_lift(self, lift_m: float) -> str:
        """Nothing to prepare: the axis rests, and every height can be reached."""
        return ""

    def command_lift(self, height_m: float, speed_m_s: float) -> None:
        """Move up at ``speed_m_s``."""
        self.speed_m_s = speed_m_s

    def gripper_position(self) -> Place:
        """The gripper frame."""
        return (*self._base, float(self._data.qpos[HEIGHT])), self._quaternion


class Fingers:
    """The two fingers and their motors; as ``gripper.Fingers``."""

    def __init__(self, model: Any, data: Any) -> None:
        self._model, self._data = model, data
        self.links = {pad: int(model.geom(pad).id) for pad in PAD_NAMES}
        self.speed_m_s = 0.0

    def place(self, travel_m: float) -> None:
        """Put both fingers ``travel_m`` in, at rest."""
        self._data.qpos[list(MOTORS)], self._data.qpos[list(FINGERS)] = travel_m, 0.0

    def drive(self, speed_m_s: float, force_n: float) -> None:
        """Close at ``speed_m_s``, pressing with ``force_n`` at most."""
        self.speed_m_s = speed_m_s
        self._model.dof_frictionloss[np.array(FINGERS) + SPEED_OFFSET] = force_n

    def set_spinning_friction(
        self, spinning_friction_m: Mapping[str, float], friction_share: float
    ) -> None:
        """Moment about its normal that each pad resists beside that share of its friction.

        The elliptic cone reduces the moment by the share itself, so what it takes off is added.
        """
        factor = torsion_factor(friction_share)
        for pad, geom in self.links.items():
            alone_m = spinning_friction_m[pad] / factor if factor > 0 else 0.0
            self._model.geom_friction[geom, 1] = alone_m

    def couple(self) -> None:
        """From now on the fingers move by equal amounts, about where they are."""
        left_m, right_m = self._data.qpos[list(FINGERS)].tolist()
        self._model.eq_data[0, :2] = left_m - right_m, 1.0
        self._data.eq_active[0] = 1

    def travel_m(self) -> tuple[float, float]:
        """How far the left and the right finger are in."""
        left_m, right_m = self._data.qpos[list(MOTORS)] + self._data.qpos[list(FINGERS)]
        return float(left_m), float(right_m)

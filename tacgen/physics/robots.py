"""The robots that carry the gripper: a floating WSG-50, and one on the flange of a UR5e."""

import math
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from tacgen.core.arrays import FloatArray
from tacgen.core.units import M_PER_MM, MM_PER_M
from tacgen.physics import ur5e
from tacgen.physics.frames import Pose, inverse, pose, quaternion_from_rotation, rotation_about_z
from tacgen.physics.gripper import (
    FINGER_LENGTH_MM,
    HAND_MASS_KG,
    PALM_HALF_EXTENTS_MM,
    Fingers,
    create_body,
    finger_links,
    palm_link,
)
from tacgen.physics.settings import PhysicsSettings, RobotName
from tacgen.physics.world import Link, World

AXIS_FORCE_N = 2000.0
"""Of the floating gripper's vertical axis: far more than any grasp, so that it follows."""
SAME_SPEED_M_S = 1e-9
"""Commands this close are one: a float's rounding along the lift's constant part."""
BASE_POSITION_M = (-0.5, 0.0, 0.0)  # of the arm: the object is well within its reach of 850 mm
FLANGE_HEIGHT_M = (FINGER_LENGTH_MM + 2 * PALM_HALF_EXTENTS_MM[2]) * M_PER_MM
"""Of the flange above the pads' centre."""
FLANGE_IN_GRIPPER = pose(np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, FLANGE_HEIGHT_M))
ELBOW_UP_RAD = np.array([0.2699, -1.6352, -1.9463, -1.1309, 1.5708, -1.3009])
"""Joint angles that hold the gripper, pointing down, 100 mm above the middle of the table."""
LINK_RADIUS_M = 0.05  # of the rods in place of the links, whose inertia is not published
POSITION_GAIN = 0.2
"""Share of a joint's position error that a step corrects; PyBullet's own default is 0.1."""
LIFT_KNOT_MM = 10.0  # between solved joint angles of the lift: a spline goes through them
FLOATING_HAND = 0  # numbers of the links
ARM_JOINTS = tuple(range(6))
ARM_HAND = 6


@dataclass(frozen=True, slots=True)
class GripperTarget:
    """Where the gripper frame shall be: pointing down, turned by ``yaw_rad`` about z."""

    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float


class FloatingGripper:
    """The gripper alone, on a vertical axis: the fast robot."""

    def __init__(self, world: World, settings: PhysicsSettings) -> None:
        self._world = world
        hand = Link(-1, world.bullet.JOINT_PRISMATIC, HAND_MASS_KG)
        fingers = finger_links(world, settings, FLOATING_HAND)
        links = [hand, *fingers, palm_link(world, FLOATING_HAND)]
        self.body = create_body(world, links, (0.0, 0.0, 0.0))
        self.palm = len(links) - 1
        self.fingers = Fingers(world, self.body, FLOATING_HAND)

    def place(self, target: GripperTarget) -> str:
        """Put the gripper at ``target`` at rest; every place can be reached."""
        bullet = self._world.bullet
        self._base = (target.x_m, target.y_m, 0.0)
        self._quaternion = (0.0, 0.0, math.sin(target.yaw_rad / 2), math.cos(target.yaw_rad / 2))
        bullet.resetBasePositionAndOrientation(self.body, self._base, self._quaternion)
        bullet.resetJointState(self.body, FLOATING_HAND, target.z_m, 0.0)
        return ""

    def prepare_lift(self, lift_m: float) -> str:
        """Hold the present height from now on."""
        self._speed_m_s = math.inf
        self.command_lift(0.0, 0.0)
        return ""

    def command_lift(self, height_m: float, speed_m_s: float) -> None:
        """Move up at ``speed_m_s``; the axis follows so closely that heights need no correction."""
        if abs(speed_m_s - self._speed_m_s) < SAME_SPEED_M_S:
            return
        self._speed_m_s = speed_m_s
        self._world.bullet.setJointMotorControl2(
            self.body,
            FLOATING_HAND,
            self._world.bullet.VELOCITY_CONTROL,
            targetVelocity=speed_m_s,
            force=AXIS_FORCE_N,
        )

    def gripper_position(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Position (m) and quaternion of the gripper frame in the world."""
        height_m = self._world.bullet.getJointState(self.body, FLOATING_HAND)[0]
        return (self._base[0], self._base[1], height_m), self._quaternion


class ArmWithGripper:
    """The gripper on the flange of a UR5e, whose own links collide with nothing."""

    def __init__(self, world: World, settings: PhysicsSettings) -> None:
        self._world = world
        hand_in_flange = inverse(FLANGE_IN_GRIPPER)
        hand = Link(
            parent=ARM_HAND - 1,
            joint_type=world.bullet.JOINT_FIXED,
            mass_kg=HAND_MASS_KG,
            position_m=_position(ur5e.link_transform(5) @ hand_in_flange),
            quaternion=_quaternion(ur5e.link_transform(5) @ hand_in_flange),
            center_of_mass_m=(0.0, 0.0, FLANGE_HEIGHT_M - PALM_HALF_EXTENTS_MM[2] * M_PER_MM),
        )
        fingers, palm = finger_links(world, settings, ARM_HAND), palm_link(world, ARM_HAND)
        links = [*self._arm_links(), hand, *fingers, palm]
        self.body = create_body(world, links, BASE_POSITION_M)
        self.palm = len(links) - 1
        self.fingers = Fingers(world, self.body, ARM_HAND)
        for link, inertia in enumerate([*_arm_inertias(), _hand_inertia()]):
            world.bullet.changeDynamics(self.body, link, localInertiaDiagonal=inertia)
        self._step_s = settings.time_step_s
        self._joints_rad = ELBOW_UP_RAD

    def _arm_links(self) -> list[Link]:
        """Each link's frame turns with its joint; the published frames stand at its far end."""
        links = []
        for joint in ARM_JOINTS:
            before = np.eye(4) if joint == 0 else ur5e.link_transform(joint - 1)
            center = ur5e.link_transform(joint) @ [*ur5e.LINK_CENTER_OF_MASS_M[joint], 1.0]
            links.append(
                Link(
                    parent=joint - 1,
                    joint_type=self._world.bullet.JOINT_REVOLUTE,
                    mass_kg=ur5e.LINK_MASS_KG[joint],
                    position_m=_position(before),
                    quaternion=_quaternion(before),
                    center_of_mass_m=tuple(center[:3].tolist()),
                )
            )
        return links

    def place(self, target: GripperTarget) -> str:
        """Put the arm so that the gripper is at ``target``; a reason where it cannot reach."""
        joints = self._inverse(target, self._joints_rad)
        if joints is None:
            x_mm, y_mm, z_mm = (MM_PER_M * one for one in (target.x_m, target.y_m, target.z_m))
            place = f"x_mm = {x_mm:.0f}, y_mm = {y_mm:.0f}, z_mm = {z_mm:.0f}"
            return f"the arm does not reach {place}, yaw_rad = {target.yaw_rad:.2f}"
        self._joints_rad, self._target = joints, target
        for joint, angle in zip(ARM_JOINTS, joints.tolist(), strict=True):
            self._world.bullet.resetJointState(self.body, joint, angle, 0.0)
        return ""

    def _inverse(self, target: GripperTarget, seed_rad: FloatArray) -> FloatArray | None:
        gripper = pose(
            rotation_about_z(target.yaw_rad),
            np.array([target.x_m, target.y_m, target.z_m]) - BASE_POSITION_M,
        )
        return ur5e.inverse_kinematics(gripper @ FLANGE_IN_GRIPPER, seed_rad)

    def prepare_lift(self, lift_m: float) -> str:
        """Hold still, and lay out the joint angles of a straight lift."""
        count = int(np.ceil(lift_m * MM_PER_M / LIFT_KNOT_MM)) + 1
        heights_m = np.linspace(0.0, lift_m, max(count, 4))
        joints = [self._joints_rad]
        for height_m in heights_m[1:].tolist():
            higher = replace(self._target, z_m=self._target.z_m + height_m)
            following = self._inverse(higher, joints[-1])
            if following is None:
                return f"the arm cannot lift the object further than {height_m * MM_PER_M:.0f} mm"
            joints.append(following)
        from scipy.interpolate import CubicSpline  # slow to import; other robots do not need it

        self._path = CubicSpline(heights_m, np.stack(joints))
        self._path_slope = self._path.derivative()
        self.command_lift(0.0, 0.0)
        return ""

    def command_lift(self, height_m: float, speed_m_s: float) -> None:
        """Move along the path, each joint at the speed that brings it there in a step."""
        now_m = height_m - speed_m_s * self._step_s
        self._world.bullet.setJointMotorControlArray(
            self.body,
            ARM_JOINTS,
            self._world.bullet.POSITION_CONTROL,
            targetPositions=self._path(now_m).tolist(),
            targetVelocities=(self._path_slope(now_m) * speed_m_s).tolist(),
            positionGains=[POSITION_GAIN] * 6,
            velocityGains=[1.0] * 6,
            forces=ur5e.JOINT_TORQUE_LIMIT_N_M,
        )

    def gripper_position(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Position (m) and quaternion of the gripper frame in the world."""
        state = self._world.bullet.getLinkState(self.body, ARM_HAND, computeForwardKinematics=1)
        return state[4], state[5]


Robot: TypeAlias = FloatingGripper | ArmWithGripper
"""A body in the world that carries the gripper; a further one has the same methods."""
ROBOTS: dict[RobotName, type[Robot]] = {"wsg50": FloatingGripper, "ur5e_wsg50": ArmWithGripper}


def _position(matrix: Pose) -> tuple[float, float, float]:
    x, y, z = matrix[:3, 3].tolist()
    return x, y, z


def _quaternion(matrix: Pose) -> tuple[float, float, float, float]:
    x, y, z, w = quaternion_from_rotation(matrix[:3, :3]).tolist()
    return x, y, z, w


def _arm_inertias() -> list[tuple[float, float, float]]:
    """Principal moments (kg m²) of each link as a solid rod as long as the link."""
    moments = []
    for joint, mass_kg in enumerate(ur5e.LINK_MASS_KG):
        length_m = max(abs(ur5e.A_M[joint]), abs(ur5e.D_M[joint]))
        across = mass_kg * (3 * LINK_RADIUS_M**2 + length_m**2) / 12
        along = mass_kg * LINK_RADIUS_M**2 / 2
        lies_along_x = abs(ur5e.A_M[joint]) > abs(ur5e.D_M[joint])
        moments.append((along, across, across) if lies_along_x else (across, across, along))
    return moments


def _hand_inertia() -> tuple[float, float, float]:
    """Principal moments (kg m²) of the gripper's body as a solid box."""
    x, y, z = (2 * half * M_PER_MM for half in PALM_HALF_EXTENTS_MM)
    per_kg = HAND_MASS_KG / 12
    return per_kg * (y**2 + z**2), per_kg * (x**2 + z**2), per_kg * (x**2 + y**2)

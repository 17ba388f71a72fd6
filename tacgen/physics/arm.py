"""The UR5e with a WSG-50 on its flange, standing beside the object."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from tacgen.core.units import M_PER_MM, MM_PER_M
from tacgen.physics import ur5e
from tacgen.physics.frames import Pose, inverse, pose, quaternion_from_rotation, rotation_about_z
from tacgen.physics.gripper import (
    FINGER_LENGTH_MM,
    HAND_MASS_KG,
    PALM_HALF_EXTENTS_MM,
    Fingers,
    Link,
    create_body,
    finger_links,
    palm_link,
)
from tacgen.physics.robot import GripperTarget
from tacgen.physics.settings import PhysicsSettings
from tacgen.physics.world import World

BASE_POSITION_M = (-0.5, 0.0, 0.0)
FLANGE_HEIGHT_M = (FINGER_LENGTH_MM + 2 * PALM_HALF_EXTENTS_MM[2]) * M_PER_MM
"""Of the flange above the pads' centre."""
FLANGE_IN_GRIPPER = pose(np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, FLANGE_HEIGHT_M))
ELBOW_UP_RAD = np.array([0.2699, -1.6352, -1.9463, -1.1309, 1.5708, -1.3009])
"""Joint angles that hold the gripper, pointing down, 100 mm above the middle of the table."""
LINK_RADIUS_M = 0.05
"""Of the rods that stand in for the links' unpublished inertia."""
POSITION_GAIN = 0.2
LIFT_KNOT_MM = 10.0

_JOINTS = tuple(range(6))
_HAND = 6


class ArmWithGripper:
    """The robot with an arm; see ``robot.Robot``. The arm's own links collide with nothing."""

    def __init__(self) -> None:
        self.body = -1

    def build(self, world: World, settings: PhysicsSettings) -> None:
        """Make the arm and its gripper in an empty world."""
        self._world = world
        hand_in_flange = inverse(FLANGE_IN_GRIPPER)
        hand = Link(
            parent=_HAND - 1,
            joint_type=world.bullet.JOINT_FIXED,
            mass_kg=HAND_MASS_KG,
            position_m=_position(ur5e.link_transform(5) @ hand_in_flange),
            quaternion=_quaternion(ur5e.link_transform(5) @ hand_in_flange),
            center_of_mass_m=(0.0, 0.0, FLANGE_HEIGHT_M - PALM_HALF_EXTENTS_MM[2] * M_PER_MM),
        )
        links = [
            *self._arm_links(),
            hand,
            *finger_links(world, settings, _HAND),
            palm_link(world, _HAND),
        ]
        self.body = create_body(world, links, BASE_POSITION_M)
        self.palm = len(links) - 1
        self.fingers = Fingers(world, self.body, _HAND)
        for link, inertia in enumerate([*_arm_inertias(), _hand_inertia()]):
            world.bullet.changeDynamics(
                self.body, link, localInertiaDiagonal=inertia, physicsClientId=world.client
            )
        self._step_s = settings.time_step_s
        self._joints_rad = ELBOW_UP_RAD

    def _arm_links(self) -> list[Link]:
        """Each link's frame turns with its joint; the published frames stand at its far end."""
        links = []
        for joint in _JOINTS:
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
            return (
                f"the arm does not reach x_mm = {target.x_m * MM_PER_M:.0f}, "
                f"y_mm = {target.y_m * MM_PER_M:.0f}, z_mm = {target.z_m * MM_PER_M:.0f}, "
                f"yaw_rad = {target.yaw_rad:.2f}"
            )
        self._joints_rad, self._target = joints, target
        for joint, angle in zip(_JOINTS, joints.tolist(), strict=True):
            self._world.bullet.resetJointState(
                self.body, joint, angle, 0.0, physicsClientId=self._world.client
            )
        return ""

    def _inverse(
        self, target: GripperTarget, seed_rad: NDArray[np.float64]
    ) -> NDArray[np.float64] | None:
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
            target = GripperTarget(
                self._target.x_m,
                self._target.y_m,
                self._target.z_m + height_m,
                self._target.yaw_rad,
            )
            following = self._inverse(target, joints[-1])
            if following is None:
                return f"the arm cannot lift the object further than {height_m * MM_PER_M:.0f} mm"
            joints.append(following)
        self._path = CubicSpline(heights_m, np.stack(joints))
        self._path_slope = self._path.derivative()
        self.command_lift(0.0, 0.0)
        return ""

    def command_lift(self, height_m: float, speed_m_s: float) -> None:
        """Move along the path, each joint at the speed that brings it there in a step."""
        now_m = height_m - speed_m_s * self._step_s
        self._world.bullet.setJointMotorControlArray(
            self.body,
            _JOINTS,
            self._world.bullet.POSITION_CONTROL,
            targetPositions=self._path(now_m).tolist(),
            targetVelocities=(self._path_slope(now_m) * speed_m_s).tolist(),
            positionGains=[POSITION_GAIN] * 6,
            velocityGains=[1.0] * 6,
            forces=ur5e.JOINT_TORQUE_LIMIT_N_M,
            physicsClientId=self._world.client,
        )

    def gripper_position(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Position (m) and quaternion of the gripper frame in the world."""
        state = self._world.bullet.getLinkState(
            self.body, _HAND, computeForwardKinematics=1, physicsClientId=self._world.client
        )
        return state[4], state[5]


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

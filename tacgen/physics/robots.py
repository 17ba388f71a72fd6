"""The robots that carry a gripper: none, which floats, and a UR5e. The same for every engine."""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tacgen.core.errors import PhysicsError, RecipeError
from tacgen.core.resources import gripper_path
from tacgen.core.types import M_PER_MM, MM_PER_M, FloatArray, Pose, inverse, pose, rotation_about_z
from tacgen.physics import ur5e
from tacgen.physics.engine import Fingers, GripperTarget, Joints, Link, Place, Robot, Vector
from tacgen.physics.gripper import GripperSpec, load_gripper
from tacgen.physics.settings import PhysicsSettings

AXIS_FORCE_N = 2000.0
"""Force of the floating gripper's vertical axis: far more than any grasp, so that it follows."""
BASE_POSITION_M = (-0.5, 0.0, 0.0)  # of the arm: the object is well within its reach of 850 mm
UPRIGHT = (0.0, 0.0, 0.0, 1.0)  # the quaternion of no rotation
ELBOW_UP_RAD = np.array([0.2699, -1.6352, -1.9463, -1.1309, 1.5708, -1.3009])
"""Joint angles that hold the gripper, pointing down, 100 mm above the middle of the table."""
LINK_RADIUS_M = 0.05  # of the rods in place of the links, whose inertia is not published
POSITION_GAIN = 0.2
"""Share of a joint's position error that a step corrects; PyBullet's own default is 0.1."""
LIFT_KNOT_MM = 10.0  # between solved joint angles of the lift: a spline goes through them


class FloatingGripper:
    """The gripper alone, on a vertical axis: the fast robot; every place can be reached."""

    def __init__(
        self, gripper: GripperSpec, settings: PhysicsSettings, joints: Joints, fingers: Fingers
    ) -> None:
        self._joints, self.fingers = joints, fingers
        self._step_s = settings.time_step_s

    @staticmethod
    def links(gripper: GripperSpec) -> list[Link]:
        """The hand alone; the axis follows so closely that heights need no correction."""
        moments = _box_moments(gripper)
        place = np.eye(4), gripper.hand.mass_kg, (0.0, 0.0, 0.0), moments
        return [Link("slide", *place, force_limit=AXIS_FORCE_N)]

    def place(self, target: GripperTarget) -> str:
        """Put the gripper at ``target``, at rest."""
        self._quaternion = (0.0, 0.0, math.sin(target.yaw_rad / 2), math.cos(target.yaw_rad / 2))
        self._base, self._z_m = (target.x_m, target.y_m, 0.0), target.z_m
        self._joints.place((self._base, self._quaternion), [target.z_m])
        return ""

    def prepare_lift(self, lift_m: float) -> str:
        """Hold the present height from now on."""
        self.command_lift(0.0, 0.0)
        return ""

    def command_lift(self, height_m: float, speed_m_s: float) -> None:
        """Move up at ``speed_m_s``."""
        self._joints.drive([self._z_m + height_m - speed_m_s * self._step_s], [speed_m_s])

    def gripper_position(self) -> Place:
        """The gripper frame."""
        return (*self._base[:2], *self._joints.positions()), self._quaternion


class ArmWithGripper:
    """The gripper on the flange of a UR5e, whose own links collide with nothing."""

    def __init__(
        self, gripper: GripperSpec, settings: PhysicsSettings, joints: Joints, fingers: Fingers
    ) -> None:
        self._joints, self.fingers = joints, fingers
        self._step_s = settings.time_step_s
        self._flange_in_gripper = _flange_in_gripper(gripper)
        self._joints_rad = ELBOW_UP_RAD

    @staticmethod
    def links(gripper: GripperSpec) -> list[Link]:
        """Each link's frame turns with its joint; the published frames stand at its far end."""
        links = []
        for joint in range(6):
            before = np.eye(4) if joint == 0 else ur5e.link_transform(joint - 1)
            center = ur5e.link_transform(joint) @ [*ur5e.LINK_CENTER_OF_MASS_M[joint], 1.0]
            links.append(
                Link(
                    "hinge",
                    before,
                    ur5e.LINK_MASS_KG[joint],
                    tuple(center[:3].tolist()),
                    _rod_moments(joint),
                    position_gain=POSITION_GAIN,
                    force_limit=ur5e.JOINT_TORQUE_LIMIT_N_M[joint],
                )
            )
        hand = ur5e.link_transform(5) @ inverse(_flange_in_gripper(gripper))
        center_m = tuple(mm * M_PER_MM for mm in gripper.hand.box.center_mm)
        links.append(Link("fixed", hand, gripper.hand.mass_kg, center_m, _box_moments(gripper)))
        return links

    def place(self, target: GripperTarget) -> str:
        """Put the arm so that the gripper is at ``target``; a reason where it cannot reach."""
        joints = self._inverse(target, self._joints_rad)
        if joints is None:
            x_mm, y_mm, z_mm = (MM_PER_M * one for one in (target.x_m, target.y_m, target.z_m))
            place = f"x_mm = {x_mm:.0f}, y_mm = {y_mm:.0f}, z_mm = {z_mm:.0f}"
            return f"the arm does not reach {place}, yaw_rad = {target.yaw_rad:.2f}"
        self._joints_rad, self._target = joints, target
        self._joints.place((BASE_POSITION_M, UPRIGHT), joints.tolist())
        return ""

    def _inverse(self, target: GripperTarget, seed_rad: FloatArray) -> FloatArray | None:
        gripper = pose(
            rotation_about_z(target.yaw_rad),
            np.array([target.x_m, target.y_m, target.z_m]) - BASE_POSITION_M,
        )
        return ur5e.inverse_kinematics(gripper @ self._flange_in_gripper, seed_rad)

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
        speeds = (self._path_slope(now_m) * speed_m_s).tolist()
        self._joints.drive(self._path(now_m).tolist(), speeds)

    def gripper_position(self) -> Place:
        """The gripper frame."""
        return self._joints.hand()


_ROBOTS: dict[str, type[FloatingGripper | ArmWithGripper]] = {
    "ur5e_": ArmWithGripper,
    "": FloatingGripper,
}
"""By what stands before the gripper's name in the robot's; the empty one comes last."""


@dataclass(frozen=True, slots=True)
class RobotSpec:
    """A gripper and what carries it."""

    kind: type[FloatingGripper | ArmWithGripper]
    gripper: GripperSpec

    def links(self) -> list[Link]:
        """The links that carry the hand, which is the last."""
        return self.kind.links(self.gripper)

    def mounted(self, settings: PhysicsSettings, joints: Joints, fingers: Fingers) -> Robot:
        """The robot with the joints and fingers that an engine has built."""
        return self.kind(self.gripper, settings, joints, fingers)


def load_robot(name: str, *, beside: Path | None = None) -> RobotSpec:
    """The robot ``name``: that of a gripper, which floats, or ``ur5e_`` and that of a gripper.

    A gripper's file may also lie in the folder ``beside``.

    Raises ``PhysicsError`` if there is no such gripper, ``RecipeError`` if its file is wrong.
    """
    return RobotSpec(_ROBOTS[_prefix(name)], load_gripper(gripper_file(name, beside=beside)))


def gripper_file(name: str, *, beside: Path | None = None) -> Path:
    """The YAML file of the gripper of the robot ``name``; raises as ``load_robot`` does."""
    try:
        return gripper_path(name.removeprefix(_prefix(name)), beside=beside)
    except RecipeError as error:
        msg = f"robot {name!r} is not known: {error}, after `ur5e_` where the arm carries it"
        raise PhysicsError(msg) from None


def _prefix(name: str) -> str:
    return next(prefix for prefix in _ROBOTS if name.startswith(prefix))


def _flange_in_gripper(gripper: GripperSpec) -> Pose:
    height_m = gripper.hand.flange_height_mm * M_PER_MM
    return pose(np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, height_m))


def _rod_moments(joint: int) -> Vector:
    """Principal moments (kg m²) of a link as a solid rod as long as the link."""
    mass_kg = ur5e.LINK_MASS_KG[joint]
    length_m = max(abs(ur5e.A_M[joint]), abs(ur5e.D_M[joint]))
    across = mass_kg * (3 * LINK_RADIUS_M**2 + length_m**2) / 12
    along = mass_kg * LINK_RADIUS_M**2 / 2
    lies_along_x = abs(ur5e.A_M[joint]) > abs(ur5e.D_M[joint])
    return (along, across, across) if lies_along_x else (across, across, along)


def _box_moments(gripper: GripperSpec) -> Vector:
    """Principal moments (kg m²) of the hand as a solid box."""
    x, y, z = (mm * M_PER_MM for mm in gripper.hand.box.size_mm)
    per_kg = gripper.hand.mass_kg / 12
    return per_kg * (y**2 + z**2), per_kg * (x**2 + z**2), per_kg * (x**2 + y**2)

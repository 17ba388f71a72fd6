"""The floating WSG-50: a gripper on a vertical axis that nothing can push aside."""

from __future__ import annotations

import math

from tacgen.physics.gripper import (
    HAND_MASS_KG,
    Fingers,
    Link,
    create_body,
    finger_links,
    palm_link,
)
from tacgen.physics.robot import GripperTarget
from tacgen.physics.settings import PhysicsSettings
from tacgen.physics.world import World

AXIS_FORCE_N = 2000.0
"""Of the vertical axis: far more than any grasp asks for, so that it follows its command."""
SAME_SPEED_M_S = 1e-9

_HAND = 0


class FloatingGripper:
    """The fast robot; see ``robot.Robot``."""

    def __init__(self) -> None:
        self.body = -1

    def build(self, world: World, settings: PhysicsSettings) -> None:
        """Make the gripper in an empty world."""
        self._world = world
        hand = Link(-1, world.bullet.JOINT_PRISMATIC, HAND_MASS_KG)
        links = [hand, *finger_links(world, settings, _HAND), palm_link(world, _HAND)]
        self.body = create_body(world, links, (0.0, 0.0, 0.0))
        self.palm = len(links) - 1
        self.fingers = Fingers(world, self.body, _HAND)

    def place(self, target: GripperTarget) -> str:
        """Put the gripper at ``target``; every place can be reached."""
        bullet, client = self._world.bullet, self._world.client
        self._base = (target.x_m, target.y_m, 0.0)
        self._quaternion = (0.0, 0.0, math.sin(target.yaw_rad / 2), math.cos(target.yaw_rad / 2))
        bullet.resetBasePositionAndOrientation(
            self.body, self._base, self._quaternion, physicsClientId=client
        )
        bullet.resetJointState(self.body, _HAND, target.z_m, 0.0, physicsClientId=client)
        return ""

    def prepare_lift(self, lift_m: float) -> str:
        """Hold the present height."""
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
            _HAND,
            self._world.bullet.VELOCITY_CONTROL,
            targetVelocity=speed_m_s,
            force=AXIS_FORCE_N,
            physicsClientId=self._world.client,
        )

    def gripper_position(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Position (m) and quaternion of the gripper frame in the world."""
        height_m = self._world.bullet.getJointState(
            self.body, _HAND, physicsClientId=self._world.client
        )[0]
        return (self._base[0], self._base[1], height_m), self._quaternion

"""What a grasp asks of a robot, whatever carries the gripper."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from tacgen.physics.gripper import Fingers
from tacgen.physics.settings import PhysicsSettings
from tacgen.physics.world import World


@dataclass(frozen=True, slots=True)
class GripperTarget:
    """Where the gripper frame shall be: pointing down, turned by ``yaw_rad`` about z."""

    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float


class Robot(Protocol):
    """A body in the world that carries the gripper."""

    body: int
    palm: int
    fingers: Fingers

    def build(self, world: World, settings: PhysicsSettings) -> None:
        """Make the robot in an empty world."""

    def place(self, target: GripperTarget) -> str:
        """Put the gripper at ``target`` at rest; a reason where the robot cannot reach it."""

    def prepare_lift(self, lift_m: float) -> str:
        """Hold the present place from now on; a reason where it cannot rise by ``lift_m``."""

    def command_lift(self, height_m: float, speed_m_s: float) -> None:
        """Be ``height_m`` above the prepared place at the next step, moving up at ``speed_m_s``."""

    def gripper_position(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Position (m) and quaternion (x, y, z, w) of the gripper frame in the world."""

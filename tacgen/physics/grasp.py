"""One grasp, from placing the gripper to the label."""

from __future__ import annotations

from types import TracebackType

from tacgen.errors import PhysicsError
from tacgen.physics.settings import FrameRequest, PhysicsSettings, RobotName
from tacgen.records import GraspConfig, GraspObject, GraspTrace


class GraspSimulator:
    """A PyBullet world with a robot in it; use it as a context manager.

    A grasp's trace depends on its arguments alone, not on the grasps before it.
    """

    def __init__(self, robot: RobotName = "wsg50") -> None:
        self.robot = robot

    def __enter__(self) -> GraspSimulator:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        return None


def run_grasp(
    simulator: GraspSimulator,
    obj: GraspObject,
    config: GraspConfig,
    settings: PhysicsSettings,
    *,
    frames: FrameRequest,
) -> GraspTrace:
    """Simulate one grasp of ``obj`` as ``config`` asks; frames in the gel frame (mm, N).

    Raises
    ------
    PhysicsError
        If the configuration is outside what the gripper can be asked for.
    """
    msg = "the simulation of grasps is not built yet"
    raise PhysicsError(msg)

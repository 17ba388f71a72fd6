"""PyBullet as an engine of grasps."""

from collections.abc import Sequence

from tacgen.core.records import GraspObject, Mesh
from tacgen.physics.bodies import ObjectBody
from tacgen.physics.robots import ROBOTS, Robot
from tacgen.physics.settings import PhysicsSettings, RobotName
from tacgen.physics.world import World


class Engine(World):
    """A world with one kind of robot.

    Another engine has the methods that the modules of a grasp (``approach``, ``grasp``,
    ``recorder``) call of it and of the two things that it builds.
    """

    def __init__(self, robot: RobotName) -> None:
        super().__init__()
        self._robot = ROBOTS[robot]

    def build(
        self,
        obj: GraspObject,
        settings: PhysicsSettings,
        force_n: float,
        met: Sequence[Mesh] | None = None,
    ) -> tuple[ObjectBody, Robot]:
        """Empty the world, then add the table, the object in its rest pose and the robot.

        The pads can touch ``met`` of the object alone, else the whole object.
        """
        self.rebuild(settings, settings.iterations_for(force_n, obj.mass_kg))
        body, robot = ObjectBody(self, obj, met), self._robot(self, settings)
        robot.fingers.set_surface(settings, obj.friction)
        return body, robot

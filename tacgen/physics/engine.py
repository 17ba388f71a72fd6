"""What a grasp asks of a physics engine and a robot. Metres, newtons, quaternions x, y, z, w."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol, TypeAlias

from tacgen.core.engine_contacts import ContactPoint
from tacgen.core.records import GraspObject, Mesh
from tacgen.core.types import FloatArray, Pose
from tacgen.physics.settings import PhysicsSettings

Vector: TypeAlias = tuple[float, ...]
Place: TypeAlias = tuple[Vector, Vector]
"""Position and quaternion of a frame in the world; or a linear and an angular velocity."""

TABLE, PALM = "table", "palm"
"""What can touch the object beside the pads, which have their own names, and the fingers."""


class Touch(NamedTuple):
    """Where a part of the object is nearest to a pad, in world axes.

    ``normal`` points into the object; ``gap_m`` is negative where they overlap.
    """

    point_m: Vector
    normal: Vector
    gap_m: float


@dataclass(frozen=True, slots=True)
class Link:
    """A body that carries the next one, the last being the hand; only the hand can touch anything.

    ``frame`` stands in that of the link before, the first in the robot's base; the joint slides
    along its z or turns about it. ``moments_kg_m2`` are about the frame's axes, through the centre
    of mass. Each step a driven joint corrects the share ``position_gain`` of its position's error,
    with ``force_limit`` (N or N m) at most where the engine knows such a limit.
    """

    joint: Literal["slide", "hinge", "fixed"]
    frame: Pose
    mass_kg: float
    center_of_mass_m: Vector
    moments_kg_m2: Vector
    position_gain: float = 0.0
    force_limit: float = 0.0


class Body(Protocol):
    """The object in the world, standing in its rest pose to begin with.

    ``inertial`` is the frame of its principal axes at its centre of mass, in its own frame.
    """

    principal_moments_kg_m2: FloatArray
    inertial: Pose

    def inertial_position(self) -> Place:
        """The centre of mass and the principal axes."""

    def velocity(self) -> Place:
        """Linear velocity (m/s) of the centre of mass and angular velocity (rad/s), world axes."""

    def keep_place(self) -> None:
        """Stand at rest where it was to begin with, however it has come to rest on the table."""


class Joints(Protocol):
    """The joints of the links that carry the hand."""

    def place(self, base: Place, positions: Sequence[float]) -> None:
        """Put the robot's base and its joints there, at rest."""

    def drive(self, positions: Sequence[float], speeds: Sequence[float]) -> None:
        """Move at ``speeds`` from now on; ``positions`` are where the joints now should be."""

    def positions(self) -> Vector:
        """Where the joints are."""

    def hand(self) -> Place:
        """The gripper frame."""


class Fingers(Protocol):
    """The gripper's two fingers; positions count from the full opening towards the middle.

    Each is driven by a motor of its own until the lift, so that both pads press with the
    commanded force even where the table would take up a difference; then the jaws are coupled,
    as a parallel gripper's are, so that the grasp cannot drift sideways.
    """

    def place(self, travel_m: float) -> None:
        """Put both fingers ``travel_m`` in from the full opening, at rest."""

    def drive(self, speed_m_s: float, force_n: float) -> None:
        """Close at ``speed_m_s``, pressing with ``force_n`` at most."""

    def set_spinning_friction(
        self, spinning_friction_m: Mapping[str, float], friction_share: float
    ) -> None:
        """Moment about its normal that each pad resists for each newton of force.

        That is beside ``friction_share`` of its friction, which a tangential force takes up.
        """

    def couple(self) -> None:
        """From now on the fingers move by equal amounts, about where they are."""

    def travel_m(self) -> tuple[float, float]:
        """How far the left and the right finger are in from the full opening."""


class Robot(Protocol):
    """What carries the gripper."""

    fingers: Fingers

    def place(self, target: "GripperTarget") -> str:
        """Put the gripper at ``target``, at rest; a reason where the robot cannot reach it."""

    def prepare_lift(self, lift_m: float) -> str:
        """Hold still, and prepare to rise by ``lift_m``; a reason where the robot cannot."""

    def command_lift(self, height_m: float, speed_m_s: float) -> None:
        """Move up at ``speed_m_s``, to be at ``height_m`` above the grasp after a step."""

    def gripper_position(self) -> Place:
        """The gripper frame."""


@dataclass(frozen=True, slots=True)
class GripperTarget:
    """Where the gripper frame shall be: pointing down, turned by ``yaw_rad`` about z."""

    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float


class Engine(Protocol):
    """A physics engine with one kind of robot; a context manager.

    A world is built anew for every grasp, so that grasps are independent.
    """

    def __enter__(self) -> "Engine": ...

    def __exit__(self, *raised: object) -> None: ...

    def build(
        self,
        obj: GraspObject,
        settings: PhysicsSettings,
        force_n: float,
        met: Sequence[Mesh] | None = None,
    ) -> tuple[Body, Robot]:
        """An empty world with the table, the object in its rest pose and the robot.

        The gripper can touch the convex ``met`` of the object alone, else all its parts; on the
        way to the grasp the whole object counts.
        """

    def step(self, count: int) -> None:
        """Advance by ``count`` time steps."""

    def contacts(self) -> list[ContactPoint[str]]:
        """All contact points of the last step on the object, by the name of what touches it."""

    def distances(self, limit_m: float) -> list[tuple[str, float]]:
        """Parts of the gripper and how near they are to the object, within ``limit_m``.

        That is how far they are from pressing; of the pads their outlines, not the spheres by which
        they touch.
        """

    def touches(self, pad: str, limit_m: float) -> list[Touch]:
        """Where what a pad can touch of the object is nearest to it, within ``limit_m``.

        Between their own surfaces, whatever compliance lets them overlap.
        """

"""PyBullet as an engine of grasps."""

from collections.abc import Mapping, Sequence

from tacgen.core.engine_contacts import ContactPoint, bullet_points
from tacgen.core.records import PADS, GraspObject, Mesh
from tacgen.core.types import M_PER_MM, FloatArray, quaternion_from_rotation
from tacgen.physics import engine
from tacgen.physics.engine import PALM, TABLE, Link, Place, Touch, Vector
from tacgen.physics.gripper import GripperSpec, outline_of, touches_as_sphere
from tacgen.physics.robots import RobotSpec
from tacgen.physics.settings import PhysicsSettings
from tacgen.physics.standing import NEAR_TABLE_M
from tacgen.physics.world import (
    HULL_MARGIN_MM,
    BulletLink,
    Collides,
    ObjectBody,
    World,
    link_arguments,
)

SAME_SPEED = 1e-9
"""Commands this close are one: a float's rounding along the lift's constant part."""


class BulletEngine(World):
    """PyBullet with one kind of robot."""

    def __init__(self, robot: RobotSpec) -> None:
        super().__init__()
        self._robot = robot
        self._object = self._body = -1
        self._parts: dict[tuple[int, int], str] = {}
        self._links: dict[str, int] = {}

    def build(
        self,
        obj: GraspObject,
        settings: PhysicsSettings,
        force_n: float,
        met: Sequence[Mesh] | None = None,
    ) -> tuple[ObjectBody, engine.Robot]:
        """Empty the world, then add the table, the object in its rest pose and the robot."""
        self.rebuild(settings, settings.iterations_for(force_n, obj.mass_kg))
        body, gripper, carrying = (
            ObjectBody(self, obj, met),
            self._robot.gripper,
            self._robot.links(),
        )
        hand = len(carrying) - 1
        finger, names = finger_links(self, gripper, settings, hand)
        links = [*self._carrying(carrying), *finger, palm_link(self, gripper, hand)]
        robot = int(self.bullet.createMultiBody(0.0, **link_arguments(links)))
        for number in range(-1, len(links)):
            self.set_surface(robot, number, friction=0.0)
            self.collide(robot, number, Collides.GRIPPER)
        for number, link in enumerate(carrying):
            self.bullet.changeDynamics(robot, number, localInertiaDiagonal=link.moments_kg_m2)
        self._object, self._body = body.body, robot
        self._parts = {(robot, hand + 1 + k): name for k, name in enumerate([*names, PALM])}
        self._links = {name: link for (_, link), name in self._parts.items()}
        for pad in PADS:
            self.collide(robot, self._links[outline_of(pad)], Collides.NOTHING)
        fingers = Fingers(self, robot, self._links)
        fingers.set_surface(settings, obj.friction)
        return body, self._robot.mounted(settings, Joints(self, robot, carrying), fingers)

    def _carrying(self, links: Sequence[Link]) -> list[BulletLink]:
        bullet = self.bullet
        kinds = {
            "slide": bullet.JOINT_PRISMATIC,
            "hinge": bullet.JOINT_REVOLUTE,
            "fixed": bullet.JOINT_FIXED,
        }
        return [
            BulletLink(
                parent=number - 1,
                joint_type=kinds[link.joint],
                mass_kg=link.mass_kg,
                position_m=tuple(link.frame[:3, 3].tolist()),
                quaternion=tuple(quaternion_from_rotation(link.frame[:3, :3]).tolist()),
                center_of_mass_m=link.center_of_mass_m,
            )
            for number, link in enumerate(links)
        ]

    def contacts(self) -> list[ContactPoint[str]]:
        """All contact points of the last step on the object, by the name of what touches it."""
        parts, touched = self._parts, self._object
        return bullet_points(
            self.bullet.getContactPoints(),
            lambda one, other: parts.get(other, TABLE) if one[0] == touched else None,
            near_m=NEAR_TABLE_M,
        )

    def distances(self, limit_m: float) -> list[tuple[str, float]]:
        """Parts of the gripper and how near they are to the object, within ``limit_m``."""
        # Link 0 is its hull on the table, link 1 the whole object where the base is a part of it.
        link = 1 if self.bullet.getNumJoints(self._object) == 2 else -1
        margin_m = HULL_MARGIN_MM * M_PER_MM if link == 1 else 0.0
        points = self.bullet.getClosestPoints(
            self._body, self._object, limit_m - margin_m, linkIndexB=link
        )
        found = [(self._parts[self._body, point[3]], point[8] + margin_m) for point in points]
        return [one for one in found if one[0] not in PADS]

    def touches(self, pad: str, limit_m: float) -> list[Touch]:
        """Where what a pad can touch of the object is nearest to it, within ``limit_m``.

        Anew, whereas a contact point that is kept has the normal with which it was found.
        """
        points = self.bullet.getClosestPoints(
            self._body, self._object, limit_m, linkIndexA=self._links[pad], linkIndexB=-1
        )
        return [Touch(point[6], tuple(-one for one in point[7]), point[8]) for point in points]


def finger_links(
    world: World, gripper: GripperSpec, settings: PhysicsSettings, hand: int
) -> tuple[list[BulletLink], list[str]]:
    """The fingers and their boxes, and their names, to be added right after the link ``hand``.

    The boxes and the pad's outline follow their finger: PyBullet numbers links depth first,
    whatever it is given.
    """
    links: list[BulletLink] = []
    names: list[str] = []
    radius_mm, create_shape = settings.pad_dome_radius_mm, world.bullet.createCollisionShape
    for pad in PADS:
        side, finger = gripper.side(pad).side, hand + 1 + len(links)
        vertices_m = gripper.pad_vertices_m(pad, radius_mm)
        outline = create_shape(world.bullet.GEOM_MESH, vertices=vertices_m)
        shape = _dome(world, side, radius_mm) if touches_as_sphere(radius_mm) else outline
        links.append(
            BulletLink(
                parent=hand,
                joint_type=world.bullet.JOINT_PRISMATIC,
                mass_kg=gripper.finger.mass_kg,
                shape=shape,
                position_m=(side * gripper.stroke_mm / 2 * M_PER_MM, 0.0, 0.0),
                axis=(-side, 0.0, 0.0),
            )
        )
        boxes = gripper.finger_boxes_mm(pad)
        links += [_box(world, finger, *box) for box in boxes]
        links.append(BulletLink(finger, world.bullet.JOINT_FIXED, shape=outline))
        names += [pad, *(f"{pad} finger {number}" for number in range(len(boxes)))]
        names.append(outline_of(pad))
    return links, names


def palm_link(world: World, gripper: GripperSpec, hand: int) -> BulletLink:
    """The body of the gripper above the fingers, fixed to the link ``hand``."""
    return _box(world, hand, *gripper.hand.box.half_and_center_mm)


def _dome(world: World, side: int, radius_mm: float) -> int:
    radius_m, center_m = radius_mm * M_PER_MM, (side * radius_mm * M_PER_MM, 0.0, 0.0)
    sphere = world.bullet.GEOM_SPHERE
    shape = world.bullet.createCollisionShape(
        sphere, radius=radius_m, collisionFramePosition=center_m
    )
    return int(shape)


def _box(
    world: World, parent: int, half_extents_mm: FloatArray, center_mm: FloatArray
) -> BulletLink:
    bullet = world.bullet
    half_extents_m = (half_extents_mm * M_PER_MM).tolist()
    return BulletLink(
        parent=parent,
        joint_type=bullet.JOINT_FIXED,
        shape=int(bullet.createCollisionShape(bullet.GEOM_BOX, halfExtents=half_extents_m)),
        position_m=tuple((center_mm * M_PER_MM).tolist()),
    )


class Joints:
    """The joints of the links that carry the hand."""

    def __init__(self, world: World, body: int, links: Sequence[Link]) -> None:
        self._world, self._body, self._hand = world, body, len(links) - 1
        driven = [link for link in links if link.joint != "fixed"]
        self._numbers = tuple(range(len(driven)))
        self._gains = [link.position_gain for link in driven]
        self._limits = [link.force_limit for link in driven]
        self._speeds: Sequence[float] | None = None

    def place(self, base: Place, positions: Sequence[float]) -> None:
        """Put the robot's base and its joints there, at rest."""
        self._world.bullet.resetBasePositionAndOrientation(self._body, *base)
        for number, position in zip(self._numbers, positions, strict=True):
            self._world.bullet.resetJointState(self._body, number, position, 0.0)

    def drive(self, positions: Sequence[float], speeds: Sequence[float]) -> None:
        """Move at ``speeds`` from now on; ``positions`` are where the joints now should be."""
        if not any(self._gains) and self._speeds is not None:
            pairs = zip(speeds, self._speeds, strict=True)
            if all(abs(speed - before) < SAME_SPEED for speed, before in pairs):
                return
        self._speeds = speeds
        self._world.bullet.setJointMotorControlArray(
            self._body,
            self._numbers,
            self._world.bullet.POSITION_CONTROL,
            targetPositions=positions,
            targetVelocities=speeds,
            positionGains=self._gains,
            velocityGains=[1.0] * len(self._numbers),
            forces=self._limits,
        )

    def positions(self) -> Vector:
        """Where the joints are."""
        state = self._world.bullet.getJointState
        return tuple(state(self._body, number)[0] for number in self._numbers)

    def hand(self) -> Place:
        """The gripper frame."""
        bullet = self._world.bullet
        state = bullet.getLinkState(self._body, self._hand, computeForwardKinematics=1)
        return state[4], state[5]


class Fingers:
    """The two fingers, whose pads are the ``links`` of their names."""

    COUPLING_FORCE_N = 1000.0
    """Far above any pad's force, so that the jaws move as one."""

    def __init__(self, world: World, body: int, links: Mapping[str, int]) -> None:
        self._world = world
        self._body = body
        self._links = {pad: links[pad] for pad in PADS}

    def set_surface(self, settings: PhysicsSettings, friction: float) -> None:
        """Friction and compliance of the pads against an object whose own friction is 1."""
        for link in self._links.values():
            self._world.set_surface(self._body, link, friction=friction * settings.pad_friction)
            if settings.pad_stiffness_n_mm > 0:
                self._world.bullet.changeDynamics(
                    self._body,
                    link,
                    contactStiffness=settings.pad_stiffness_n_mm / M_PER_MM,
                    contactDamping=settings.pad_damping_n_s_mm / M_PER_MM,
                )

    def set_spinning_friction(
        self, spinning_friction_m: Mapping[str, float], friction_share: float
    ) -> None:
        """Moment about its normal that each pad resists, for each newton of force.

        A touch that Bullet keeps but does not find again in a step would hold the coefficients of
        its first moment, so the pads' touches are found anew.
        """
        for pad, link in self._links.items():
            self._world.bullet.changeDynamics(
                self._body, link, spinningFriction=spinning_friction_m[pad]
            )
            self._world.collide(self._body, link, Collides.GRIPPER)  # also drops its touches

    def place(self, travel_m: float) -> None:
        """Put both fingers ``travel_m`` in from the full opening, at rest."""
        for link in self._links.values():
            self._world.bullet.resetJointState(self._body, link, travel_m, 0.0)

    def drive(self, speed_m_s: float, force_n: float) -> None:
        """Close at ``speed_m_s``, pressing with ``force_n`` at most."""
        for link in self._links.values():
            self._world.bullet.setJointMotorControl2(
                self._body,
                link,
                self._world.bullet.VELOCITY_CONTROL,
                targetVelocity=speed_m_s,
                force=force_n,
            )

    def couple(self) -> None:
        """From now on the fingers move by equal amounts, about where they are."""
        bullet = self._world.bullet
        left_m, right_m = self.travel_m()
        left, right = self._links.values()
        gear = bullet.createConstraint(
            self._body,
            left,
            self._body,
            right,
            bullet.JOINT_GEAR,
            (1.0, 0.0, 0.0),
            (0.0, 0.0, 0.0),
            (0.0, 0.0, 0.0),
        )
        bullet.changeConstraint(
            gear,
            gearRatio=-1.0,
            maxForce=self.COUPLING_FORCE_N,
            relativePositionTarget=left_m - right_m,
            erp=0.2,
        )

    def travel_m(self) -> tuple[float, float]:
        """How far the left and the right finger are in from the full opening."""
        state = self._world.bullet.getJointState
        left, right = (state(self._body, link)[0] for link in self._links.values())
        return left, right

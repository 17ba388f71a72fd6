"""The WSG-50 with gel pads: its geometry, and the fingers that both robots share.

The hand's link frame is the gripper frame (``frames.py``). Finger positions count from the full
opening towards the middle. Bullet's lengths are metres.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np

from tacgen.core.units import M_PER_MM
from tacgen.physics.frames import PAD_SIDE
from tacgen.physics.settings import PAD_DEPTH_MM, PAD_NAMES, PhysicsSettings
from tacgen.physics.world import HULL_MARGIN_MM, Collides, Link, World, link_arguments

STROKE_MM = 110.0  # largest opening. Source: Weiss Robotics, WSG 50 data sheet
HAND_MASS_KG = 1.2  # Source: Weiss Robotics, WSG 50 data sheet
FINGER_MASS_KG = 0.15  # a finger with its sensor; assumed

PAD_WIDTH_MM, PAD_HEIGHT_MM = 24.0, 19.0
"""A GelSight's window of 18.9 × 14.2 mm (640 × 480 at 0.0295 mm/px) and 2.5 mm around it."""
PAD_PITCH_MM = 2.0  # of the vertices on the dome: chords of a 30 mm dome lie 17 µm inside it
LARGEST_SPHERE_MM = 60.0
"""A pad of this dome radius or less touches as a sphere: a face that is tilted by 0.15 rad or less
then meets it on the pad. A flatter one is a hull, whose facets are off by 0.02 rad or less."""
FINGER_THICKNESS_MM = 12.0  # assumed
FINGER_LENGTH_MM = 150.0
"""From the pad's centre to the palm; assumed, so that tall objects can be held low."""
STEM_HEIGHT_MM = FINGER_LENGTH_MM + PAD_HEIGHT_MM / 2
STEM_HALF_EXTENTS_MM = (FINGER_THICKNESS_MM / 2, PAD_WIDTH_MM / 2 - 1.0, STEM_HEIGHT_MM / 2)
STEM_CENTER_MM = (PAD_DEPTH_MM + FINGER_THICKNESS_MM / 2, 0.0, (STEM_HEIGHT_MM - PAD_HEIGHT_MM) / 2)
"""Of the finger behind the right pad, from the dome's top."""
PALM_HALF_EXTENTS_MM = (73.0, 25.0, 35.0)  # of the gripper's housing; assumed


@lru_cache(maxsize=8)
def pad_vertices_m(side: float, dome_radius_mm: float) -> tuple[tuple[float, float, float], ...]:
    """Vertices of the convex pad whose dome's top is at the origin and looks away from ``side``.

    They lie ``HULL_MARGIN_MM`` inside it, where Bullet's margin puts its surface. Made once,
    because PyBullet never releases the sequence of vertices that it is given.
    """
    half_y, half_z = PAD_WIDTH_MM / 2 - HULL_MARGIN_MM, PAD_HEIGHT_MM / 2 - HULL_MARGIN_MM
    y, z = np.meshgrid(_symmetric_range(half_y), _symmetric_range(half_z), indexing="ij")
    drop = dome_radius_mm - np.sqrt((dome_radius_mm - HULL_MARGIN_MM) ** 2 - y**2 - z**2)
    front = np.stack([side * drop, y, z], axis=-1).reshape(-1, 3)
    back = side * (PAD_DEPTH_MM - HULL_MARGIN_MM)
    rim = np.array([[back, y, z] for y in (-half_y, half_y) for z in (-half_z, half_z)])
    vertices = np.concatenate([front, rim]) * M_PER_MM
    return tuple((x, y, z) for x, y, z in vertices.tolist())


def touches_as_sphere(settings: PhysicsSettings) -> bool:
    """Whether the pads' domes are spheres, which reach beyond the pads' outline."""
    return settings.pad_dome_radius_mm <= LARGEST_SPHERE_MM


def _symmetric_range(half: float) -> np.ndarray:
    """Values over [−half, half] about ``PAD_PITCH_MM`` apart, 0 among them."""
    return np.linspace(-half, half, 2 * int(np.ceil(half / PAD_PITCH_MM)) + 1)


def create_body(world: World, links: Sequence[Link], base_position_m: Sequence[float]) -> int:
    """A body of ``links`` on a base that is fixed to the world."""
    body = world.bullet.createMultiBody(0.0, basePosition=base_position_m, **link_arguments(links))
    for link in range(-1, len(links)):
        world.set_surface(body, link, friction=0.0)
        world.collide(body, link, Collides.GRIPPER)
    return int(body)


def finger_links(world: World, settings: PhysicsSettings, hand: int) -> list[Link]:
    """The fingers, to be added right after the link ``hand`` that carries them.

    Each is followed by its stem and by its pad's outline, which counts on the way to the grasp
    alone: PyBullet numbers links depth first, whatever it is given.
    """
    links: list[Link] = []
    for side in (PAD_SIDE[pad] for pad in PAD_NAMES):
        finger = hand + 1 + len(links)
        vertices_m = pad_vertices_m(side, settings.pad_dome_radius_mm)
        outline = world.bullet.createCollisionShape(world.bullet.GEOM_MESH, vertices=vertices_m)
        fixed = world.bullet.JOINT_FIXED
        links += [
            Link(
                parent=hand,
                joint_type=world.bullet.JOINT_PRISMATIC,
                mass_kg=FINGER_MASS_KG,
                shape=_dome(world, settings, side) if touches_as_sphere(settings) else outline,
                position_m=(side * STROKE_MM / 2 * M_PER_MM, 0.0, 0.0),
                axis=(-side, 0.0, 0.0),
            ),
            Link(
                parent=finger,
                joint_type=fixed,
                shape=_box(world, STEM_HALF_EXTENTS_MM),
                position_m=tuple(M_PER_MM * np.array(STEM_CENTER_MM) * (side, 1.0, 1.0)),
            ),
            Link(parent=finger, joint_type=fixed, shape=outline),
        ]
    return links


def palm_link(world: World, hand: int) -> Link:
    """The body of the gripper above the fingers, fixed to the link ``hand``."""
    return Link(
        parent=hand,
        joint_type=world.bullet.JOINT_FIXED,
        shape=_box(world, PALM_HALF_EXTENTS_MM),
        position_m=(0.0, 0.0, (FINGER_LENGTH_MM + PALM_HALF_EXTENTS_MM[2]) * M_PER_MM),
    )


def _dome(world: World, settings: PhysicsSettings, side: float) -> int:
    radius_m = settings.pad_dome_radius_mm * M_PER_MM
    return int(
        world.bullet.createCollisionShape(
            world.bullet.GEOM_SPHERE,
            radius=radius_m,
            collisionFramePosition=(side * radius_m, 0.0, 0.0),
        )
    )


def _box(world: World, half_extents_mm: Sequence[float]) -> int:
    half_extents_m = [half * M_PER_MM for half in half_extents_mm]
    return int(world.bullet.createCollisionShape(world.bullet.GEOM_BOX, halfExtents=half_extents_m))


class Fingers:
    """The two fingers of a body in which ``finger_links`` follow the link ``hand``.

    Each is driven by a motor of its own until the lift, so that both pads press with the
    commanded force even where the table would take up a difference; then the jaws are coupled,
    as the WSG-50's are, so that the grasp cannot drift sideways.
    """

    COUPLING_FORCE_N = 1000.0
    """Far above any pad's force, so that the jaws move as one."""

    def __init__(self, world: World, body: int, hand: int) -> None:
        self._world = world
        self._body = body
        self.links = {"left": hand + 1, "right": hand + 4}
        for finger in self.links.values():
            world.collide(body, finger + 2, Collides.NOTHING)

    def set_surface(self, settings: PhysicsSettings, friction: float) -> None:
        """Friction and compliance of the pads against an object whose own friction is 1."""
        for link in self.links.values():
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
        for pad, link in self.links.items():
            self._world.bullet.changeDynamics(
                self._body, link, spinningFriction=spinning_friction_m[pad]
            )
            self._world.collide(self._body, link, Collides.GRIPPER)  # also drops its touches

    def place(self, travel_m: float) -> None:
        """Put both fingers ``travel_m`` in from the full opening, at rest."""
        for link in self.links.values():
            self._world.bullet.resetJointState(self._body, link, travel_m, 0.0)

    def drive(self, speed_m_s: float, force_n: float) -> None:
        """Close at ``speed_m_s``, pressing with ``force_n`` at most."""
        for link in self.links.values():
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
        gear = bullet.createConstraint(
            self._body,
            self.links["left"],
            self._body,
            self.links["right"],
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
        left, right = (state(self._body, link)[0] for link in self.links.values())
        return left, right

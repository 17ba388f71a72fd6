"""An object as a body of PyBullet."""

import operator
from collections.abc import Sequence

import numpy as np

from tacgen.core.records import GraspObject, Mesh
from tacgen.core.types import M_PER_MM, FloatArray, pose, quaternion_from_rotation
from tacgen.physics.engine import Place
from tacgen.physics.world import HULL_MARGIN_MM, BulletLink, Collides, World, link_arguments

OBJECT_FRICTION = 1.0
"""Bullet multiplies the coefficients of two bodies: the pads and the table carry the real ones."""


def principal_axes(inertia: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Principal moments (3,) and the right-handed (3, 3) rotation whose columns are the axes."""
    moments, axes = np.linalg.eigh(inertia)
    if np.linalg.det(axes) < 0:
        axes[:, 0] = -axes[:, 0]
    return moments, axes


class ObjectBody:
    """The object in the world, standing in its rest pose to begin with.

    An object of several convex parts meets the table as one convex hull: on a plane that is the
    same, and it saves a pair of bodies for each part at every step. The gripper can touch ``met``
    alone; on the way to the grasp the whole parts count.
    """

    def __init__(self, world: World, obj: GraspObject, met: Sequence[Mesh] | None = None) -> None:
        self._world = world
        moments, axes = principal_axes(obj.inertia_kg_mm2)
        self.principal_moments_kg_m2 = moments * M_PER_MM**2
        self.inertial = pose(axes, obj.center_of_mass_mm * M_PER_MM)
        parts, links = obj.collision, []
        met = parts if met is None else met
        whole = len(met) == len(parts) and all(map(operator.is_, met, parts))
        if len(parts) > 1 or not whole:
            # Massless, and raised by the margin that Bullet keeps around the hulls of links, so
            # that the object stands where it should.
            hull, raised_m = world.hull_shape(parts, enclosing=True), HULL_MARGIN_MM * M_PER_MM
            fixed = world.bullet.JOINT_FIXED
            links = [BulletLink(-1, fixed, shape=hull, position_m=(0.0, 0.0, raised_m))]
            if not whole:
                links.append(BulletLink(-1, fixed, shape=world.hull_shape(parts)))
        self.body = world.bullet.createMultiBody(
            obj.mass_kg,
            world.hull_shape(met or parts, kept=whole or not met),
            baseInertialFramePosition=self.inertial[:3, 3].tolist(),
            baseInertialFrameOrientation=quaternion_from_rotation(axes).tolist(),
            **link_arguments(links),
        )
        world.set_surface(self.body, -1, friction=OBJECT_FRICTION)
        inertia = self.principal_moments_kg_m2.tolist()
        world.bullet.changeDynamics(self.body, -1, localInertiaDiagonal=inertia)
        base = Collides.GRIPPER if met else Collides.NOTHING
        world.collide(self.body, -1, base if links else base | Collides.TABLE)
        for link in range(len(links)):
            world.set_surface(self.body, link, friction=OBJECT_FRICTION)
            world.collide(self.body, link, Collides.NOTHING if link else Collides.TABLE)
        (self._x_m, self._y_m, _), _ = self.inertial_position()

    def inertial_position(self) -> Place:
        """Position (m) of the centre of mass and quaternion of the principal axes."""
        position, quaternion = self._world.bullet.getBasePositionAndOrientation(self.body)
        return position, quaternion

    def velocity(self) -> Place:
        """Linear velocity (m/s) of the centre of mass and angular velocity (rad/s), world axes."""
        linear, angular = self._world.bullet.getBaseVelocity(self.body)
        return linear, angular

    def keep_place(self) -> None:
        """Stand at rest where it was to begin with, however it has come to rest on the table."""
        bullet, ((_, _, z_m), quaternion) = self._world.bullet, self.inertial_position()
        place_m = (self._x_m, self._y_m, z_m)
        bullet.resetBasePositionAndOrientation(self.body, place_m, quaternion)
        bullet.resetBaseVelocity(self.body, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))

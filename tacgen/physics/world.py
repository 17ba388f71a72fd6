"""A PyBullet client, and what bodies in it are made of. Lengths are in metres."""

import hashlib
import operator
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntFlag
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any, Self

import numpy as np

from tacgen.core.errors import PhysicsError
from tacgen.core.records import GraspObject, Mesh
from tacgen.core.types import (
    M_PER_MM,
    STANDARD_GRAVITY_M_S2,
    FloatArray,
    pose,
    quaternion_from_rotation,
)
from tacgen.physics.engine import Place, Vector
from tacgen.physics.pybullet_import import load_bullet
from tacgen.physics.settings import PhysicsSettings

TABLE_HALF_EXTENTS_M = (0.6, 0.6, 0.05)
"""Larger than any grasp's reach; thick enough that nothing falls through in a step."""
BALL_TOLERANCE = 1e-3  # of the radius, for vertices: 0.02 mm of a golf ball
BALL_FILL = 0.92  # of its volume: 162 vertices fill 0.97, 512 uneven ones 0.96, 42 fill 0.87
SOLVER_TOLERANCE_M_S = 1e-5
"""A contact's residual in the solver's last iteration; a held object creeps by less."""
HULL_MARGIN_MM = 1.0  # what Bullet adds around a convex hull; on a link it cannot be taken off
NO_TURN = (0.0, 0.0, 0.0, 1.0)  # the quaternion x, y, z, w of no rotation


OBJECT_FRICTION = 1.0
"""Bullet multiplies the coefficients of two bodies: the pads and the table carry the real ones."""


class Collides(IntFlag):
    """What a link can touch: things that share a flag."""

    NOTHING = 0
    GRIPPER = 1
    TABLE = 2


@dataclass(frozen=True, slots=True)
class BulletLink:
    """One link for ``createMultiBody``; ``parent`` is the index of a link, −1 for the base."""

    parent: int
    joint_type: int
    mass_kg: float = 0.0
    shape: int = -1
    position_m: Vector = (0.0, 0.0, 0.0)
    quaternion: Vector = NO_TURN
    axis: Vector = (0.0, 0.0, 1.0)
    center_of_mass_m: Vector = (0.0, 0.0, 0.0)


def link_arguments(links: Sequence[BulletLink]) -> dict[str, Any]:
    """The links as arguments of ``createMultiBody``."""
    return {
        "linkMasses": [link.mass_kg for link in links],
        "linkCollisionShapeIndices": [link.shape for link in links],
        "linkVisualShapeIndices": [-1] * len(links),
        "linkPositions": [link.position_m for link in links],
        "linkOrientations": [link.quaternion for link in links],
        "linkInertialFramePositions": [link.center_of_mass_m for link in links],
        "linkInertialFrameOrientations": [NO_TURN] * len(links),
        "linkParentIndices": [link.parent + 1 for link in links],
        "linkJointTypes": [link.joint_type for link in links],
        "linkJointAxis": [link.axis for link in links],
    }


class _Client:
    """PyBullet's constants, and its functions bound to a new client."""

    def __init__(self, module: ModuleType) -> None:
        self._module, self._number = module, module.connect(module.DIRECT)

    def __getattr__(self, name: str) -> Any:
        bound = getattr(self._module, name)
        if callable(bound) and self._number != 0:  # which is PyBullet's default
            bound = partial(bound, physicsClientId=self._number)
        setattr(self, name, bound)
        return bound


class World:
    """A DIRECT client with a table at z = 0; a context manager. Lengths are in metres."""

    def __init__(self) -> None:
        self._module = load_bullet()
        self._client: Any = None
        self.table = -1

    @property
    def bullet(self) -> Any:
        """PyBullet's functions, bound to this client, and its constants."""
        if self._client is None:
            msg = "the simulator is not open; use it in a `with` block"
            raise PhysicsError(msg)
        return self._client

    def __enter__(self) -> Self:
        # Not `pybullet_utils.bullet_client`: that prints a line for every client.
        self._client = _Client(self._module)
        if not self._client.isConnected():
            msg = "PyBullet accepts no further client in this process; close other simulators first"
            raise PhysicsError(msg)
        self._folder = tempfile.TemporaryDirectory(prefix="tacgen-physics-")
        self._shapes: dict[str, dict[str, Any]] = {}
        return self

    def __exit__(self, *raised: object) -> None:
        self._client.disconnect()
        self._client = None
        self._folder.cleanup()

    def rebuild(self, settings: PhysicsSettings, solver_iterations: int) -> None:
        """Empty the world and lay the table: the state that every grasp starts from.

        A rebuild rather than ``restoreState``: that leaves out the motors, and does not repeat
        bit for bit once an object of many parts is in contact (``docs/explanation/physics.md``).
        """
        bullet = self.bullet
        bullet.resetSimulation()
        bullet.setPhysicsEngineParameter(
            fixedTimeStep=settings.time_step_s,
            numSubSteps=0,
            numSolverIterations=solver_iterations,
            solverResidualThreshold=SOLVER_TOLERANCE_M_S**2,
            enableConeFriction=1,
            deterministicOverlappingPairs=1,
            enableFileCaching=0,  # which would keep every hull that a grasp ever had
        )
        bullet.setGravity(0.0, 0.0, -STANDARD_GRAVITY_M_S2)
        shape = bullet.createCollisionShape(bullet.GEOM_BOX, halfExtents=TABLE_HALF_EXTENTS_M)
        self.table = bullet.createMultiBody(
            0.0, shape, basePosition=(0.0, 0.0, -TABLE_HALF_EXTENTS_M[2])
        )
        self.set_surface(self.table, -1, friction=settings.table_friction)
        self.collide(self.table, -1, Collides.TABLE)

    def step(self, count: int) -> None:
        """Advance by ``count`` time steps."""
        step = self.bullet.stepSimulation
        for _ in range(count):
            step()

    def hull_shape(
        self, parts: Sequence[Mesh], *, enclosing: bool = False, kept: bool = True
    ) -> int:
        """A collision shape of convex ``parts`` (mm), or of one convex hull ``enclosing`` them.

        A ball is a sphere: on its facets the pads would press past each other and turn it.
        A hull goes through a file because ``createCollisionShape(vertices=…)`` takes one
        hull only; it is ``kept`` for the next grasp of the object, if it is the same in each. The
        margin around such hulls can be taken off a body's base, not off its links.
        """
        if not kept:
            once = self._shape(parts, Path(self._folder.name) / "once", enclosing)
            return int(self.bullet.createCollisionShape(**once))
        digest = hashlib.sha256(bytes([enclosing]))
        for part in parts:
            digest.update(part.vertices_mm.tobytes() + part.faces.tobytes())
        key = digest.hexdigest()[:32]
        if key not in self._shapes:
            self._shapes[key] = self._shape(parts, Path(self._folder.name) / key, enclosing)
        return int(self.bullet.createCollisionShape(**self._shapes[key]))

    def _shape(self, parts: Sequence[Mesh], path: Path, enclosing: bool) -> dict[str, Any]:
        """Arguments of ``createCollisionShape``."""
        if len(parts) == 1 and (ball := ball_of(parts[0])):
            center_m, radius_m = (ball[0] * M_PER_MM).tolist(), ball[1] * M_PER_MM
            sphere = self.bullet.GEOM_SPHERE
            return {"shapeType": sphere, "radius": radius_m, "collisionFramePosition": center_m}
        path = path.with_suffix(".obj")
        text = _wavefront([_hull_around(parts)] if enclosing else parts)
        path.write_text(text, encoding="ascii")
        return {"shapeType": self.bullet.GEOM_MESH, "fileName": str(path)}

    def collide(self, body: int, link: int, what: Collides) -> None:
        """Let a link touch only what shares a flag with it."""
        self.bullet.setCollisionFilterGroupMask(body, link, int(what), int(what))

    def set_surface(self, body: int, link: int, *, friction: float) -> None:
        """Friction of a link; none of Bullet's default damping is kept.

        The margin is a call of its own, for bodies only: on a link Bullet does not apply it, and
        drops the rest of the call.
        """
        self.bullet.changeDynamics(
            body,
            link,
            lateralFriction=friction,
            spinningFriction=0.0,
            rollingFriction=0.0,
            restitution=0.0,
            linearDamping=0.0,
            angularDamping=0.0,
            jointDamping=0.0,
        )
        if link == -1:
            self.bullet.changeDynamics(body, link, collisionMargin=0.0)


def ball_of(part: Mesh) -> tuple[FloatArray, float] | None:
    """Centre (3,) and radius, mm, of the ball that a convex part stands for, if it does."""
    points = part.vertices_mm
    # On a sphere |p|² = 2 c·p + r² − |c|².
    terms = np.column_stack([2 * points, np.ones(len(points))])
    found = np.linalg.lstsq(terms, np.sum(points**2, axis=1))[0]
    center, radius = found[:3], float(np.sqrt(found[3] + found[:3] @ found[:3]))
    off = np.abs(np.linalg.norm(points - center, axis=1) - radius)
    if off.max() > BALL_TOLERANCE * radius:
        return None
    from scipy.spatial import ConvexHull  # slow to import, and most objects do not need it

    filled = ConvexHull(points).volume / (4 / 3 * np.pi * radius**3)
    return (center, radius) if filled > BALL_FILL else None


def _hull_around(parts: Sequence[Mesh]) -> Mesh:
    from scipy.spatial import ConvexHull  # slow to import, and most objects do not need it

    return mesh_of_hull(ConvexHull(np.concatenate([part.vertices_mm for part in parts])))


def mesh_of_hull(hull: Any) -> Mesh:
    """The mesh of scipy's ``ConvexHull``; its faces are not turned the same way."""
    numbers = np.full(len(hull.points), -1, dtype=np.int32)
    numbers[hull.vertices] = np.arange(len(hull.vertices), dtype=np.int32)
    return Mesh(hull.points[hull.vertices], numbers[hull.simplices])


def _wavefront(parts: Sequence[Mesh]) -> str:
    """An OBJ text in metres, an object for each part: Bullet makes a convex hull of each."""
    lines: list[str] = []
    first = 1
    for number, part in enumerate(parts):
        lines.append(f"o part{number}")
        lines += [
            f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in (part.vertices_mm * M_PER_MM).tolist()
        ]
        lines += [f"f {a} {b} {c}" for a, b, c in (part.faces + first).tolist()]
        first += len(part.vertices_mm)
    return "\n".join(lines) + "\n"


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

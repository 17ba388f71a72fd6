"""A sensor on a link of a body in a user's own PyBullet simulation."""

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from tacgen.core.engine_contacts import ContactPoint, bullet_points
from tacgen.core.errors import SensorError
from tacgen.core.records import Mesh, Sensor
from tacgen.core.types import MM_PER_M, FloatArray, inverse, pose, rotation_of
from tacgen.sensor.engines import (
    TOUCHING_GAP_M,
    EngineContacts,
    Part,
    merged,
    solid,
)

SOFT_BODY = 3  # among the kinds of PyBullet's getDynamicsInfo


@dataclass(slots=True)
class _BulletStep:
    """What PyBullet said when it was last read.

    Attributes
    ----------
    contacts : (n, 13) float
        Points on both bodies, normal, distance, and the impulses of the last substep, N s.
    poses_m : (1 + bodies, 4, 4) float
        Poses of the gel and of the objects.
    step_s, substeps : float, int
        With which the step was made.
    """

    contacts: FloatArray
    poses_m: FloatArray
    step_s: float
    substeps: int

    def is_of_the_step_of(self, other: "_BulletStep") -> bool:
        """Whether no step was made in between: contacts and impulses are the same."""
        return (
            self.contacts.shape == other.contacts.shape
            and self.poses_m.shape == other.poses_m.shape
            and np.array_equal(self.contacts[:, :10], other.contacts[:, :10])
            and np.allclose(self.contacts[:, 10:], other.contacts[:, 10:], rtol=1e-9, atol=0.0)
        )


class PyBulletContacts(EngineContacts):
    """A link of a PyBullet body that carries the gel."""

    def __init__(
        self,
        sensor: Sensor,
        body_id: int,
        link_id: int,
        pose_link_gel_m: FloatArray,
        client_id: int,
    ) -> None:
        import pybullet

        super().__init__(sensor)
        self._bullet, self._client = pybullet, client_id
        self._body, self._link, self._gel = int(body_id), int(link_id), pose_link_gel_m
        self._last: _BulletStep | None = None
        self._refuse_soft(self._body)
        n_links = self._asked("body", body_id, pybullet.getNumJoints, self._body)
        if not -1 <= self._link < n_links:
            msg = f"link_id = {link_id}: body {body_id} has links -1 (its base) to {n_links - 1}"
            raise SensorError(msg)

    def _asked(self, what: str, which: object, function: Any, *arguments: Any) -> Any:
        try:
            return function(*arguments, physicsClientId=self._client)
        except self._bullet.error as error:
            msg = f"PyBullet has no {what} {which} on client {self._client}: {error}"
            raise SensorError(msg) from None

    def clock_s(self) -> float | None:
        """PyBullet keeps no clock."""
        return None

    def time_step_s(self) -> float:
        """The simulation's fixed step."""
        known = self._bullet.getPhysicsEngineParameters(physicsClientId=self._client)
        return float(known["fixedTimeStep"])

    def add_object(self, body: Any, mesh: Mesh | None) -> None:
        """Watch for contacts of a body's links; ``mesh`` is in the frame of its base link."""
        number = int(body)
        self._refuse_soft(number)
        links = range(-1, self._asked("body", body, self._bullet.getNumJoints, number))
        if mesh is None:
            has_shapes = [k for k in links if self._shape_data((number, k))]
            if not has_shapes:
                msg = f"body {body} has no shape that collides; give a mesh: add_object(…, mesh=…)"
                raise SensorError(msg)
            self._own_mesh((number, has_shapes[0]))
        self._watch(number, [(number, k) for k in links], mesh)

    def _refuse_soft(self, body: int) -> None:
        """Raise a ``SensorError`` for a soft body: of those PyBullet tells no collision shape."""
        info = self._asked("body", body, self._bullet.getBodyInfo, body)
        if self._asked("body", body, self._bullet.getDynamicsInfo, body, -1)[10] == SOFT_BODY:
            msg = (
                f"body {body} ({info[1].decode() or 'without a name'}) is soft: the sensor cannot "
                "draw a surface that the engine deforms; use rigid bodies"
            )
            raise SensorError(msg)

    def _shape_data(self, part: Part) -> Any:
        return self._asked("body", part[0], self._bullet.getCollisionShapeData, *part)

    def _shapes(self, part: Part) -> Hashable:
        data, meshes = self._shape_data(part), list[object]()
        for k, one in enumerate(data):
            if one[2] == self._bullet.GEOM_MESH:
                file = Path(one[4].decode())
                is_there = file.is_file()
                meshes.append(file.stat().st_mtime_ns if is_there else self._vertices_m(part, k))
        name = self._asked("body", part[0], self._bullet.getBodyInfo, part[0])
        place = self._asked("body", part[0], self._bullet.getDynamicsInfo, *part)[3:5]
        return data, name, place, tuple(meshes)

    def _root(self, body: int) -> int:
        return -1

    def _mesh_of(self, part: Part) -> Mesh:
        body, link = part
        data = self._shape_data(part)
        shapes = [_bullet_shape(one, partial(self._hull_of, part, k)) for k, one in enumerate(data)]
        found = merged(shapes, f"link {link} of body {body}")
        inertial = self._inertial_of(part)
        vertices_m = found.vertices @ inertial[:3, :3].T + inertial[:3, 3]
        return Mesh.fixed(MM_PER_M * vertices_m, found.faces)

    def _hull_of(self, part: Part, number: int) -> trimesh.Trimesh | None:
        """The convex hull that a shape collides as, in the inertial frame, if PyBullet has it.

        It makes one of a URDF's cylinder.
        """
        vertices_m = self._vertices_m(part, number)
        return trimesh.Trimesh(vertices_m).convex_hull if len(vertices_m) > 3 else None

    def _vertices_m(self, part: Part, number: int) -> tuple[tuple[float, ...], ...]:
        known: tuple[tuple[float, ...], ...] = self._bullet.getMeshData(
            *part, collisionShapeIndex=number, physicsClientId=self._client
        )[1]
        return known

    def _inertial_of(self, part: Part) -> FloatArray:
        """The inertial frame of a link in the link's own; shapes are given in it."""
        known = self._asked("body", part[0], self._bullet.getDynamicsInfo, *part)
        return pose(rotation_of(known[4]), known[3])

    def _part_pose_m(self, part: Part) -> FloatArray:
        body, link = part
        if link == -1:
            at, turned = self._asked("body", body, self._bullet.getBasePositionAndOrientation, body)
            return pose(rotation_of(turned), at) @ inverse(self._inertial_of(part))
        state = self._link_state(part)
        return pose(rotation_of(state[5]), state[4])

    def _link_state(self, part: Part) -> Any:
        return self._bullet.getLinkState(
            *part, computeLinkVelocity=True, computeForwardKinematics=True,
            physicsClientId=self._client,
        )  # fmt: skip

    def _velocity_m_s(self, part: Part) -> Any:
        if part[1] == -1:
            return self._asked("body", part[0], self._bullet.getBaseVelocity, part[0])[0]
        return self._link_state(part)[6]

    def _gel_pose_m(self) -> FloatArray:
        return self._part_pose_m((self._body, self._link)) @ self._gel

    def _contact_points(self) -> list[ContactPoint[Part]]:
        """What presses, and its contact points of the last step, with the forces that acted in it.

        PyBullet divides the impulse of the last substep by the whole ``fixedTimeStep``, as that is
        now; and it keeps contacts of bodies that were moved since. Bodies that are apart do not
        press on each other.

        Raises ``SensorError`` where a body was moved since the last step and still touches: then
        no force is known.
        """
        raw = self._bullet.getContactPoints(physicsClientId=self._client)
        known = self._bullet.getPhysicsEngineParameters(physicsClientId=self._client)
        step_s, substeps = float(known["fixedTimeStep"]), max(1, int(known["numSubSteps"]))
        pressing = [one for one in bullet_points(raw, self._part_of) if one.normal_force_n > 0]
        numbers = [(*c[5], *c[6], *c[7], c[8], *(step_s * c[k] for k in (9, 10, 12))) for c in raw]
        touched = {point.part for point in pressing}
        for body in {body for body, _ in touched}:
            self._refuse_soft(body)  # the number may have been a rigid one's
        places = [self._part_pose_m(part) for part in sorted(touched)]
        now = _BulletStep(np.array(numbers), np.array([self._gel_pose_m(), *places]), step_s,
                          substeps)  # fmt: skip
        near = {part for part in touched if self._is_near(part, step_s)}
        moved = False
        if self._last is not None and len(raw) and self._last.is_of_the_step_of(now):
            moved = not np.allclose(now.poses_m, self._last.poses_m, rtol=0.0, atol=1e-6)
            now = self._last  # the step was made with what was set then
        self._last = now if near == touched or moved else None
        if moved and near:
            bodies_named = ", ".join(map(str, sorted({body for body, _ in near})))
            fix = "call stepSimulation after resetting poses or joints, before read()"
            msg = f"body {bodies_named} or the gel was moved since the last step: {fix}"
            raise SensorError(msg)
        factor = now.substeps * step_s / now.step_s
        return [
            point._replace(
                normal_force_n=factor * point.normal_force_n,
                force_n=tuple(factor * along_n for along_n in point.force_n),
            )
            for point in pressing
            if point.part in near
        ]

    def _part_of(self, side: Part, other: Part) -> Part | None:
        """The part of an object that a side is; None where the other is not the gel."""
        is_gel = other == (self._body, self._link) != side
        return side if is_gel and side[0] in self._given else None

    def _is_near(self, part: Part, step_s: float) -> bool:
        """Whether a part and the gel are as near as pressing bodies are."""
        gel = self._body, self._link
        speeds = [self._velocity_m_s(one) for one in (part, gel)]
        reach = TOUCHING_GAP_M + step_s * float(np.linalg.norm(np.subtract(*speeds)))
        found = self._bullet.getClosestPoints(
            part[0], self._body, reach, linkIndexA=part[1], linkIndexB=self._link,
            physicsClientId=self._client,
        )  # fmt: skip
        return bool(found)


def _bullet_shape(
    data: tuple[Any, ...], hull: Callable[[], trimesh.Trimesh | None]
) -> trimesh.Trimesh:
    """One collision shape of PyBullet as a mesh in the link's inertial frame, metres.

    ``hull`` gives that of a shape that is of no file.
    """
    import pybullet

    kind, sizes, file = data[2], data[3], data[4]
    solids = {
        pybullet.GEOM_SPHERE: ("sphere", sizes[0]),
        pybullet.GEOM_BOX: ("box", *sizes),
        pybullet.GEOM_CYLINDER: ("cylinder", sizes[1], sizes[0]),
        pybullet.GEOM_CAPSULE: ("capsule", sizes[1], sizes[0]),
    }
    shape: trimesh.Trimesh
    if kind in solids:
        shape = solid(*solids[kind])
    else:
        try:
            shape = trimesh.load_mesh(file.decode())
        except (OSError, ValueError, TypeError, NotImplementedError):
            if kind == pybullet.GEOM_MESH and (found := hull()) is not None:
                return found
            msg = f"PyBullet keeps no mesh file of body {data[0]}; give one: add_object(…, mesh=…)"
            raise SensorError(msg) from None
        shape.apply_scale(sizes)
    shape.apply_transform(pose(rotation_of(data[6]), data[5]))
    return shape

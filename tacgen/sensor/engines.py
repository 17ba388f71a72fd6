"""Poses and contact forces of a user's own simulation, as a sensor on one of its bodies needs them.

Engines are in metres; what leaves this module is in mm, N and the gel frame.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh

from tacgen.core.arrays import FloatArray
from tacgen.core.errors import SensorError
from tacgen.core.records import Mesh
from tacgen.core.units import MM_PER_M
from tacgen.physics.frames import inverse, pose, rotation_of
from tacgen.physics.world import contact_points

SPHERE_SUBDIVISIONS = 6  # 82 k triangles: facets of a ball of 10 mm are then flatter than 1 µm
TOUCHING_GAP_M = 2e-3
"""Bodies farther apart than this, and than they move in a step, do not press on each other: Bullet
lets bodies sink in and rebound by tenths of a millimetre."""

SECTIONS = 512  # around a cylinder or capsule: on 20 mm of radius its facets are within 0.4 µm


class EngineContacts(ABC):
    """What a sensor asks of the physics engine that it is attached to."""

    def __init__(self) -> None:
        self._objects: list[tuple[int, Mesh]] = []
        self.center_mm = np.zeros(2)

    def contact(self) -> tuple[Mesh, FloatArray, FloatArray, float]:
        """Mesh of all objects, its pose in the gel frame, force (3,) and moment on the gel.

        The moment is that about the normal through the centre of pressure, then ``center_mm`` (2,).
        Raises ``SensorError`` if no object is watched.
        """
        if not self._objects:
            msg = "the sensor knows of no object; call add_object with the body that it touches"
            raise SensorError(msg)
        gel = self._gel_pose_m()
        poses = [_in_mm(inverse(gel) @ self._object_pose_m(body)) for body, _ in self._objects]
        points_m, forces_n = self._forces_on_gel()
        local_n = forces_n @ gel[:3, :3]
        points_mm = MM_PER_M * (points_m - gel[:3, 3]) @ gel[:3, :3]
        pressed_n = np.maximum(-local_n[:, 2], 0.0)
        self.center_mm = pressed_n @ points_mm[:, :2] / max(float(pressed_n.sum()), 1e-12)
        arms_mm = points_mm[:, :2] - self.center_mm
        torsion = np.sum(arms_mm[:, 0] * local_n[:, 1] - arms_mm[:, 1] * local_n[:, 0])
        total = local_n.sum(axis=0)
        force = np.array([total[0], total[1], 0.0 - total[2]])
        meshes = [mesh for _, mesh in self._objects]
        if len(meshes) == 1:
            return meshes[0], poses[0], force, float(torsion)
        return _joined(meshes, poses), np.eye(4), force, float(torsion)

    @abstractmethod
    def clock_s(self) -> float | None:
        """Time of the present state; None where the engine keeps no clock."""

    @abstractmethod
    def time_step_s(self) -> float:
        """Time from one state to the next."""

    @abstractmethod
    def add_object(self, body: Any, mesh: Mesh | None) -> None:
        """Watch for contacts of a body; its mesh from the engine's own shapes where None."""

    @abstractmethod
    def _gel_pose_m(self) -> FloatArray:
        """Pose (4, 4) of the gel in the world."""

    @abstractmethod
    def _object_pose_m(self, body: int) -> FloatArray:
        """Pose (4, 4) of a body in the world."""

    @abstractmethod
    def _forces_on_gel(self) -> tuple[FloatArray, FloatArray]:
        """Contact points (n, 3), m, and the forces (n, 3) on the gel there, N, in the world."""


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
        self, body_id: int, link_id: int, pose_link_gel_m: FloatArray, client_id: int
    ) -> None:
        import pybullet

        super().__init__()
        self._bullet, self._client = pybullet, client_id
        self._body, self._link, self._gel = int(body_id), int(link_id), pose_link_gel_m
        self._base_in_inertial_m: dict[int, FloatArray] = {}
        self._last: _BulletStep | None = None
        self._asked("body", body_id, pybullet.getBodyInfo, self._body)
        n_links = self._asked("body", body_id, pybullet.getNumJoints, self._body)
        if not -1 <= self._link < n_links:
            msg = f"link_id = {link_id}: body {body_id} has links -1 (its base) to {n_links - 1}"
            raise SensorError(msg)
        self._read_inertial(self._body)

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
        """Watch for contacts of a body; ``mesh`` is in the frame of its base link."""
        self._asked("body", body, self._bullet.getBodyInfo, int(body))
        inertial = self._read_inertial(int(body))
        if mesh is None:
            # In the inertial frame, metres.
            parts = self._asked("body", body, self._bullet.getCollisionShapeData, int(body), -1)
            found = _merged([_bullet_shape(part) for part in parts], f"body {body}")
            vertices_m = found.vertices @ inertial[:3, :3].T + inertial[:3, 3]
            mesh = Mesh.fixed(MM_PER_M * vertices_m, found.faces)
        self._objects.append((int(body), mesh))

    def _read_inertial(self, body: int) -> FloatArray:
        """The inertial frame of a base in the base's own; it stays, and poses are given of it."""
        known = self._asked("body", body, self._bullet.getDynamicsInfo, body, -1)
        inertial = pose(rotation_of(known[4]), known[3])
        self._base_in_inertial_m[body] = inverse(inertial)
        return inertial

    def _link_pose_m(self, body: int, link: int) -> FloatArray:
        if link == -1:
            at, turned = self._asked("body", body, self._bullet.getBasePositionAndOrientation, body)
            return pose(rotation_of(turned), at) @ self._base_in_inertial_m[body]
        state = self._bullet.getLinkState(
            body, link, computeForwardKinematics=True, physicsClientId=self._client
        )
        return pose(rotation_of(state[5]), state[4])

    def _gel_pose_m(self) -> FloatArray:
        return self._link_pose_m(self._body, self._link) @ self._gel

    def _object_pose_m(self, body: int) -> FloatArray:
        return self._link_pose_m(body, -1)

    def _fresh_contacts(self) -> list[tuple[Any, ...]]:
        """The contact points of the last step, with the forces that acted in it.

        PyBullet divides the impulse of the last substep by the whole ``fixedTimeStep``, as that is
        now; and it keeps contacts of bodies that were moved since. Bodies that are apart do not
        press on each other.

        Raises ``SensorError`` where a body was moved since the last step and still touches: then
        no force is known.
        """
        raw = self._bullet.getContactPoints(physicsClientId=self._client)
        known = self._bullet.getPhysicsEngineParameters(physicsClientId=self._client)
        step_s, substeps = float(known["fixedTimeStep"]), max(1, int(known["numSubSteps"]))
        touching = [contact for contact in raw if self._is_on_gel(contact) and contact[9] > 0]
        numbers = [(*c[5], *c[6], *c[7], c[8], *(step_s * c[k] for k in (9, 10, 12))) for c in raw]
        bodies = [self._object_pose_m(body) for body, _ in self._objects]
        now = _BulletStep(np.array(numbers), np.array([self._gel_pose_m(), *bodies]), step_s,
                          substeps)  # fmt: skip
        touched = self._touched(touching)
        near = {body for body in touched if self._is_near(body, step_s)}
        moved = False
        if self._last is not None and len(raw) and self._last.is_of_the_step_of(now):
            moved = not np.allclose(now.poses_m, self._last.poses_m, rtol=0.0, atol=1e-6)
            now = self._last  # the step was made with what was set then
        self._last = now if near == touched or moved else None
        if moved and near:
            bodies_named = ", ".join(map(str, sorted(near)))
            fix = "call stepSimulation after resetting poses or joints, before read()"
            msg = f"body {bodies_named} or the gel was moved since the last step: {fix}"
            raise SensorError(msg)
        factor = now.substeps * step_s / now.step_s
        return [
            (*c[:9], factor * c[9], factor * c[10], c[11], factor * c[12], *c[13:])
            for c in touching
            if self._touched([c]) <= near
        ]

    def _is_on_gel(self, contact: tuple[Any, ...]) -> bool:
        gel = self._body, self._link
        return gel in ((contact[1], contact[3]), (contact[2], contact[4]))

    def _touched(self, contacts: Sequence[tuple[Any, ...]]) -> set[int]:
        """The objects of contacts with the gel."""
        sides = {side for contact in contacts for side in contact[1:3]}
        return sides & {body for body, _ in self._objects}

    def _is_near(self, body: int, step_s: float) -> bool:
        """Whether an object and the gel are as near as pressing bodies are."""
        speeds = [self._asked("body", b, self._bullet.getBaseVelocity, b)[0]
                  for b in (body, self._body)]  # fmt: skip
        reach = TOUCHING_GAP_M + step_s * float(np.linalg.norm(np.subtract(*speeds)))
        found = self._bullet.getClosestPoints(
            body, self._body, reach, linkIndexB=self._link, physicsClientId=self._client
        )
        return bool(found)

    def _forces_on_gel(self) -> tuple[FloatArray, FloatArray]:
        raw, gel = self._fresh_contacts(), (self._body, self._link)
        touching = [
            point
            for number, _ in self._objects
            for point in contact_points(raw, number, lambda *it: "gel" if it == gel else "")
        ]
        points, forces = [p.point_m for p in touching], [p.force_n for p in touching]
        return np.array(points).reshape(-1, 3), -np.array(forces).reshape(-1, 3)


class MujocoContacts(EngineContacts):
    """A body of a MuJoCo model that carries the gel."""

    def __init__(self, model: Any, data: Any, body: int | str, pose_body_gel_m: FloatArray) -> None:
        import mujoco

        super().__init__()
        self._mujoco, self._model, self._data = mujoco, model, data
        self._scratch = mujoco.MjData(model)
        self._body, self._gel = self._body_id(body), pose_body_gel_m

    def _body_id(self, body: int | str) -> int:
        if isinstance(body, str):
            found = self._mujoco.mj_name2id(self._model, self._mujoco.mjtObj.mjOBJ_BODY, body)
        else:
            found = int(body) if 0 <= int(body) < self._model.nbody else -1
        if found < 0:
            names = [self._model.body(k).name for k in range(self._model.nbody)]
            msg = f"the model has no body {body!r}; it has {', '.join(filter(None, names))}"
            raise SensorError(msg)
        return int(found)

    def clock_s(self) -> float | None:
        """The simulation's clock."""
        return float(self._data.time)

    def time_step_s(self) -> float:
        """The simulation's step."""
        return float(self._model.opt.timestep)

    def add_object(self, body: Any, mesh: Mesh | None) -> None:
        """Watch for contacts of a body; ``mesh`` is in its body frame."""
        number = self._body_id(body)
        if mesh is None:
            first = self._model.body_geomadr[number]
            geoms = range(first, first + self._model.body_geomnum[number])
            found = _merged([self._shape(k) for k in geoms], f"body {body!r}")
            mesh = Mesh.fixed(MM_PER_M * np.asarray(found.vertices), found.faces)
        self._objects.append((number, mesh))

    def _shape(self, geom: int) -> trimesh.Trimesh:
        kinds, size = self._mujoco.mjtGeom, self._model.geom_size[geom]
        kind = self._model.geom_type[geom]
        shape: trimesh.Trimesh
        if kind == kinds.mjGEOM_SPHERE:
            shape = trimesh.creation.icosphere(SPHERE_SUBDIVISIONS, size[0])
        elif kind == kinds.mjGEOM_ELLIPSOID:
            shape = trimesh.creation.icosphere(SPHERE_SUBDIVISIONS)
            shape.apply_scale(size)
        elif kind == kinds.mjGEOM_BOX:
            shape = trimesh.creation.box(2 * size)
        elif kind == kinds.mjGEOM_CYLINDER:
            shape = trimesh.creation.cylinder(size[0], 2 * size[1], sections=SECTIONS)
        elif kind == kinds.mjGEOM_CAPSULE:
            shape = _capsule(size[0], 2 * size[1])
        elif kind == kinds.mjGEOM_MESH:
            number = self._model.geom_dataid[geom]
            vertex, face = self._model.mesh_vertadr[number], self._model.mesh_faceadr[number]
            vertices = self._model.mesh_vert[vertex : vertex + self._model.mesh_vertnum[number]]
            faces = self._model.mesh_face[face : face + self._model.mesh_facenum[number]]
            shape = trimesh.Trimesh(vertices, faces, process=False)
        else:
            name = self._model.geom(geom).name
            msg = f"geom {name!r} has no mesh of its own; give one: add_object(body, mesh=…)"
            raise SensorError(msg)
        w, x, y, z = self._model.geom_quat[geom]
        shape.apply_transform(pose(rotation_of([x, y, z, w]), self._model.geom_pos[geom]))
        return shape

    def _gel_pose_m(self) -> FloatArray:
        return self._object_pose_m(self._body) @ self._gel

    def _object_pose_m(self, body: int) -> FloatArray:
        return pose(np.array(self._data.xmat[body]).reshape(3, 3), np.array(self._data.xpos[body]))

    def _places(self, back_s: float) -> FloatArray:
        """Place and rotation (n, 12) of all bodies by the joints, so long before at this speed."""
        there, now = self._scratch, self._data
        there.qpos[:], there.mocap_pos[:], there.mocap_quat[:] = (
            now.qpos, now.mocap_pos, now.mocap_quat,
        )  # fmt: skip
        if back_s:
            self._mujoco.mj_integratePos(self._model, there.qpos, now.qvel, -back_s)
        self._mujoco.mj_kinematics(self._model, there)
        return np.hstack([there.xpos, there.xmat])

    def _refuse_moved(self) -> None:
        """Raise a ``SensorError`` where ``qpos`` was set since poses and contacts were computed.

        MuJoCo computes them at the beginning of a step: they may be as old as that.
        """
        places, step_s = self._places(0.0), self.time_step_s()
        moved = np.linalg.norm(places - self._places(step_s), axis=1)
        there = np.hstack([self._data.xpos, self._data.xmat])
        off = np.linalg.norm(there - places, axis=1)
        for body in (self._body, *(body for body, _ in self._objects)):
            is_mocap = self._model.body_mocapid[self._model.body_rootid[body]] >= 0
            if off[body] > 1e-6 + 2.0 * moved[body] and not is_mocap:
                name = self._model.body(body).name or body
                msg = (
                    f"body {name}: qpos is not that of the contacts: it was set since; call "
                    "mj_forward or mj_step after setting it, before read()"
                )
                raise SensorError(msg)

    def _forces_on_gel(self) -> tuple[FloatArray, FloatArray]:
        self._refuse_moved()
        objects = {body for body, _ in self._objects}
        points, forces = [np.zeros((0, 3))], [np.zeros((0, 3))]
        for k in range(self._data.ncon):
            contact = self._data.contact[k]
            if min(contact.geom) < 0:  # of a soft body, which has no geoms
                continue
            first, second = (int(self._model.geom_bodyid[g]) for g in contact.geom)
            if {first, second} != {self._body, *({first, second} & objects)}:
                continue
            wrench = np.zeros(6)
            self._mujoco.mj_contactForce(self._model, self._data, k, wrench)
            # In the contact's frame, rows of `frame`; it acts on the second geom.
            on_second = wrench[:3] @ np.array(contact.frame).reshape(3, 3)
            forces.append(on_second[None] if second == self._body else -on_second[None])
            points.append(np.array(contact.pos)[None])
        return np.concatenate(points), np.concatenate(forces)


def _bullet_shape(data: tuple[Any, ...]) -> trimesh.Trimesh:
    """One collision shape of PyBullet as a mesh in the body's inertial frame, metres."""
    import pybullet

    kind, sizes, file = data[2], data[3], data[4]
    shape: trimesh.Trimesh
    if kind == pybullet.GEOM_SPHERE:
        shape = trimesh.creation.icosphere(SPHERE_SUBDIVISIONS, sizes[0])
    elif kind == pybullet.GEOM_BOX:
        shape = trimesh.creation.box(sizes)
    elif kind == pybullet.GEOM_CYLINDER:
        shape = trimesh.creation.cylinder(sizes[1], sizes[0], sections=SECTIONS)
    elif kind == pybullet.GEOM_CAPSULE:
        shape = _capsule(sizes[1], sizes[0])
    else:
        try:
            shape = trimesh.load_mesh(file.decode())
        except (OSError, ValueError, TypeError, NotImplementedError):
            msg = f"PyBullet keeps no mesh file of body {data[0]}; give one: add_object(…, mesh=…)"
            raise SensorError(msg) from None
        shape.apply_scale(sizes)
    shape.apply_transform(pose(rotation_of(data[6]), data[5]))
    return shape


def _capsule(radius_m: float, length_m: float) -> trimesh.Trimesh:
    """A capsule about the origin, its cylinder ``length_m`` long along z."""
    shape = trimesh.creation.capsule(length_m, radius_m, count=[SECTIONS // 2, SECTIONS // 2])
    shape.apply_translation(-shape.bounds.mean(axis=0))
    return shape


def _merged(shapes: list[trimesh.Trimesh], what: str) -> trimesh.Trimesh:
    if not shapes:
        msg = f"{what} has no shape that collides; give a mesh: add_object(…, mesh=…)"
        raise SensorError(msg)
    return sum(shapes[1:], start=shapes[0])


def _joined(meshes: list[Mesh], poses_mm: list[FloatArray]) -> Mesh:
    """Several objects as one mesh in the gel frame."""
    posed = zip(meshes, poses_mm, strict=True)
    vertices_mm = [mesh.vertices_mm @ at[:3, :3].T + at[:3, 3] for mesh, at in posed]
    joined, faces = trimesh.util.append_faces(vertices_mm, [mesh.faces for mesh in meshes])
    return Mesh.fixed(joined, faces)


def _in_mm(pose_m: FloatArray) -> FloatArray:
    pose_mm = pose_m.copy()
    pose_mm[:3, 3] *= MM_PER_M
    return pose_mm

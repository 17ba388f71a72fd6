"""Poses and contact forces of a user's own simulation, as a sensor on one of its bodies needs them.

Engines are in metres; what leaves this module is in mm, N and the gel frame.
"""

import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Container, Hashable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from tacgen.contact.gel import gel_size_mm
from tacgen.contact.raster import dome_mm
from tacgen.core.errors import SensorError
from tacgen.core.records import Mesh, Sensor
from tacgen.core.types import MM_PER_M, BoolArray, FloatArray
from tacgen.physics.frames import inverse, pose, rotation_of
from tacgen.sensor.tactile_pad import Imprint

SPHERE_SUBDIVISIONS = 6  # 82 k triangles: facets of a ball of 10 mm are then flatter than 1 µm
TOUCHING_GAP_M = 2e-3
"""Bodies farther apart than this, and than they move in a step, do not press on each other: Bullet
lets bodies sink in and rebound by tenths of a millimetre."""

SOFT_BODY = 3  # among the kinds of PyBullet's getDynamicsInfo

NO_MESH = Mesh.fixed(np.zeros((0, 3)), np.zeros((0, 3)))

SECTIONS = 512  # around a cylinder or capsule: on 20 mm of radius its facets are within 0.4 µm


Part = tuple[int, int]
"""A link of a PyBullet body, or a body below an object's in MuJoCo: of which object, and which."""


@dataclass(frozen=True, slots=True)
class EngineContact:
    """What presses on the gel.

    ``mesh`` is the surface of all parts that touch, ``pose_gel_object`` (4, 4) its pose, mm.
    ``force_n`` (3,) acts on the gel, ``torsion_n_mm`` about the normal through the centre of
    pressure ``center_mm`` (2,). ``share`` of what presses on the sensor presses on its gel; not
    ``is_over_gel`` where all points that the engine gives are beside it: a body that is larger than
    the gel may press on it all the same.
    """

    mesh: Mesh
    pose_gel_object: FloatArray
    force_n: FloatArray
    torsion_n_mm: float
    center_mm: NDArray[np.float64]
    share: float
    is_over_gel: bool

    def is_on_gel(self, imprint: Imprint) -> bool:
        """Whether it is the gel that it presses on, as ``imprint`` has it."""
        return self.is_over_gel or imprint.first_touch_mm <= MM_PER_M * TOUCHING_GAP_M


class EngineContacts(ABC):
    """What a sensor asks of the physics engine that it is attached to."""

    def __init__(self, sensor: Sensor) -> None:
        self._sensor = sensor
        self._half_gel_mm = np.array(gel_size_mm(sensor)) / 2
        self._given: dict[int, Mesh | None] = {}
        self._given_with: dict[Part, Hashable] = {}
        self._own: dict[Part, tuple[Hashable, Mesh]] = {}

    def contact(self) -> EngineContact:
        """What presses on the gel now; raises ``SensorError`` if no object is watched."""
        if not self._given:
            msg = "the sensor knows of no object; call add_object with the body that it touches"
            raise SensorError(msg)
        gel = self._gel_pose_m()
        points_m, forces_n, moments_n_m, parts = self._forces_on_gel()
        local_n, twists_n_mm = forces_n @ gel[:3, :3], MM_PER_M * moments_n_m @ gel[:3, 2]
        points_mm = MM_PER_M * (points_m - gel[:3, 3]) @ gel[:3, :3]
        pressed_n = np.maximum(-local_n[:, 2], 0.0)
        level, beyond = self._places(points_mm, pressed_n)
        is_over_gel = bool((pressed_n[level & ~beyond] > 0).any())
        used = level & ~beyond if is_over_gel else level
        whole_n = float(pressed_n[level].sum())
        share = float(pressed_n[used].sum()) / whole_n if whole_n > 0 else 1.0
        touching = sorted({parts[k] for k in np.flatnonzero(used & (pressed_n > 0))})
        pressed_n, local_n, points_mm = pressed_n[used], local_n[used], points_mm[used]
        center_mm = pressed_n @ points_mm[:, :2] / max(float(pressed_n.sum()), 1e-12)
        arms_mm = points_mm[:, :2] - center_mm
        torsion = np.sum(arms_mm[:, 0] * local_n[:, 1] - arms_mm[:, 1] * local_n[:, 0])
        torsion += twists_n_mm[used].sum()
        total = local_n.sum(axis=0)
        force = np.array([total[0], total[1], 0.0 - total[2]])
        mesh, at = self._surface(touching, inverse(gel))
        return EngineContact(mesh, at, force, float(torsion), center_mm, share, is_over_gel)

    def _places(self, points_mm: FloatArray, pressed_n: FloatArray) -> tuple[BoolArray, BoolArray]:
        """Which contacts (n,) are at the height of the gel, and which beyond its rim.

        The engine's shapes are as near to the gel as ``TOUCHING_GAP_M``; what is higher or lower is
        on another face of the sensor's link, or the gel is not where ``pose_link_gel`` says.
        """
        reach_mm = MM_PER_M * TOUCHING_GAP_M
        square = (points_mm[:, :2] ** 2).sum(axis=1).tolist()
        dome_radius_mm = self._sensor.dome_radius_mm
        sag_mm = -np.maximum([dome_mm(one, dome_radius_mm) for one in square], -dome_radius_mm)
        height_mm = points_mm[:, 2]
        lowest_mm = -(sag_mm + self._sensor.gel_depth_mm + reach_mm)
        level = (height_mm <= reach_mm) & (height_mm >= lowest_mm)
        if (pressed_n > 0).any() and not (pressed_n[level] > 0).any():
            off_mm = float(height_mm[np.argmax(pressed_n)])
            text = (
                f"the simulation presses on the sensor's link {abs(off_mm):.3g} mm "
                f"{'above' if off_mm > 0 else 'below'} its gel, so nothing touches the gel; if it "
                "does, the pose of the gel on the link (mm) is another"
            )
            warnings.warn(text, stacklevel=4)
        beyond = np.abs(points_mm[:, :2]) > self._half_gel_mm
        return level, np.asarray(beyond.any(axis=1))

    def _surface(
        self, parts: Sequence[Part], gel_from_world: FloatArray
    ) -> tuple[Mesh, FloatArray]:
        """The surface of the parts that touch, and its pose in the gel frame, mm."""
        found: dict[Part, Mesh] = {}
        for part in parts:
            given = self._given[part[0]]
            if given is not None and self._shapes(part) != self._given_with.get(part):
                msg = (
                    f"body {part[0]} has other shapes than when its mesh was given: the mesh may "
                    "be of another body; call add_object again, with the mesh of this one"
                )
                raise SensorError(msg)
            if given is not None and self._is_of(given, part):
                found[part[0], self._root(part[0])] = given
            else:
                found[part] = self._own_mesh(part)
        if not found:
            return NO_MESH, np.eye(4)
        poses = [_in_mm(gel_from_world @ self._part_pose_m(part)) for part in found]
        if len(found) == 1:
            return next(iter(found.values())), poses[0]
        return _joined(list(found.values()), poses), np.eye(4)

    def _is_of(self, given: Mesh, part: Part) -> bool:
        """Whether an object's given mesh has the part: its root, or one within the mesh's box."""
        root = part[0], self._root(part[0])
        if part == root:
            return True
        try:
            own = self._own_mesh(part).vertices_mm
        except SensorError:  # the engine keeps no shape of it: the given mesh is all there is
            return True
        corners = trimesh.bounds.corners(np.stack([own.min(axis=0), own.max(axis=0)]))
        at = _in_mm(inverse(self._part_pose_m(root)) @ self._part_pose_m(part))
        corners = corners @ at[:3, :3].T + at[:3, 3]
        low, high = given.vertices_mm.min(axis=0), given.vertices_mm.max(axis=0)
        slack_mm = MM_PER_M * TOUCHING_GAP_M
        return bool((corners >= low - slack_mm).all() and (corners <= high + slack_mm).all())

    def _own_mesh(self, part: Part) -> Mesh:
        """The shapes of a part that the engine collides, made again where they change."""
        shapes = self._shapes(part)
        if part not in self._own or self._own[part][0] != shapes:
            self._own[part] = shapes, self._mesh_of(part)
        return self._own[part][1]

    def _watch(self, body: int, parts: Iterable[Part], mesh: Mesh | None) -> None:
        """Watch an object of these parts; a given mesh serves as long as their shapes stay."""
        self._given_with.update((part, self._shapes(part)) for part in parts)
        self._given[body] = mesh

    @abstractmethod
    def clock_s(self) -> float | None:
        """Time of the present state; None where the engine keeps no clock."""

    @abstractmethod
    def time_step_s(self) -> float:
        """Time from one state to the next."""

    @abstractmethod
    def add_object(self, body: Any, mesh: Mesh | None) -> None:
        """Watch for contacts of a body and all its parts.

        ``mesh`` is of the body's root; from the engine's own shapes where None.
        """

    @abstractmethod
    def _root(self, body: int) -> int:
        """The part of an object whose frame is the object's."""

    @abstractmethod
    def _shapes(self, part: Part) -> Hashable:
        """What a part's mesh is made from: engines give its number to another, or change it."""

    @abstractmethod
    def _mesh_of(self, part: Part) -> Mesh:
        """The shapes of a part that the engine collides, in the part's frame."""

    @abstractmethod
    def _gel_pose_m(self) -> FloatArray:
        """Pose (4, 4) of the gel in the world."""

    @abstractmethod
    def _part_pose_m(self, part: Part) -> FloatArray:
        """Pose (4, 4) of a part in the world."""

    @abstractmethod
    def _forces_on_gel(self) -> tuple[FloatArray, FloatArray, FloatArray, list[Part]]:
        """Contact points (n, 3), m; forces and moments on the gel there, N, N m; what presses.

        In world axes.
        """


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
        found = _merged(shapes, f"link {link} of body {body}")
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

    def _fresh_contacts(self) -> list[tuple[Part, tuple[Any, ...]]]:
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
        pressing = [(self._part_of(contact), contact) for contact in raw if contact[9] > 0]
        touching = [(part, contact) for part, contact in pressing if part is not None]
        numbers = [(*c[5], *c[6], *c[7], c[8], *(step_s * c[k] for k in (9, 10, 12))) for c in raw]
        touched = {part for part, _ in touching}
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
            (part, (*c[:9], factor * c[9], factor * c[10], c[11], factor * c[12], *c[13:]))
            for part, c in touching
            if part in near
        ]

    def _part_of(self, contact: tuple[Any, ...]) -> Part | None:
        """The part of an object that a contact point lies on; None where it is not of the gel."""
        sides = (contact[1], contact[3]), (contact[2], contact[4])
        gel = self._body, self._link
        for side, other in (sides, sides[::-1]):
            if other == gel and side != gel and side[0] in self._given:
                return side
        return None

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

    def _forces_on_gel(self) -> tuple[FloatArray, FloatArray, FloatArray, list[Part]]:
        gel = self._body, self._link
        points, forces, parts = list[Any](), list[Any](), list[Part]()
        for part, raw in self._fresh_contacts():
            sides = {(raw[1], raw[3]): 1.0, (raw[2], raw[4]): -1.0}
            # As PyBullet gives them, normal force and friction act on the first.
            on_gel = sides[gel] * (
                raw[9] * np.array(raw[7])
                + raw[10] * np.array(raw[11])
                + raw[12] * np.array(raw[13])
            )
            points.append(raw[5] if sides[part] > 0 else raw[6])
            forces.append(on_gel)
            parts.append(part)
        points_m, forces_n = np.array(points).reshape(-1, 3), np.array(forces).reshape(-1, 3)
        return points_m, forces_n, np.zeros_like(forces_n), parts  # it tells of no moments


class MujocoContacts(EngineContacts):
    """A body of a MuJoCo model that carries the gel."""

    def __init__(
        self, sensor: Sensor, model: Any, data: Any, body: int | str, pose_body_gel_m: FloatArray
    ) -> None:
        import mujoco

        super().__init__(sensor)
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
        """Watch for contacts of a body and those below it; ``mesh`` is in its body frame."""
        number = self._body_id(body)
        parts = [k for k in range(self._model.nbody) if self._object_of(k, {number}) == number]
        for flex in range(self._model.nflex):
            start = self._model.flex_vertadr[flex]
            of_flex = self._model.flex_vertbodyid[start : start + self._model.flex_vertnum[flex]]
            if {*of_flex.tolist()} & {*parts} - {0}:  # it may be pinned to the world
                kind = self._mujoco.mjtObj.mjOBJ_FLEX
                name = self._mujoco.mj_id2name(self._model, kind, flex)
                msg = (
                    f"body {body!r} is of the flex {name!r}, which is soft: "
                    "the sensor cannot draw a surface that the engine deforms; use rigid bodies"
                )
                raise SensorError(msg)
        if not any(self._touching_geoms(k) for k in parts):
            msg = (
                f"body {body!r} has no geom that can touch the sensor's (contype, conaffinity); "
                "name the body that does"
            )
            raise SensorError(msg)
        self._watch(number, [(number, k) for k in parts], mesh)

    def _object_of(self, body: int, objects: Container[int]) -> int | None:
        """The nearest of the objects that a body belongs to; the world's is only itself."""
        if body == self._body:
            return None
        here = body
        while here not in objects and here != 0:
            here = int(self._model.body_parentid[here])
        return here if here in objects and (here != 0 or body == 0) else None

    def _touching_geoms(self, body: int) -> list[int]:
        """The geoms of a body that can touch those of the gel's: others are there for show."""
        model = self._model
        gel, own = (
            range(model.body_geomadr[k], model.body_geomadr[k] + model.body_geomnum[k])
            for k in (self._body, body)
        )
        pairs = {*zip(model.pair_geom1.tolist(), model.pair_geom2.tolist(), strict=True)}

        def touch(one: int, other: int) -> bool:
            masks = model.geom_contype, model.geom_conaffinity
            meets = masks[0][one] & masks[1][other] or masks[0][other] & masks[1][one]
            return bool(meets) or bool({(one, other), (other, one)} & pairs)

        return [one for one in own if any(touch(one, other) for other in gel)]

    def _root(self, body: int) -> int:
        return body

    def _shapes(self, part: Part) -> Hashable:
        return tuple(self._made_from(geom) for geom in self._touching_geoms(part[1]))

    def _made_from(self, geom: int) -> tuple[bytes, ...]:
        model = self._model
        kept = [model.geom_type, model.geom_size, model.geom_pos, model.geom_quat]
        found = [np.array(one[geom]).tobytes() for one in kept]
        if model.geom_type[geom] == self._mujoco.mjtGeom.mjGEOM_MESH:
            found += [one.tobytes() for one in self._mesh(geom)]
        return tuple(found)

    def _mesh(self, geom: int) -> tuple[FloatArray, NDArray[np.int32]]:
        """Vertices and faces of a geom's mesh."""
        model, number = self._model, self._model.geom_dataid[geom]
        vertex, face = model.mesh_vertadr[number], model.mesh_faceadr[number]
        return (
            model.mesh_vert[vertex : vertex + model.mesh_vertnum[number]],
            model.mesh_face[face : face + model.mesh_facenum[number]],
        )

    def _mesh_of(self, part: Part) -> Mesh:
        shapes = [self._shape(k) for k in self._touching_geoms(part[1])]
        found = _merged(shapes, f"body {self._model.body(part[1]).name!r}")
        return Mesh.fixed(MM_PER_M * np.asarray(found.vertices), found.faces)

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
            shape = trimesh.Trimesh(*self._mesh(geom), process=False)
        else:
            name = self._model.geom(geom).name
            msg = f"geom {name!r} has no mesh of its own; give one: add_object(body, mesh=…)"
            raise SensorError(msg)
        w, x, y, z = self._model.geom_quat[geom]
        shape.apply_transform(pose(rotation_of([x, y, z, w]), self._model.geom_pos[geom]))
        return shape

    def _gel_pose_m(self) -> FloatArray:
        return self._part_pose_m((self._body, self._body)) @ self._gel

    def _part_pose_m(self, part: Part) -> FloatArray:
        body = part[1]
        return pose(np.array(self._data.xmat[body]).reshape(3, 3), np.array(self._data.xpos[body]))

    def _joint_places(self, back_s: float) -> FloatArray:
        """Place and rotation (n, 12) of all bodies by the joints, so long before at this speed."""
        there, now = self._scratch, self._data
        there.qpos[:], there.mocap_pos[:], there.mocap_quat[:] = (
            now.qpos, now.mocap_pos, now.mocap_quat,
        )  # fmt: skip
        if back_s:
            self._mujoco.mj_integratePos(self._model, there.qpos, now.qvel, -back_s)
        self._mujoco.mj_kinematics(self._model, there)
        return np.hstack([there.xpos, there.xmat])

    def _refuse_moved(self, parts: Sequence[Part]) -> None:
        """Raise a ``SensorError`` where ``qpos`` was set since poses and contacts were computed.

        MuJoCo computes them at the beginning of a step: they may be as old as that.
        """
        places, step_s = self._joint_places(0.0), self.time_step_s()
        moved = np.linalg.norm(places - self._joint_places(step_s), axis=1)
        there = np.hstack([self._data.xpos, self._data.xmat])
        off = np.linalg.norm(there - places, axis=1)
        for body in {self._body, *self._given, *(body for _, body in parts)}:
            is_mocap = self._model.body_mocapid[self._model.body_rootid[body]] >= 0
            if off[body] > 1e-6 + 2.0 * moved[body] and not is_mocap:
                name = self._model.body(body).name or body
                msg = (
                    f"body {name}: qpos is not that of the contacts: it was set since; call "
                    "mj_forward or mj_step after setting it, before read()"
                )
                raise SensorError(msg)

    def _forces_on_gel(self) -> tuple[FloatArray, FloatArray, FloatArray, list[Part]]:
        points, wrenches, parts = list[FloatArray](), list[FloatArray](), list[Part]()
        for k in range(self._data.ncon):
            contact = self._data.contact[k]
            if min(contact.geom) < 0:  # of a soft body, which has no geoms
                continue
            first, second = (int(self._model.geom_bodyid[g]) for g in contact.geom)
            if self._body not in (first, second):
                continue
            other = first if second == self._body else second
            if (owner := self._object_of(other, self._given)) is None:
                continue
            wrench = np.zeros(6)
            self._mujoco.mj_contactForce(self._model, self._data, k, wrench)
            # In the contact's frame, rows of `frame`; it acts on the second geom. With condim 4
            # and 6 friction also holds the turn about the contact's axes, by a moment.
            on_second = wrench.reshape(2, 3) @ np.array(contact.frame).reshape(3, 3)
            wrenches.append(on_second if second == self._body else -on_second)
            points.append(np.array(contact.pos))
            parts.append((owner, other))
        self._refuse_moved(parts)
        forces_n, moments_n_m = np.array(wrenches).reshape(-1, 2, 3).swapaxes(0, 1)
        return np.array(points).reshape(-1, 3), forces_n, moments_n_m, parts


def _bullet_shape(
    data: tuple[Any, ...], hull: Callable[[], trimesh.Trimesh | None]
) -> trimesh.Trimesh:
    """One collision shape of PyBullet as a mesh in the link's inertial frame, metres.

    ``hull`` gives that of a shape that is of no file.
    """
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
            if kind == pybullet.GEOM_MESH and (found := hull()) is not None:
                return found
            msg = f"PyBullet keeps no mesh file of body {data[0]}; give one: add_object(…, mesh=…)"
            raise SensorError(msg) from None
        shape.apply_scale(sizes)
    shape.apply_transform(pose(rotation_of(data[6]), data[5]))
    return shape


def _capsule(radius_m: float, length_m: float) -> trimesh.Trimesh:
    """A capsule about the origin, its cylinder ``length_m`` long along z."""
    size_mm = MM_PER_M * length_m, MM_PER_M * radius_m  # in metres trimesh drops small triangles
    shape = trimesh.creation.capsule(*size_mm, count=[SECTIONS // 2, SECTIONS // 2])
    shape.apply_scale(1.0 / MM_PER_M)
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

"""A sensor on a body of a user's own MuJoCo model."""

from collections.abc import Container, Hashable, Sequence
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from tacgen.core.engine_contacts import ContactPoint, mujoco_points
from tacgen.core.errors import SensorError
from tacgen.core.records import Mesh, Sensor
from tacgen.core.types import MM_PER_M, FloatArray, pose, rotation_of
from tacgen.sensor.engines import (
    EngineContacts,
    Part,
    merged,
    solid,
)


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
        found = merged(shapes, f"body {self._model.body(part[1]).name!r}")
        return Mesh.fixed(MM_PER_M * np.asarray(found.vertices), found.faces)

    def _shape(self, geom: int) -> trimesh.Trimesh:
        kinds, size = self._mujoco.mjtGeom, self._model.geom_size[geom]
        kind = int(self._model.geom_type[geom])
        solids = {
            int(kinds.mjGEOM_SPHERE): ("sphere", size[0]),
            int(kinds.mjGEOM_ELLIPSOID): ("sphere", 1.0),
            int(kinds.mjGEOM_BOX): ("box", *(2 * size)),
            int(kinds.mjGEOM_CYLINDER): ("cylinder", size[0], 2 * size[1]),
            int(kinds.mjGEOM_CAPSULE): ("capsule", size[0], 2 * size[1]),
        }
        shape: trimesh.Trimesh
        if kind in solids:
            shape = solid(*solids[kind])
        elif kind == kinds.mjGEOM_MESH:
            shape = trimesh.Trimesh(*self._mesh(geom), process=False)
        else:
            name = self._model.geom(geom).name
            msg = f"geom {name!r} has no mesh of its own; give one: add_object(body, mesh=…)"
            raise SensorError(msg)
        if kind == kinds.mjGEOM_ELLIPSOID:
            shape.apply_scale(size)
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

    def _contact_points(self) -> list[ContactPoint[Part]]:
        points = mujoco_points(self._mujoco, self._model, self._data, self._part_of)
        self._refuse_moved([point.part for point in points])
        return points

    def _part_of(self, geom: int, other: int) -> Part | None:
        """The part of an object that a geom is of; None where the other is not the gel's."""
        if min(geom, other) < 0:  # of a soft body, which has no geoms
            return None
        body, touched = (int(self._model.geom_bodyid[k]) for k in (geom, other))
        owner = self._object_of(body, self._given) if touched == self._body else None
        return None if owner is None else (owner, body)

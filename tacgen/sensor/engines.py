"""Poses and contact forces of a user's own simulation, as a sensor on one of its bodies needs them.

Engines are in metres; what leaves this module is in mm, N and the gel frame.
"""

import warnings
from abc import ABC, abstractmethod
from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from tacgen.contact.gel import gel_size_mm
from tacgen.contact.indenter import Imprint
from tacgen.contact.raster import dome_mm
from tacgen.core.engine_contacts import ContactPoint
from tacgen.core.errors import SensorError
from tacgen.core.records import Mesh, Sensor
from tacgen.core.types import MM_PER_M, BoolArray, FloatArray, inverse

SPHERE_SUBDIVISIONS = 6  # 82 k triangles: facets of a ball of 10 mm are then flatter than 1 µm
TOUCHING_GAP_M = 2e-3
"""Bodies farther apart than this, and than they move in a step, do not press on each other: Bullet
lets bodies sink in and rebound by tenths of a millimetre."""

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
        points = self._contact_points()
        rows = [(point.point_m, point.force_n, point.moment_n_m) for point in points]
        points_m, forces_n, moments_n_m = np.array(rows).reshape(-1, 3, 3).swapaxes(0, 1)
        # They act on what touches the gel, and the gel is pressed the other way.
        local_n, twists_n_mm = -forces_n @ gel[:3, :3], -MM_PER_M * moments_n_m @ gel[:3, 2]
        points_mm = MM_PER_M * (points_m - gel[:3, 3]) @ gel[:3, :3]
        pressed_n = np.maximum(-local_n[:, 2], 0.0)
        level, beyond = self._places(points_mm, pressed_n)
        is_over_gel = bool((pressed_n[level & ~beyond] > 0).any())
        used = level & ~beyond if is_over_gel else level
        whole_n = float(pressed_n[level].sum())
        share = float(pressed_n[used].sum()) / whole_n if whole_n > 0 else 1.0
        touching = sorted({points[k].part for k in np.flatnonzero(used & (pressed_n > 0)).tolist()})
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
    def _contact_points(self) -> Sequence[ContactPoint[Part]]:
        """What touches the gel, with the force that acted on it there in the last step."""


def solid(kind: str, *size_m: float) -> trimesh.Trimesh:
    """A ``box`` of extents, a ``sphere`` of a radius, a ``cylinder`` or a ``capsule``, about 0.

    The latter two are of a radius, and their cylinder of a length along z.
    """
    made: trimesh.Trimesh
    if kind == "box":
        made = trimesh.creation.box(size_m)
    elif kind == "sphere":
        made = trimesh.creation.icosphere(SPHERE_SUBDIVISIONS, *size_m)
    elif kind == "cylinder":
        radius_m, length_m = size_m
        made = trimesh.creation.cylinder(radius_m, length_m, sections=SECTIONS)
    else:
        radius_mm, length_mm = (MM_PER_M * size for size in size_m)
        # In metres trimesh drops small triangles.
        count = [SECTIONS // 2, SECTIONS // 2]
        made = trimesh.creation.capsule(length_mm, radius_mm, count=count)
        made.apply_scale(1.0 / MM_PER_M)
        made.apply_translation(-made.bounds.mean(axis=0))
    return made


def merged(shapes: list[trimesh.Trimesh], what: str) -> trimesh.Trimesh:
    """All shapes of a part; raises ``SensorError`` if there are none."""
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

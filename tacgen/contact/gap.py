"""The gap map: how far each point of the gel's surface is from the object."""

import operator
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.contact.gel import gel_map_mm
from tacgen.contact.raster import (
    Float64,
    Int32,
    cut_mesh,
    faces_over,
    rasterize,
    whole_mesh,
)
from tacgen.core.arrays import FloatArray
from tacgen.core.compiled import njit
from tacgen.core.errors import ContactError
from tacgen.core.records import Sensor

CAMERAS = ("raster", "pyrender")

GAP_GRAIN_MM = 2.0**-19
"""Gaps are whole multiples of this (1.9 nm). Below 32 mm such multiples and their differences are
exact in float32, so the indentation keeps its last bit wherever along z the object is."""

NO_OBJECT = 2**30
"""In place of a number of grains where there is no object (or one over half a metre away)."""

FIRST_ROWS = 32
"""Every 32nd row is rasterised first: its smallest gap shows which triangles are too far away to
touch anywhere, whatever the shape of the mesh."""

CUT_AFTER = 30
"""Uses of a mesh before it is cut into cells: that takes as long as about so many uses save."""

DepthCamera = Callable[[Float64, Int32, Float64, Sensor], Float64]


@dataclass(frozen=True, slots=True)
class ObjectGap:
    """The gap of one posed mesh, re-zeroed at first touch.

    Outside the half-open rectangle ``window`` (top, bottom, left, right) of pixels there is no
    object. ``grains`` (bottom − top, right − left) int32 are gaps beyond first touch in units of
    ``GAP_GRAIN_MM``: 0 at the first pixel to touch, ``NO_OBJECT`` where there is none; it is the
    mapper's own memory, valid until its next use. ``first_touch_mm`` is the smallest gap before
    re-zeroing; +inf if there is no object in the window.
    """

    window: tuple[int, int, int, int]
    grains: Int32
    first_touch_mm: float

    @property
    def touches(self) -> bool:
        """Whether there is any object over the window."""
        return bool(np.isfinite(self.first_touch_mm))


@njit(cache=True, nogil=True)
def _smallest_gap(
    depth_mm: Float64, gel_mm: Float64, window: tuple[int, int, int, int], every: int = 1
) -> float:
    """The smallest gap in every n-th row of the window, from its first; +inf if there is none."""
    top, bottom, left, right = window
    smallest = np.full(max(0, right - left), np.inf)
    for r in range(top, bottom, every):
        depth_row, gel_row = depth_mm[r, left:right], gel_mm[r, left:right]
        for k in range(smallest.shape[0]):
            smallest[k] = min(smallest[k], depth_row[k] - gel_row[k])
    return smallest.min() if smallest.shape[0] else np.inf


@njit(cache=True, nogil=True)
def _fill_grains(
    depth_mm: Float64,
    gel_mm: Float64,
    window: tuple[int, int, int, int],
    zero_mm: float,
    grains: Int32,
) -> None:
    """Gaps beyond ``zero_mm``, in whole grains."""
    top, bottom, left, right = window
    per_mm = 1.0 / GAP_GRAIN_MM
    for r in range(top, bottom):
        depth_row, gel_row = depth_mm[r, left:right], gel_mm[r, left:right]
        grains_row = grains[r - top]
        for k in range(grains_row.shape[0]):
            gap = (depth_row[k] - gel_row[k] - zero_mm) * per_mm + 0.5
            grains_row[k] = np.int32(min(gap, NO_OBJECT))


class GapMapper:
    """Takes gap maps of meshes over one sensor, in memory that it keeps.

    Raises ``ContactError`` if the camera is unknown or cannot work on this machine.
    """

    def __init__(self, sensor: Sensor, camera: str = "raster") -> None:
        if camera not in CAMERAS:
            msg = f"camera = {camera!r} is not one of {', '.join(CAMERAS)}"
            raise ContactError(msg)
        self.sensor = sensor
        self._gel_mm = gel_map_mm(sensor)
        self._depth_mm = np.full(sensor.shape_px, np.inf)
        self._drawn = (0, 0, 0, 0)  # the window of the depth map that is not +inf
        self._grains = np.empty(sensor.height_px * sensor.width_px, dtype=np.int32)
        # Of the last mesh, if they cannot change: it has been checked.
        self._arrays: tuple[NDArray[Any], ...] = ()
        self._uses = 0
        self._mesh = whole_mesh(np.empty((0, 3)), np.empty((0, 3), dtype=np.int32))
        self._posed = np.empty((3, 0))
        self._faces = np.empty((0, 3), dtype=np.int32)
        self._camera: DepthCamera | None = None
        if camera == "pyrender":
            from tacgen.contact.pyrender_camera import depth_map_mm

            self._camera = depth_map_mm

    def measure(
        self,
        vertices_mm: FloatArray,
        faces: NDArray[np.integer],
        pose_gel_object: FloatArray,
        *,
        reach_mm: float = np.inf,
    ) -> ObjectGap:
        """The gap of a posed mesh, re-zeroed at first touch.

        ``vertices_mm`` (n, 3) are in the object's frame; ``pose_gel_object`` (4, 4) leads to the
        gel's. Gaps further than ``reach_mm`` beyond first touch may be left at +inf: the depth of
        the gel, say, since nothing further can touch.

        Raises ``ContactError`` if the mesh or pose is no mesh or pose.
        """
        pose = self._take(vertices_mm, faces, pose_gel_object)
        if self._camera is None:
            window, zero_mm = self._rasterize(pose, reach_mm)
        else:
            mesh = self._mesh
            self._depth_mm[...] = self._camera(mesh.vertices_mm, mesh.faces, pose, self.sensor)
            window = (0, self.sensor.height_px, 0, self.sensor.width_px)
            zero_mm = _smallest_gap(self._depth_mm, self._gel_mm, window)
        top, bottom, left, right = window
        if not np.isfinite(zero_mm):
            return ObjectGap((0, 0, 0, 0), np.empty((0, 0), dtype=np.int32), np.inf)
        shape = (bottom - top, right - left)
        grains = self._grains[: shape[0] * shape[1]].reshape(shape)
        _fill_grains(self._depth_mm, self._gel_mm, window, zero_mm, grains)
        return ObjectGap(window, grains, zero_mm + float(pose[2, 3]))

    def _take(
        self, vertices_mm: FloatArray, faces: NDArray[np.integer], pose_gel_object: FloatArray
    ) -> Float64:
        """Make the mesh and its memory ready; returns the pose, checked like the mesh."""
        arrays = (vertices_mm, faces)
        if self._arrays and all(map(operator.is_, arrays, self._arrays)):
            self._uses += 1
            if self._uses == CUT_AFTER and self._mesh.faces.size:
                self._mesh = cut_mesh(self._mesh.vertices_mm, self._mesh.faces)
                self._posed = np.empty((3, len(self._mesh.vertices_mm)))
            return checked_pose(pose_gel_object)
        vertices, corners, pose = checked_mesh(*arrays, pose_gel_object)
        self._arrays, self._uses = arrays if all(map(_is_fixed, arrays)) else (), 1
        self._mesh = whole_mesh(vertices, corners)
        self._posed, self._faces = np.empty((3, len(vertices))), np.empty_like(corners)
        return pose

    def _rasterize(
        self, pose_gel_object: Float64, reach_mm: float
    ) -> tuple[tuple[int, int, int, int], float]:
        sensor, gel_mm, depth_mm = self.sensor, self._gel_mm, self._depth_mm
        mesh, posed, found = self._mesh, self._posed, self._faces
        arrays = (mesh.vertices_mm, mesh.faces, mesh.first, mesh.spheres_mm)
        view = (pose_gel_object, sensor.mm_per_px, sensor.shape_px)
        over = found[: faces_over(*arrays, *view, posed, found)]
        x, y, z = posed
        top, bottom, left, right = self._drawn
        depth_mm[top:bottom, left:right] = np.inf
        first = rasterize(x, y, z, over, gel_mm, np.inf, FIRST_ROWS, depth_mm)
        limit_mm = _smallest_gap(depth_mm, gel_mm, first, FIRST_ROWS) + reach_mm
        rest = rasterize(x, y, z, over, gel_mm, limit_mm, 1, depth_mm)
        self._drawn = (
            min(first[0], rest[0]),
            max(first[1], rest[1]),
            min(first[2], rest[2]),
            max(first[3], rest[3]),
        )
        return rest, _smallest_gap(depth_mm, gel_mm, rest)


def _is_fixed(array: object) -> bool:
    """Whether nothing else can write to the array's memory, as ``frozen_array`` makes it."""
    flags = array.flags if isinstance(array, np.ndarray) else None
    return flags is not None and flags.owndata and not flags.writeable


def gap_map(
    vertices_mm: NDArray[np.floating],
    faces: NDArray[np.integer],
    pose_gel_object: NDArray[np.floating],
    sensor: Sensor,
    *,
    camera: str = "raster",
) -> NDArray[np.float32]:
    """Distance along z from the gel at rest to the nearest surface of a posed mesh.

    Parameters
    ----------
    vertices_mm : (n, 3)
        Object frame, mm.
    faces : (m, 3)
        Indices of each triangle's corners.
    pose_gel_object : (4, 4)
        Object to gel frame, mm.
    sensor : Sensor
    camera : {"raster", "pyrender"}

    Returns
    -------
    (H, W) float32
        Gel frame, mm, dome included; negative where the object reaches into the gel, +inf where
        the ray misses. The centre of pixel (row r, column c) is at x = (c + ½ − W/2) s,
        y = (r + ½ − H/2) s.

    Raises
    ------
    ContactError
        If the mesh or pose is no mesh or pose, or the camera cannot be used.

    Source
    ------
    Si et al. 2022, §III-B: the depth camera at the gel's surface.
    """
    gap = GapMapper(sensor, camera).measure(vertices_mm, faces, pose_gel_object)
    gap_mm = np.full(sensor.shape_px, np.inf, dtype=np.float32)
    if gap.touches:
        top, bottom, left, right = gap.window
        touch = round(gap.first_touch_mm / GAP_GRAIN_MM)
        gap_mm[top:bottom, left:right] = np.where(
            gap.grains == NO_OBJECT, np.inf, (gap.grains + np.int64(touch)) * GAP_GRAIN_MM
        )
    return gap_mm


def checked_pose(pose_gel_object: FloatArray) -> Float64:
    """The pose as the rasteriser reads it; raises ``ContactError`` if it is none."""
    pose = np.ascontiguousarray(pose_gel_object, dtype=np.float64)
    if pose.shape != (4, 4) or not np.isfinite(pose).all():
        msg = f"pose_gel_object of shape {pose.shape} is not (4, 4) finite numbers"
        raise ContactError(msg)
    return pose


def checked_mesh(
    vertices_mm: NDArray[np.floating],
    faces: NDArray[np.integer],
    pose_gel_object: NDArray[np.floating],
) -> tuple[Float64, Int32, Float64]:
    """The mesh and pose in the types that the rasteriser reads.

    Raises ``ContactError`` that lists whatever is wrong with their shapes, values or indices.
    """
    vertices = np.ascontiguousarray(vertices_mm, dtype=np.float64)
    corners = np.ascontiguousarray(faces, dtype=np.int32)
    pose = np.ascontiguousarray(pose_gel_object, dtype=np.float64)
    problems = []
    if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.isfinite(vertices).all():
        problems.append(f"vertices_mm of shape {vertices.shape} are not (n, 3) finite numbers")
    if corners.ndim != 2 or corners.shape[1] != 3:
        problems.append(f"faces of shape {corners.shape} are not (m, 3)")
    elif corners.size and (corners.min() < 0 or corners.max() >= len(vertices)):
        problems.append(
            f"faces name corners {corners.min()} to {corners.max()}, "
            f"but there are {len(vertices)} vertices"
        )
    if pose.shape != (4, 4) or not np.isfinite(pose).all():
        problems.append(f"pose_gel_object of shape {pose.shape} is not (4, 4) finite numbers")
    ContactError.raise_if(problems)
    return vertices, corners, pose

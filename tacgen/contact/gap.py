"""The gap map: how far each point of the gel's surface is from the object."""

import math
import operator
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.contact.gel import gel_map_mm, gel_size_mm
from tacgen.contact.raster import (
    CellMesh,
    Float64,
    Int32,
    PixelGrid,
    cut_mesh,
    dome_mm,
    faces_over,
    rasterize,
    whole_mesh,
)
from tacgen.core.compiled import njit
from tacgen.core.errors import ContactError
from tacgen.core.records import Sensor
from tacgen.core.types import FloatArray

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

BESIDE_MM = 0.5
"""About the size of the pixels of the gel around the window, of which only the balance of forces is
taken: contact patches are some millimetres wide."""

ROTATION_TOLERANCE = 1e-3
"""By which the axes of a pose may be off those of a rotation: more than rounding to four digits."""

_NONE: Int32 = np.empty(0, np.int32)

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
    depth_mm: NDArray[Any],
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


@njit(cache=True, nogil=True)
def _gather_beside(
    depth_mm: Float64,
    gel_mm: Float64,
    outside: NDArray[np.bool_],
    drawn: tuple[int, int, int, int],
    zero_mm: float,
    limit_mm: float,
    grains: Int32,
    places: Int32,
) -> int:
    """Gaps beyond ``zero_mm`` of the pixels ``outside``, below ``limit_mm``, and their places.

    ``depth_mm`` is +inf again where it was ``drawn``. Returns their number.
    """
    top, bottom, left, right = drawn
    count, per_mm = 0, 1.0 / GAP_GRAIN_MM
    if zero_mm == np.inf:
        for r in range(top, bottom):
            for c in range(left, right):
                if outside[r, c]:
                    zero_mm = min(zero_mm, depth_mm[r, c] - gel_mm[r, c])
    for r in range(top, bottom):
        for c in range(left, right):
            gap_mm = depth_mm[r, c] - gel_mm[r, c]
            depth_mm[r, c] = np.inf
            if outside[r, c] and gap_mm < limit_mm:
                gap = (gap_mm - zero_mm) * per_mm + 0.5
                grains[count] = np.int32(max(min(gap, NO_OBJECT), -NO_OBJECT))
                places[count] = r * depth_mm.shape[1] + c
                count += 1
    return count


@njit(cache=True, nogil=True)
def _is_within(columns: Float64, rows: Float64, shape_px: tuple[int, int]) -> bool:
    """Whether all points, in pixels, are in the window."""
    low_x, high_x, low_y, high_y = np.inf, -np.inf, np.inf, -np.inf
    for k in range(columns.shape[0]):
        low_x, high_x = min(low_x, columns[k]), max(high_x, columns[k])
        low_y, high_y = min(low_y, rows[k]), max(high_y, rows[k])
    within_x = low_x >= 0 and high_x <= shape_px[1] - 1
    return bool(within_x and low_y >= 0 and high_y <= shape_px[0] - 1)


def gap_of_map(gap_map_mm: NDArray[np.floating]) -> ObjectGap:
    """The gap of a map (H, W), mm, re-zeroed at first touch; +inf where there is no object."""
    window = (0, gap_map_mm.shape[0], 0, gap_map_mm.shape[1])
    zero_mm, grains = float(gap_map_mm.min()), np.empty(gap_map_mm.shape, np.int32)
    if not np.isfinite(zero_mm):
        return ObjectGap((0, 0, 0, 0), np.empty((0, 0), np.int32), np.inf)
    _fill_grains(gap_map_mm, np.zeros(gap_map_mm.shape), window, zero_mm, grains)
    return ObjectGap(window, grains, zero_mm)


class Surround:
    """The gel around a sensor's window, in pixels of about ``BESIDE_MM``.

    The camera does not see what touches there, but it carries a part of the force.
    """

    def __init__(self, sensor: Sensor) -> None:
        # A power of two, of which images usually are multiples.
        self.pixels = 2 ** max(0, round(math.log2(BESIDE_MM / sensor.mm_per_px)))
        self.pixel_mm = self.pixels * sensor.mm_per_px
        half_window_mm = np.array([sensor.width_px, sensor.height_px]) * sensor.mm_per_px / 2
        size_mm = gel_size_mm(sensor)
        # An even number of pixels, so that the window is whole pixels where it can be.
        columns, rows = (2 * math.ceil(one / (2 * self.pixel_mm) - 1e-6) for one in size_mm)
        self.shape_px = rows, columns
        x_mm, y_mm = (self.pixel_mm * (np.arange(n) + 0.5 - n / 2) for n in (columns, rows))
        self.places_mm = np.stack(np.meshgrid(x_mm, y_mm), axis=-1).reshape(-1, 2)
        away_mm = np.abs(self.places_mm)
        outside = (away_mm > half_window_mm).any(axis=1)
        outside &= (away_mm < np.array(size_mm) / 2).all(axis=1)
        self.outside = outside.reshape(self.shape_px)
        square_mm2 = (self.places_mm**2).sum(axis=1).tolist()
        gel_mm = np.array([dome_mm(one, sensor.dome_radius_mm) for one in square_mm2])
        self.gel_mm = gel_mm.reshape(self.shape_px)
        self._depth_mm = np.full(self.shape_px, np.inf)
        self._grains = np.empty(len(gel_mm), np.int32)
        self._places = np.empty(len(gel_mm), np.int32)
        self._mesh: CellMesh | None = None
        self._posed, self._found = np.empty((3, 0)), np.empty((0, 3), np.int32)
        self.is_there = bool(self.outside.any())

    def gaps(
        self, mesh: CellMesh, pose: Float64, zero_mm: float, reach_mm: float
    ) -> tuple[Int32, Int32]:
        """Gaps beyond ``zero_mm`` as of ``GapMapper.beside``, and their places."""
        if self._mesh is not mesh:  # memory for what is posed of it
            self._mesh, self._posed = mesh, np.empty((3, len(mesh.vertices_mm)))
            self._found = np.empty_like(mesh.faces)
        posed, found = self._posed, self._found
        limit_mm = zero_mm + reach_mm if np.isfinite(zero_mm) else np.inf
        grid = PixelGrid(self.pixel_mm, self.shape_px)
        count = faces_over(mesh, pose, grid, limit_mm, posed, found)
        drawn = rasterize(posed, found[:count], self.gel_mm, limit_mm, 1, self._depth_mm)
        count = _gather_beside(
            *(self._depth_mm, self.gel_mm, self.outside, drawn, zero_mm, limit_mm),
            *(self._grains, self._places),
        )
        return self._grains[:count], self._places[:count]


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
        self._pose, self._zero_mm = np.eye(4), np.inf
        self._camera: DepthCamera | None = None
        if camera == "pyrender":
            from tacgen.contact.pyrender_camera import depth_map_mm

            self._camera = depth_map_mm

    @cached_property
    def _surround(self) -> Surround:
        """The gel around the window, made where it is first asked for."""
        return Surround(self.sensor)

    @property
    def beside_mm(self) -> Float64:
        """Places (n, 2) of the gel around the window, gel frame, mm."""
        return self._surround.places_mm

    @property
    def beside_pixels(self) -> int:
        """How many pixels of the window each of them stands for."""
        return int(self._surround.pixels**2)

    def beside(self, reach_mm: float) -> tuple[Int32, Int32]:
        """Gaps of the gel around the window, of what was measured last, and their places.

        Those (n,) below ``reach_mm`` beyond first touch in the window, in grains: negative where
        the object touches there first. Where there is no object in the window, all of them, beyond
        first touch there. Places (n,) are indices of ``beside_mm``; both are as short-lived as
        ``grains``.
        """
        if not self._surround.is_there:
            return _NONE, _NONE
        columns, rows, _ = self._posed
        is_whole = len(self._mesh.spheres_mm) == 1  # and all its vertices are posed
        if is_whole and _is_within(columns, rows, self.sensor.shape_px):
            return _NONE, _NONE
        return self._surround.gaps(self._mesh, self._pose, self._zero_mm, reach_mm)

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
            self._faces_over(pose)
            self._depth_mm[...] = self._camera(mesh.vertices_mm, mesh.faces, pose, self.sensor)
            window = (0, self.sensor.height_px, 0, self.sensor.width_px)
            zero_mm = _smallest_gap(self._depth_mm, self._gel_mm, window)
        self._pose, self._zero_mm = pose, zero_mm
        if not np.isfinite(zero_mm):
            return ObjectGap((0, 0, 0, 0), np.empty((0, 0), dtype=np.int32), np.inf)
        top, bottom, left, right = window
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

    def _faces_over(self, pose_gel_object: Float64) -> Int32:
        """Pose the mesh; the faces over the window."""
        grid = PixelGrid(self.sensor.mm_per_px, self.sensor.shape_px)
        posed, found = self._posed, self._faces
        return found[: faces_over(self._mesh, pose_gel_object, grid, np.inf, posed, found)]

    def _rasterize(
        self, pose_gel_object: Float64, reach_mm: float
    ) -> tuple[tuple[int, int, int, int], float]:
        gel_mm, depth_mm = self._gel_mm, self._depth_mm
        over = self._faces_over(pose_gel_object)
        posed = self._posed
        top, bottom, left, right = self._drawn
        depth_mm[top:bottom, left:right] = np.inf
        first = rasterize(posed, over, gel_mm, np.inf, FIRST_ROWS, depth_mm)
        limit_mm = _smallest_gap(depth_mm, gel_mm, first, FIRST_ROWS) + reach_mm
        rest = rasterize(posed, over, gel_mm, limit_mm, 1, depth_mm)
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
    if problem := pose_problem(pose):
        msg = f"pose_gel_object {problem}"
        raise ContactError(msg)
    return pose


def pose_problem(pose: Float64) -> str:
    """What is wrong with a pose, with the fix; empty if it is a rotation and a translation."""
    if pose.shape == (4, 4) and _is_rigid(pose):
        return ""
    if pose.shape != (4, 4) or not np.isfinite(pose).all():
        wrong = f"of shape {pose.shape} is not (4, 4) finite numbers"
        return wrong if pose.shape != (4, 4) else "holds values that are not finite"
    if not np.allclose(pose[3], [0.0, 0.0, 0.0, 1.0], atol=ROTATION_TOLERANCE):
        row = ", ".join(f"{one:g}" for one in pose[3])
        return f"has the last row {row} instead of 0, 0, 0, 1; was it transposed?"
    lengths = np.linalg.norm(pose[:3, :3], axis=0)
    if np.abs(lengths - 1.0).max() > ROTATION_TOLERANCE:
        sizes = ", ".join(f"{one:.4g}" for one in lengths)
        fix = "scale a mesh itself: a pose turns and moves"
        return f"is no rotation: its axes are {sizes} long, not 1; {fix}"
    if np.linalg.det(pose[:3, :3]) < 0:
        return "is no rotation: it mirrors (its determinant is -1); turn one of its axes round"
    return "is no rotation: its axes are not at right angles"


@njit(cache=True, nogil=True)
def _is_rigid(pose: Float64) -> bool:
    """Whether the (4, 4) matrix turns and moves, without scaling, shearing or mirroring."""
    for i in range(3):
        if not abs(pose[i, 3]) < np.inf:
            return False
        for j in range(i, 3):
            product = pose[0, i] * pose[0, j] + pose[1, i] * pose[1, j] + pose[2, i] * pose[2, j]
            if not abs(product - (1.0 if i == j else 0.0)) <= ROTATION_TOLERANCE:
                return False
    for j in range(4):
        if not abs(pose[3, j] - (1.0 if j == 3 else 0.0)) <= ROTATION_TOLERANCE:
            return False
    minor_x = pose[1, 1] * pose[2, 2] - pose[1, 2] * pose[2, 1]
    minor_y = pose[1, 0] * pose[2, 2] - pose[1, 2] * pose[2, 0]
    minor_z = pose[1, 0] * pose[2, 1] - pose[1, 1] * pose[2, 0]
    return bool(pose[0, 0] * minor_x - pose[0, 1] * minor_y + pose[0, 2] * minor_z > 0.0)


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
    if problem := pose_problem(pose):
        problems.append(f"pose_gel_object {problem}")
    ContactError.raise_if(problems)
    return vertices, corners, pose

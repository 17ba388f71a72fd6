"""What a pinhole camera sees of meshes: colour, depth and segments, on the processor alone.

One thread, float64, no fast-math and no library between: the same bits on every machine.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tacgen.core.compiled import njit
from tacgen.core.records import Camera, Mesh, frozen_array
from tacgen.objects.shading import nearest_face, view_axes

NEAR_MM = 1.0  # what is nearer to the pinhole is not seen
SAMPLES = 3
"""Samples along each side of a pixel, whose mean is its colour; the middle one has its depth."""
DEPTH_STEP_MM = 1 / 64
"""Depths are rounded to it: finer than any depth camera, and half of a float's bits are then 0."""
AMBIENT = 0.35
LIGHTS = ((0.45, 0.55, 0.7, 0.4), (-0.7, 0.1, 0.7, 0.25), (0.2, -0.8, 0.6, 0.3))
"""Direction towards each light in the world, and its strength: no side of an object is black, and
what faces up is nearly as bright as its colour."""
BACKGROUND_RGB = (255, 255, 255)
FAR, FILLED = 6.0, 0.92
"""Of a picture of things: how far its camera is, in their sizes, and what they fill of a side."""


@dataclass(frozen=True, slots=True)
class Solid:
    """A closed mesh in the world, outward faces, of one colour and one segment."""

    vertices_mm: NDArray[np.float64]
    faces: NDArray[np.int32]
    color_rgb: tuple[int, int, int]
    segment: int = 0


def joined(solids: Sequence[Solid]) -> tuple[Mesh, NDArray[np.int64]]:
    """One mesh of all, and the number of the solid that each of its faces is of."""
    starts = np.cumsum([0, *(len(solid.vertices_mm) for solid in solids)], dtype=np.int32)
    faces = [solid.faces + start for solid, start in zip(solids, starts, strict=False)]
    mesh = Mesh(np.concatenate([s.vertices_mm for s in solids]), np.concatenate(faces))
    return mesh, np.repeat(np.arange(len(solids)), [len(solid.faces) for solid in solids])


@njit(cache=True)
def _in_camera(vertices_mm: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """The points (n, 3) in the axes of a camera whose pose in the world is (4, 4)."""
    seen = np.empty(vertices_mm.shape)
    for i in range(vertices_mm.shape[0]):
        x = vertices_mm[i, 0] - pose[0, 3]
        y = vertices_mm[i, 1] - pose[1, 3]
        z = vertices_mm[i, 2] - pose[2, 3]
        for axis in range(3):
            seen[i, axis] = pose[0, axis] * x + pose[1, axis] * y + pose[2, axis] * z
    return seen


@njit(cache=True)
def _on_cut(seen: np.ndarray, back: int, front: int, point: np.ndarray) -> None:
    """Where an edge comes nearer than ``NEAR_MM``: the same point for both of its faces."""
    share = (NEAR_MM - seen[back, 2]) / (seen[front, 2] - seen[back, 2])
    for axis in range(2):
        point[axis] = seen[back, axis] + share * (seen[front, axis] - seen[back, axis])
    point[2] = NEAR_MM


@njit(cache=True)
def _cut(seen: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, faces of them, and of which face each is, without what is nearer than ``NEAR_MM``."""
    n, m = seen.shape[0], faces.shape[0]
    behind = seen[:, 2] < NEAR_MM
    n_cut = 0
    for f in range(m):
        n_cut += behind[faces[f, 0]] | behind[faces[f, 1]] | behind[faces[f, 2]]
    points = np.zeros((n + 2 * n_cut, 3))
    points[:n] = seen
    kept, source = np.empty((m + n_cut, 3), np.int64), np.empty(m + n_cut, np.int64)
    count, p = 0, n
    for f in range(m):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        near = int(behind[a]) + int(behind[b]) + int(behind[c])
        if near == 3:
            continue
        if near == 0:
            kept[count, 0], kept[count, 1], kept[count, 2], source[count] = a, b, c, f
            count += 1
            continue
        # Turn it so that the odd corner, alone on its side of the cut, is the first.
        while behind[a] != (near == 1) or behind[b] == (near == 1) or behind[c] == (near == 1):
            a, b, c = b, c, a
        if near == 1:
            _on_cut(seen, a, b, points[p])
            _on_cut(seen, a, c, points[p + 1])
            kept[count, 0], kept[count, 1], kept[count, 2], source[count] = p, b, c, f
            count += 1
            kept[count, 0], kept[count, 1], kept[count, 2], source[count] = p, c, p + 1, f
        else:
            _on_cut(seen, b, a, points[p])
            _on_cut(seen, c, a, points[p + 1])
            kept[count, 0], kept[count, 1], kept[count, 2], source[count] = a, p, p + 1, f
        count += 1
        p += 2
    return points[:p], kept[:count], source[:count]


@njit(cache=True)
def _onto_picture(points: np.ndarray, k_px: np.ndarray, samples: int) -> None:
    """Turn points (n, 3) in place into columns and rows of samples, and 1 / depth.

    1 / depth is linear in the picture.
    """
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        if z < NEAR_MM:
            continue  # no face has it
        column = k_px[0, 0] * (x / z) + k_px[0, 1] * (y / z) + k_px[0, 2]
        row = k_px[1, 1] * (y / z) + k_px[1, 2]
        points[i, 0] = samples * column + (samples - 1) / 2
        points[i, 1] = samples * row + (samples - 1) / 2
        points[i, 2] = 1.0 / z


@njit(cache=True)
def _brightness(vertices_mm: np.ndarray, faces: np.ndarray, lights: np.ndarray) -> np.ndarray:
    """Lambert's law of each face under lights (n, 4): unit direction in the world, strength."""
    found = np.empty(faces.shape[0])
    for f in range(faces.shape[0]):
        a, b, c = vertices_mm[faces[f, 0]], vertices_mm[faces[f, 1]], vertices_mm[faces[f, 2]]
        x = (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1])
        y = (b[2] - a[2]) * (c[0] - a[0]) - (b[0] - a[0]) * (c[2] - a[2])
        z = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        length = math.sqrt(x * x + y * y + z * z)
        found[f] = AMBIENT
        if length > 0.0:
            for k in range(lights.shape[0]):
                along = (x * lights[k, 0] + y * lights[k, 1] + z * lights[k, 2]) / length
                found[f] += lights[k, 3] * max(0.0, along)
    return found


@njit(cache=True)
def _resolved(
    nearness: np.ndarray,
    face: np.ndarray,
    color: np.ndarray,
    segment: np.ndarray,
    background: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The pictures from samples: the mean of the colours, and what the middle one sees."""
    samples = SAMPLES  # along a pixel
    height, width = face.shape[0] // samples, face.shape[1] // samples
    rgb, total = np.empty((height, width, 3), np.uint8), np.empty(3)
    depth_mm, ids = np.zeros((height, width), np.float32), np.zeros((height, width), np.uint8)
    for row in range(height):
        for column in range(width):
            total[:] = 0.0
            for i in range(samples * row, samples * (row + 1)):
                for j in range(samples * column, samples * (column + 1)):
                    f = face[i, j]
                    for k in range(3):
                        total[k] += background[k] if f < 0 else color[f, k]
            for k in range(3):
                rgb[row, column, k] = np.uint8(math.floor(total[k] / (samples * samples) + 0.5))
            i, j = samples * row + samples // 2, samples * column + samples // 2
            f = face[i, j]
            if f >= 0:
                ids[row, column] = segment[f]
                steps = math.floor(1.0 / nearness[i, j] / DEPTH_STEP_MM + 0.5)
                depth_mm[row, column] = np.float32(steps * DEPTH_STEP_MM)
    return rgb, depth_mm, ids


def pinhole_view(
    camera: Camera, solids: Sequence[Solid]
) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.uint8]]:
    """What a camera sees: RGB (H, W, 3), depth along its axis in mm (H, W), segments (H, W).

    Depth and segment are those of the middle of each pixel, exact but for ``DEPTH_STEP_MM``; 0
    where there is nothing. Surfaces are matt, lit by lights that stand still in the world, without
    shadows; the background is white.
    """
    mesh, of = joined(solids)
    segment = np.array([solid.segment for solid in solids], np.uint8)[of]
    plain = np.array([solid.color_rgb for solid in solids], np.float64)[of]
    lights = np.array(LIGHTS)
    lights[:, :3] /= np.sqrt((lights[:, :3] ** 2).sum(axis=1, keepdims=True))
    color = np.minimum(plain * _brightness(mesh.vertices_mm, mesh.faces, lights)[:, None], 255.0)
    points, kept, source = _cut(_in_camera(mesh.vertices_mm, camera.t_world_camera_mm), mesh.faces)
    _onto_picture(points, camera.k_px, SAMPLES)
    height, width = camera.shape_px
    nearness, seen = nearest_face(points, kept, SAMPLES * height, SAMPLES * width)
    background = np.array(BACKGROUND_RGB, np.float64)
    return _resolved(nearness, seen, color[source], segment[source], background)


def camera_around(
    points_mm: NDArray[np.float64],
    size_px: tuple[int, int],
    azimuth_deg: float,
    elevation_deg: float,
) -> Camera:
    """A far camera, from a direction, whose picture (height, width) a box around points fills."""
    ends_mm = np.array([points_mm.min(axis=0), points_mm.max(axis=0)])
    corners_mm = np.array([ends_mm[choice, range(3)] for choice in np.ndindex(2, 2, 2)])
    right, up, towards = view_axes(azimuth_deg, elevation_deg)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, -up, -towards], axis=1)
    size_mm = float(np.linalg.norm(ends_mm[1] - ends_mm[0]))
    pose[:3, 3] = ends_mm.mean(axis=0) + FAR * size_mm * towards
    x, y, z = _in_camera(corners_mm, pose).T
    across = np.stack([x / z, y / z], axis=1)
    low, high = across.min(axis=0), across.max(axis=0)
    sides_px = np.array(size_px[::-1])
    focal_px = FILLED * float((sides_px / (high - low)).min())
    x_px, y_px = (sides_px - 1) / 2 - focal_px * (low + high) / 2
    k_px = frozen_array([[focal_px, 0, x_px], [0, focal_px, y_px], [0, 0, 1]])
    return Camera("around", *size_px, k_px, frozen_array(pose))

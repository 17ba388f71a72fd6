"""A small shaded orthographic view of a mesh, on the processor alone."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.core.compiled import njit
from tacgen.core.records import Mesh

LIGHTS = ((0.45, 0.55, 0.7, 0.75), (-0.7, 0.1, 0.7, 0.45))
"""Direction towards each light in view axes (right, up, towards the viewer), and its strength."""


@njit(cache=True)
def nearest_face(
    points: np.ndarray, faces: np.ndarray, height: int, width: int
) -> tuple[np.ndarray, np.ndarray]:
    """The largest third coordinate (−inf: none) and its face (−1) at whole columns and rows.

    ``points`` (n, 3) are column, row, and what grows towards the viewer, linear in the picture.
    """
    depth = np.full((height, width), -np.inf)
    face = np.full((height, width), -1, np.int64)
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ay, by, cy = points[a, 1], points[b, 1], points[c, 1]
        first_row = max(0, int(np.ceil(min(ay, by, cy))))
        last_row = min(height - 1, int(np.floor(max(ay, by, cy))))
        if first_row > last_row:
            continue
        ax, bx, cx = points[a, 0], points[b, 0], points[c, 0]
        first_column = max(0, int(np.ceil(min(ax, bx, cx))))
        last_column = min(width - 1, int(np.floor(max(ax, bx, cx))))
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if first_column > last_column or area == 0.0:
            continue
        az, bz, cz = points[a, 2], points[b, 2], points[c, 2]
        for row in range(first_row, last_row + 1):
            for column in range(first_column, last_column + 1):
                u = ((bx - column) * (cy - row) - (cx - column) * (by - row)) / area
                v = ((cx - column) * (ay - row) - (ax - column) * (cy - row)) / area
                w = 1.0 - u - v
                if u < -1e-9 or v < -1e-9 or w < -1e-9:
                    continue
                z = u * az + v * bz + w * cz
                if z > depth[row, column]:
                    depth[row, column] = z
                    face[row, column] = f
    return depth, face


@njit(cache=True)
def _mean_of_samples(colors: np.ndarray, sample: np.ndarray, picture: np.ndarray) -> None:
    """Fill ``picture`` (H, W, 3) with the means of the ``colors`` (n, 3) of 2 × 2 samples each."""
    for row in range(picture.shape[0]):
        for column in range(picture.shape[1]):
            upper, lower = sample[2 * row], sample[2 * row + 1]
            left, right = 2 * column, 2 * column + 1
            for k in range(3):
                above = colors[upper[left], k] + colors[upper[right], k]
                below = colors[lower[left], k] + colors[lower[right], k]
                picture[row, column, k] = np.uint8(min(max((above + below) / 4, 0.0), 255.0))


def view_axes(azimuth_deg: float, elevation_deg: float) -> NDArray[np.float64]:
    """Rows (3, 3): the view's right, up and towards-the-viewer, for a viewer at those angles."""
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    flat = np.array([np.cos(azimuth), np.sin(azimuth)])
    towards = np.append(np.cos(elevation) * flat, np.sin(elevation))
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    return np.stack([right, np.cross(towards, right), towards])


def depth_view(
    mesh: Mesh,
    axes: NDArray[np.float64],
    center_mm: NDArray[np.float64],
    size_px: tuple[int, int],
    mm_per_px: float,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Height towards the viewer, mm (−inf: nothing), and the face seen (−1), each (H, W)."""
    height, width = size_px
    seen = (mesh.vertices_mm - center_mm) @ axes.T
    seen[:, 0] = seen[:, 0] / mm_per_px + (width - 1) / 2
    seen[:, 1] = (height - 1) / 2 - seen[:, 1] / mm_per_px
    depth, face = nearest_face(seen, mesh.faces, height, width)
    return depth, face


def shaded_view(
    mesh: Mesh,
    color_rgb: tuple[int, int, int] | NDArray[Any],
    *,
    azimuth_deg: float,
    elevation_deg: float,
    size_px: tuple[int, int] = (480, 480),
    fill: float = 0.92,
) -> NDArray[np.uint8]:
    """A shaded picture (H, W, 3) of the whole mesh on white, smoothed by 2 × 2 samples.

    ``color_rgb`` is one colour, or one a face, (m, 3).
    """
    axes = view_axes(azimuth_deg, elevation_deg)
    flat = np.ascontiguousarray((mesh.vertices_mm @ axes.T).T)
    low, high = flat.min(axis=1), flat.max(axis=1)
    samples = (2 * size_px[0], 2 * size_px[1])
    extent = (high - low)[:2]
    mm_per_px = float(max(extent[0] / samples[1], extent[1] / samples[0]) / fill)
    center = axes.T @ ((low + high) / 2)
    _, face = depth_view(mesh, axes, center, samples, mm_per_px)

    # Only faces that are seen need a shade: a few hundred of a fine mesh in a small picture.
    is_shown = np.zeros(len(mesh.faces) + 1, dtype=bool)  # the last: −1, nothing
    is_shown[face] = True
    shown = np.flatnonzero(is_shown[:-1])
    place = np.full(len(is_shown), len(shown))
    place[shown] = np.arange(len(shown))
    corners = mesh.vertices_mm[mesh.faces[shown]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30) @ axes.T
    light = np.full(len(shown), 0.25)
    gloss = np.zeros(len(shown))
    for *direction, strength in LIGHTS:
        towards = np.array(direction) / np.linalg.norm(direction)
        light += strength * np.clip(normals @ towards, 0, None)
        half = towards + np.array([0.0, 0.0, 1.0])
        gloss += 0.25 * strength * np.clip(normals @ (half / np.linalg.norm(half)), 0, None) ** 30
    colors = np.broadcast_to(color_rgb, (len(mesh.faces), 3))[shown]
    shade = colors * light[:, None] + 255 * gloss[:, None]
    picture = np.empty((*size_px, 3), dtype=np.uint8)
    _mean_of_samples(np.vstack([shade, [255.0, 255.0, 255.0]]), place[face], picture)
    return picture

"""What is nearest in a picture of a mesh, on the processor alone; orthographic views."""

import numpy as np
from numpy.typing import NDArray

from tacgen.core.compiled import njit
from tacgen.core.records import Mesh


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

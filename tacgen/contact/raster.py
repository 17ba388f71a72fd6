"""Exact orthographic depth of a posed mesh in the pad's window, by a z-buffer in numba.

One thread, float64, no fast-math and no fused operations: the same bits on every machine.
"""

import math
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from tacgen.core.compiled import njit

Float64: TypeAlias = NDArray[np.float64]
Int32: TypeAlias = NDArray[np.int32]

CELL_MM = 4.0  # of a cut mesh: a fifth of a sensor's window, and some 50 faces
MOST_CELLS = 1024  # along an axis: what lies over 4 m from the mesh's end is in the last cell


class CellMesh(NamedTuple):
    """A mesh cut into cells with vertices of their own: one beside the window is not looked into.

    ``vertices_mm`` (n, 3) and ``faces`` (m, 3) lie cell by cell; ``first`` (c + 1, 2) is the first
    vertex and face of each, ``spheres_mm`` (c, 4) the centre and radius of one around it.
    """

    vertices_mm: Float64
    faces: Int32
    first: Int32
    spheres_mm: Float64


class PixelGrid(NamedTuple):
    """Rows and columns of pixels about the middle of the gel."""

    mm_per_px: float
    shape_px: tuple[int, int]


def cut_mesh(vertices_mm: Float64, faces: Int32) -> CellMesh:
    """The mesh in cells of ``CELL_MM``; a face belongs to that of its first corner."""
    cells = ((vertices_mm - vertices_mm.min(axis=0)) / CELL_MM).clip(max=MOST_CELLS - 1)
    cells = cells.astype(np.int64)
    cell = np.ravel_multi_index(tuple(cells.T), tuple(cells.max(axis=0) + 1))
    key = cell.astype(np.min_scalar_type(cell.max()))[faces[:, 0]]  # short: sorted sooner
    order = np.argsort(key, kind="stable")
    starts = np.concatenate([[0], 1 + np.flatnonzero(np.diff(key[order])), [len(faces)]])
    return CellMesh(*_by_cell(vertices_mm, faces[order], starts))


def whole_mesh(vertices_mm: Float64, faces: Int32) -> CellMesh:
    """The mesh as one cell: cutting it pays only where it is used often."""
    first = np.array([[0, 0], [len(vertices_mm), len(faces)]], dtype=np.int32)
    everywhere = np.array([[0.0, 0.0, 0.0, np.inf]])
    return CellMesh(vertices_mm, faces, first, everywhere)


@njit(cache=True, nogil=True)
def _by_cell(
    vertices_mm: Float64, faces: Int32, starts: NDArray[np.int64]
) -> tuple[Float64, Int32, Int32, Float64]:
    """The fields of a ``CellMesh`` whose cells begin at the faces ``starts`` (the last ends)."""
    n_cells = starts.shape[0] - 1
    cell_of, place_of = np.full(len(vertices_mm), -1), np.empty(len(vertices_mm), np.int32)
    vertices, own = np.empty((3 * len(faces), 3)), np.empty(faces.shape, np.int32)
    first, spheres = np.zeros((n_cells + 1, 2), np.int32), np.empty((n_cells, 4))
    count = 0
    for cell in range(n_cells):
        for i in range(starts[cell], starts[cell + 1]):
            for j in range(3):
                corner = faces[i, j]
                if cell_of[corner] != cell:
                    cell_of[corner], place_of[corner] = cell, count
                    vertices[count] = vertices_mm[corner]
                    count += 1
                own[i, j] = place_of[corner]
        first[cell + 1, 0], first[cell + 1, 1] = count, starts[cell + 1]
        part = vertices[first[cell, 0] : count]
        for axis in range(3):
            spheres[cell, axis] = (part[:, axis].min() + part[:, axis].max()) / 2
        offsets = part - spheres[cell, :3]
        spheres[cell, 3] = math.sqrt((offsets * offsets).sum(axis=1).max())
    return vertices[:count].copy(), own, first, spheres


@njit(cache=True, nogil=True)
def faces_over(
    mesh: CellMesh,
    pose_gel_object: Float64,
    grid: PixelGrid,
    highest_mm: float,
    posed: Float64,
    found: Int32,
) -> int:
    """Pose a mesh; write the faces whose bounding rectangle holds a pixel's centre.

    Those all of whose corners are above ``highest_mm`` may be left out.
    ``posed`` (3, n) are the fractional column and row (0 at the first pixel's centre) and z in mm
    of the vertices, but for those of cells beside the window; returns the number of faces found.

    The translation along z is left out: the indentation does not depend on it, and without it not
    even the last bit does.
    """
    t = pose_gel_object
    vertices_mm, faces, first, spheres_mm = mesh
    per_px, shape_px = 1.0 / grid.mm_per_px, grid.shape_px
    half_row = 0.5 * shape_px[0] - 0.5
    half_column = 0.5 * shape_px[1] - 0.5
    columns, rows, heights_mm = posed[0], posed[1], posed[2]
    across = math.sqrt(t[0, 0] ** 2 + t[0, 1] ** 2 + t[0, 2] ** 2) * per_px
    down = math.sqrt(t[1, 0] ** 2 + t[1, 1] ** 2 + t[1, 2] ** 2) * per_px
    count = 0
    for cell in range(spheres_mm.shape[0]):
        x, y, z, radius = spheres_mm[cell]
        column = (t[0, 0] * x + t[0, 1] * y + t[0, 2] * z + t[0, 3]) * per_px
        row = (t[1, 0] * x + t[1, 1] * y + t[1, 2] * z + t[1, 3]) * per_px
        # Half a pixel more than the pixels' centres reach, for rounding.
        if abs(column) > half_column + 0.5 + across * radius:
            continue
        if abs(row) > half_row + 0.5 + down * radius:
            continue
        for i in range(first[cell, 0], first[cell + 1, 0]):
            x, y, z = vertices_mm[i, 0], vertices_mm[i, 1], vertices_mm[i, 2]
            columns[i] = (t[0, 0] * x + t[0, 1] * y + t[0, 2] * z + t[0, 3]) * per_px + half_column
            rows[i] = (t[1, 0] * x + t[1, 1] * y + t[1, 2] * z + t[1, 3]) * per_px + half_row
            heights_mm[i] = t[2, 0] * x + t[2, 1] * y + t[2, 2] * z
        for i in range(first[cell, 1], first[cell + 1, 1]):
            a, b, c = faces[i, 0], faces[i, 1], faces[i, 2]
            if min(heights_mm[a], heights_mm[b], heights_mm[c]) > highest_mm:
                continue
            ya, yb, yc = rows[a], rows[b], rows[c]
            low, high = max(0.0, min(ya, yb, yc)), min(shape_px[0] - 1.0, max(ya, yb, yc))
            if low > high or math.ceil(low) > high:
                continue
            xa, xb, xc = columns[a], columns[b], columns[c]
            low, high = max(0.0, min(xa, xb, xc)), min(shape_px[1] - 1.0, max(xa, xb, xc))
            if low > high or math.ceil(low) > high:
                continue
            found[count, 0], found[count, 1], found[count, 2] = a, b, c
            count += 1
    return count


@njit(cache=True, nogil=True)
def dome_mm(square_mm2: float, radius_mm: float) -> float:
    """Rest height of the gel so far, squared, from its middle; as ``gel_map_mm``."""
    if radius_mm == 0.0:
        return 0.0
    if square_mm2 >= radius_mm**2:
        return -np.inf
    return -square_mm2 / (radius_mm + math.sqrt(radius_mm**2 - square_mm2))


@njit(cache=True, nogil=True)
def rasterize(
    posed: Float64,
    faces: Int32,
    gel_mm: Float64,
    gap_limit_mm: float,
    every: int,
    depth_mm: Float64,
) -> tuple[int, int, int, int]:
    """Lower ``depth_mm`` (H, W) to the nearest surface over pixels' centres in ``every`` n-th row.

    ``posed`` (3, n) are columns, rows and z in mm of the vertices, as ``faces_over`` writes them.
    Triangles that lie outside the window, or everywhere further than ``gap_limit_mm`` above the
    gel at rest ``gel_mm`` (H, W), are left out. An edge belongs to both of its triangles, and both
    compute its crossing with a row from the same numbers, so that no pixel falls between them.
    Returns the half-open rectangle (top, bottom, left, right) of pixels that was touched; empty
    where top >= bottom.
    """
    columns, rows, heights_mm = posed[0], posed[1], posed[2]
    n_rows, n_columns = depth_mm.shape
    top, bottom, left, right = n_rows, 0, n_columns, 0
    for i in range(faces.shape[0]):
        a, b, c = faces[i, 0], faces[i, 1], faces[i, 2]
        za, zb, zc = heights_mm[a], heights_mm[b], heights_mm[c]
        z_low, z_high = min(za, zb, zc), max(za, zb, zc)
        if z_low > gap_limit_mm:
            continue
        ya, yb, yc = rows[a], rows[b], rows[c]
        row_start = max(0.0, math.ceil(min(ya, yb, yc)))
        row_last = min(n_rows - 1.0, math.floor(max(ya, yb, yc)))
        row_start = every * math.ceil(row_start / every)
        if row_start > row_last:
            continue
        xa, xb, xc = columns[a], columns[b], columns[c]
        # The gel is highest at its middle, and so under a triangle where that is nearest.
        nearest_row = int(min(max(n_rows // 2, row_start), row_last))
        nearest_column = int(min(max(n_columns // 2, min(xa, xb, xc)), max(xa, xb, xc)))
        if z_low - gel_mm[nearest_row, nearest_column] > gap_limit_mm:
            continue
        area = (xb - xa) * (yc - ya) - (xc - xa) * (yb - ya)
        if area == 0.0:
            continue
        slope_x = ((zb - za) * (yc - ya) - (zc - za) * (yb - ya)) / area
        slope_y = ((zc - za) * (xb - xa) - (zb - za) * (xc - xa)) / area
        z_origin = za - xa * slope_x - ya * slope_y
        # Sort by row, then column: an edge always runs from its lower end to its upper.
        if yb < ya or (yb == ya and xb < xa):
            xa, ya, xb, yb = xb, yb, xa, ya
        if yc < yb or (yc == yb and xc < xb):
            xb, yb, xc, yc = xc, yc, xb, yb
            if yb < ya or (yb == ya and xb < xa):
                xa, ya, xb, yb = xb, yb, xa, ya
        long_slope = (xc - xa) / (yc - ya)
        low_slope = (xb - xa) / (yb - ya) if yb > ya else 0.0
        high_slope = (xc - xb) / (yc - yb) if yc > yb else 0.0
        for r in range(int(row_start), int(row_last) + 1, every):
            x_long = xa + (r - ya) * long_slope
            x_short = xa + (r - ya) * low_slope if r < yb else xb + (r - yb) * high_slope
            start = int(max(0.0, math.ceil(min(x_long, x_short))))
            end = int(min(n_columns - 1.0, math.floor(max(x_long, x_short)))) + 1
            if start >= end:
                continue
            z_row, span_mm = z_origin + r * slope_y, depth_mm[r, start:end]
            for k in range(end - start):
                # A sliver's plane is steep: its own corners bound what rounding may do.
                z = min(max(z_row + (start + k) * slope_x, z_low), z_high)
                span_mm[k] = min(span_mm[k], z)
            top, bottom = min(top, r), max(bottom, r + 1)
            left, right = min(left, start), max(right, end)
    return top, bottom, left, right

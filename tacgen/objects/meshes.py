"""Closed meshes: mass properties, convex hulls and conversion for boolean operations."""

import itertools
from collections.abc import Sequence

import manifold3d
import numpy as np
from numpy.typing import NDArray

from tacgen.core.records import Mesh, frozen_array
from tacgen.core.types import FloatArray

VERTEX_DECIMALS = 6
"""Vertices are rounded to 1e-6 mm, so that the last bits of a sine do not reach the mesh."""


def rounded_mesh(vertices_mm: FloatArray, faces: NDArray[np.integer]) -> Mesh:
    """A read-only mesh with its vertices on the grid of ``VERTEX_DECIMALS``."""
    rounded = np.round(np.asarray(vertices_mm, dtype=np.float64), VERTEX_DECIMALS) + 0.0
    return Mesh(frozen_array(rounded), frozen_array(faces, np.int32))


def hull(points_mm: FloatArray) -> Mesh:
    """The convex hull of points (n, 3), faces outward."""
    from scipy.spatial import ConvexHull  # slow to import, and loading an object does not need it

    points_mm = np.round(np.asarray(points_mm, dtype=np.float64).reshape(-1, 3), VERTEX_DECIMALS)
    found = ConvexHull(points_mm)
    corners = points_mm[found.simplices]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.einsum("ij,ij->i", normals, found.equations[:, :3]) < 0
    faces = np.where(inward[:, None], found.simplices[:, ::-1], found.simplices)
    used, faces = np.unique(faces, return_inverse=True)
    return rounded_mesh(points_mm[used], faces.reshape(-1, 3))


def to_manifold(solid: Mesh) -> manifold3d.Manifold:
    """``solid`` for boolean operations, in double precision."""
    return manifold3d.Manifold(
        manifold3d.Mesh64(
            np.array(solid.vertices_mm, dtype=np.float64), np.array(solid.faces, dtype=np.uint64)
        )
    )


def from_manifold(solid: manifold3d.Manifold) -> Mesh:
    """The mesh of a boolean's result."""
    out = solid.to_mesh64()
    return rounded_mesh(np.asarray(out.vert_properties)[:, :3], np.asarray(out.tri_verts))


def is_inside(solid: Mesh, point_mm: FloatArray) -> bool:
    """Whether a point is within a closed mesh: the solid angles of its faces add up to 4π there."""
    angles = solid_angles(solid.vertices_mm[solid.faces] - point_mm)
    return bool(abs(angles.sum()) > 2 * np.pi)


def solid_angles(corners_mm: FloatArray) -> FloatArray:
    """The solid angle (n,) of each triangle (n, 3, 3) from the origin, by the side that it shows.

    Those of a closed surface add up to ±4π inside, to 0 outside.

    Source: van Oosterom & Strackee 1983, The solid angle of a plane triangle.
    """
    a, b, c = np.moveaxis(corners_mm, 1, 0)
    x, y, z = (np.linalg.norm(corner, axis=1) for corner in (a, b, c))
    ab, ac, bc = (np.einsum("ij,ij->i", *pair) for pair in ((a, b), (a, c), (b, c)))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    return np.asarray(2 * np.arctan2(volume, x * y * z + ab * z + ac * y + bc * x))


def volume_mm3(solid: Mesh) -> float:
    """Volume enclosed by a closed mesh; negative where its faces point inward."""
    return float(_six_volumes(solid.vertices_mm[solid.faces]).sum() / 6)


def mass_properties(
    bodies: Sequence[tuple[Mesh, float]], mass_kg: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centre of mass (3,), mm, and the inertia about it (3, 3), kg mm², along the meshes' axes.

    The bodies, closed meshes with relative densities, weigh ``mass_kg`` together.

    Source: the second moments of a tetrahedron with one corner at the origin,
    det/120 · (Σ_i p_i p_iᵀ + (Σ p)(Σ p)ᵀ).
    """
    total, first, second = 0.0, np.zeros(3), np.zeros((3, 3))
    for solid, density in bodies:
        corners = solid.vertices_mm[solid.faces]
        weight = density * _six_volumes(corners)
        sums = corners.sum(axis=1)
        total += weight.sum() / 6
        first += (weight[:, None] * sums).sum(axis=0) / 24
        # Plain sums: a matrix product's last bits depend on the number of threads.
        for i, j in itertools.product(range(3), repeat=2):
            products = (corners[:, :, i] * corners[:, :, j]).sum(axis=1) + sums[:, i] * sums[:, j]
            second[i, j] += (weight * products).sum() / 120
    center = first / total
    covariance = second - total * np.outer(center, center)
    inertia = np.trace(covariance) * np.eye(3) - covariance
    return center, inertia * (mass_kg / total)


def _six_volumes(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Six times the signed volume of each tetrahedron (n, 3, 3) with a corner at the origin."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    return np.asarray((a * np.cross(b, c)).sum(axis=1))

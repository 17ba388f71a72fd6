"""A twisty cube and a golf ball."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from scripts.make_objects.cans import offset_rings
from scripts.make_objects.profiles import rounded_rectangle
from scripts.make_objects.shape import Shape, loft, moved, union
from tacgen.core.records import Mesh
from tacgen.objects.meshes import hull, rounded_mesh


def twisty_cube(
    *,
    side_mm: float,
    cubie_gap_mm: float = 0.15,
    cubie_edge_mm: float = 1.3,
    sticker_mm: float = 0.1,
    sticker_margin_mm: float = 1.7,
    edge_steps: int = 6,
) -> Shape:
    """3 × 3 × 3 cubies with rounded edges and a sticker on each outer face.

    ``side_mm`` is over the stickers. The hidden middle is one block.
    """
    pitch = (side_mm / 2 - sticker_mm + cubie_gap_mm / 2) / 1.5
    half = (pitch - cubie_gap_mm) / 2
    cubie = rounded_cube(half, cubie_edge_mm, edge_steps)
    middle = side_mm / 2
    spots = [np.array(spot) for spot in itertools.product((-1.0, 0.0, 1.0), repeat=3)]
    block = rounded_cube(1.5 * pitch - 2 * cubie_edge_mm, cubie_edge_mm, 1)
    solids = [moved(cubie, shift_mm=pitch * spot) for spot in spots if np.any(spot)]
    stickers = _stickers(half, sticker_margin_mm, sticker_mm, pitch)
    surface = moved(union([block, *solids, *stickers]), shift_mm=np.array([0.0, 0.0, middle]))

    near, far = middle - cubie_edge_mm, middle
    corners = itertools.product((-1.0, 1.0), repeat=3)
    points = [
        np.array(signs) * np.roll([far, near, near], axis) for signs in corners for axis in range(3)
    ]
    return Shape(surface, (hull(np.array(points) + np.array([0.0, 0.0, middle])),))


def rounded_cube(half_mm: float, edge_mm: float, edge_steps: int) -> Mesh:
    """A cube centred at the origin whose edges are rounded by ``edge_mm``."""
    angle = np.linspace(0, np.pi / 4, edge_steps + 1)
    edge = half_mm - edge_mm + edge_mm * np.tan(angle)
    line = np.concatenate([-edge[::-1], edge])
    n = len(line)
    u, v = np.meshgrid(line, line, indexing="ij")
    top = np.stack([u, v, np.full_like(u, half_mm)], axis=-1).reshape(-1, 3)
    here = np.arange(n * n).reshape(n, n)
    a, b, c, d = here[:-1, :-1], here[1:, :-1], here[1:, 1:], here[:-1, 1:]
    quad = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    points: list[NDArray[np.float64]] = []
    faces: list[NDArray[np.int64]] = []
    for axis, sign in itertools.product(range(3), (1.0, -1.0)):
        # (u, v, w) → cyclic permutation keeps the winding; the opposite face mirrors u.
        points.append(np.roll(top * [sign, 1.0, sign], axis, axis=1))
        faces.append(quad + len(faces) * n * n)
    surface = np.concatenate(points)
    inner = np.clip(surface, edge_mm - half_mm, half_mm - edge_mm)
    out = surface - inner
    rounded = inner + edge_mm * out / np.linalg.norm(out, axis=1, keepdims=True)
    rounded, index = np.unique(np.round(rounded, 6), axis=0, return_inverse=True)
    return rounded_mesh(rounded, index.ravel()[np.concatenate(faces)])


def _stickers(half_mm: float, margin_mm: float, thickness_mm: float, pitch_mm: float) -> list[Mesh]:
    """54 rounded slabs, sunk into their cubies, with softened upper edges."""
    side = half_mm - margin_mm
    outline, normals = rounded_rectangle(side, side, 1.6, 4.0, corner_steps=8)
    soft = 0.4 * thickness_mm
    rows = np.array([[0.0, -0.4], [0.0, thickness_mm - soft], [-soft, thickness_mm]])
    slab = loft(offset_rings(outline, normals, rows + np.array([0.0, half_mm])))
    result = []
    for axis, sign in itertools.product(range(3), (1.0, -1.0)):
        turn = np.roll(np.diag([sign, 1.0, sign]), axis, axis=0)
        for i, j in itertools.product((-1.0, 0.0, 1.0), repeat=2):
            spot = np.roll(pitch_mm * np.array([i, j, sign]), axis)
            result.append(moved(slab, turn=turn, shift_mm=spot))
    return result


def golf_ball(
    *,
    diameter_mm: float,
    dimple_diameter_mm: float = 3.7,
    dimple_depth_mm: float = 0.25,
    dimple_order: int = 6,
    subdivisions: int = 6,
) -> Shape:
    """A ball with 10·order² + 2 dimples at the points of an icosahedral grid."""
    from trimesh import creation  # slow to import, and not every object needs it

    radius = diameter_mm / 2
    sphere = creation.icosphere(subdivisions=subdivisions, radius=1.0)
    directions = _gathered(np.asarray(sphere.vertices))
    chord, _ = cKDTree(icosahedral_points(dimple_order)).query(directions)
    share = 2 * np.arcsin(chord / 2) * radius / (dimple_diameter_mm / 2)
    depth = dimple_depth_mm * np.clip(1 - share**2, 0, None) ** 1.5
    vertices = directions * (radius - depth)[:, None]
    lift = np.array([0.0, 0.0, radius])
    ball = hull(radius * icosahedral_points(4) + lift)
    return Shape(rounded_mesh(vertices + lift, sphere.faces), (ball,))


def _gathered(directions: NDArray[np.float64], strength: float = 0.6) -> NDArray[np.float64]:
    """Unit vectors drawn together around ±x, where the pads touch first."""
    x, across = directions[:, 0], np.linalg.norm(directions[:, 1:], axis=1)
    angle = np.arctan2(across, x)
    angle = angle - strength / 2 * np.sin(2 * angle)
    sideways = directions[:, 1:] / np.maximum(across, 1e-12)[:, None]
    return np.column_stack([np.cos(angle), np.sin(angle)[:, None] * sideways])


def icosahedral_points(order: int) -> NDArray[np.float64]:
    """10·order² + 2 unit vectors: an icosahedron's faces divided into a triangular grid."""
    from trimesh import creation

    solid = creation.icosahedron()
    corners = np.asarray(solid.vertices)[np.asarray(solid.faces)]
    weights = (
        np.array(
            [(i, j, order - i - j) for i in range(order + 1) for j in range(order + 1 - i)],
            dtype=np.float64,
        )
        / order
    )
    points = np.einsum("wk,fkc->fwc", weights, corners).reshape(-1, 3)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return np.unique(np.round(points, 9), axis=0)

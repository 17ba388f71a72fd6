"""What a builder of a procedural object returns, and the solids it is made of."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import manifold3d
import numpy as np
from numpy.typing import NDArray

from tacgen.core.records import Mesh
from tacgen.objects.meshes import from_manifold, hull, rounded_mesh, to_manifold

Points = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Body:
    """A closed mesh of one material; several of them say how the mass is distributed."""

    mesh: Mesh
    density_kg_m3: float


@dataclass(frozen=True, slots=True)
class Shape:
    """A procedural object in its rest pose, mm, footprint centre at the origin, table at z = 0.

    ``surface`` is watertight, its faces counter-clockwise seen from outside; ``collision`` are
    convex parts; ``bodies`` is empty where one material fills the surface.
    """

    surface: Mesh
    collision: tuple[Mesh, ...]
    bodies: tuple[Body, ...] = ()


def loft(rings_mm: Points) -> Mesh:
    """The closed surface through rings of points, both ends closed by a fan.

    ``rings_mm`` (k, n, 3) goes ring after ring from one end to the other, each counter-clockwise
    seen against the direction of travel. The end rings must be star-shaped about their mean.
    """
    rings_mm = np.asarray(rings_mm, dtype=np.float64)
    k, n, _ = rings_mm.shape
    vertices = np.concatenate(
        [rings_mm.reshape(-1, 3), rings_mm[0].mean(axis=0)[None], rings_mm[-1].mean(axis=0)[None]]
    )
    here = np.arange(n)
    after = (here + 1) % n
    row = n * np.arange(k - 1)[:, None]
    a, b, c, d = row + here, row + after, row + n + after, row + n + here
    walls = np.concatenate([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)], axis=1)
    first = np.stack([np.full(n, k * n), after, here], axis=-1)
    last = np.stack([np.full(n, k * n + 1), n * (k - 1) + here, n * (k - 1) + after], axis=-1)
    return rounded_mesh(vertices, np.concatenate([walls.reshape(-1, 3), first, last]))


def polar_rings(radius_mm: Points, angle_rad: Points, height_mm: Points) -> Points:
    """Rings (k, n, 3) about z from polar radii (k, n) or (k, 1) at heights (k,)."""
    x, y = radius_mm * np.cos(angle_rad), radius_mm * np.sin(angle_rad)
    return np.stack([x, y, np.broadcast_to(height_mm[:, None], x.shape)], axis=-1)


def revolve(profile_rz_mm: Points, segments: int) -> Points:
    """Rings (k, segments, 3) of a profile (k, 2) of radius and height, turned about z."""
    return polar_rings(profile_rz_mm[:, :1], angles_rad(segments), profile_rz_mm[:, 1])


def angles_rad(count: int) -> NDArray[np.float64]:
    """``count`` angles around a turn, the first at 0."""
    return 2 * np.pi * np.arange(count) / count


def slab_hulls(rings_mm: Points, breaks: Sequence[int], count: int = 32) -> tuple[Mesh, ...]:
    """Convex hulls of the stretches of a loft between the rings ``breaks``.

    Each ring is thinned to ``count`` points. A stretch must itself be convex but for detail
    finer than what the physics should feel.
    """
    thinned = rings_mm[:, :: max(1, rings_mm.shape[1] // count)]
    return tuple(hull(thinned[[start, end]]) for start, end in itertools.pairwise(breaks))


def union(solids: Sequence[Mesh]) -> Mesh:
    """One watertight surface around all of ``solids``."""
    manifolds = [to_manifold(solid) for solid in solids]
    return from_manifold(manifold3d.Manifold.batch_boolean(manifolds, manifold3d.OpType.Add))


def moved(solid: Mesh, *, turn: Points | None = None, shift_mm: Points | None = None) -> Mesh:
    """``solid`` turned by a rotation matrix (3, 3), then shifted by (3,) mm."""
    vertices = solid.vertices_mm
    if turn is not None:
        vertices = vertices @ np.asarray(turn, dtype=np.float64).T
    if shift_mm is not None:
        vertices = vertices + np.asarray(shift_mm, dtype=np.float64)
    return rounded_mesh(vertices, solid.faces)


def sweep(path_mm: Points, across: Points, sections_mm: Points) -> Points:
    """Rings (k, n, 3) of plane sections carried along a path.

    The origin of each section, (k, n, 2) or (n, 2), goes to its point of ``path_mm`` (k, 3), and
    the direction of travel there is its normal. ``across`` (3,), perpendicular to the whole path,
    is its first axis; the second is travel × across, so that sections counter-clockwise in their
    plane face outward.
    """
    path_mm = np.asarray(path_mm, dtype=np.float64)
    travel = np.gradient(path_mm, axis=0)
    travel /= np.linalg.norm(travel, axis=1, keepdims=True)
    first = np.broadcast_to(np.asarray(across, dtype=np.float64), path_mm.shape)
    second = np.cross(travel, first)
    sections = np.broadcast_to(sections_mm, (len(path_mm), *np.shape(sections_mm)[-2:]))
    return (
        path_mm[:, None]
        + sections[:, :, :1] * first[:, None]
        + sections[:, :, 1:] * second[:, None]
    )


def path_hulls(
    rings_mm: Points, parts: int, count: int = 16, rings_each: int = 3
) -> tuple[Mesh, ...]:
    """Convex hulls of ``parts`` equal stretches of a sweep, each ring thinned to ``count``.

    ``rings_each`` rings of a stretch belong to its hull, so that a bend is followed from outside.
    """
    thinned = rings_mm[:, :: max(1, rings_mm.shape[1] // count)]
    steps = rings_each - 1
    rows = np.linspace(0, len(rings_mm) - 1, steps * parts + 1).round().astype(int)
    return tuple(hull(thinned[rows[i * steps : (i + 1) * steps + 1]]) for i in range(parts))

"""Volume, centre of mass and inertia of closed meshes, and how a shape comes to rest."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from tacgen.core.records import Mesh
from tacgen.objects.shapes.shape import Body, Shape, moved


def settled(shape: Shape) -> Shape:
    """``shape``, lying along y, tipped about x until it is stable, then put at the origin.

    Seen along x, a body rests on that edge of its outline's hull above which its centre of mass
    stands; of several such edges, on the one that the table is nearest to already. The middle of
    its extent along x and y goes to the origin and its lowest point to z = 0.
    """
    bodies = [(body.mesh, body.density_kg_m3) for body in shape.bodies]
    center = mass_properties(bodies or [(shape.surface, 1.0)], 1.0).center_mm
    tip_rad = resting_tilt_rad(shape.surface.vertices_mm[:, 1:], center[1:])
    c, s = np.cos(tip_rad), np.sin(tip_rad)
    turn = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    tipped = moved(shape.surface, turn=turn).vertices_mm
    low, high = tipped.min(axis=0), tipped.max(axis=0)
    shift = -np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    return Shape(
        moved(shape.surface, turn=turn, shift_mm=shift),
        tuple(moved(part, turn=turn, shift_mm=shift) for part in shape.collision),
        tuple(
            Body(moved(body.mesh, turn=turn, shift_mm=shift), body.density_kg_m3)
            for body in shape.bodies
        ),
    )


def resting_tilt_rad(outline_mm: NDArray[np.float64], center_mm: NDArray[np.float64]) -> float:
    """The smallest turn in the plane after which the points (n, 2) rest stably on a floor.

    ``outline_mm`` holds (along, up); a positive turn lifts what lies at larger ``along``.
    """
    found = ConvexHull(outline_mm)
    tilts = []
    for (first, second), equation in zip(found.simplices, found.equations, strict=True):
        start, side = outline_mm[first], outline_mm[second] - outline_mm[first]
        share = float((center_mm - start) @ side / (side @ side))
        if 0 <= share <= 1:
            # The side's outward normal must come to point down.
            tilts.append(float(np.arctan2(-equation[0], -equation[1])))
    return min(tilts, key=abs)


@dataclass(frozen=True, slots=True)
class MassProperties:
    """``inertia_kg_mm2`` (3, 3) is about ``center_mm`` (3,), along the mesh's axes."""

    mass_kg: float
    center_mm: NDArray[np.float64]
    inertia_kg_mm2: NDArray[np.float64]


def volume_mm3(solid: Mesh) -> float:
    """Volume enclosed by a closed mesh; negative where its faces point inward."""
    return float(_six_volumes(solid.vertices_mm[solid.faces]).sum() / 6)


def mass_properties(bodies: Sequence[tuple[Mesh, float]], mass_kg: float) -> MassProperties:
    """Of closed meshes with relative densities, scaled so that together they weigh ``mass_kg``.

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
    return MassProperties(mass_kg, center, inertia * (mass_kg / total))


def _six_volumes(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Six times the signed volume of each tetrahedron (n, 3, 3) with a corner at the origin."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    return np.asarray((a * np.cross(b, c)).sum(axis=1))

"""Volume, centre and inertia of closed meshes, exactly, by summing tetrahedra."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tacgen.core.records import Mesh


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
    return (a * np.cross(b, c)).sum(axis=1)

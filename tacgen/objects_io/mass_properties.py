"""Volume, centre and inertia of closed meshes, exactly, by summing tetrahedra."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tacgen.records import Mesh


@dataclass(frozen=True, slots=True)
class MassProperties:
    """``inertia_kg_mm2`` (3, 3) is about ``center_mm`` (3,), along the mesh's axes."""

    mass_kg: float
    center_mm: NDArray[np.float64]
    inertia_kg_mm2: NDArray[np.float64]


def volume_mm3(solid: Mesh) -> float:
    """Volume enclosed by a closed mesh; negative where its faces point inward."""
    return float(np.linalg.det(solid.vertices_mm[solid.faces]).sum() / 6)


def mass_properties(bodies: Sequence[tuple[Mesh, float]], mass_kg: float) -> MassProperties:
    """Of closed meshes with relative densities, scaled so that together they weigh ``mass_kg``.

    Source: the second moments of a tetrahedron with one corner at the origin,
    det/120 · (Σ_i p_i p_iᵀ + (Σ p)(Σ p)ᵀ).
    """
    total, first, second = 0.0, np.zeros(3), np.zeros((3, 3))
    for solid, density in bodies:
        corners = solid.vertices_mm[solid.faces]
        weight = density * np.linalg.det(corners)
        sums = corners.sum(axis=1)
        total += weight.sum() / 6
        first += weight @ sums / 24
        second += np.einsum("n,nci,ncj->ij", weight, corners, corners, optimize=True) / 120
        second += (weight[:, None] * sums).T @ sums / 120
    center = first / total
    covariance = second - total * np.outer(center, center)
    inertia = np.trace(covariance) * np.eye(3) - covariance
    return MassProperties(mass_kg, center, inertia * (mass_kg / total))

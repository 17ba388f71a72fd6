"""A smooth model of how a gel answers to its slope: polynomials in surface normal and position.

The change of grey level from flat to a slope is a polynomial in the two tangential parts of the
surface's unit normal, (nx, ny) = (gx, gy)/√(1 + gx² + gy²), each term times a quadratic in image
position. It is 0 where the slope is 0. For matt gel under distant light only the terms of first
order would be left; the higher ones hold what lamps close by, gloss and several bounces add. One
more term steps from 0 to 1 within a few degrees of slope: gel under a ball differs from gel at
rest even where it lies level, because its neighbourhood scatters other light.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tacgen.core.arrays import FloatArray
from tacgen.optics.table import N_FEATURES

STEP_SINE = 0.1
"""Sine of the slope at which the step term is half way up."""


def exponents(degree: int) -> list[tuple[int, int]]:
    """Powers of (nx, ny) in the order of the model's terms, without constant and step."""
    return [(k - j, j) for k in range(1, degree + 1) for j in range(k + 1)]


def n_terms(degree: int) -> int:
    """How many terms a model of this degree has: the powers of (nx, ny) and the step."""
    return degree * (degree + 3) // 2 + 1


def normal_parts(gx: FloatArray, gy: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(nx, ny): the slope vector's sine along x and y."""
    length = np.sqrt(1.0 + gx * gx + gy * gy)
    return gx / length, gy / length


def monomials(nx: FloatArray, ny: FloatArray, degree: int) -> FloatArray:
    """The terms (n, n_terms) at normals (n,)."""
    powers_x, powers_y = [np.ones_like(nx)], [np.ones_like(ny)]
    for _ in range(degree):
        powers_x.append(powers_x[-1] * nx)
        powers_y.append(powers_y[-1] * ny)
    terms = [powers_x[i] * powers_y[j] for i, j in exponents(degree)]
    square = nx * nx + ny * ny
    return np.stack([*terms, square / (square + STEP_SINE**2)], axis=-1)


def monomial_derivatives(
    nx: FloatArray, ny: FloatArray, degree: int
) -> tuple[FloatArray, FloatArray]:
    """∂terms/∂nx and ∂terms/∂ny, each (n, n_terms)."""
    powers_x, powers_y = [np.ones_like(nx)], [np.ones_like(ny)]
    for _ in range(degree):
        powers_x.append(powers_x[-1] * nx)
        powers_y.append(powers_y[-1] * ny)
    terms = exponents(degree)
    by_x = [i * powers_x[max(i - 1, 0)] * powers_y[j] for i, j in terms]
    by_y = [j * powers_x[i] * powers_y[max(j - 1, 0)] for i, j in terms]
    step = 2 * STEP_SINE**2 / (nx * nx + ny * ny + STEP_SINE**2) ** 2
    return np.stack([*by_x, step * nx], axis=-1), np.stack([*by_y, step * ny], axis=-1)


def position_terms(u: FloatArray, v: FloatArray) -> FloatArray:
    """u², v², uv, u, v, 1 (n, 6): the table's features."""
    return np.stack([u * u, v * v, u * v, u, v, np.ones_like(u)], axis=-1)


def design(terms: FloatArray, position: FloatArray) -> FloatArray:
    """Every term times every position feature: (n, n_terms · 6)."""
    return (terms[:, :, None] * position[:, None, :]).reshape(len(terms), -1)


def position_costs() -> FloatArray:
    """How much the ridge charges for each position feature (6,): the constant costs 1."""
    return np.array([16.0, 16.0, 16.0, 4.0, 4.0, 1.0])


def roughness(degree: int) -> FloatArray:
    """Diagonal (n_terms · 6,) of the ridge: higher powers of slope and of position cost more."""
    term_cost = np.array([*(float(i + j) ** 2 for i, j in exponents(degree)), 1.0])
    return (term_cost[:, None] * position_costs()[None, :] / 16.0).ravel()


@dataclass(frozen=True, slots=True)
class SmoothModel:
    """A fitted smooth model.

    Attributes
    ----------
    weights : (n_terms, 6, 3) float64
        Grey levels, RGB, for each term in (nx, ny) and position feature.
    degree : int
    """

    weights: FloatArray
    degree: int

    def of_terms(self, terms: FloatArray, position: FloatArray) -> FloatArray:
        """Grey levels (n, 3) of the model's terms (n, n_terms) at places (n, 6)."""
        n_here, n_features, n_channels = self.weights.shape
        at_features = terms @ self.weights.reshape(n_here, -1)
        by_feature = at_features.reshape(len(terms), n_features, n_channels)
        return np.asarray((by_feature * position[:, :, None]).sum(axis=1))

    def change(self, gx: FloatArray, gy: FloatArray, position: FloatArray) -> FloatArray:
        """Grey levels (n, 3) that a slope (n,) adds, at ``position`` (n, 6)."""
        terms = monomials(*normal_parts(gx, gy), self.degree)
        return self.of_terms(terms, position)

    def coefficients(self, slope_rad: FloatArray, direction_rad: FloatArray) -> NDArray:
        """The table's coefficients (n_slope, n_direction, 3, 6) at nodes of slope and direction."""
        sine = np.sin(slope_rad)[:, None]
        nx, ny = sine * np.cos(direction_rad), sine * np.sin(direction_rad)
        terms = monomials(nx.ravel(), ny.ravel(), self.degree)
        values = np.einsum("nt,tfc->ncf", terms, self.weights)
        return values.reshape(*nx.shape, 3, N_FEATURES).astype(np.float32)


def solve_ridge(gram: FloatArray, moment: FloatArray, ridge: float, degree: int) -> SmoothModel:
    """The weights that minimise squared error plus ``ridge`` × roughness.

    Parameters
    ----------
    gram : (k, k) float
        Designᵀ·design summed over pixels; k = n_terms · 6.
    moment : (k, 3) float
        Designᵀ·grey level change.
    """
    penalty = ridge * np.trace(gram) / len(gram) * roughness(degree)
    weights = np.linalg.solve(gram + np.diag(penalty), moment)
    return SmoothModel(weights.reshape(n_terms(degree), N_FEATURES, -1), degree)

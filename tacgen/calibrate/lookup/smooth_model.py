"""A smooth model of how a gel answers to its slope: polynomials in surface normal and position.

The change of grey level from flat to a slope is a polynomial in the two tangential parts of the
surface's unit normal, (nx, ny) = (gx, gy)/√(1 + gx² + gy²), each term times a function of image
position: a polynomial plus a share of the light that falls there, for which the bare gel's smoothed
brightness in each channel stands. It is 0 where the slope is 0. For matt gel under distant light
only the terms of first order would be left; the higher ones hold what lamps close by, gloss and
several bounces add. One more term steps from 0 to 1 within a few degrees of slope: gel under a ball
differs from gel at rest even where it lies level, because its neighbourhood scatters other light.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from tacgen.calibrate.lookup.settings import FitSettings
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


def roughness(degree: int) -> FloatArray:
    """Diagonal (n_terms · 6,) of a ridge for a quadratic in position: higher powers cost more."""
    term_cost = np.array([*(float(i + j) ** 2 for i, j in exponents(degree)), 1.0])
    return (term_cost[:, None] * np.array([1.0, 1.0, 1.0, 0.25, 0.25, 0.0625])).ravel()


N_LIGHT = 3
"""Features of position that are the light's: one for each channel."""


def n_position_features(degree: int) -> int:
    """How many features of position a model of this degree in position has."""
    return (degree + 1) * (degree + 2) // 2 + N_LIGHT


def position_degree_of(n_features: int) -> int:
    """The degree in position of a model with so many features of position."""
    return (math.isqrt(8 * (n_features - N_LIGHT) + 1) - 3) // 2


def position_features(u: FloatArray, v: FloatArray, light: FloatArray, degree: int) -> FloatArray:
    """Features (n, n_position_features) of places in the image.

    Products of Legendre polynomials in 2u and 2v, lowest total degree first, then the light.

    Parameters
    ----------
    u, v : (n,) float
        Position in the image, −½ to ½.
    light : (H, W, 3) float
        The bare gel's smoothed brightness, relative to its mean.
    """
    along_u, along_v = legendre.legvander(2 * u, degree), legendre.legvander(2 * v, degree)
    products = [along_u[:, k - j] * along_v[:, j] for k in range(degree + 1) for j in range(k + 1)]
    height, width = light.shape[:2]
    rows = np.clip(((v + 0.5) * height).astype(int), 0, height - 1)
    columns = np.clip(((u + 0.5) * width).astype(int), 0, width - 1)
    return np.column_stack([*products, light[rows, columns]])


def feature_index(n_features: int, degree: int) -> NDArray[np.int64]:
    """Which of ``n_features`` features of position a lower degree in position has."""
    n_products = n_position_features(degree) - N_LIGHT
    return np.append(np.arange(n_products), np.arange(n_features - N_LIGHT, n_features))


def first_features(position: FloatArray, n_features: int) -> FloatArray:
    """Of ``position_features`` (n, f) of a higher degree those of a degree that has fewer."""
    if position.shape[1] == n_features:
        return position
    n_products = n_features - N_LIGHT
    return np.concatenate([position[:, :n_products], position[:, -N_LIGHT:]], axis=1)


def design(terms: FloatArray, position: FloatArray) -> FloatArray:
    """Every term times every position feature: (n, n_terms · n_features)."""
    return (terms[:, :, None] * position[:, None, :]).reshape(len(terms), -1)


LIGHT_COST = float(np.exp(-1.0))
"""The ridge charges less for the light than for a constant: that a slope's change is in proportion
to the light at its place is what physics expects."""


def ridge_costs(degree: int, position_degree: int) -> FloatArray:
    """Diagonal (n_terms · n_features,) of the ridge: e times as much for each power of position."""
    orders = [float(k) for k in range(position_degree + 1) for _ in range(k + 1)]
    cost = np.append(np.exp(orders), np.full(N_LIGHT, LIGHT_COST))
    return np.tile(cost, n_terms(degree))


def weighed(terms: FloatArray, at_places: FloatArray) -> FloatArray:
    """Terms (n, n_terms) times what each stands for at its place (n, n_terms, 3), summed."""
    return np.asarray(np.matmul(terms[:, None, :], at_places)[:, 0])


@dataclass(frozen=True, slots=True)
class SmoothModel:
    """A fitted smooth model.

    Attributes
    ----------
    weights : (n_terms, n_features, 3) float64
        Grey levels, RGB, for each term in (nx, ny) and position feature.
    degree : int
    """

    weights: FloatArray
    degree: int

    def at_places(self, position: FloatArray) -> FloatArray:
        """Grey levels (n, n_terms, 3) for each term at places (n, n_features)."""
        n_here, n_features, n_channels = self.weights.shape
        position = first_features(position, n_features)
        by_feature = self.weights.transpose(1, 0, 2).reshape(n_features, -1)
        return np.asarray((position @ by_feature).reshape(len(position), n_here, n_channels))

    def of_terms(self, terms: FloatArray, position: FloatArray) -> FloatArray:
        """Grey levels (n, 3) of the model's terms (n, n_terms) at places (n, n_features)."""
        return weighed(terms, self.at_places(position))

    def change(self, gx: FloatArray, gy: FloatArray, position: FloatArray) -> FloatArray:
        """Grey levels (n, 3) that a slope (n,) adds, at ``position`` (n, n_features)."""
        terms = monomials(*normal_parts(gx, gy), self.degree)
        return self.of_terms(terms, position)

    def responses(
        self, slope_rad: FloatArray, direction_rad: FloatArray, position: FloatArray
    ) -> FloatArray:
        """Grey levels (n_slope, n_direction, p, 3) at nodes of slope, direction, place (p, f)."""
        sine = np.sin(slope_rad)[:, None]
        nx, ny = sine * np.cos(direction_rad), sine * np.sin(direction_rad)
        terms = monomials(nx.ravel(), ny.ravel(), self.degree)
        at_places = np.einsum("pf,tfc->tpc", position, self.weights)
        values = terms @ at_places.reshape(len(at_places), -1)
        return np.asarray(values.reshape(*nx.shape, len(position), -1))

    def coefficients(self, slope_rad: FloatArray, direction_rad: FloatArray) -> NDArray[np.float32]:
        """Coefficients (n_slope, n_direction, 3, 6) of a model whose features are a table's six."""
        unit = self.responses(slope_rad, direction_rad, np.eye(N_FEATURES))
        return unit.swapaxes(-1, -2).astype(np.float32)


def solve_ridge(gram: FloatArray, moment: FloatArray, settings: FitSettings) -> SmoothModel:
    """The weights that minimise mean squared error plus ``settings.ridge`` × the terms' costs.

    Parameters
    ----------
    gram : (k, k) float
        Designᵀ·design, mean over the pixels; k = n_terms · n_features.
    moment : (k, 3) float
        Designᵀ·grey level change, mean over the pixels.
    """
    degree, position_degree = settings.degree, settings.position_degree
    penalty = np.diag(settings.ridge * ridge_costs(degree, position_degree))
    weights = np.linalg.solve(gram + penalty, moment)
    shape = (n_terms(degree), n_position_features(position_degree), -1)
    return SmoothModel(weights.reshape(shape), degree)

"""A smooth model of how a gel answers to its slope: polynomials in surface normal and position.

The change of grey level from flat to a slope is a polynomial in the two tangential parts of the
surface's unit normal, (nx, ny) = (gx, gy)/√(1 + gx² + gy²), each term times a function of image
position: a polynomial plus a share of the light that falls there, for which the bare gel's smoothed
brightness in each channel stands. It is 0 where the slope is 0. For matt gel under distant light
only the terms of first order would be left; the higher ones hold what lamps close by, gloss and
several bounces add. Three more terms, d/(d + 1 mm) at depth d times 1, nx and ny, say what gel that
is pressed in answers otherwise than gel of the same slope beside the contact: it is thinner, lies
lower in the lamps' light, and its neighbourhood scatters other light.

Gel lit at a grazing angle, or seen through a diffuser, is as bright at a slope of 20° as it gets: a
polynomial that is to follow that needs (nx, ny) bent, times √((1 + b²)/(nx² + ny² + b²)), which
leaves the direction and spreads out slopes up to the sine b.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy import linalg

from tacgen.calibrate.lookup.settings import RULES, FitSettings
from tacgen.core.types import FloatArray


def exponents(degree: int) -> list[tuple[int, int]]:
    """Powers of (nx, ny) in the order of the model's terms, without the constant."""
    return [(k - j, j) for k in range(1, degree + 1) for j in range(k + 1)]


def monomials(nx: FloatArray, ny: FloatArray, degree: int) -> FloatArray:
    """The powers (n, degree · (degree + 3) / 2) of normals (n,), each power together in memory."""
    powers = [np.stack([nx, ny])]
    for _ in range(1, degree):
        powers.append(np.concatenate([nx * powers[-1], ny * powers[-1][-1:]]))
    return np.concatenate(powers).T


N_LIGHT = 3  # features of position that are the light's: one for each channel


def n_position_features(degree: int) -> int:
    """How many features of position a model of this degree in position has."""
    return (degree + 1) * (degree + 2) // 2 + N_LIGHT


def position_degree_of(n_features: int) -> int:
    """The degree in position of a model with so many features of position."""
    return (math.isqrt(8 * (n_features - N_LIGHT) + 1) - 3) // 2


def position_features(u: FloatArray, v: FloatArray, light: FloatArray, degree: int) -> FloatArray:
    """Features (n, n_position_features) of places in the image.

    Products of Legendre polynomials in 2u and 2v, lowest total degree first, then the light.
    ``u``, ``v`` (n,) are −½ to ½ in the image, ``light`` (H, W, 3) the bare gel's smoothed
    brightness, relative to its mean.
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
    """Those of ``position_features`` (n, f) that a lower degree has."""
    if position.shape[1] == n_features:
        return position
    n_products = n_features - N_LIGHT
    return np.concatenate([position[:, :n_products], position[:, -N_LIGHT:]], axis=1)


def design(terms: FloatArray, position: FloatArray) -> FloatArray:
    """Every term times every position feature: (n, n_terms · n_features)."""
    # All pixels of a column together in memory, as the terms are.
    return (terms.T[:, None] * position.T[None]).reshape(-1, len(terms)).T


LIGHT_COST = float(np.exp(-1.0))
"""The ridge charges less for the light than for a constant: that a slope's change is in proportion
to the light at its place is what physics expects."""


def ridge_costs(degree: int, position_degree: int) -> FloatArray:
    """Diagonal (n_light_terms · n_features,): e times as much for each power of position."""
    orders = [float(k) for k in range(position_degree + 1) for _ in range(k + 1)]
    cost = np.append(np.exp(orders), np.full(N_LIGHT, LIGHT_COST))
    terms = np.ones(n_light_terms(degree))
    terms[-2:] = RULES.tilt_cost
    return np.outer(terms, cost).ravel()


CONTACT_DEPTH_MM = 1.0
"""Depth at which half of what a contact adds shows: 0.5 to 1.5 mm fit the measured sets alike."""

N_CONTACT = 3  # terms of the contact itself


def n_light_terms(degree: int) -> int:
    """How many terms of slope and depth a model of this degree has."""
    return len(exponents(degree)) + N_CONTACT


def light_terms(
    gx: FloatArray, gy: FloatArray, depth_mm: FloatArray, degree: int, bend: float = 0.0
) -> FloatArray:
    """The terms (n, n_light_terms) of gel with slopes (n,) at depths (n,) below its rest."""
    length = np.sqrt(1.0 + gx * gx + gy * gy)
    nx, ny = gx / length, gy / length
    depth = np.maximum(depth_mm, 0.0)
    share = depth / (depth + CONTACT_DEPTH_MM)
    contact = np.stack([share, share * nx, share * ny])
    return np.concatenate([monomials(*bent_normal(gx, gy, bend), degree).T, contact]).T


def bent_normal(gx: FloatArray, gy: FloatArray, bend: float) -> tuple[FloatArray, FloatArray]:
    """The tangential parts of the unit normal, bent."""
    square = gx * gx + gy * gy
    more = 1.0 / np.sqrt(1.0 + square)
    if bend:
        more *= np.sqrt((1.0 + bend**2) / (square / (1.0 + square) + bend**2))
    return gx * more, gy * more


def weighed(terms: FloatArray, at_places: FloatArray) -> FloatArray:
    """Terms (n, n_terms) times what each stands for at its place (n, n_terms, 3), summed."""
    return np.asarray((terms[..., None] * at_places).sum(axis=1))


@dataclass(frozen=True, slots=True)
class SmoothModel:
    """A fitted smooth model."""

    weights: FloatArray  # (n_light_terms, n_features, 3), RGB grey levels of each term and feature
    degree: int
    bend: float = 0.0

    def at_places(self, position: FloatArray) -> FloatArray:
        """Grey levels (n, n_terms, 3) for each term at places (n, n_features)."""
        n_here, n_features, n_channels = self.weights.shape
        position = first_features(position, n_features)
        by_channel = self.weights.transpose(2, 0, 1).reshape(-1, n_features)
        grey = (by_channel @ position.T).reshape(n_channels, n_here, len(position))
        return np.asarray(grey.transpose(2, 1, 0))

    def of_terms(self, terms: FloatArray, position: FloatArray) -> FloatArray:
        """Grey levels (n, 3) of the model's terms (n, n_terms) at places (n, n_features)."""
        return weighed(terms, self.at_places(position))

    def responses(
        self, slope_rad: FloatArray, direction_rad: FloatArray, position: FloatArray
    ) -> FloatArray:
        """Grey levels (n_slope, n_direction, p, 3) at nodes of slope, direction, place (p, f).

        Light of the gel at rest: what a contact adds is ``of_contact``.
        """
        tangent = np.tan(slope_rad)[:, None]
        gx, gy = tangent * np.cos(direction_rad), tangent * np.sin(direction_rad)
        terms = light_terms(gx.ravel(), gy.ravel(), np.zeros(gx.size), self.degree, self.bend)
        at_places = self.at_places(position).swapaxes(0, 1)
        values = terms @ at_places.reshape(len(at_places), -1)
        return np.asarray(values.reshape(*gx.shape, len(position), -1))

    def of_contact(self, position: FloatArray) -> FloatArray:
        """What a contact adds at places (p, f): (p, 3, 3), for 1, nx and ny."""
        return self.at_places(position)[:, -N_CONTACT:]


def solve_ridge(gram: FloatArray, moment: FloatArray, settings: FitSettings) -> SmoothModel:
    """The weights that minimise mean squared error plus ``settings.ridge`` × the terms' costs.

    ``gram`` (k, k) is designᵀ·design, ``moment`` (k, 3) designᵀ·grey level change, both means over
    the pixels; k = n_light_terms · n_features.
    """
    degree, position_degree = settings.degree, settings.position_degree
    penalty = np.diag(settings.ridge * ridge_costs(degree, position_degree))
    weights = linalg.solve(gram + penalty, moment, assume_a="pos", check_finite=False)
    shape = (n_light_terms(degree), n_position_features(position_degree), -1)
    return SmoothModel(weights.reshape(shape), degree, settings.bend)

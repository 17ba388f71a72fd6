"""A ball in the gel, in closed form: the volume that it displaces, the slope around it."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tacgen.core.compiled import njit
from tacgen.core.types import FloatArray

MAX_RADIUS_SHARE = 0.98
"""Largest contact radius as a share of the ball's radius: at 1 the gel would stand upright."""
MAX_CAP_SHARE = 0.9999  # largest radius, as a share of the ball's, at which its cap has a slope


@dataclass(frozen=True, slots=True)
class Membrane:
    """How the gel leaves the ball at the rim of the contact."""

    decay_mm: float  # over which the slope falls off by 1/e outside the contact
    sharpness: float = 8.0  # of the joint of the two pieces: large is a kink, 2 a wide shoulder
    slope_factors: tuple[tuple[float, float], ...] = ()
    """Contact radii, rising, and what the slope is multiplied by there; 1 inside the contact,
    linear between, and beyond the last as there."""


def rest_slope(
    x_mm: FloatArray, y_mm: FloatArray, dome_radius_mm: float
) -> tuple[FloatArray, FloatArray]:
    """Slope (∂h/∂x, ∂h/∂y) of the gel at rest at positions from its centre; 0 for a flat gel.

    Source: A sphere: h = √(R² − x² − y²) − R.
    """
    if dome_radius_mm <= 0:
        return np.zeros_like(x_mm), np.zeros_like(y_mm)
    limit = (0.95 * dome_radius_mm) ** 2
    height = np.sqrt(dome_radius_mm**2 - np.minimum(x_mm**2 + y_mm**2, limit))
    return -x_mm / height, -y_mm / height


def rest_height(x_mm: FloatArray, y_mm: FloatArray, dome_radius_mm: float) -> FloatArray:
    """Height of the gel at rest, mm, 0 at its centre: what ``rest_slope`` is the slope of."""
    if dome_radius_mm <= 0:
        return np.zeros_like(x_mm)
    limit = (0.95 * dome_radius_mm) ** 2
    return np.sqrt(dome_radius_mm**2 - np.minimum(x_mm**2 + y_mm**2, limit)) - dome_radius_mm


@dataclass(frozen=True, slots=True)
class PressedGel:
    """What a ball adds to the gel at rest, as functions of the distance from its centre.

    ``dome_radius_mm`` is the radius of curvature of the gel at rest, 0 for a flat one.
    """

    contact_radius_mm: float
    ball_radius_mm: float
    membrane: Membrane
    dome_radius_mm: float = 0.0

    def radial_slope(self, r_mm: FloatArray) -> FloatArray:
        """Slope along the radius that the ball adds to the gel at rest, positive outwards.

        Inside the contact the surface is the ball's, r/√(R² − r²) (on a dome, that less the dome's
        own slope); outside, what the ball adds decays exponentially. The two are joined by a power
        mean, so that the slope is smooth. Beyond ``MAX_CAP_SHARE`` of the ball's radius the cap's
        slope stays what it is there.
        """
        ball, joint = self.ball_radius_mm, self.membrane.sharpness
        contact = min(self.contact_radius_mm, MAX_RADIUS_SHARE * ball)
        dome_per_mm = 1.0 / self.dome_radius_mm if self.dome_radius_mm > 0 else 0.0
        rim = contact / math.sqrt(ball**2 - contact**2) + contact * dome_per_mm
        outward = (r_mm - contact) / self.membrane.decay_mm
        outward = np.minimum(np.maximum(outward, -30.0), 30.0)  # where an exponential is finite
        inside = np.minimum(r_mm, MAX_CAP_SHARE * ball)
        cap = inside * (1.0 / np.sqrt(ball**2 - inside**2) + dome_per_mm)
        tail = rim * np.exp(-outward)
        slope = cap * (1.0 + (cap / tail) ** joint) ** (-1 / joint)
        if self.membrane.slope_factors:
            radii, factors = zip((1.0, 1.0), *self.membrane.slope_factors, strict=True)
            slope = slope * np.interp(r_mm / self.contact_radius_mm, radii, factors)
        return np.asarray(slope)

    def slope(self, dx_mm: FloatArray, dy_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """∂h/∂x and ∂h/∂y at distances along columns and rows (...) from the centre.

        Slopes of the gel-frame height map: positive away from the centre, where the gel is deepest.
        """
        r = np.sqrt(dx_mm * dx_mm + dy_mm * dy_mm)  # five times as fast as np.hypot
        per_mm = self.radial_slope(r) / np.maximum(r, 1e-12)
        return per_mm * dx_mm, per_mm * dy_mm

    def depth(self, r_mm: FloatArray, points: int = 200, decays: float = 8.0) -> FloatArray:
        """Depth below the gel at rest, mm: 0 far away, positive under the ball.

        The slope is summed over ``points`` along the radius, up to ``decays`` decay lengths outside
        the contact; by default to within a thousandth of the depth.
        """
        reach = self.contact_radius_mm + decays * self.membrane.decay_mm
        grid = reach * np.arange(points) / (points - 1)
        slope = self.radial_slope(grid)
        rise = np.cumsum(slope[:0:-1] + slope[-2::-1]) * (0.5 * grid[1])
        return np.asarray(_interpolated(np.append(rise[::-1], 0.0), r_mm / grid[1]))

    def height(self, r_mm: FloatArray) -> FloatArray:
        """−``depth``, so fine that differences of neighbouring pixels are slopes."""
        return -self.depth(r_mm, 4096, 14.0)


@njit(cache=True, nogil=True)
def _interpolated(nodes: NDArray[Any], at: NDArray[Any]) -> NDArray[Any]:
    """Values between nodes (n,) at coordinates (...) of at least 0; 0 beyond the last node."""
    values = np.zeros(at.size)
    flat = at.reshape(-1)
    for k in range(flat.size):
        i = int(flat[k])
        if i < nodes.size - 1:
            values[k] = nodes[i] + (flat[k] - i) * (nodes[i + 1] - nodes[i])
    return values.reshape(at.shape)


def ball_volume_mm3(depth_mm: ArrayLike, radius_mm: ArrayLike) -> FloatArray:
    """Volume of the gel that a ball displaces at ``depth_mm``, over a flat gel at rest.

    Up to its own radius a cap, π d² (R − d/3); deeper, the half ball and the cylinder above it,
    as the gel cannot close behind it. 0 where the depth is negative.
    """
    depth = np.maximum(np.asarray(depth_mm, dtype=np.float64), 0.0)
    radius = np.asarray(radius_mm, dtype=np.float64)
    cap = np.minimum(depth, radius)
    return np.asarray(np.pi * cap**2 * (radius - cap / 3.0) + np.pi * radius**2 * (depth - cap))


def ball_depth_mm(volume_mm3: ArrayLike, radius_mm: ArrayLike) -> FloatArray:
    """The depth at which a ball displaces ``volume_mm3``; 0 where the volume is not positive.

    The cap's cubic d³ − 3R d² + 3V/π = 0 by its trigonometric root.
    """
    radius = np.asarray(radius_mm, dtype=np.float64)
    volume = np.maximum(np.asarray(volume_mm3, dtype=np.float64), 0.0)
    half = 2.0 * np.pi * radius**3 / 3.0
    share = np.clip(volume / half, 0.0, 1.0)
    cap = radius * (1.0 + 2.0 * np.cos((np.arccos(1.0 - share) - 2.0 * np.pi) / 3.0))
    return cap + np.maximum(volume - half, 0.0) / (np.pi * radius**2)


def cap_volume_from_circle_mm3(contact_radius_mm: ArrayLike, radius_mm: ArrayLike) -> FloatArray:
    """Volume of the cap of a ball whose contact circle has ``contact_radius_mm``.

    A circle at least as wide as the ball means that the ball is in to its middle or deeper; the
    half ball is then the least that it can be.
    """
    radius = np.asarray(radius_mm, dtype=np.float64)
    a = np.clip(np.asarray(contact_radius_mm, dtype=np.float64), 0.0, radius)
    return ball_volume_mm3(radius - np.sqrt(radius**2 - a**2), radius)

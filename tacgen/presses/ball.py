"""The volume that a ball indents, and its inverse."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from tacgen.core.arrays import FloatArray


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

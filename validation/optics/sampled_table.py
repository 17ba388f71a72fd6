"""A lookup table straight from the virtual sensor, without pressing anything."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from scripts.reference_background import with_reference
from tacgen.optics.table import LookupTable, features
from tacgen.optics.virtual_sensor import VirtualSensor

_PLACES = 9
"""Points along each side of the image at which every slope is looked at."""


def sampled_table(
    virtual: VirtualSensor,
    rest_map_mm: NDArray[np.floating],
    *,
    sensor: str,
    n_slope: int = 40,
    n_direction: int = 72,
    max_slope_rad: float = 1.2,
) -> LookupTable:
    """The table that presses of every slope everywhere would give a calibration of ``virtual``.

    At each node of slope and direction the virtual sensor shades a grid of places, and the six
    coefficients are the least-squares quadratic through the change from a level surface.
    """
    half_x_mm = virtual.width_px * virtual.mm_per_px / 2
    half_y_mm = virtual.height_px * virtual.mm_per_px / 2
    side = (np.arange(_PLACES) + 0.5) / _PLACES - 0.5
    u, v = (grid.ravel() for grid in np.meshgrid(side, side))
    slope = np.tan(np.linspace(0, max_slope_rad, n_slope))[:, None, None]
    direction = (-math.pi + 2 * math.pi * np.arange(n_direction) / n_direction)[None, :, None]
    shape = (n_slope, n_direction, u.size)
    x_mm = np.broadcast_to(2 * half_x_mm * u, shape)
    y_mm = np.broadcast_to(2 * half_y_mm * v, shape)
    level, z_mm = np.zeros(shape), np.zeros(shape)
    grey = virtual.shade(
        x_mm, y_mm, z_mm, level + slope * np.cos(direction), level + slope * np.sin(direction)
    )
    change = grey - virtual.shade(x_mm, y_mm, z_mm, level, level)
    solve = np.linalg.pinv(features(u, v))
    coefficients = np.einsum("fp,sdpc->sdcf", solve, change).astype(np.float16)
    coefficients[0] = 0
    empty = LookupTable(
        coefficients=coefficients.astype(np.float32),
        background=np.zeros((*rest_map_mm.shape, 3), dtype=np.float32),
        mm_per_px=virtual.mm_per_px,
        max_slope_rad=max_slope_rad,
        sensor=sensor,
        noise_grey=virtual.noise_grey,
        provenance={"made_by": "validation.optics.sampled_table", "source": "virtual sensor"},
    )
    return with_reference(empty, rest_map_mm, virtual.grey_levels(rest_map_mm))

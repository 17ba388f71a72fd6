"""A flat screwdriver with a fluted handle."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from scripts.make_objects.profiles import between, superellipse_radius
from scripts.make_objects.resting import settled
from scripts.make_objects.shape import (
    Body,
    Shape,
    angles_rad,
    loft,
    moved,
    polar_rings,
    slab_hulls,
)
from tacgen.core.records import Mesh

ACETATE_KG_M3 = 1280.0  # cellulose acetate, textbook density
STEEL_KG_M3 = 7850.0  # textbook density

_HANDLE = np.array(
    [
        # share of the handle's length, share of its largest radius
        [0.0, 0.35],
        [0.012, 0.56],
        [0.04, 0.74],
        [0.09, 0.88],
        [0.16, 0.96],
        [0.28, 1.0],
        [0.46, 0.98],
        [0.64, 0.86],
        [0.76, 0.76],
        [0.84, 0.78],
        [0.90, 0.84],
        [0.95, 0.80],
        [0.985, 0.62],
        [1.0, 0.45],
    ]
)
_LYING = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""Turns what was built along z to lie along y."""


def flat_screwdriver(
    *,
    handle_diameter_mm: float,
    length_mm: float,
    handle_length_mm: float = 103.0,
    shaft_diameter_mm: float = 6.4,
    blade_width_mm: float = 8.0,
    blade_thickness_mm: float = 1.1,
    blade_length_mm: float = 22.0,
    tang_mm: float = 40.0,
    flutes: int = 6,
    flute_depth_mm: float = 1.7,
    segments: int = 360,
) -> Shape:
    """Lying along y, its blade towards +y: fluted acetate handle, round shaft, ground tip."""
    radius = handle_diameter_mm / 2
    angle = angles_rad(segments)
    handle = _handle_rings(radius, handle_length_mm, flutes, flute_depth_mm, angle)
    shaft, shaft_height = _shaft_rings(
        shaft_diameter_mm / 2,
        (handle_length_mm, length_mm),
        (blade_width_mm / 2, blade_thickness_mm / 2, blade_length_mm),
        angle,
    )
    tang = np.stack(
        [
            np.column_stack([shaft[0, :, :2], np.full(segments, height)])
            for height in (handle_length_mm - tang_mm, handle_length_mm)
        ]
    )
    breaks = np.searchsorted(
        handle[:, 0, 2] / handle_length_mm, (0, 0.04, 0.16, 0.28, 0.4, 0.6, 0.76, 0.9)
    )
    parts = slab_hulls(handle, [*breaks.tolist(), len(handle) - 1], count=30)
    ground = int(np.searchsorted(shaft_height, length_mm - blade_length_mm))
    parts += slab_hulls(shaft, [0, ground, len(shaft) - 1], count=20)
    bodies = (
        Body(_lying(loft(handle)), ACETATE_KG_M3),
        Body(_lying(loft(shaft)), STEEL_KG_M3),
        Body(_lying(loft(tang)), STEEL_KG_M3 - ACETATE_KG_M3),
    )
    surface = _lying(loft(np.concatenate([handle, shaft])))
    return settled(Shape(surface, tuple(_lying(part) for part in parts), bodies))


def _lying(solid: Mesh) -> Mesh:
    return moved(solid, turn=_LYING)


def _handle_rings(
    radius_mm: float, length_mm: float, flutes: int, depth_mm: float, angle: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Rings of the handle along z; a lobe between two flutes points along +x."""
    share = np.concatenate(
        [
            0.04 * np.linspace(0, 1, 9)[:-1] ** 1.5,
            np.linspace(0.04, 0.9, 76),
            np.linspace(0.91, 1, 12),
        ]
    )
    profile = radius_mm * PchipInterpolator(*_HANDLE.T)(share)
    fluted = between(share, 0.13, 0.80, 0.12)
    # Half the angle between lobes, measured from the bottom of the nearest flute.
    off = np.abs(np.mod(angle * flutes / (2 * np.pi), 1.0) - 0.5) * 2
    groove = np.exp(-((off / 0.42) ** 2) * 1.5)
    ring = profile[:, None] - depth_mm * fluted[:, None] * groove
    return polar_rings(ring, angle, share * length_mm)


def _shaft_rings(
    radius_mm: float,
    ends_mm: tuple[float, float],
    blade_mm: tuple[float, float, float],
    angle: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rings of the shaft from the handle to the tip, which is ground flat, and their heights."""
    half_width, half_thickness, blade = blade_mm
    start, end = ends_mm
    along = np.concatenate([[0.0], np.linspace(0.02, 1, 22)])
    flat_height = end - blade + blade * along
    width = PchipInterpolator([0, 0.45, 0.8, 1], [radius_mm, half_width, half_width, half_width])
    thick = PchipInterpolator([0, 0.4, 1], [radius_mm, 0.45 * radius_mm, half_thickness])
    power = PchipInterpolator([0, 0.5, 1], [2.0, 6.0, 12.0])
    flat = superellipse_radius(
        angle, width(along)[:, None], thick(along)[:, None], power(along)[:, None]
    )
    height = np.concatenate([[start + 0.5, (start + end - blade) / 2], flat_height])
    round_part = np.full((2, len(angle)), radius_mm)
    return polar_rings(np.vstack([round_part, flat]), angle, height), height

"""A squeeze bottle and a mug."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from scripts.make_objects.cans import prism
from scripts.make_objects.profiles import Curve, arc, between, joined, polar, superellipse_radius
from scripts.make_objects.shape import (
    Shape,
    angles_rad,
    loft,
    path_hulls,
    polar_rings,
    revolve,
    slab_hulls,
    sweep,
    union,
)


def squeeze_bottle(
    *,
    width_mm: float,
    length_mm: float,
    height_mm: float,
    cap_diameter_mm: float = 37.0,
    cap_ribs: int = 44,
    rib_depth_mm: float = 0.45,
    label_recess_mm: float = 0.35,
    mould_seam_mm: float = 0.15,
    segments: int = 352,
) -> Shape:
    """A flat-sided bottle: recessed label panel, mould seams, ribbed cap, conical nozzle."""
    angle = angles_rad(segments)
    body = _bottle_rows(height_mm)
    shares = (
        PchipInterpolator(*_SHOULDER[:, :2].T)(body),
        PchipInterpolator(*_SHOULDER[:, [0, 2]].T)(body),
    )
    power = PchipInterpolator(*_SHOULDER[:, [0, 3]].T)(body)
    base = np.where(body < _BASE_MM / height_mm, _fillet(body * height_mm, _BASE_MM), 0.0)
    neck = 0.37 * cap_diameter_mm
    half_x = neck + (width_mm / 2 - neck) * shares[0] - base
    half_y = neck + (length_mm / 2 - neck) * shares[1] - base
    radius = superellipse_radius(angle, half_x[:, None], half_y[:, None], power[:, None])
    label = between(body, 0.11, 0.50, 0.8 / height_mm)[:, None]
    seam = np.exp(-((np.cos(angle) * length_mm / 2 / 0.35) ** 2))
    wall = between(body, 0.03, 0.70, 0.02)[:, None]
    radius = radius - label_recess_mm * label + mould_seam_mm * wall * (1 - label) * seam

    cap = _cap_profile(cap_diameter_mm, height_mm)
    ribbed = between(cap[:, 1], 0.785 * height_mm + 2, 0.875 * height_mm - 3, 1.0)
    ribs = 0.5 * rib_depth_mm * (np.cos(cap_ribs * angle) - 1)
    cap_radius = cap[:, :1] + ribbed[:, None] * ribs
    heights = np.concatenate([body * height_mm, cap[:, 1]])
    rings = polar_rings(np.concatenate([radius, cap_radius]), angle, heights)

    rows = np.array([0, 0.023, 0.115, 0.485, 0.52, 0.56, 0.60, 0.64, 0.68, 0.72, 0.77])
    breaks = np.searchsorted(heights[: len(body)], rows * height_mm).tolist()
    cap_breaks = [len(body) + i for i in (2, 20, 32, len(cap) - 1)]
    parts = slab_hulls(rings, breaks) + slab_hulls(rings, cap_breaks)
    return Shape(loft(rings), parts)


_BASE_MM = 4.0  # radius of the fillet at the bottom
_SHOULDER = np.array(
    [
        # height, half width and half length (1 body, 0 neck), boxiness
        [0.0, 1.0, 1.0, 3.0],
        [0.55, 1.0, 1.0, 3.0],
        [0.62, 0.93, 0.85, 2.8],
        [0.69, 0.62, 0.50, 2.4],
        [0.75, 0.18, 0.12, 2.1],
        [0.78, 0.0, 0.0, 2.0],
    ]
)


def _bottle_rows(height_mm: float) -> NDArray[np.float64]:
    """Heights of the body's rings as shares of the whole height, denser where it curves."""
    base = _BASE_MM * (1 - np.cos(np.linspace(0, np.pi / 2, 12))) / height_mm
    edges = [np.linspace(at - 0.004, at + 0.004, 7) for at in (0.11, 0.50)]
    wall = np.linspace(0.03, 0.105, 3), np.linspace(0.15, 0.49, 4)
    shoulder = np.linspace(0.52, 0.775, 30)
    return np.concatenate([base, wall[0], edges[0], wall[1], edges[1], shoulder])


def _fillet(height_mm: NDArray[np.float64], radius_mm: float) -> NDArray[np.float64]:
    """How far a quarter circle at the base draws the wall in at each height."""
    up = np.clip(height_mm, 0, radius_mm)
    return radius_mm - np.sqrt(radius_mm**2 - (radius_mm - up) ** 2)


def _cap_profile(diameter_mm: float, height_mm: float) -> Curve:
    """Radius and height of the cap from its lower rim to the tip of the nozzle."""
    r, h = diameter_mm / 2, height_mm
    base, top = 0.785 * h, 0.875 * h
    edge = np.linspace(-0.5, 0.5, 5)
    rib_rows = np.concatenate([[base + 1], base + 2 + edge, top - 3 + edge])
    return joined(
        [(0.72 * r, base), (r - 0.8, base)],
        arc((r - 0.6, base + 0.6), 0.6, -90, 0, 7),
        np.stack([np.full(11, r), rib_rows], axis=-1),
        arc((r - 2.0, top - 2.0), 2.0, 0, 90, 13),
        arc((0.62 * r + 1.0, top + 1.0), 1.0, -90, -160, 7),
        np.stack([np.linspace(0.58 * r, 0.27 * r, 6), np.linspace(top + 1, h - 5, 6)], axis=-1),
        [(0.27 * r, h - 4.6), (0.36 * r, h - 4.2), (0.36 * r, h - 2.2)],
        arc((0.36 * r - 2.2, h - 2.2), 2.2, 0, 80, 10),
    )


def mug(
    *,
    diameter_mm: float,
    height_mm: float,
    wall_mm: float = 4.0,
    floor_mm: float = 5.0,
    handle_reach_mm: float = 34.0,
    handle_width_mm: float = 13.0,
    handle_thickness_mm: float = 8.0,
    segments: int = 560,
) -> Shape:
    """A cylindrical mug with a foot ring, a rounded rim and a handle on its +y side.

    It collides as if it were filled: the physics has no finger inside it.
    """
    radius = diameter_mm / 2
    body = loft(revolve(_mug_profile(radius, height_mm, wall_mm, floor_mm), segments))
    turn = np.linspace(-np.pi / 2, np.pi / 2, 60)
    start = radius - 0.5 * wall_mm
    reach = handle_reach_mm - handle_thickness_mm / 2 + radius - start
    path = np.stack(
        [
            np.zeros_like(turn),
            start + reach * np.abs(np.cos(turn)) ** 0.75,
            height_mm * 0.5 + 0.31 * height_mm * np.sin(turn),
        ],
        axis=-1,
    )
    oval = polar(1.0, angles_rad(56)) * [handle_width_mm / 2, handle_thickness_mm / 2]
    rings = sweep(path, np.array([1.0, 0.0, 0.0]), oval)
    surface = union([body, loft(rings)])
    collision = (prism(radius, 0.0, height_mm), *path_hulls(rings, 8))
    return Shape(surface, collision)


def _mug_profile(radius: float, height: float, wall: float, floor: float) -> Curve:
    """Profile from the middle of the underside, out, up, over the rim, down to the floor."""
    inner = radius - wall
    return joined(
        [(1.0, 1.5), (radius - 9.5, 1.5)],
        arc((radius - 7.5, 0.8), 0.8, 180, 270, 6),
        arc((radius - 4.5, 0.8), 0.8, 270, 360, 6),
        arc((radius - 2.5, 2.5 + 1.2), 2.5, 270, 360, 12),
        arc((radius - wall / 2, height - wall / 2), wall / 2, 0, 180, 25),
        arc((inner - 6.0, floor + 6.0), 6.0, 0, -90, 14),
        [(1.0, floor)],
    )

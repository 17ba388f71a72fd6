"""Grasp ranges for an object about which no more is known than its shape, mass and friction."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from tacgen.core.records import Mesh
from tacgen.core.units import STANDARD_GRAVITY_M_S2
from tacgen.objects.shading import depth_view, view_axes

STROKE_MM = 110.0
MARGIN_MM = 5.0
PAD_MM = (20.0, 16.0)
LOWEST_PAD_MM = 10.5
"""Height of the pad's centre at which its lower edge clears the table."""
MIN_FORCE_N, MAX_FORCE_N = 1.0, 40.0
THRESHOLD_SHARES = (0.4, 0.7, 1.0, 1.4, 2.0, 3.0, 4.0)


def suggest_ranges(
    surface: Mesh, *, mass_kg: float, friction: float
) -> tuple[dict[str, tuple[float, ...]], list[str]]:
    """Forces about the slip threshold mg/(2μ), and places where both pads meet the object.

    Returns the values by axis, and notes on what could not be satisfied.
    """
    notes = []
    threshold = mass_kg * STANDARD_GRAVITY_M_S2 / (2 * max(friction, 0.05))
    clipped = np.clip([share * threshold for share in THRESHOLD_SHARES], MIN_FORCE_N, MAX_FORCE_N)
    forces = tuple(dict.fromkeys(float(f"{force:.2g}") for force in clipped))
    if threshold > MAX_FORCE_N:
        notes.append(f"slips below {threshold:.0f} N, more than the gripper's {MAX_FORCE_N:.0f} N")

    low, high = surface.vertices_mm.min(axis=0), surface.vertices_mm.max(axis=0)
    heights = _distinct(max(LOWEST_PAD_MM, float(share * high[2])) for share in (0.25, 0.5, 0.75))
    sides = _distinct(float(share * (high[1] - low[1]) / 2) for share in (-0.4, 0.0, 0.4))
    z_mm = tuple(z for z in heights if graspable(surface, 0.0, z))
    if not z_mm:
        notes.append("no height at which the pads meet it across x; set grasp_ranges by hand")
        z_mm = heights
    y_mm = tuple(y for y in sides if all(graspable(surface, y, z) for z in z_mm)) or (0.0,)
    return {"force_n": forces, "x_mm": (0.0,), "y_mm": y_mm, "z_mm": z_mm}, notes


def graspable(surface: Mesh, y_mm: float, z_mm: float) -> bool:
    """Whether both pads, centred there, meet the object and it fits between them."""
    reach = [_reach_mm((surface,), azimuth_deg, y_mm, z_mm) for azimuth_deg in (0.0, 180.0)]
    return bool(np.isfinite(reach).all() and sum(reach) <= STROKE_MM - MARGIN_MM)


def collision_error_mm(
    surface: Mesh, parts: Sequence[Mesh], ranges: Mapping[str, tuple[float, ...]]
) -> float:
    """The most by which a pad meets the convex parts elsewhere than the surface, along x."""
    errors = [
        abs(_reach_mm((surface,), azimuth, y, z) - _reach_mm(parts, azimuth, y, z))
        for azimuth in (0.0, 180.0)
        for y in ranges["y_mm"]
        for z in ranges["z_mm"]
        if graspable(surface, y, z)
    ]
    return max(errors, default=0.0)


def _reach_mm(meshes: Sequence[Mesh], azimuth_deg: float, y_mm: float, z_mm: float) -> float:
    """How far towards a pad the meshes reach within it; −inf where there is nothing."""
    px = 0.5
    size = (int(PAD_MM[1] / px), int(PAD_MM[0] / px))
    axes, center = view_axes(azimuth_deg, 0.0), np.array([0.0, y_mm, z_mm])
    return max(float(depth_view(mesh, axes, center, size, px)[0].max()) for mesh in meshes)


def _distinct(values: Iterable[float]) -> tuple[float, ...]:
    return tuple(dict.fromkeys(round(value, 1) + 0.0 for value in values))

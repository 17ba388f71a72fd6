"""Closed office scissors: ground steel blades, a pivot screw, moulded bows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from scripts.make_objects.cans import offset_rings
from scripts.make_objects.profiles import (
    arc,
    joined,
    polar,
    rounded_rectangle,
    superellipse_radius,
)
from scripts.make_objects.resting import settled
from scripts.make_objects.shape import (
    Body,
    Shape,
    angles_rad,
    loft,
    moved,
    path_hulls,
    revolve,
    slab_hulls,
    sweep,
    union,
)
from tacgen.core.records import Mesh
from tacgen.objects.meshes import from_manifold, rounded_mesh, to_manifold

POLYPROPYLENE_KG_M3 = 910.0  # textbook density
STEEL_KG_M3 = 7850.0  # textbook density

_BLADE = np.array(
    [
        # share of the way from the pivot to the tip, x of the spine, x of the edge, mm
        [-0.10, -9.0, 7.5],
        [0.0, -9.0, 7.5],
        [0.3, -7.6, 5.0],
        [0.7, -4.6, 2.6],
        [0.92, -2.2, 1.3],
        [1.0, -0.7, 0.5],
    ]
)


def scissors(
    *,
    width_mm: float,
    length_mm: float,
    thickness_mm: float,
    pivot_mm: float = 14.0,
    blade_thickness_mm: float = 2.0,
    grind_mm: float = 3.2,
    screw_diameter_mm: float = 9.0,
    bow_mm: float = 9.5,
) -> Shape:
    """Lying flat along y, tips towards +y, the pivot at ``pivot_mm``; bows and tips carry it."""
    middle = thickness_mm / 2
    lower = _blade(pivot_mm, length_mm / 2, blade_thickness_mm, grind_mm)
    about_y = np.diag([-1.0, 1.0, -1.0])
    center = np.array([0.0, 0.0, middle])
    blades = [
        moved(loft(lower), shift_mm=center),
        moved(loft(lower), turn=about_y, shift_mm=center),
    ]

    bows = [_bow(side, width_mm, length_mm, thickness_mm, bow_mm) for side in (-1.0, 1.0)]
    shanks = [
        _shank(side, bow, pivot_mm, middle) for side, bow in zip((-1.0, 1.0), bows, strict=True)
    ]
    plastic = [*(_ring_solid(bow) for bow in bows), *(loft(shank) for shank in shanks)]
    screw = _screw(screw_diameter_mm, pivot_mm, middle, blade_thickness_mm)
    surface = union([*blades, *plastic, screw])

    mirrored = lower * [-1.0, 1.0, -1.0]
    both = np.concatenate([lower, mirrored[:, ::-1]], axis=1) + center
    steps = np.linspace(0, len(both) - 1, 7).round().astype(int).tolist()
    blade_parts = slab_hulls(both, steps, count=both.shape[1])
    plastic_parts = [
        part
        for bow, shank in zip(bows, shanks, strict=True)
        for part in (
            *path_hulls(np.concatenate([bow, bow[:1]]), 8, 11, rings_each=5),
            *path_hulls(shank, 3),
        )
    ]
    bodies = [Body(solid, STEEL_KG_M3) for solid in blades]
    bodies += [Body(solid, POLYPROPYLENE_KG_M3) for solid in plastic]
    return settled(Shape(surface, (*blade_parts, *plastic_parts), tuple(bodies)))


def _blade(
    pivot_mm: float, tip_mm: float, thickness_mm: float, grind_mm: float
) -> NDArray[np.float64]:
    """Rings (k, n, 3) of the lower blade along y: flat on top (z = 0), ground towards its edge."""
    share = np.concatenate([np.linspace(-0.1, 0.9, 110), np.linspace(0.905, 1.0, 20)])
    spine, edge = (PchipInterpolator(_BLADE[:, 0], _BLADE[:, i])(share) for i in (1, 2))
    y = pivot_mm + (tip_mm - pivot_mm) * share
    ground = np.minimum(grind_mm, 0.45 * (edge - spine))
    soft, land = 0.25, 0.15
    corner = arc((soft, soft - thickness_mm), soft, 180, 270, 6)
    rings = []
    for i in range(len(share)):
        # Clockwise in (x, z) is counter-clockwise seen against travel along +y.
        under = [(edge[i] - ground[i], -thickness_mm), (edge[i] - 0.3 * land, -0.35)]
        tip = arc((edge[i] - land, -land), land, -30, 90, 6)
        section = joined(
            corner + np.array([spine[i], 0.0]),
            under,
            tip,
            [(spine[i] + 0.1, 0.0)],
            [(spine[i], -0.1)],
        )
        rings.append(np.insert(section[::-1], 1, y[i], axis=1))
    return np.array(rings)


def _bow(
    side: float, width_mm: float, length_mm: float, thickness_mm: float, bow_mm: float
) -> NDArray[np.float64]:
    """Rings (k, n, 3) around one bow; the bow at +x is the longer one."""
    long = 44.0 if side > 0 else 38.0
    half_bow = bow_mm / 2
    outer = width_mm / 2 - half_bow
    wide = 0.47 * outer
    center = np.array(
        [side * (outer - wide), -length_mm / 2 + half_bow + (44.0 if side > 0 else 43.0)]
    )
    turn = angles_rad(184)
    loop = superellipse_radius(turn, wide, long, 2.3)
    path = np.insert(center + polar(loop, turn), 2, thickness_mm / 2, axis=1)
    angle = angles_rad(77)
    radius = superellipse_radius(angle, thickness_mm / 2, half_bow, 2.6)
    section = polar(radius, angle)
    # Two more points at each end make the direction of travel periodic.
    wrapped = np.concatenate([path[-2:], path, path[:2]])
    return sweep(wrapped, np.array([0.0, 0.0, 1.0]), section)[2:-2]


def _shank(
    side: float, bow: NDArray[np.float64], pivot_mm: float, middle_mm: float
) -> NDArray[np.float64]:
    """Rings (k, n, 3) of the plastic that joins a bow to the blades at the pivot."""
    center = bow.mean(axis=(0, 1))
    top = bow[:, :, 1].max()
    start = np.array([0.72 * center[0], top - 9.0, middle_mm])
    end = np.array([side * 1.5, pivot_mm - 6.0, middle_mm])
    t = np.linspace(0, 1, 60)[:, None]
    bend = np.array([0.12 * center[0], 0.3 * top + 0.7 * end[1], middle_mm])
    path = (1 - t) ** 2 * start + 2 * t * (1 - t) * bend + t**2 * end
    angle = angles_rad(72)
    half_z = 4.6 - 1.4 * t
    half_x = 6.5 + 1.0 * t
    radius = superellipse_radius(angle, half_z, half_x, 3.0)
    return sweep(path, np.array([0.0, 0.0, 1.0]), polar(radius, angle))


def _ring_solid(rings: NDArray[np.float64]) -> Mesh:
    """The closed tube through rings of which the last meets the first."""
    k, n, _ = rings.shape
    here = np.arange(k * n).reshape(k, n)
    a, b = here, np.roll(here, -1, axis=1)
    c, d = np.roll(b, -1, axis=0), np.roll(here, -1, axis=0)
    faces = np.concatenate([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)])
    return rounded_mesh(rings.reshape(-1, 3), faces.reshape(-1, 3))


def _screw(diameter_mm: float, pivot_mm: float, middle_mm: float, blade_mm: float) -> Mesh:
    """A domed, slotted screw head on each side of the blades."""
    r, top = diameter_mm / 2, blade_mm + 2.2
    upper = joined(
        arc((r - 0.6, top - 0.6), 0.6, 0, 80, 8), [(0.6 * r, top + 0.1), (0.1, top + 0.2)]
    )
    profile = joined((upper * [1, -1])[::-1], upper)
    head = to_manifold(loft(revolve(profile, 180)))
    slot, away = rounded_rectangle(0.5, r + 1.0, 0.2, 2.0)
    ends = np.array([[0.0, top - 0.9], [0.0, top + 1.0]])
    head = head - to_manifold(loft(offset_rings(slot, away, ends)))
    return moved(from_manifold(head), shift_mm=np.array([0.0, pivot_mm, middle_mm]))

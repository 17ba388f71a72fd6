"""A strawberry with seeds in their pits, lying on its flank."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree

from scripts.make_objects.profiles import Curve, arc, between, joined
from scripts.make_objects.resting import settled
from scripts.make_objects.shape import Shape, angles_rad, loft, moved, polar_rings
from tacgen.objects.meshes import hull

GOLDEN_ANGLE_RAD = np.pi * (3 - np.sqrt(5))
FLESH_ROWS = 160
COLLISION_ROWS, COLLISION_SECTIONS = 15, 28  # chords of 5 mm, which lie 0.13 mm inside

_FLESH = np.array(
    [
        # share of the largest radius, share of the flesh's length, from the tip to the stem
        [0.0, 0.0],
        [0.30, 0.035],
        [0.55, 0.17],
        [0.80, 0.40],
        [0.97, 0.66],
        [0.98, 0.83],
        [0.80, 0.965],
        [0.50, 1.0],
        [0.24, 0.985],
    ]
)


def strawberry(
    *,
    diameter_mm: float,
    length_mm: float,
    stem_mm: float = 7.0,
    seeds: int = 190,
    pit_mm: float = 0.7,
    seed_mm: float = 0.4,
    leaves: int = 7,
    leaf_mm: float = 1.1,
    segments: int = 260,
) -> Shape:
    """Lying along y with its tip towards +y, in the pose in which it comes to rest."""
    radius, flesh = diameter_mm / 2, length_mm - stem_mm
    profile = _profile(radius, flesh, stem_mm)
    angle = angles_rad(segments)
    # Rings start at the flank that faces +x; points gather there and at the opposite one.
    angle = angle - 0.38 * np.sin(2 * angle)
    rings = polar_rings(profile[:, :1], angle, profile[:, 1])
    rings += _relief(profile, angle, radius, flesh, (seeds, pit_mm, seed_mm, leaves, leaf_mm))

    # Evenly thinned, without pits: alike on both sides, and with a facet at the bottom to rest on.
    rows = np.linspace(3, FLESH_ROWS - 12, COLLISION_ROWS).round().astype(int)
    body = _turned(profile[rows], COLLISION_SECTIONS)
    stem = _turned(profile[[FLESH_ROWS + 6, -1]], 12)
    lying = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    return settled(
        Shape(
            moved(loft(rings), turn=lying),
            (moved(hull(body), turn=lying), moved(hull(stem), turn=lying)),
        )
    )


def _profile(radius_mm: float, flesh_mm: float, stem_mm: float) -> Curve:
    """Radius and height from the tip, evenly spaced along the flesh, then the stem."""
    points = _FLESH * [radius_mm / 0.985, flesh_mm]
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    start, end = np.array([1.0, 0.0]), np.array([-0.8, -0.6])
    spline = CubicSpline(along, points, bc_type=((1, start), (1, end)))
    flesh = spline(along[-1] * np.linspace(0.004, 1, FLESH_ROWS))
    top = flesh_mm + stem_mm
    return joined(
        flesh,
        arc((3.6, flesh_mm + 0.9), 1.4, -100, -180, 6),
        [(2.0, flesh_mm + 2.5), (1.8, top - 1.2)],
        arc((1.0, top - 0.8), 0.8, 0, 80, 5),
    )


def _turned(profile: Curve, sections: int) -> NDArray[np.float64]:
    """Rings (k, sections, 3) about z; of a multiple of four sections, facets face ±x and ±y."""
    angle = angles_rad(sections) + np.pi / sections
    return polar_rings(profile[:, :1], angle, profile[:, 1])


def _relief(
    profile: Curve,
    angle: NDArray[np.float64],
    radius: float,
    flesh: float,
    detail: tuple[int, float, float, int, float],
) -> NDArray[np.float64]:
    """What pits, seeds and leaves add to the rings, along the surface's normal."""
    seeds, pit_mm, seed_mm, leaves, leaf_mm = detail
    travel = np.gradient(profile, axis=0)
    travel /= np.linalg.norm(travel, axis=1, keepdims=True)
    rows = np.arange(len(profile)) < FLESH_ROWS
    across, along = _to_nearest_seed(profile, angle, flesh, seeds)
    q = (across / 1.5) ** 2 + (along / 2.1) ** 2
    pit = -pit_mm * np.clip(1 - q, 0, None) ** 2
    grain = (across / 0.85) ** 2 + (along / 1.3) ** 2
    height = (pit + seed_mm * np.clip(1 - grain, 0, None) ** 2) * rows[:, None]

    out = np.where(profile[:, 1] > 0.9 * flesh, profile[:, 0] / radius, 9.0)[:, None]
    lobe = np.abs(np.mod(angle * leaves / (2 * np.pi), 1.0) - 0.5) * 2
    width = np.clip(1 - ((out - 0.42) / 0.42) ** 2, 0, None) ** 0.5
    vein = 0.25 * np.exp(-((lobe / 0.06) ** 2))
    leaf = between(lobe - width, -9.0, 0.0, 0.4) * (leaf_mm + vein) * (out > 0.16) * rows[:, None]
    height = np.where(out < 0.86, np.maximum(leaf, height), height)
    normal = np.stack(
        [
            travel[:, 1:] * np.cos(angle),
            travel[:, 1:] * np.sin(angle),
            np.broadcast_to(-travel[:, :1], height.shape),
        ],
        axis=-1,
    )
    return np.asarray(height[:, :, None] * normal)


def _to_nearest_seed(
    profile: Curve, angle: NDArray[np.float64], flesh: float, seeds: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Distance across and along the flank from each point to its nearest seed, mm."""
    side = profile[:FLESH_ROWS]
    side = side[(side[:, 1] > 0.05 * flesh) & (np.gradient(side[:, 1]) > 0)]
    step = np.linalg.norm(np.diff(side, axis=0), axis=1)
    area = np.concatenate([[0], np.cumsum(step * (side[1:, 0] + side[:-1, 0]))])
    share = (np.arange(seeds) + 0.5) / seeds * area[-1]
    ring = np.stack([np.interp(share, area, side[:, i]) for i in range(2)], axis=-1)
    turn = GOLDEN_ANGLE_RAD * np.arange(seeds) + 0.3
    places = np.column_stack([ring[:, 0] * np.cos(turn), ring[:, 0] * np.sin(turn), ring[:, 1]])
    points = polar_rings(profile[:, :1], angle, profile[:, 1])
    _, nearest = cKDTree(places).query(points.reshape(-1, 3))
    off = points - places[nearest].reshape(points.shape)
    turn = turn[nearest].reshape(points.shape[:2])
    across = off[:, :, 1] * np.cos(turn) - off[:, :, 0] * np.sin(turn)
    return across, np.sqrt(np.maximum((off**2).sum(axis=-1) - across**2, 0.0))

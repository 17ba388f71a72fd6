"""Plane curves that the objects are turned, lofted or extruded from."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Curve = NDArray[np.float64]


def arc(
    center_mm: tuple[float, float], radius_mm: float, from_deg: float, to_deg: float, count: int
) -> Curve:
    """``count`` points (count, 2) along an arc, both ends included."""
    return center_mm + polar(radius_mm, np.radians(np.linspace(from_deg, to_deg, count)))


def joined(*pieces: Curve | list[tuple[float, float]]) -> Curve:
    """Pieces of a profile (k, 2) end to end, without repeated points."""
    points = np.concatenate([np.asarray(piece, dtype=np.float64) for piece in pieces])
    step = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return np.asarray(points[np.concatenate([[True], step > 1e-9])])


def smooth_step(x: NDArray[np.float64] | float) -> NDArray[np.float64]:
    """0 below 0, 1 above 1, and a cubic without kinks in between."""
    t = np.clip(x, 0.0, 1.0)
    return np.asarray(t * t * (3 - 2 * t))


def between(x: NDArray[np.float64], low: float, high: float, edge: float) -> NDArray[np.float64]:
    """1 between ``low`` and ``high``, 0 outside, each edge ``edge`` wide and centred."""
    return smooth_step((x - low) / edge + 0.5) * smooth_step((high - x) / edge + 0.5)


def superellipse_radius(
    angle_rad: Curve, a: Curve | float, b: Curve | float, power: Curve | float
) -> Curve:
    """Polar radius of ``|x/a|^p + |y/b|^p = 1``; 2 is an ellipse, larger is boxier."""
    x, y = np.abs(np.cos(angle_rad)) / a, np.abs(np.sin(angle_rad)) / b
    return (x**power + y**power) ** (-1 / np.asarray(power, dtype=np.float64))


def rounded_rectangle(
    half_x_mm: float,
    half_y_mm: float,
    corner_mm: float,
    spacing_mm: float,
    corner_steps: int | None = None,
) -> tuple[Curve, Curve]:
    """Points (n, 2) about every ``spacing_mm`` around a rounded rectangle, and their normals.

    Counter-clockwise from the middle of the +x side; offsetting the points along the normals
    gives the rounded rectangle of another size with the same number of points.
    """
    quarter = []
    steps_y = max(1, int(np.ceil((half_y_mm - corner_mm) / spacing_mm)))
    steps_x = max(1, int(np.ceil((half_x_mm - corner_mm) / spacing_mm)))
    turns = corner_steps or max(6, int(np.ceil(corner_mm * np.pi / 2 / spacing_mm)))
    for y in np.linspace(0, half_y_mm - corner_mm, steps_y, endpoint=False):
        quarter.append((half_x_mm, y, 1.0, 0.0))
    for angle in np.linspace(0, np.pi / 2, turns, endpoint=False):
        c, s = float(np.cos(angle)), float(np.sin(angle))
        quarter.append(
            (half_x_mm - corner_mm + corner_mm * c, half_y_mm - corner_mm + corner_mm * s, c, s)
        )
    for x in np.linspace(half_x_mm - corner_mm, 0, steps_x, endpoint=False):
        quarter.append((x, half_y_mm, 0.0, 1.0))
    first = np.array(quarter)
    second = np.vstack([[0, half_y_mm, 0, 1], first[:0:-1] * [-1, 1, -1, 1]])
    half = np.vstack([first, second])
    full = np.vstack([half, half * -1.0])
    return full[:, :2], full[:, 2:]


def polar(radius_mm: NDArray[np.float64] | float, angle_rad: NDArray[np.float64]) -> Curve:
    """Points (…, n, 2) at polar radii (…, n) and angles (n,)."""
    return np.stack([radius_mm * np.cos(angle_rad), radius_mm * np.sin(angle_rad)], axis=-1)


def rounded_polygon(
    corners_mm: Curve, radius_mm: float, *, steps: int, spacing_mm: float = 1e3
) -> tuple[Curve, Curve]:
    """Points (n, 2) around a convex polygon with rounded corners, and their outward normals.

    ``corners_mm`` (m, 2) counter-clockwise. Each corner has ``steps`` + 1 points; each side has
    one about every ``spacing_mm``.
    """
    corners_mm = np.asarray(corners_mm, dtype=np.float64)
    points, normals = [], []
    for i, corner in enumerate(corners_mm):
        before = corner - corners_mm[i - 1]
        after = corners_mm[(i + 1) % len(corners_mm)] - corner
        # Angles of the outward normals of the two sides; the arc runs from one to the other.
        start = np.arctan2(-before[0], before[1])
        turn = np.mod(np.arctan2(-after[0], after[1]) - start, 2 * np.pi)
        center = corner - radius_mm / np.cos(turn / 2) * polar(1.0, start + turn / 2)
        outward = polar(1.0, start + turn * np.linspace(0, 1, steps + 1))
        points.append(center + radius_mm * outward)
        normals.append(outward)
    filled = [
        _with_side(points[i], points[(i + 1) % len(points)], normals[i], spacing_mm)
        for i in range(len(points))
    ]
    return np.concatenate([p for p, _ in filled]), np.concatenate([n for _, n in filled])


def _with_side(
    arc_mm: Curve, following_mm: Curve, normals: Curve, spacing_mm: float
) -> tuple[Curve, Curve]:
    """A corner's arc and the points along the side that follows it."""
    end, start = following_mm[0], arc_mm[-1]
    count = max(1, round(float(np.linalg.norm(end - start)) / spacing_mm))
    side = start + (end - start) * np.arange(1, count)[:, None] / count
    return np.vstack([arc_mm, side]), np.vstack([normals, np.repeat(normals[-1:], len(side), 0)])

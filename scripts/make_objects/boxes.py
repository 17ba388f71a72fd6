"""Boxes: a filled carton whose walls bulge, and a block of wood."""

from __future__ import annotations

import numpy as np

from scripts.make_objects.cans import offset_rings
from scripts.make_objects.profiles import arc, between, joined, rounded_rectangle, smooth_step
from scripts.make_objects.shape import Shape, loft
from tacgen.objects.meshes import hull


def carton(
    *,
    width_mm: float,
    length_mm: float,
    height_mm: float,
    edge_mm: float = 1.0,
    bulge_mm: float = 0.5,
    board_mm: float = 0.45,
    flap_edge_mm: float = 3.0,
    spacing_mm: float = 0.5,
) -> Shape:
    """A folded carton: bulging walls, creased edges, tucked ends and the step of its glue flap.

    The board of the glue flap ends on both broad walls, ``flap_edge_mm`` from their middle, as
    a step of one ``board_mm``. The published width and length are those over the bulge.
    """
    half_x, half_y = width_mm / 2 - bulge_mm, length_mm / 2 - bulge_mm
    outline, normals = rounded_rectangle(half_x, half_y, edge_mm, spacing_mm)
    tuck = joined([(-0.9 * edge_mm, board_mm), (-board_mm - 0.2, board_mm)])
    lower = joined(tuck, arc((-board_mm / 2, board_mm / 2), board_mm / 2, 180, 360, 9))
    upper = (lower * [1, -1] + [0, height_mm])[::-1]
    rows = np.linspace(1.0, height_mm - 1.0, 54)
    profile = joined(lower, np.stack([np.zeros_like(rows), rows], axis=-1), upper)
    rings = offset_rings(outline, normals, profile)

    on_wall = between(profile[:, 1], 0.5, height_mm - 0.5, 0.8)
    up = 1 - (2 * profile[:, 1] / height_mm - 1) ** 2
    bow = _bow(outline, normals, half_x, half_y)[:, 0]
    swell = (bulge_mm - board_mm) * np.clip(up, 0, 1)[:, None] * bow
    flap = board_mm * on_wall[:, None] * _flap(outline, normals, flap_edge_mm)
    rings[:, :, :2] += (swell + flap)[:, :, None] * normals

    corners, corner_normals = rounded_rectangle(half_x, half_y, edge_mm, 11.0, corner_steps=1)
    middle = corners + corner_normals * (bulge_mm * _bow(corners, corner_normals, half_x, half_y))
    heights = ((corners, 0.0), (corners, 1.0), (middle, 0.35), (middle, 0.65))
    bulged = [np.insert(ring, 2, height_mm * part, axis=1) for ring, part in heights]
    return Shape(loft(rings), (hull(np.concatenate(bulged)),))


def _bow(outline: np.ndarray, normals: np.ndarray, half_x: float, half_y: float) -> np.ndarray:
    """How much of the bulge there is around a coarse outline, (n, 1)."""
    facing_x = np.abs(normals[:, 0]) > np.abs(normals[:, 1])
    across = np.where(facing_x, outline[:, 1] / half_y, outline[:, 0] / half_x)
    return (1 - across**2)[:, None]


def _flap(outline: np.ndarray, normals: np.ndarray, edge_mm: float) -> np.ndarray:
    """Where the second layer of board lies: from the step to the wall's edge, faded there."""
    y = outline[:, 1] * np.sign(normals[:, 0])
    layer = between(y, edge_mm, np.abs(outline[:, 1]).max() - 1.5, 0.7)
    return np.asarray(layer * (np.abs(normals[:, 0]) > 0.999))


def wood_block(
    *,
    side_mm: float,
    height_mm: float,
    edge_mm: float = 1.5,
    grain_mm: float = 0.12,
    grain_pitch_mm: float = 2.6,
    spacing_mm: float = 0.5,
) -> Shape:
    """A square block, its edges broken, whose late wood stands out along the grain."""
    half = side_mm / 2
    outline, normals = rounded_rectangle(half, half, edge_mm, spacing_mm)
    rows = np.linspace(edge_mm + 0.5, height_mm - edge_mm - 0.5, 47)
    profile = joined(
        [(-0.9 * edge_mm, 0.0)],
        arc((-0.9 * edge_mm, 0.9 * edge_mm), 0.9 * edge_mm, -90, 0, 7),
        np.stack([np.zeros_like(rows), rows], axis=-1),
        arc((-0.9 * edge_mm, height_mm - 0.9 * edge_mm), 0.9 * edge_mm, 0, 90, 7),
    )
    rings = offset_rings(outline, normals, profile)
    height = profile[:, 1:]
    on_wall = between(profile[:, 1], 1.2 * edge_mm, height_mm - 1.2 * edge_mm, 1.0)[:, None]
    # Annual rings are cylinders about a pith outside the block, cut by its faces.
    pith = np.array([-1.9 * half, -0.6 * half]) + np.stack(
        [0.5 * np.sin(height / 41), 3.0 * np.sin(height / 47 + 1)], axis=-1
    )
    age = np.linalg.norm(outline - pith, axis=-1) / grain_pitch_mm
    late = np.mod(age + 0.25 * np.sin(1.7 * age), 1.0)
    ridge = smooth_step(late / 0.7) * smooth_step((1 - late) / 0.3)
    rings[:, :, :2] -= (grain_mm * on_wall * (1 - ridge))[:, :, None] * normals

    corners, away = rounded_rectangle(half, half, edge_mm, 1e3, corner_steps=1)
    ends = offset_rings(corners, away, np.array([[0.0, 0.0], [0.0, height_mm]]))
    return Shape(loft(rings), (hull(ends),))

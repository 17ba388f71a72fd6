"""A slotted turner of nylon."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from scripts.make_objects.cans import offset_rings
from scripts.make_objects.profiles import (
    arc,
    polar,
    rounded_polygon,
    rounded_rectangle,
    superellipse_radius,
)
from scripts.make_objects.resting import settled
from scripts.make_objects.shape import (
    Shape,
    angles_rad,
    loft,
    moved,
    path_hulls,
    sweep,
    union,
)
from tacgen.core.records import Mesh
from tacgen.objects.meshes import from_manifold, hull, to_manifold

_SPINE = np.array(
    [
        # share of the handle from neck to end, share of the height, width and thickness in mm
        [0.0, 0.60, 15.0, 4.5],
        [0.06, 0.74, 12.0, 6.0],
        [0.16, 0.865, 10.5, 7.0],
        [0.30, 0.855, 13.0, 8.0],
        [0.42, 0.72, 21.0, 10.5],
        [0.55, 0.58, 24.0, 12.0],
        [0.78, 0.36, 23.0, 12.0],
        [0.94, 0.22, 25.0, 12.0],
        [1.0, 0.17, 22.0, 10.0],
    ]
)


def slotted_spatula(
    *,
    width_mm: float,
    length_mm: float,
    height_mm: float,
    head_length_mm: float = 98.0,
    back_width_mm: float = 62.0,
    thickness_mm: float = 2.4,
    slots: int = 4,
    slot_width_mm: float = 6.0,
    slot_length_mm: float = 58.0,
    segments: int = 300,
) -> Shape:
    """Lying along y, head towards +y: it touches the table with its front edge and its end."""
    neck_y = length_mm / 2 - head_length_mm + 8.0
    spine_z = _SPINE[0, 1] * height_mm
    rings = _handle_rings(neck_y, -length_mm / 2, height_mm, segments)
    front = length_mm / 2
    tilt = -np.arctan2(spine_z, front - neck_y)
    c, s = np.cos(tilt), np.sin(tilt)
    turn = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    plate, outline = _head(
        width_mm,
        head_length_mm / c,
        back_width_mm,
        thickness_mm,
        (slots, slot_width_mm, slot_length_mm),
    )
    at = np.array([0.0, front, 0.0])
    head = moved(plate, turn=turn, shift_mm=at)
    head_part = moved(hull(outline), turn=turn, shift_mm=at)
    surface = union([head, loft(rings)])
    return settled(Shape(surface, (head_part, *path_hulls(rings, 5, count=20))))


def _handle_rings(
    neck_mm: float, end_mm: float, height_mm: float, segments: int
) -> NDArray[np.float64]:
    """Sections of the handle from the neck to its end."""
    share = np.concatenate([np.linspace(0, 0.985, 95), 1 - 0.015 * np.linspace(0.9, 0, 10) ** 2])
    height, width, thickness = (
        PchipInterpolator(_SPINE[:, 0], _SPINE[:, i])(share) for i in (1, 2, 3)
    )
    rounding = np.sqrt(np.clip(1 - np.clip((share - 0.985) / 0.0152, 0, 1) ** 2, 0, None))
    path = np.stack(
        [np.zeros_like(share), neck_mm + (end_mm - neck_mm) * share, height * height_mm], axis=-1
    )
    angle = angles_rad(segments)
    # Points gather on the narrow sides, which the pads touch.
    angle = angle - 0.3 * np.sin(2 * angle)
    radius = superellipse_radius(
        angle, (rounding * width / 2)[:, None], (rounding * thickness / 2)[:, None], 2.6
    )
    return sweep(path, np.array([1.0, 0.0, 0.0]), polar(radius, angle))


def _head(
    width_mm: float,
    length_mm: float,
    back_mm: float,
    thickness_mm: float,
    slots: tuple[int, float, float],
) -> tuple[Mesh, NDArray[np.float64]]:
    """The plate in its own plane, front edge at y = 0, and a few points that bound it."""
    corners = np.array(
        [
            [back_mm / 2, -length_mm],
            [width_mm / 2, 0.0],
            [-width_mm / 2, 0.0],
            [-back_mm / 2, -length_mm],
        ]
    )
    half = thickness_mm / 2
    outline, normals = rounded_polygon(corners, 9.0, steps=24, spacing_mm=1.0)
    edge = arc((-half, 0.0), half, -90, 90, 13)
    # Rounding takes the front corners away: the published width is over what is left.
    full = width_mm / float(np.ptp(outline[:, 0]))
    outline = outline * [full, 1.0]
    plate = to_manifold(loft(offset_rings(outline, normals, edge)))
    count, wide, long = slots
    slot, slot_normals = rounded_rectangle(
        wide / 2, long / 2, wide / 2 - 0.01, 2.0, corner_steps=16
    )
    lip = np.array(
        [
            [0.5, -half - 0.01],
            [0.12, -half + 0.1],
            [0.0, -half + 0.35],
            [0.0, half - 0.35],
            [0.12, half - 0.1],
            [0.5, half + 0.01],
        ]
    )
    cutter = loft(offset_rings(slot, slot_normals, lip))
    pitch = 0.72 * back_mm / max(1, count - 1)
    for i in range(count):
        x = (i - (count - 1) / 2) * pitch
        plate = plate - to_manifold(moved(cutter, shift_mm=np.array([x, -0.5 * length_mm, 0.0])))
    rim, rim_normals = rounded_polygon(corners, 9.0, steps=4)
    slim = np.array([[-0.4 * half, -half], [0.0, 0.0], [-0.4 * half, half]])
    return from_manifold(plate), offset_rings(rim * [full, 1.0], rim_normals, slim)

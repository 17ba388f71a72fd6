"""What is drawn over a tactile image: the markers' motion and the force field, as paths of SVG.

Their units are pixels of the image, whose middle is the origin of the gel frame.
"""

import math

import numpy as np
from numpy.typing import NDArray

from tacgen.core.images import side_by_side
from tacgen.core.types import FloatArray

LEAST_SHARE = 0.01  # of the largest force of a cell, below which nothing is drawn
HEAD_SHARE, MOST_HEAD_PX = 0.35, 6.0  # of an arrow: its head's share of the length, and the longest


SEGMENT_COLORS = np.array(
    [
        *([255, 255, 255], [222, 214, 200], [214, 76, 60], [60, 110, 180], [120, 190, 235]),
        *([60, 140, 90], [140, 215, 150], [90, 90, 100]),
    ],
    np.uint8,
)
"""Of each number of a segmentation."""


def camera_panel(
    rgb: NDArray[np.uint8], depth_mm: NDArray[np.float32], ids: NDArray[np.uint8]
) -> NDArray[np.uint8]:
    """What a camera sees at one time, side by side: colours, depth (near is dark), segments."""
    is_there = depth_mm > 0
    near_mm = float(depth_mm.min(where=is_there, initial=np.inf))
    share = (depth_mm - near_mm) / max(float(depth_mm.max()) - near_mm, 1e-9)
    grey = np.where(is_there, 40 + 190 * share, 255).astype(np.uint8)
    return side_by_side([rgb, np.repeat(grey[..., None], 3, axis=-1), SEGMENT_COLORS[ids]])


def gain_of(largest_mm: float, room_mm: float) -> float:
    """1, 2, 5, 10, 20 … times: as long as the largest motion may be drawn in that room."""
    if not 0 < largest_mm < room_mm:
        return 1.0
    power = 10.0 ** math.floor(math.log10(room_mm / largest_mm))
    return max(step * power for step in (1, 2, 5) if step * power * largest_mm <= room_mm)


def spacing_mm(rest_mm: FloatArray) -> float:
    """Distance (mm) between neighbours of the places (M, 2); 1 for a single one."""
    if len(rest_mm) < 2:
        return 1.0
    return float(np.linalg.norm(rest_mm[1:] - rest_mm[0], axis=1).min())


def to_pixels(places_mm: FloatArray, mm_per_px: float, shape_px: tuple[int, int]) -> FloatArray:
    """Places (…, 2) of the gel frame in the image, x and y."""
    height, width = shape_px
    return np.asarray(places_mm / mm_per_px + (width / 2, height / 2))


def dots_path(places_px: FloatArray) -> str:
    """A dot at each of the places (M, 2)."""
    return "".join(f"M{x:.1f} {y:.1f}h0" for x, y in places_px)


def arrows_path(places_px: FloatArray, steps_px: FloatArray) -> str:
    """An arrow from each of the places (M, 2) by its step (M, 2), where that is half a pixel."""
    length = np.linalg.norm(steps_px, axis=1)
    seen = length >= 0.5
    head = np.minimum(HEAD_SHARE, MOST_HEAD_PX / length[seen, None]) * steps_px[seen]
    side = head[:, ::-1] * (-0.5, 0.5)
    return "".join(
        f"M{x:.1f} {y:.1f}l{dx:.1f} {dy:.1f}"
        f"m{ax:.1f} {ay:.1f}l{-ax:.1f} {-ay:.1f}l{bx:.1f} {by:.1f}"
        for (x, y), (dx, dy), (ax, ay), (bx, by) in zip(
            places_px[seen], steps_px[seen], side - head, -side - head, strict=True
        )
    )


def field_paths(
    field_n: NDArray[np.floating], largest_n: float, shape_px: tuple[int, int]
) -> tuple[str, str]:
    """Squares whose area is each cell's normal force, arrows along its shear; (rows, columns, 3).

    A square of the ``largest_n`` fills its cell, an arrow of it is as long as the cell.
    """
    rows, columns, _ = field_n.shape
    cell_px = np.array([shape_px[1] / columns, shape_px[0] / rows])
    row, column = np.nonzero(np.abs(field_n).max(axis=2) >= LEAST_SHARE * max(largest_n, 1e-9))
    middle_px = (np.stack([column, row], axis=1) + 0.5) * cell_px
    force = field_n[row, column] / max(largest_n, 1e-9)
    sides_px = cell_px.min() * np.sqrt(np.maximum(force[:, 2], 0.0))
    squares = "".join(
        f"M{x - side / 2:.1f} {y - side / 2:.1f}h{side:.1f}v{side:.1f}h{-side:.1f}z"
        for (x, y), side in zip(middle_px, sides_px, strict=True)
    )
    return squares, arrows_path(middle_px, force[:, :2] * cell_px.min())

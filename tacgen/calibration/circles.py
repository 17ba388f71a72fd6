"""Finding the contact circle of a ball press in its image."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.optimize import least_squares

FloatArray = NDArray[np.floating]

WORK_WIDTH_PX = 160
"""Images are looked at this wide: a circle needs no more."""

CLEAR_SIGMAS = 8.0
"""A contact stands out of the bare gel's scatter by at least this many standard deviations."""

MIN_CHANGE_GREY = 6.0
"""And by at least this many grey levels, so that a still camera does not make a press of dust."""

MIN_ROUNDNESS = 0.6
"""Least share of the circle that the changed pixels fill, and of them that lie within it."""


@dataclass(frozen=True, slots=True)
class Circle:
    """A contact circle in pixels of the image; ``problem`` says why it cannot be used."""

    center_px: FloatArray
    radius_px: float
    problem: str = ""


def find_circle(image: NDArray[np.uint8], background: NDArray[np.uint8]) -> Circle:
    """The contact circle of a press from its image and the background, both (H, W, 3) RGB.

    What changed against the background, less what the whole picture changed by, is thresholded
    about half way up; a circle is fitted robustly to the edge of the largest patch.
    """
    height, width = image.shape[:2]
    scale = min(1.0, WORK_WIDTH_PX / width)
    size = (max(8, round(width * scale)), max(8, round(height * scale)))
    change = _coarse(image, size) - _coarse(background, size)
    change = change - np.median(change, axis=(0, 1))
    strength = np.asarray(cv2.GaussianBlur(np.linalg.norm(change, axis=2), (0, 0), 1.0))
    middle = float(np.median(strength))
    scatter = 1.4826 * float(np.median(np.abs(strength - middle))) + 0.2
    top = float(np.percentile(strength, 99.7))
    nothing = Circle(np.full(2, np.nan), float("nan"))
    if top - middle < max(CLEAR_SIGMAS * scatter, MIN_CHANGE_GREY):
        return _with(nothing, "shows no contact")
    level = middle + max(0.55 * (top - middle), 4.0 * scatter)
    patch = _largest_patch(strength > level)
    center, radius = _fit_circle(patch)
    problem = _problem(patch, center, radius)
    return Circle((center + 0.5) / scale - 0.5, radius / scale, problem)


def _with(circle: Circle, problem: str) -> Circle:
    return Circle(circle.center_px, circle.radius_px, problem)


def _coarse(image: NDArray, size: tuple[int, int]) -> NDArray:
    return np.asarray(cv2.resize(image.astype(np.float32), size, interpolation=cv2.INTER_AREA))


def _largest_patch(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The largest connected patch of ``mask``, closed and without holes."""
    closed = ndimage.binary_closing(np.pad(mask, 4), iterations=3)[4:-4, 4:-4]
    labels, count = ndimage.label(closed)
    if count == 0:
        return closed
    sizes = ndimage.sum_labels(closed, labels, np.arange(1, count + 1))
    filled: NDArray[np.bool_] = ndimage.binary_fill_holes(labels == 1 + int(np.argmax(sizes)))
    return filled


def _fit_circle(patch: NDArray[np.bool_]) -> tuple[FloatArray, float]:
    """Centre (x, y) and radius of the circle through the patch's edge, robust to bites and tails.

    Edge pixels on the image's border are no edge of the contact and are left out.
    """
    rows, columns = np.nonzero(patch & ~ndimage.binary_erosion(patch))
    inner = (
        (rows > 0) & (columns > 0) & (rows < patch.shape[0] - 1) & (columns < patch.shape[1] - 1)
    )
    if inner.sum() >= 8:
        rows, columns = rows[inner], columns[inner]
    area = float(patch.sum())
    every_row, every_column = np.nonzero(patch)
    start = np.array([every_column.mean(), every_row.mean(), np.sqrt(max(area, 1.0) / np.pi)])
    if len(rows) < 5:
        return start[:2], float(start[2])

    def distance(circle: FloatArray) -> FloatArray:
        return np.hypot(columns - circle[0], rows - circle[1]) - circle[2]

    fitted = least_squares(distance, start, loss="soft_l1", f_scale=1.0).x
    return fitted[:2], float(abs(fitted[2]) + 0.5)


def _problem(patch: NDArray[np.bool_], center: FloatArray, radius: float) -> str:
    height, width = patch.shape
    rows, columns = np.indices(patch.shape)
    disc = np.hypot(columns - center[0], rows - center[1]) <= radius
    both = float((disc & patch).sum())
    filled, within = both / max(float(disc.sum()), 1.0), both / max(float(patch.sum()), 1.0)
    if radius < 2:
        return "shows a change of less than 2 pixels across, too small for a contact"
    if not (0 <= center[0] < width and 0 <= center[1] < height):
        return "the contact's centre lies out of view"
    if radius > 0.45 * min(height, width):
        return "the change covers most of the image: the background does not match this press"
    if filled < MIN_ROUNDNESS or within < MIN_ROUNDNESS:
        return "what changed is not round"
    return ""


def outside_share(center_px: FloatArray, radius_px: float, shape_px: tuple[int, int]) -> float:
    """The share of a circle that lies outside the image, 0 to 1."""
    height, width = shape_px
    side = np.linspace(-1, 1, 81)
    x, y = np.meshgrid(side, side)
    disc = np.hypot(x, y) <= 1
    column, row = center_px[0] + radius_px * x[disc], center_px[1] + radius_px * y[disc]
    seen = (column > -0.5) & (column < width - 0.5) & (row > -0.5) & (row < height - 0.5)
    return float(1 - seen.mean())

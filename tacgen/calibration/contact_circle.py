"""The contact circle of a ball press, found in the picture: where the change of colour ends."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.optimize import minimize

Floats = NDArray[np.floating]
Image = NDArray[np.uint8]

SECTORS = 48
MIN_CHANGE_GREY = 4.0
"""A picture whose strongest change is below this shows no contact."""


@dataclass(frozen=True, slots=True)
class Circle:
    """Centre (column, row) and radius in px, and how clearly its rim stands out (grey levels)."""

    column_px: float
    row_px: float
    radius_px: float
    contrast_grey: float


def find_circle(
    rgb: Image, background: Image, hidden: NDArray[np.bool_] | None = None
) -> Circle | None:
    """The circle across which the change from the background drops most; None without contact.

    The slope of the gel under a ball grows towards the rim of the contact and falls outside it.
    """
    change = np.abs(rgb.astype(np.float32) - background.astype(np.float32)).sum(axis=2)
    if hidden is not None:
        change = cv2.inpaint(
            np.clip(change, 0, 255).astype(np.uint8), hidden.astype(np.uint8), 3, cv2.INPAINT_TELEA
        ).astype(np.float32)
    change = gaussian_filter(change, 1.0)
    quiet = float(np.median(change))
    if change.max() - quiet < MIN_CHANGE_GREY:
        return None
    start = _blob(change, quiet)
    if start is None:
        return None
    column, row, radius = start
    best = None
    for guess in (radius, 0.85 * radius, 1.15 * radius):
        found = minimize(
            lambda p: -_rim_contrast(change, p),
            [column, row, guess],
            method="Nelder-Mead",
            options={
                "initial_simplex": _simplex(column, row, guess),
                "xatol": 0.02,
                "fatol": 1e-3,
                "maxiter": 300,
            },
        )
        if best is None or found.fun < best.fun:
            best = found
    if best is None or not -best.fun > 0:
        return None
    column, row, radius = (float(value) for value in best.x)
    return Circle(column, row, radius, float(-best.fun))


def _simplex(column: float, row: float, radius: float) -> Floats:
    start = np.array([column, row, radius])
    return np.vstack([start, start + 0.1 * radius * np.eye(3)])


def _blob(change: Floats, quiet: float) -> tuple[float, float, float] | None:
    """Centre and radius of the largest patch of strong change."""
    level = quiet + 0.35 * (np.quantile(change, 0.995) - quiet)
    count, labels, stats, _ = cv2.connectedComponentsWithStats((change > level).astype(np.uint8))
    if count < 2:
        return None
    largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    rows, columns = np.nonzero(labels == largest)
    hull = cv2.convexHull(np.column_stack([columns, rows]).astype(np.int32))
    (column, row), _ = cv2.minEnclosingCircle(hull)
    area = float(cv2.contourArea(hull))
    if area < 12:
        return None
    return float(column), float(row), float(np.sqrt(area / np.pi))


def _rim_contrast(change: Floats, parameters: Floats) -> float:
    """Mean over directions of the drop of change across the rim; dark directions count little."""
    column, row, radius = parameters
    if radius < 3.0:
        return -1.0
    angle = 2.0 * np.pi * np.arange(SECTORS) / SECTORS
    width = max(1.5, 0.08 * radius)
    offsets = np.array([-1.0, -0.5, 0.5, 1.0]) * width
    reach = radius + offsets[:, None]
    samples = map_coordinates(
        change,
        [row + reach * np.sin(angle), column + reach * np.cos(angle)],
        order=1,
        mode="nearest",
    )
    drop = samples[:2].mean(axis=0) - samples[2:].mean(axis=0)
    return float(np.mean(np.sort(drop)[SECTORS // 8 : -SECTORS // 8]))

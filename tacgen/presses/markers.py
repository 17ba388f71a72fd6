"""Printed dots in pictures of the gel: found, and followed from picture to picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tacgen.core.errors import PressError

Floats = NDArray[np.floating[Any]]
Image = NDArray[np.uint8]

DARKER_THAN = 0.8
"""A dot's pixels are darker than their surroundings by at least this factor."""
MIN_DOTS = 4
SMALLEST_PX, LARGEST_SHARE = 4, 0.01
"""Areas of a dot: at least so many pixels, at most this share of the picture."""
SURROUNDINGS_SHARE = 0.12
"""Width of the surroundings that a dot is compared with, as a share of the picture's height."""


@dataclass(frozen=True, slots=True)
class Dots:
    """Dots at rest: places (n, 2), column and row in px, and their spacing in px."""

    places_px: Floats
    spacing_px: float

    def __len__(self) -> int:
        return len(self.places_px)


def darkness(rgb: Image) -> Floats:
    """How much darker than its surroundings each pixel (H, W) is: 0 not at all, 1 black."""
    grey = cv2.GaussianBlur(rgb, (0, 0), 0.8).mean(axis=2, dtype=np.float32)
    size = max(5, int(SURROUNDINGS_SHARE * rgb.shape[0]) | 1)
    # A closing takes dark spots away and leaves slow shading where it is.
    around = cv2.morphologyEx(grey, cv2.MORPH_CLOSE, np.ones((size, size), np.uint8))
    around = cv2.GaussianBlur(around, (0, 0), size / 4)
    result: Floats = np.clip(1.0 - grey / np.maximum(around, 1.0), 0.0, 1.0)
    return result


def dot_mask(rgb: Image, grow_px: int = 2) -> NDArray[np.bool_]:
    """Pixels (H, W) that dots cover, edges included."""
    dark = (darkness(rgb) > 1.0 - DARKER_THAN).astype(np.uint8)
    size = 2 * grow_px + 1
    return np.asarray(cv2.dilate(dark, np.ones((size, size), np.uint8))).astype(bool)


def dot_places_px(rgb: Image) -> Floats:
    """Column and row of every dot's centre (n, 2), px, to a fraction of a pixel."""
    dark = darkness(rgb)
    mask = (dark > 1.0 - DARKER_THAN).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    areas = stats[:, cv2.CC_STAT_AREA]
    usable = (areas >= SMALLEST_PX) & (areas <= LARGEST_SHARE * dark.size)
    usable[0] = False
    rows, columns = np.nonzero(mask)
    index = labels[rows, columns]
    weight = dark[rows, columns].astype(np.float64)
    total = np.maximum(np.bincount(index, weight, count), 1e-9)
    places = np.column_stack(
        [np.bincount(index, weight * columns, count), np.bincount(index, weight * rows, count)]
    )
    return (places / total[:, None])[usable]


def dots_at_rest(background: Image, path: str = "background.png") -> Dots:
    """The dots of the gel at rest.

    Raises
    ------
    PressError
        Where fewer than four dots are seen.
    """
    places = dot_places_px(background)
    if len(places) < MIN_DOTS:
        msg = (
            f"{path}: {len(places)} marker dots found, fewer than {MIN_DOTS}: shear cannot be "
            "tracked; use a gel with printed dots, or log shear_x_mm and shear_y_mm"
        )
        raise PressError(msg)
    nearest, _ = cKDTree(places).query(places, k=2)
    return Dots(places, float(np.median(nearest[:, 1])))


def follow(dots: Dots, pictures: list[Image]) -> tuple[Floats, NDArray[np.int64]]:
    """Motion of every dot from rest, through pictures in time order.

    A dot is looked for where it would be if it had gone on with its neighbours, within half of
    the dots' spacing. One that is not seen moves as its four nearest neighbours that are.

    Returns
    -------
    motion_px : (T, n, 2) float
    seen : (T,) int
        How many dots were found in each picture.
    """
    motion = np.zeros((len(pictures), len(dots), 2))
    seen = np.zeros(len(pictures), dtype=np.int64)
    expected: Floats = np.array(dots.places_px)
    for index, picture in enumerate(pictures):
        found = dot_places_px(picture)
        matched = _match(expected, found, 0.5 * dots.spacing_px)
        known: NDArray[np.bool_] = np.asarray(np.isfinite(matched).all(axis=1))
        seen[index] = int(known.sum())
        step: Floats = matched - dots.places_px
        if known.any():
            step = _filled_from_neighbours(step, known, dots.places_px)
            motion[index] = step
            expected = np.asarray(dots.places_px + step)
    return motion, seen


def _match(expected: Floats, found: Floats, reach_px: float) -> Floats:
    """Place of each expected dot among the found ones, NaN where none; each is used once."""
    matched: Floats = np.full_like(expected, np.nan)
    if not len(found):
        return matched
    there, back = cKDTree(found), cKDTree(expected)
    distance, index = there.query(expected)
    _, owner = back.query(found)
    mutual = (owner[index] == np.arange(len(expected))) & (distance <= reach_px)
    matched[mutual] = found[index[mutual]]
    return matched


def _filled_from_neighbours(step: Floats, known: NDArray[np.bool_], places_px: Floats) -> Floats:
    if known.all():
        return step
    _, near = cKDTree(places_px[known]).query(places_px[~known], k=min(4, int(known.sum())))
    filled = step.copy()
    near = near.reshape(int((~known).sum()), -1)
    filled[~known] = np.median(step[known][near], axis=1)
    return filled

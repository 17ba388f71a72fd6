"""Printed dots in pictures of ball presses: found, masked, and filled in from around them."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tacgen.presses.markers import DARKER_THAN, darkness

Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]

MIN_PRINTED = 8
"""A gel has printed dots where at least so many stand on a grid; fewer are dust and shading."""

SAME_AREA = (0.4, 2.5)
"""Areas of printed dots, relative to their median."""

MAX_UNEVEN = 0.25
"""Largest relative scatter (median) of the distance from a dot to its nearest neighbour."""

MAX_AREA_SHARE = 0.01
"""Of the picture: larger dark spots are no dots."""

MERGED_AREA = 4.0
"""A dark spot in a press of more than so many dots' area is the shade of the contact."""


def printed_dots(background: Image) -> Mask | None:
    """Pixels (H, W) that printed dots cover in the gel at rest; None where it has none."""
    mask, labels, areas, places = _spots(background)
    usable = (areas >= 4) & (areas <= MAX_AREA_SHARE * mask.size)
    usable[0] = False
    if usable.sum() < MIN_PRINTED:
        return None
    median = float(np.median(areas[usable]))
    alike = usable & (areas > SAME_AREA[0] * median) & (areas < SAME_AREA[1] * median)
    if alike.sum() < max(MIN_PRINTED, 0.6 * usable.sum()):
        return None
    nearest = cKDTree(places[alike]).query(places[alike], k=2)[0][:, 1]
    spacing = float(np.median(nearest))
    if np.median(np.abs(nearest - spacing)) > MAX_UNEVEN * spacing:
        return None
    # Dots cut by the picture's border are smaller than their kind.
    return _grown(usable[labels])


def dot_centers(background: Image) -> NDArray[np.float64]:
    """Column and row (n, 2), px, of the dots that are wholly in view."""
    _, _, areas, places = _spots(background)
    usable = (areas >= 4) & (areas <= MAX_AREA_SHARE * background[..., 0].size)
    usable[0] = False
    median = float(np.median(areas[usable]))
    alike = usable & (areas > SAME_AREA[0] * median) & (areas < SAME_AREA[1] * median)
    return np.asarray(places[alike])


def dots_in(image: Image, at_rest: Mask) -> Mask:
    """Pixels (H, W) that dots cover in a press: where they are now, and where they were."""
    _, labels, areas, _ = _spots(image)
    count = max(cv2.connectedComponents(at_rest.astype(np.uint8))[0] - 1, 1)
    largest = MERGED_AREA * at_rest.sum() / count
    usable = (areas >= 2) & (areas <= largest)
    usable[0] = False
    return _grown(usable[labels]) | at_rest


def filled_in(image: NDArray, hidden: Mask) -> NDArray[np.float32]:
    """The image (H, W, C) with the hidden pixels filled in from around them."""
    picture = image.astype(np.float32)
    if not hidden.any():
        return picture
    known = (~hidden).astype(np.float32)
    sigma = max(2.0, 0.006 * image.shape[0])
    result = picture.copy()
    unknown = hidden
    while unknown.any():
        weight = cv2.GaussianBlur(known, (0, 0), sigma)
        around = cv2.GaussianBlur(picture * known[..., None], (0, 0), sigma)
        reached = unknown & (weight > 0.05)
        result[reached] = around[reached] / weight[reached, None]
        unknown, sigma = unknown & ~reached, 2.0 * sigma
        if sigma > image.shape[1]:
            break
    return result


def coarse(image: NDArray, size: tuple[int, int], hidden: Mask | None = None) -> NDArray:
    """The image (H, W, 3) averaged down to ``size`` (width, height), hidden pixels left out."""
    picture = image.astype(np.float32)
    if hidden is None:
        return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA))
    known = (~hidden).astype(np.float32)
    share = np.asarray(cv2.resize(known, size, interpolation=cv2.INTER_AREA))
    total = cv2.resize(picture * known[..., None], size, interpolation=cv2.INTER_AREA)
    return filled_in(np.asarray(total) / np.maximum(share, 1e-6)[..., None], share < 0.2)


def _spots(image: Image) -> tuple[Mask, NDArray, NDArray, NDArray]:
    """Dark spots: mask, labels, area of each, and centre of each (0 is what is no spot)."""
    mask = darkness(image) > 1.0 - DARKER_THAN
    _, labels, stats, places = cv2.connectedComponentsWithStats(
        mask.astype(np.uint8), connectivity=8
    )
    return mask, labels, stats[:, cv2.CC_STAT_AREA], places


def _grown(mask: Mask) -> Mask:
    """The mask and the pixels around it: the lens smears a dot's edge over one or two."""
    size = 2 * max(1, round(0.008 * mask.shape[0])) + 1
    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((size, size), np.uint8))) > 0

"""Printed dots in pictures of the gel: found, masked, filled in from around, and followed."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tacgen.core.errors import PressError
from tacgen.core.types import BoolArray, FloatArray, IntArray

Image = NDArray[np.uint8]

DARKER_THAN = 0.8  # a dot's pixels are darker than their surroundings by at least this factor

SURROUNDINGS_SHARE = 0.12
"""Width of the surroundings that a dot is compared with, as a share of the picture's height."""

SMALLEST_PX, LARGEST_SHARE = 4, 0.01
"""Areas of a dot: at least so many pixels, at most this share of the picture."""

MIN_PRINTED = 8
"""A gel has printed dots where at least so many stand on a grid; fewer are dust and shading."""

SAME_AREA = (0.4, 2.5)  # areas of printed dots, relative to their median

MAX_UNEVEN = 0.25
"""Largest relative scatter (median) of the distance from a dot to its nearest neighbour."""

MERGED_AREA = 4.0
"""A dark spot in a press of more than so many dots' area is the shade of the contact."""

LEAST_SEEN = 0.8  # of a gel's dots: with fewer in a picture they are not followed, or another gel's
MIN_TRACKED = 4  # dots whose motion tells a shear from the noise of one


@dataclass(frozen=True, slots=True)
class Spots:
    """Dark spots of a picture.

    ``labels`` (H, W) is which spot a pixel is of: 0 for none, k + 1 for spot k. Each of the n spots
    has an area in pixels and a ``places_px`` (n, 2), column and row of its centre weighted by
    darkness; ``usable`` (n,) are of a dot's size.
    """

    labels: IntArray
    areas: IntArray
    places_px: FloatArray
    usable: BoolArray

    @property
    def alike(self) -> BoolArray:
        """Usable spots (n,) of about the usual size: dots that are wholly in view."""
        median = float(np.median(self.areas[self.usable]))
        low, high = SAME_AREA
        return self.usable & (self.areas > low * median) & (self.areas < high * median)

    def mask(self, which: BoolArray) -> BoolArray:
        """Pixels (H, W) of some spots and around: the lens smears a dot's edge over one or two."""
        chosen = np.append(False, which)[self.labels]
        size = 2 * max(1, round(0.008 * len(chosen))) + 1
        return np.asarray(cv2.dilate(chosen.astype(np.uint8), np.ones((size, size), np.uint8))) > 0


def find_spots(image: Image) -> Spots:
    """The dark spots of a picture (H, W, 3)."""
    dark = _darkness(image)
    mask = (dark > 1.0 - DARKER_THAN).astype(np.uint8)
    count, spots, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    labels = np.asarray(spots, dtype=np.int32)
    areas = np.asarray(stats[1:, cv2.CC_STAT_AREA], dtype=np.int32)
    rows, columns = np.nonzero(mask)
    index = labels[rows, columns] - 1
    weight = dark[rows, columns].astype(np.float64)
    total = np.maximum(np.bincount(index, weight, count - 1), 1e-9)
    places = [np.bincount(index, weight * at, count - 1) / total for at in (columns, rows)]
    usable = (areas >= SMALLEST_PX) & (areas <= LARGEST_SHARE * dark.size)
    return Spots(labels, areas, np.column_stack(places), usable)


def _darkness(rgb: Image) -> FloatArray:
    """How much darker than its surroundings each pixel (H, W) is: 0 not at all, 1 black."""
    grey = cv2.GaussianBlur(rgb, (0, 0), 0.8).mean(axis=2, dtype=np.float32)
    size = max(5, int(SURROUNDINGS_SHARE * rgb.shape[0]) | 1)
    # A closing removes dark spots and keeps slow shading.
    around = cv2.morphologyEx(grey, cv2.MORPH_CLOSE, np.ones((size, size), np.uint8))
    around = cv2.GaussianBlur(around, (0, 0), size / 4)
    return np.asarray(np.clip(1.0 - grey / np.maximum(around, 1.0), 0.0, 1.0))


def printed_dots(background: Image) -> BoolArray | None:
    """Pixels (H, W) that printed dots cover in the gel at rest; None where it has none."""
    spots = find_spots(background)
    n_usable = int(spots.usable.sum())
    if n_usable < MIN_PRINTED:
        return None
    alike = spots.alike
    if alike.sum() < max(MIN_PRINTED, 0.6 * n_usable):
        return None
    nearest = nearest_px(spots.places_px[alike])
    spacing = float(np.median(nearest))
    if np.median(np.abs(nearest - spacing)) > MAX_UNEVEN * spacing:
        return None
    # Dots cut by the picture's border are smaller than their kind.
    return spots.mask(spots.usable)


def nearest_px(places_px: FloatArray) -> FloatArray:
    """Distance (n,) of each dot (n, 2) to its nearest neighbour, px."""
    distance, _ = cKDTree(places_px).query(places_px, k=2)
    return np.asarray(distance[:, 1])


def dots_in(image: Image | Spots, at_rest: BoolArray) -> BoolArray:
    """Pixels (H, W) that dots cover in a press: where they are now, and where they were."""
    spots = image if isinstance(image, Spots) else find_spots(image)
    count = max(cv2.connectedComponents(at_rest.astype(np.uint8))[0] - 1, 1)
    largest = MERGED_AREA * at_rest.sum() / count
    return spots.mask((spots.areas >= 2) & (spots.areas <= largest)) | at_rest


def filled_in(image: FloatArray | Image, hidden: BoolArray) -> FloatArray:
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


def coarse(
    image: FloatArray | Image, size: tuple[int, int], hidden: BoolArray | None = None
) -> FloatArray:
    """The image (H, W, 3) averaged down to ``size`` (width, height), less the hidden pixels."""
    picture = image.astype(np.float32)
    if hidden is None:
        return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA))
    known = (~hidden).astype(np.float32)
    share = np.asarray(cv2.resize(known, size, interpolation=cv2.INTER_AREA))
    total = cv2.resize(picture * known[..., None], size, interpolation=cv2.INTER_AREA)
    return filled_in(np.asarray(total) / np.maximum(share, 1e-6)[..., None], share < 0.2)


@dataclass(frozen=True, slots=True)
class Dots:
    """Dots at rest: places (n, 2), column and row in px, and their spacing in px."""

    places_px: FloatArray
    spacing_px: float

    def __len__(self) -> int:
        return len(self.places_px)


def dots_at_rest(background: Image, path: str = "background.png") -> Dots:
    """The dots of the gel at rest; ``PressError`` where fewer than four are seen."""
    spots = find_spots(background)
    places = spots.places_px[spots.usable]
    if len(places) < MIN_TRACKED:
        msg = (
            f"{path}: {len(places)} marker dots found, fewer than {MIN_TRACKED}: shear cannot be "
            "tracked; use a gel with printed dots, or log shear_x_mm and shear_y_mm"
        )
        raise PressError(msg)
    return Dots(places, float(np.median(nearest_px(places))))


def follow(dots: Dots, pictures: Sequence[Image | Spots]) -> tuple[FloatArray, IntArray]:
    """Motion of every dot from rest, through pictures in time order, or their spots.

    A dot is looked for where it would be if it had gone on with its neighbours, within half of
    the dots' spacing. One that is not seen moves as its four nearest neighbours that are. Returns
    the motion (T, n, 2), px, and how many dots were found in each picture (T,).
    """
    motion = np.zeros((len(pictures), len(dots), 2))
    seen = np.zeros(len(pictures), dtype=np.int64)
    expected: FloatArray = np.array(dots.places_px)
    for index, picture in enumerate(pictures):
        spots = picture if isinstance(picture, Spots) else find_spots(picture)
        matched = _match(expected, spots.places_px[spots.usable], 0.5 * dots.spacing_px)
        known: BoolArray = np.asarray(np.isfinite(matched).all(axis=1))
        seen[index] = int(known.sum())
        step: FloatArray = matched - dots.places_px
        if known.any():
            step = _filled_from_neighbours(step, known, dots.places_px)
            motion[index] = step
            expected = np.asarray(dots.places_px + step)
    return motion, seen


def _match(expected: FloatArray, found: FloatArray, reach_px: float) -> FloatArray:
    """Place of each expected dot among the found ones, NaN where none; each is used once."""
    matched: FloatArray = np.full_like(expected, np.nan)
    if not len(found):
        return matched
    there, back = cKDTree(found), cKDTree(expected)
    distance, index = there.query(expected)
    _, owner = back.query(found)
    mutual = (owner[index] == np.arange(len(expected))) & (distance <= reach_px)
    matched[mutual] = found[index[mutual]]
    return matched


def _filled_from_neighbours(
    step: FloatArray, known: BoolArray, places_px: FloatArray
) -> FloatArray:
    if known.all():
        return step
    _, near = cKDTree(places_px[known]).query(places_px[~known], k=min(4, int(known.sum())))
    filled = step.copy()
    near = near.reshape(int((~known).sum()), -1)
    filled[~known] = np.median(step[known][near], axis=1)
    return filled

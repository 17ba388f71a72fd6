"""Whether two pictures show the gel in the same colours, turned and cropped alike."""

import cv2
import numpy as np
from numpy.typing import NDArray

from tacgen.core.arrays import FloatArray
from tacgen.optics.drift import gain_and_offset

MUCH_BETTER = 0.5  # of the difference as it is: what is proven, where lamps and contacts differ too
CLEARLY_GREY = 0.15  # differences below it show nothing
VIEW_PX = 40  # width of the pictures that are compared: colours and light show at any size
LEAST_SHIFT = 0.02  # of the width
ZOOMS = (0.8, 0.85, 0.9, 0.95, 1.05, 1.1, 1.15, 1.2)
REORDERED: dict[str, tuple[int, ...]] = {
    "red and blue are swapped": (2,),
    "it is turned by 180°": (0, 1),
    "it is mirrored left to right": (1,),
    "it is mirrored top to bottom": (0,),
}
"""Axes of a picture (H, W, 3) that are reversed."""


def other_view(image: FloatArray | NDArray[np.uint8], rest: FloatArray | NDArray[np.uint8]) -> str:
    """How a picture (H, W, 3) is turned, coloured or shifted otherwise than ``rest`` (H, W, 3).

    Empty unless the bare gel, up to a gain and an offset of each channel, agrees far better that
    way: a gel that looks alike from all sides shows nothing.
    """
    small, gel = _small(image), _small(rest)
    plain = apart_grey(small, gel)
    if plain < CLEARLY_GREY:
        return ""
    found = {
        what: apart_grey(small, np.flip(gel, axes)) / plain for what, axes in REORDERED.items()
    }
    for zoom in ZOOMS:
        # Compared on the part that both pictures show.
        share = min(zoom, 1.0 / zoom)
        middle, rest_middle = _middle(small, share), _middle(gel, share)
        pair = (small, rest_middle) if zoom > 1 else (middle, gel)
        found[f"it is {zoom:g} times as large"] = apart_grey(*pair) / apart_grey(
            middle, rest_middle
        )
    shift = _shift_px(image, rest)
    height, width = image.shape[:2]
    if LEAST_SHIFT * width <= np.hypot(*shift) and np.all(np.abs(shift) < (width / 2, height / 2)):
        dx, dy = shift
        rows, columns = (
            slice(max(dy, 0), height + min(dy, 0)),
            slice(max(dx, 0), width + min(dx, 0)),
        )
        moved = slice(max(-dy, 0), height - max(dy, 0)), slice(max(-dx, 0), width - max(dx, 0))
        here, same_place, there = (
            _small(part) for part in (image[rows, columns], rest[rows, columns], rest[moved])
        )
        found[f"it is shifted by {shift} px"] = apart_grey(here, there) / apart_grey(
            here, same_place
        )
    what = min(found, key=lambda name: found[name])
    return what if found[what] < MUCH_BETTER else ""


def _middle(image: FloatArray, share: float) -> FloatArray:
    """The middle of a picture (h, w, 3), ``share`` of its width and height, enlarged."""
    height, width = image.shape[:2]
    scale = np.array(
        [[share, 0, (1 - share) * (width - 1) / 2], [0, share, (1 - share) * (height - 1) / 2]]
    )
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(image, scale, (width, height), flags=flags))


def apart_grey(image: FloatArray, rest: FloatArray) -> float:
    """Median difference, grey levels, of two pictures (h, w, 3) after gain and offset."""
    differences = np.median(np.abs(image - gain_and_offset(image, rest)), axis=(0, 1))
    return float(np.median(differences))


def _small(image: FloatArray | NDArray[np.uint8]) -> FloatArray:
    height, width = image.shape[:2]
    size = VIEW_PX, max(8, round(VIEW_PX * height / width))
    picture = np.ascontiguousarray(image, dtype=np.float32)
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.float64)


def _shift_px(
    image: FloatArray | NDArray[np.uint8], rest: FloatArray | NDArray[np.uint8]
) -> tuple[int, int]:
    """(x, y) by which the image's content is shifted, by the correlation of phases."""
    before, now = (np.asarray(part, np.float64).mean(axis=2) for part in (rest, image))
    window = cv2.createHanningWindow(before.shape[::-1], cv2.CV_64F)
    (dx, dy), _ = cv2.phaseCorrelate(before - before.mean(), now - now.mean(), window)
    return round(dx), round(dy)

"""Images for pages, and the order in time of pictures by their names."""

import base64
import re
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tacgen.core.errors import TacgenError

Image = NDArray[np.uint8]  # RGB, (H, W, 3)

JPEG_QUALITY = 82  # no artefact is seen in a tactile image at the sizes that a gallery shows
MIDDLE_GREY = 128  # shown for no difference
GAP_PX = 4  # white between images of a strip


def encode_png(rgb: Image) -> bytes:
    """The bytes of an RGB uint8 image (H, W, 3), or of one of numbers (H, W), as PNG."""
    return _encoded(rgb, ".png", [])


def jpeg_uri(rgb: Image) -> str:
    """An image as a JPEG data URI."""
    jpeg = _encoded(rgb, ".jpg", [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return f"data:image/jpeg;base64,{base64.b64encode(jpeg).decode()}"


def no_wider(rgb: Image, width_px: int) -> Image:
    """The image, made smaller where it is wider than ``width_px``."""
    height, width = rgb.shape[:2]
    if width <= width_px:
        return rgb
    size = (width_px, max(1, round(height * width_px / width)))
    whole = width // width_px
    if whole > 1 and height % whole == 0 and width % whole == 0:
        # Means of whole blocks first: 4 times as fast.
        blocks = (width // whole, height // whole)
        rgb = np.asarray(cv2.resize(rgb, blocks, interpolation=cv2.INTER_AREA), np.uint8)
    return np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), np.uint8)


def side_by_side(images: Sequence[Image], width_px: int | None = None) -> Image:
    """Images of one size in a row, each no wider than ``width_px``, white between them."""
    small = [image if width_px is None else no_wider(image, width_px) for image in images]
    gap = np.full((small[0].shape[0], GAP_PX, 3), 255, np.uint8)
    return np.concatenate([part for image in small for part in (image, gap)][:-1], axis=1)


def difference(after: NDArray[Any], before: NDArray[Any], gain: float) -> Image:
    """``gain`` × (after − before) about middle grey."""
    change = gain * (np.asarray(after, np.float64) - before)
    return np.asarray(np.rint(np.clip(MIDDLE_GREY + change, 0, 255)).astype(np.uint8))


def evenly(count: int, most: int) -> list[int]:
    """Up to ``most`` of the numbers below ``count`` at even distances, first and last included."""
    if count <= most:
        return list(range(count))
    return [int(k) for k in np.linspace(0, count - 1, most).round()]


def _encoded(rgb: Image, kind: str, options: list[int]) -> bytes:
    bgr = rgb[..., ::-1] if rgb.ndim == 3 else rgb
    done, encoded = cv2.imencode(kind, np.ascontiguousarray(bgr), options)
    if not done:
        msg = f"an image of shape {rgb.shape} and type {rgb.dtype} cannot be encoded as {kind[1:]}"
        raise TacgenError(msg)
    return encoded.tobytes()


_NUMBER = re.compile(r"(\d+(?:\.\d+)?)")
_CLOCK_DIGITS = 9
"""Digits before the point of a clock's seconds (since 1970, or nanoseconds): no running number."""


def in_time_order(paths: Sequence[Path], error: type[TacgenError] = TacgenError) -> list[Path]:
    """Pictures in the order of the numbers in their names: ``frame2`` comes before ``frame10``.

    Names may differ in nothing but their numbers. A point is read as that of a decimal, as in
    ``1764234000.9731``.

    Raises ``error`` where the names have no order, or more than one: other words, equal numbers,
    or parts behind a point that may be decimals or numbers of their own (``1.9``, ``1.10``).
    """
    if len(paths) < 2:
        return list(paths)
    parts = {path: _NUMBER.split(path.stem) for path in paths}
    folder, example = paths[0].parent, ", ".join(path.name for path in paths[:3])
    fix = "number the pictures in the order of time: 0.png, 1.png, …"
    if len({tuple(part[::2]) for part in parts.values()}) > 1:
        msg = f"{folder}: the names {example} … do not tell the order of the pictures; {fix}"
        raise error(msg)
    texts = [part[1::2] for part in parts.values()]
    decimal = {path: [Fraction(n) for n in part[1::2]] for path, part in parts.items()}
    whole = {path: [tuple(map(int, n.split("."))) for n in part[1::2]]
             for path, part in parts.items()}  # fmt: skip
    ordered = sorted(paths, key=lambda path: decimal[path])
    if len({tuple(numbers) for numbers in decimal.values()}) < len(paths):
        msg = f"{folder}: of {example} … several have the same number; {fix}"
        raise error(msg)
    if ordered != sorted(paths, key=lambda path: whole[path]) and not _are_decimals(texts):
        msg = f"{folder}: {example} … are in one order as decimals, in another as numbers; {fix}"
        raise error(msg)
    return ordered


def _are_decimals(texts: Sequence[Sequence[str]]) -> bool:
    """Whether what stands behind the points is surely a fraction: of a clock, or with a 0 first."""
    pairs = [number.split(".") for numbers in texts for number in numbers if "." in number]
    clock = all(len(first) >= _CLOCK_DIGITS for first, _ in pairs)
    return clock or any(second.startswith("0") and len(second) > 1 for _, second in pairs)

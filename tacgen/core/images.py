"""Images for pages: encoded, side by side, and differences about grey."""

import base64
from collections.abc import Sequence
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

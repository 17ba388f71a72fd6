"""The background of a table, estimated from the reference image and what the presses leave bare."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from tacgen.core.arrays import FloatArray
from tacgen.presses.dots import coarse, filled_in
from tacgen.presses.press_images import PressImages

BARE_BEYOND = 2.2
"""Pixels farther from a contact's centre than this many contact radii count as bare gel."""

MIN_VIEWS = 3
"""Presses that must leave a pixel bare before their median is believed there."""

_FINE_SIGMA_PX = 4.0
"""A Gaussian of this width is as good as any wider one, on fewer pixels."""

_COARSE_PX = 160
"""Width of the images that the drift is estimated on."""


@dataclass(frozen=True, slots=True)
class BackgroundRecipe:
    """How a background is made.

    Attributes
    ----------
    smooth : float
        Gaussian width, as a share of the image's width, that the reference is smoothed with;
        0 leaves it as it is.
    drift : bool
        Whether the median change of the bare gel over the presses is added (lamps and camera
        drift between the reference and the presses).
    """

    smooth: float = 0.0
    drift: bool = False


def blur(image: NDArray, sigma_px: float) -> NDArray:
    """Gaussian blur of (H, W) or (H, W, C); edges are mirrored."""
    if sigma_px <= 0:
        return image
    source = np.ascontiguousarray(image, dtype=np.float32)
    step = int(sigma_px / _FINE_SIGMA_PX)
    if step < 2:
        return np.asarray(cv2.GaussianBlur(source, (0, 0), sigma_px, borderType=cv2.BORDER_REFLECT))
    # A wide Gaussian cannot tell the means of few pixels from the pixels.
    height, width = source.shape[:2]
    size = (max(1, width // step), max(1, height // step))
    small = cv2.resize(source, size, interpolation=cv2.INTER_AREA)
    soft = cv2.GaussianBlur(small, (0, 0), sigma_px / step, borderType=cv2.BORDER_REFLECT)
    return np.asarray(cv2.resize(soft, (width, height), interpolation=cv2.INTER_LINEAR))


def bare_changes(presses: PressImages) -> NDArray:
    """Image − reference where no press touches (N, h, w, 3), coarse; NaN near the contacts."""
    height, width = presses.shape_px
    scale = min(1.0, _COARSE_PX / width)
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    reference = coarse(presses.background, size, presses.dots)
    rows, columns = np.mgrid[: size[1], : size[0]]
    changes = np.empty((len(presses), size[1], size[0], 3), np.float32)
    for k in range(len(presses)):
        x, y = (presses.center_px[k] + 0.5) * scale - 0.5
        bare = np.hypot(columns - x, rows - y) > BARE_BEYOND * presses.radius_px[k] * scale
        image = coarse(presses.images[k], size, presses.hidden_in(k))
        changes[k] = np.where(bare[..., None], image - reference, np.nan)
    return changes


def press_drift(presses: PressImages, changes: FloatArray | None = None) -> NDArray:
    """What each picture's bare gel is brighter by than that of the others (N, 3), grey levels.

    ``changes`` is what ``bare_changes`` gives, where it is already known.
    """
    drift = np.zeros((len(presses), 3))
    for k, change in enumerate(bare_changes(presses) if changes is None else changes):
        bare = change[np.isfinite(change[..., 0])]
        if len(bare):
            drift[k] = np.median(bare, axis=0)
    return drift - drift.mean(axis=0)


def bare_gel_change(presses: PressImages, changes: FloatArray | None = None) -> NDArray:
    """Median over the presses of image − reference where no press touches: (h, w, 3), coarse.

    Where fewer than three presses leave the gel bare the change is carried over from around.
    ``changes`` is what ``bare_changes`` gives, where it is already known.
    """
    changes = bare_changes(presses) if changes is None else changes
    views = np.isfinite(changes[..., 0]).sum(axis=0)
    known = views >= MIN_VIEWS
    median = np.zeros(changes.shape[1:], np.float32)
    if not known.any():
        return median
    median[known] = _median_of_known(changes, views)[known]
    weight = known.astype(np.float32)
    sigma = 0.05 * known.shape[1]
    near = (
        blur(median * weight[..., None], sigma) / np.maximum(blur(weight, sigma), 1e-6)[..., None]
    )
    return np.where(known[..., None], median, near)


def _median_of_known(changes: FloatArray, views: NDArray[np.int64]) -> NDArray:
    """Median over the first axis of what is not NaN; ``views`` (h, w) is how many that are."""
    ordered = np.sort(changes, axis=0)  # NaN goes last
    middle = [np.maximum(views - 1 + upper, 0) // 2 for upper in (0, 1)]
    low, high = (np.take_along_axis(ordered, index[None, ..., None], axis=0)[0] for index in middle)
    return np.asarray(0.5 * (low + high))


def make_background(
    reference: NDArray[np.uint8],
    change: FloatArray | None,
    recipe: BackgroundRecipe,
    dots: NDArray[np.bool_] | None = None,
) -> NDArray[np.float32]:
    """The background (H, W, 3) by ``recipe``; ``change`` is what ``bare_gel_change`` gives.

    Printed ``dots`` (H, W) are kept as sharp as they are: the gel around them is smoothed, and
    they dim it by what they dim the reference by.
    """
    height, width = reference.shape[:2]
    image = reference.astype(np.float32)
    gel = image if dots is None else filled_in(image, dots)
    ink = None if dots is None else np.where(dots[..., None], image / np.maximum(gel, 1.0), 1.0)
    if recipe.drift and change is not None:
        gel = gel + cv2.resize(change, (width, height), interpolation=cv2.INTER_LINEAR)
    gel = blur(gel, recipe.smooth * width)
    return np.asarray(gel if ink is None else gel * ink, dtype=np.float32)

"""Single effects of the images' model: shade by direction, and where the camera clips."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tacgen.calibration.press_fit import Sample
from tacgen.calibration.press_images import PressImages

FloatArray = NDArray[np.floating]


def shadow_terms(sample: Sample, geometry: FloatArray) -> FloatArray:
    """Terms (n, 10) of shade on the walls of the dent and around it, by direction from the centre.

    A lamp's shadow lies on one side of the contact; what slope alone explains lies on both.
    """
    dx = sample.pixels.x_mm - geometry[0]
    dy = sample.pixels.y_mm - geometry[1]
    r = np.hypot(dx, dy) / geometry[2]
    ux, uy = dx / np.maximum(np.hypot(dx, dy), 1e-9), dy / np.maximum(np.hypot(dx, dy), 1e-9)
    around = np.stack([np.ones_like(r), ux, uy, ux * ux - uy * uy, 2 * ux * uy], axis=-1)
    outside = np.clip((r - 1.0) / 0.3, 0.0, 1.0)[:, None]
    wall = np.exp(-(((r - 0.8) / 0.15) ** 2))[:, None]
    return np.hstack([outside * around, wall * around])


def unclipped(sample: Sample, background: FloatArray, level: float) -> FloatArray:
    """Weights of the pixels; one that is clipped in any channel says nothing of its slope."""
    if level >= 255:
        return sample.weight
    clipped = (sample.pixels.grey >= level - 1).any(axis=1)
    return np.where(clipped, 0.0, sample.weight)


def clip_level(presses: PressImages) -> float:
    """The grey level that the brightest pixels pile up at; 255 where they do not."""
    counts = np.bincount(presses.images.ravel(), minlength=256).astype(float)
    top = int(np.nonzero(counts)[0].max())
    below = float(np.median(counts[max(0, top - 12) : max(1, top - 2)]))
    piled = counts[max(0, top - 1) : top + 1].max()
    return float(top) if piled > 5 * max(below, 1.0) and counts[top] > 50 else 255.0

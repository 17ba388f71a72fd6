"""Draws that schedules, covariates and effects share."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A number, all of the range being alike likely."""
    return float(rng.uniform(low, high))


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A number, all factors within the range being alike likely."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def smooth_course(rng: np.random.Generator, n_samples: int, width: int) -> Floats:
    """White noise under a Gaussian window of ``width`` samples, of standard deviation 1."""
    window = np.exp(-0.5 * (np.arange(-3 * width, 3 * width + 1) / width) ** 2)
    white = rng.normal(size=n_samples + 6 * width)
    course = np.convolve(white, window / window.sum(), "valid")[:n_samples]
    return course / (course.std() + 1e-12)


def rms(values: Floats) -> float:
    """Root of the mean square over all samples and columns."""
    return float(np.sqrt(np.mean(np.square(values))))

"""How the gel's surface bends around a contact: a pyramid of Gaussians."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Window = tuple[int, int, int, int]
"""Half-open rectangle of pixels: top, bottom, left, right."""

PYRAMID_SIGMA_MM = (0.236, 0.1033, 0.059, 0.0325)
"""Widths of the Gaussians, coarse to fine.

Source: Taxim's kernels of 51, 21, 11 and 5 px at 0.0295 mm/px, which OpenCV turns into standard
deviations of 8.0, 3.5, 2.0 and 1.1 px by σ = 0.3 ((k − 1)/2 − 1) + 0.8.
"""
FINAL_SIGMA_MM = 0.0325
"""Width of the last Gaussian, over the contact too; Taxim's general kernel of 5 px."""

FIRM_CONTACT = 0.4
"""Pixels indented by more than this share of the deepest one keep the object's shape through the
pyramid; the rim of the contact bends with the gel around it. Source: Taxim's ``contact_scale``."""

_REACH_SIGMAS = 3.0


@njit(cache=True, nogil=True)
def _blur_rows(source: NDArray, kernel: NDArray, line: NDArray, target: NDArray) -> None:
    """Convolve along rows; what lies beyond an edge equals the edge."""
    radius = kernel.shape[0] - 1
    height, width = source.shape
    for r in range(height):
        row, out = source[r], target[r]
        first, last = row[0], row[width - 1]
        for k in range(radius):
            line[k] = first
            line[width + radius + k] = last
        for k in range(width):
            line[radius + k] = row[k]
        for k in range(width):
            out[k] = kernel[0] * line[radius + k]
        for j in range(1, radius + 1):
            weight = kernel[j]
            before, after = line[radius - j :], line[radius + j :]
            for k in range(width):
                out[k] += weight * (before[k] + after[k])


@njit(cache=True, nogil=True)
def _blur_columns(source: NDArray, kernel: NDArray, target: NDArray) -> None:
    """Convolve along columns; what lies beyond an edge equals the edge."""
    radius = kernel.shape[0] - 1
    height, width = source.shape
    for r in range(height):
        row, out = source[r], target[r]
        for k in range(width):
            out[k] = kernel[0] * row[k]
        for j in range(1, radius + 1):
            weight = kernel[j]
            above, below = source[max(r - j, 0)], source[min(r + j, height - 1)]
            for k in range(width):
                out[k] += weight * (above[k] + below[k])


@njit(cache=True, nogil=True)
def _keep_contact(depth: NDArray, firm_mm: float, surface: NDArray) -> None:
    firm = np.float32(firm_mm)
    for r in range(depth.shape[0]):
        row, out = depth[r], surface[r]
        for k in range(row.shape[0]):
            out[k] = row[k] if row[k] > firm else out[k]


def half_kernel(sigma_px: float) -> NDArray[np.float32]:
    """The centre and right half of a Gaussian of unit sum; a single 1 below a tenth of a pixel."""
    radius = math.ceil(_REACH_SIGMAS * sigma_px) if sigma_px > 0.1 else 0
    weights = np.exp(-0.5 * (np.arange(radius + 1) / max(sigma_px, 0.1)) ** 2)
    return (weights / (2 * weights.sum() - weights[0])).astype(np.float32)


class Smoother:
    """Gaussian smoothing of maps of one scale, in numba: the same bits on every machine."""

    def __init__(self, mm_per_px: float, sigmas_mm: tuple[float, ...]) -> None:
        self._kernels = [half_kernel(sigma / mm_per_px) for sigma in sigmas_mm]
        self._widest = max((len(kernel) for kernel in self._kernels), default=1)

    @property
    def reach_px(self) -> int:
        """How far anything spreads, px."""
        return sum(len(kernel) - 1 for kernel in self._kernels)

    def apply(
        self, surface: NDArray[np.float32], depth: NDArray[np.float32], firm_mm: float
    ) -> None:
        """Smooth ``surface`` in place by each width, keeping ``depth`` where it is above firm."""
        scratch = np.empty_like(surface)
        line = np.empty(surface.shape[1] + 2 * self._widest, dtype=np.float32)
        for kernel in self._kernels:
            _blur_rows(surface, kernel, line, scratch)
            _blur_columns(scratch, kernel, surface)
            if firm_mm < np.inf:
                _keep_contact(depth, firm_mm, surface)


class Deformer:
    """Turns the indentation under an object into the deformation of the whole gel.

    Parameters
    ----------
    mm_per_px : float
    pyramid_sigma_mm, final_sigma_mm, firm_contact
        See the constants of this module.
    """

    def __init__(
        self,
        mm_per_px: float,
        *,
        pyramid_sigma_mm: tuple[float, ...] = PYRAMID_SIGMA_MM,
        final_sigma_mm: float = FINAL_SIGMA_MM,
        firm_contact: float = FIRM_CONTACT,
    ) -> None:
        self._pyramid = Smoother(mm_per_px, pyramid_sigma_mm)
        self._final = Smoother(mm_per_px, (final_sigma_mm,))
        self._firm_contact = firm_contact

    @property
    def reach_px(self) -> int:
        """Pixels around a contact that it deforms."""
        return self._pyramid.reach_px + self._final.reach_px

    def window_around(self, contact: Window, shape_px: tuple[int, int]) -> Window:
        """The window that holds a contact and all that it deforms, within the image.

        One more pixel on each side stays at rest, so that cutting the window out changes nothing.
        """
        top, bottom, left, right = contact
        margin = self.reach_px + 1
        return (
            max(0, top - margin),
            min(shape_px[0], bottom + margin),
            max(0, left - margin),
            min(shape_px[1], right + margin),
        )

    def deform(self, depth_mm: NDArray[np.float32]) -> NDArray[np.float32]:
        """Deformation (h, w), mm, into the gel, of an indentation (h, w).

        The gel takes the object's shape where they are in firm contact and falls off smoothly
        around it.

        Source
        ------
        Si & Yuan 2022, Taxim, §III-C.
        """
        surface = depth_mm.copy()
        self._pyramid.apply(surface, depth_mm, self._firm_contact * float(depth_mm.max()))
        self._final.apply(surface, depth_mm, np.inf)
        return surface


def deform(depth_map_mm: NDArray[np.floating], mm_per_px: float) -> NDArray[np.float32]:
    """Deformation of the gel (H, W), mm, into the gel, around an indentation (H, W)."""
    return Deformer(mm_per_px).deform(np.ascontiguousarray(depth_map_mm, dtype=np.float32))

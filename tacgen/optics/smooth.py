"""Gaussian smoothing within a window, in numba: the same bits on every machine."""

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Window = tuple[int, int, int, int]
"""Half-open rectangle of pixels: top, bottom, left, right."""

COARSEST = 4  # the largest number of pixels, along a side, that a wide Gaussian averages into one

_REACH_SIGMAS = 3.0  # beyond it a Gaussian has 0.3 % of its sum


def grown(window: Window, margin_px: int, shape_px: tuple[int, int]) -> Window:
    """The window with a margin on each side, as far as the image goes."""
    top, bottom, left, right = window
    return (
        max(0, top - margin_px),
        min(shape_px[0], bottom + margin_px),
        max(0, left - margin_px),
        min(shape_px[1], right + margin_px),
    )


def aligned(window: Window, step_px: int, shape_px: tuple[int, int]) -> Window:
    """The window grown to whole steps from the image's first pixel, as far as the image goes."""
    top, bottom, left, right = window
    return (
        top - top % step_px,
        min(shape_px[0], bottom + -bottom % step_px),
        left - left % step_px,
        min(shape_px[1], right + -right % step_px),
    )


@njit(cache=True, nogil=True, inline="always")
def _taps(
    k: int, kernel: NDArray[Any], j: int, lower: tuple[Any, ...], upper: tuple[Any, ...]
) -> Any:
    """The sum at pixel k of four taps on each side, j to j + 3."""
    near = kernel[j] * (lower[0][k] + upper[0][k]) + kernel[j + 1] * (lower[1][k] + upper[1][k])
    far = kernel[j + 2] * (lower[2][k] + upper[2][k]) + kernel[j + 3] * (lower[3][k] + upper[3][k])
    return near + far


@njit(cache=True, nogil=True, inline="always")
def _add_taps(
    row: NDArray[Any],
    kernel: NDArray[Any],
    j: int,
    lower: tuple[Any, ...],
    upper: tuple[Any, ...],
    out: NDArray[Any],
) -> None:
    """Walk along the row once: the first four taps on each side start the sum, others add to it."""
    if j == 1:
        for k in range(out.shape[0]):
            out[k] = kernel[0] * row[k] + _taps(k, kernel, j, lower, upper)
    else:
        for k in range(out.shape[0]):
            out[k] += _taps(k, kernel, j, lower, upper)


@njit(cache=True, nogil=True)
def _blur_rows(
    source: NDArray[Any], window: Window, kernel: NDArray[Any], target: NDArray[Any]
) -> None:
    """Convolve along rows within the window; what lies beyond its edge equals the edge."""
    top, bottom, left, right = window
    radius, width = kernel.shape[0] - 1, right - left
    line = np.empty(width + 2 * radius, np.float32)
    for r in range(top, bottom):
        row, out = source[r, left:right], target[r, left:right]
        line[:radius] = row[0]
        line[radius : radius + width] = row
        line[radius + width :] = row[width - 1]
        for j in range(1, radius, 4):
            low, high = line[radius - j - 3 :], line[radius + j :]
            lower = low[3:], low[2:], low[1:], low
            upper = high, high[1:], high[2:], high[3:]
            _add_taps(row, kernel, j, lower, upper, out)


@njit(cache=True, nogil=True)
def _blur_columns(
    source: NDArray[Any], window: Window, kernel: NDArray[Any], target: NDArray[Any]
) -> None:
    """Convolve along columns within the window; what lies beyond its edge equals the edge."""
    top, bottom, left, right = window
    radius, last = kernel.shape[0] - 1, bottom - 1
    for r in range(top, bottom):
        row, out = source[r, left:right], target[r, left:right]
        for j in range(1, radius, 4):
            lower = (
                source[max(r - j, top), left:right],
                source[max(r - j - 1, top), left:right],
                source[max(r - j - 2, top), left:right],
                source[max(r - j - 3, top), left:right],
            )
            upper = (
                source[min(r + j, last), left:right],
                source[min(r + j + 1, last), left:right],
                source[min(r + j + 2, last), left:right],
                source[min(r + j + 3, last), left:right],
            )
            _add_taps(row, kernel, j, lower, upper, out)


def half_kernel(sigma_px: float) -> NDArray[np.float32]:
    """The centre and right half of a Gaussian of unit sum, not narrower than a tenth of a pixel.

    The half reaches three standard deviations, and to the next multiple of four.
    """
    radius = 4 * max(1, math.ceil(_REACH_SIGMAS * sigma_px / 4))
    weights = np.exp(-0.5 * (np.arange(radius + 1) / max(sigma_px, 0.1)) ** 2)
    return np.asarray((weights / (2 * weights.sum() - weights[0])).astype(np.float32))


def smooth(
    surface: NDArray[np.float32], window: Window, kernel: NDArray[np.float32], scratch: NDArray[Any]
) -> None:
    """Blur ``surface`` in place within the window; beyond it the edge's values go on."""
    _blur_rows(surface, window, kernel, scratch)
    _blur_columns(scratch, window, kernel, surface)


@njit(cache=True, nogil=True)
def _coarsen(surface: NDArray[Any], window: Window, factor: int, coarse: NDArray[Any]) -> None:
    """Means of blocks of ``factor`` pixels a side, with one block more beyond each edge.

    What lies beyond the window equals its edge.
    """
    top, bottom, left, right = window
    width, n_columns = right - left, coarse.shape[1]
    line = np.empty(n_columns * factor, np.float32)
    within = line[factor : factor + width]
    share = np.float32(1 / factor**2)
    for i in range(coarse.shape[0]):
        start = top + (i - 1) * factor
        within[:] = surface[min(max(start, top), bottom - 1), left:right]
        for r in range(start + 1, start + factor):
            row = surface[min(max(r, top), bottom - 1), left:right]
            for k in range(width):
                within[k] += row[k]
        line[:factor] = within[0]
        line[factor + width :] = within[width - 1]
        out = coarse[i]
        out[:] = 0
        for phase in range(factor):
            for j in range(n_columns):
                out[j] += line[j * factor + phase]
        for j in range(n_columns):
            out[j] *= share


@njit(cache=True, nogil=True)
def _refine(coarse: NDArray[Any], factor: int, window: Window, surface: NDArray[Any]) -> None:
    """Interpolate between the middles of the blocks that ``_coarsen`` made."""
    top, bottom, left, right = window
    between = np.empty(coarse.shape[1], np.float32)
    one, half = np.float32(1), np.float32(0.5)
    for r in range(top, bottom):
        at = (np.float32(r - top) + half) / np.float32(factor) + half
        i = int(at)
        share = at - np.float32(i)
        above, below = coarse[i], coarse[i + 1]
        for j in range(between.shape[0]):
            between[j] = (one - share) * above[j] + share * below[j]
        row = surface[r, left:right]
        for phase in range(factor):
            at = (np.float32(phase) + half) / np.float32(factor) + half
            shift = int(at)
            share = at - np.float32(shift)
            before, after = between[shift:], between[shift + 1 :]
            for j in range((row.shape[0] - phase + factor - 1) // factor):
                row[j * factor + phase] = (one - share) * before[j] + share * after[j]


class Gaussian:
    """One Gaussian; a wide one is computed on means of blocks of pixels smaller than σ."""

    def __init__(self, sigma_px: float) -> None:
        self.factor = COARSEST if sigma_px >= 7.5 else 2 if sigma_px >= 3.0 else 1
        variance = (sigma_px / self.factor) ** 2
        if self.factor > 1:
            # What taking means of blocks, and interpolating between them, smooths already.
            variance -= (1 - self.factor**-2) / 12 + 1 / 6
        self.kernel = half_kernel(math.sqrt(variance))

    @property
    def reach_px(self) -> int:
        """How far anything spreads."""
        blocks = len(self.kernel) - 1
        return blocks if self.factor == 1 else (blocks + 2) * self.factor

    def apply(
        self, surface: NDArray[np.float32], window: Window, scratch: NDArray[np.float32]
    ) -> None:
        """Blur in place within a window that is aligned to ``factor`` from the image's corner."""
        if self.factor == 1:
            smooth(surface, window, self.kernel, scratch)
            return
        top, bottom, left, right = window
        shape = (-(-(bottom - top) // self.factor) + 2, -(-(right - left) // self.factor) + 2)
        coarse = np.empty(shape, dtype=np.float32)
        _coarsen(surface, window, self.factor, coarse)
        smooth(coarse, (0, shape[0], 0, shape[1]), self.kernel, np.empty_like(coarse))
        _refine(coarse, self.factor, window, surface)

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
def _add_taps(
    out: NDArray[Any], kernel: NDArray[Any], j: int, lower: tuple[Any, ...], upper: tuple[Any, ...]
) -> None:
    """Add four taps on each side, j to j + 3, in one walk along the row."""
    b0, b1, b2, b3 = lower
    a0, a1, a2, a3 = upper
    w0, w1, w2, w3 = kernel[j], kernel[j + 1], kernel[j + 2], kernel[j + 3]
    for k in range(out.shape[0]):
        near = w0 * (b0[k] + a0[k]) + w1 * (b1[k] + a1[k])
        far = w2 * (b2[k] + a2[k]) + w3 * (b3[k] + a3[k])
        out[k] += near + far


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
        for k in range(width):
            out[k] = kernel[0] * row[k]
        for j in range(1, radius, 4):
            low, high = line[radius - j - 3 :], line[radius + j :]
            _add_taps(
                out,
                kernel,
                j,
                (low[3:], low[2:], low[1:], low),
                (high, high[1:], high[2:], high[3:]),
            )


@njit(cache=True, nogil=True)
def _blur_columns(
    source: NDArray[Any], window: Window, kernel: NDArray[Any], target: NDArray[Any]
) -> None:
    """Convolve along columns within the window; what lies beyond its edge equals the edge."""
    top, bottom, left, right = window
    radius, last = kernel.shape[0] - 1, bottom - 1
    for r in range(top, bottom):
        row, out = source[r, left:right], target[r, left:right]
        for k in range(right - left):
            out[k] = kernel[0] * row[k]
        for j in range(1, radius, 4):
            _add_taps(
                out,
                kernel,
                j,
                (
                    source[max(r - j, top), left:right],
                    source[max(r - j - 1, top), left:right],
                    source[max(r - j - 2, top), left:right],
                    source[max(r - j - 3, top), left:right],
                ),
                (
                    source[min(r + j, last), left:right],
                    source[min(r + j + 1, last), left:right],
                    source[min(r + j + 2, last), left:right],
                    source[min(r + j + 3, last), left:right],
                ),
            )


def half_kernel(sigma_px: float) -> NDArray[np.float32]:
    """The centre and right half of a Gaussian of unit sum; a single 1 below a tenth of a pixel.

    The half reaches three standard deviations, and to the next multiple of four.
    """
    radius = 4 * math.ceil(_REACH_SIGMAS * sigma_px / 4) if sigma_px > 0.1 else 0
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
    """Means of blocks of ``factor`` pixels a side; the last ones may be cut by the window."""
    top, bottom, left, right = window
    total = np.empty(right - left, np.float32)
    for i in range(coarse.shape[0]):
        start, end = top + i * factor, min(bottom, top + (i + 1) * factor)
        total[:] = 0
        for r in range(start, end):
            row = surface[r, left:right]
            for k in range(row.shape[0]):
                total[k] += row[k]
        for j in range(coarse.shape[1]):
            first, last = j * factor, min(total.shape[0], (j + 1) * factor)
            block = np.float32(0)
            for k in range(first, last):
                block += total[k]
            coarse[i, j] = block / np.float32((end - start) * (last - first))


@njit(cache=True, nogil=True)
def _refine(coarse: NDArray[Any], factor: int, window: Window, surface: NDArray[Any]) -> None:
    """Interpolate between the blocks' middles; beyond the outer ones, their values."""
    top, bottom, left, right = window
    n_rows, n_columns = coarse.shape
    between = np.empty(n_columns + 2, np.float32)
    one, half = np.float32(1), np.float32(0.5)
    for r in range(top, bottom):
        at = (np.float32(r - top) + half) / np.float32(factor) - half
        i = math.floor(at)
        share = at - np.float32(i)
        above, below = coarse[max(i, 0)], coarse[min(i + 1, n_rows - 1)]
        for j in range(n_columns):
            between[j + 1] = (one - share) * above[j] + share * below[j]
        between[0], between[n_columns + 1] = between[1], between[n_columns]
        row = surface[r, left:right]
        for phase in range(factor):
            at = (np.float32(phase) + half) / np.float32(factor) - half
            shift = 0 if at < 0 else 1
            share = at + one if at < 0 else at
            for j in range((row.shape[0] - phase + factor - 1) // factor):
                row[j * factor + phase] = (one - share) * between[j + shift] + share * between[
                    j + shift + 1
                ]


class Gaussian:
    """One Gaussian; a wide one works on means of blocks of pixels, which it cannot tell apart."""

    def __init__(self, sigma_px: float) -> None:
        self.factor = COARSEST if sigma_px >= 7.5 else 2 if sigma_px >= 3.75 else 1
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
        shape = (-(-(bottom - top) // self.factor), -(-(right - left) // self.factor))
        coarse = np.empty(shape, dtype=np.float32)
        _coarsen(surface, window, self.factor, coarse)
        smooth(coarse, (0, shape[0], 0, shape[1]), self.kernel, np.empty_like(coarse))
        _refine(coarse, self.factor, window, surface)

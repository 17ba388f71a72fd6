"""Gaussian smoothing within a window, in numba: the same bits on every machine."""

import math
from typing import Any, TypeAlias

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


Rows: TypeAlias = tuple[NDArray[Any], ...]


@njit(cache=True, nogil=True, inline="always")
def _first_taps(
    row: NDArray[Any], kernel: NDArray[Any], lower: Rows, upper: Rows, out: NDArray[Any]
) -> None:
    """Start a row's sum with the centre and four taps on each side of it."""
    for k in range(out.shape[0]):
        near = kernel[1] * (lower[0][k] + upper[0][k]) + kernel[2] * (lower[1][k] + upper[1][k])
        far = kernel[3] * (lower[2][k] + upper[2][k]) + kernel[4] * (lower[3][k] + upper[3][k])
        out[k] = kernel[0] * row[k] + (near + far)


@njit(cache=True, nogil=True, inline="always")
def _add_taps(kernel: NDArray[Any], j: int, lower: Rows, upper: Rows, out: NDArray[Any]) -> None:
    """Add taps j and j + 1 on each side."""
    near, far = kernel[j], kernel[j + 1]
    for k in range(out.shape[0]):
        out[k] += near * (lower[0][k] + upper[0][k]) + far * (lower[1][k] + upper[1][k])


@njit(cache=True, nogil=True)
def _blur_row(
    row: NDArray[Any], kernel: NDArray[Any], line: NDArray[Any], out: NDArray[Any]
) -> None:
    """Convolve a row, by way of ``line``; what lies beyond its ends equals them."""
    radius, width = kernel.shape[0] - 1, row.shape[0]
    line[:radius] = row[0]
    line[radius : radius + width] = row
    line[radius + width :] = row[width - 1]
    low, high = line[radius - 4 :], line[radius + 1 :]
    lower, upper = (low[3:], low[2:], low[1:], low), (high, high[1:], high[2:], high[3:])
    _first_taps(row, kernel, lower, upper, out)
    for j in range(5, radius, 2):
        low, high = line[radius - j - 1 :], line[radius + j :]
        _add_taps(kernel, j, (low[1:], low), (high, high[1:]), out)


@njit(cache=True, nogil=True)
def smooth(surface: NDArray[Any], window: Window, kernel: NDArray[Any]) -> None:
    """Blur ``surface`` in place within the window; beyond it the edge's values go on."""
    top, bottom, left, right = window
    radius, last = kernel.shape[0] - 1, bottom - 1
    # Only the rows that a column's sum needs are kept, each blurred along itself.
    n_kept = 2 * radius + 1
    kept = np.empty((n_kept, right - left), np.float32)
    line = np.empty(right - left + 2 * radius, np.float32)
    n_blurred = 0
    for r in range(top, bottom):
        while top + n_blurred <= min(r + radius, last):
            _blur_row(surface[top + n_blurred, left:right], kernel, line, kept[n_blurred % n_kept])
            n_blurred += 1
        row, out = kept[(r - top) % n_kept], surface[r, left:right]
        i, i_last = r - top, last - top
        _first_taps(
            row,
            kernel,
            (
                kept[max(i - 1, 0) % n_kept],
                kept[max(i - 2, 0) % n_kept],
                kept[max(i - 3, 0) % n_kept],
                kept[max(i - 4, 0) % n_kept],
            ),
            (
                kept[min(i + 1, i_last) % n_kept],
                kept[min(i + 2, i_last) % n_kept],
                kept[min(i + 3, i_last) % n_kept],
                kept[min(i + 4, i_last) % n_kept],
            ),
            out,
        )
        for j in range(5, radius, 2):
            lower = kept[max(i - j, 0) % n_kept], kept[max(i - j - 1, 0) % n_kept]
            upper = kept[min(i + j, i_last) % n_kept], kept[min(i + j + 1, i_last) % n_kept]
            _add_taps(kernel, j, lower, upper, out)


def half_kernel(sigma_px: float) -> NDArray[np.float32]:
    """The centre and right half of a Gaussian of unit sum, not narrower than a tenth of a pixel.

    The half reaches three standard deviations, an even number of pixels and at least four.
    """
    radius = 2 * max(2, math.ceil(_REACH_SIGMAS * sigma_px / 2))
    weights = np.exp(-0.5 * (np.arange(radius + 1) / max(sigma_px, 0.1)) ** 2)
    return np.asarray((weights / (2 * weights.sum() - weights[0])).astype(np.float32))


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
def _widen(blocks: NDArray[Any], factor: int, row: NDArray[Any]) -> None:
    """Interpolate along a row of blocks, from one block before the first pixel on."""
    one, half = np.float32(1), np.float32(0.5)
    for phase in range(factor):
        at = (np.float32(phase) + half) / np.float32(factor) + half
        shift = int(at)
        share = at - np.float32(shift)
        before, after = blocks[shift:], blocks[shift + 1 :]
        for j in range((row.shape[0] - phase + factor - 1) // factor):
            row[j * factor + phase] = (one - share) * before[j] + share * after[j]


@njit(cache=True, nogil=True)
def _refine(coarse: NDArray[Any], factor: int, window: Window, surface: NDArray[Any]) -> None:
    """Interpolate between the middles of the blocks that ``_coarsen`` made."""
    top, bottom, left, right = window
    wide = np.empty((2, right - left), np.float32)  # two rows of blocks, as wide as the window
    one, half = np.float32(1), np.float32(0.5)
    n_wide = 0
    for r in range(top, bottom):
        at = (np.float32(r - top) + half) / np.float32(factor) + half
        i = int(at)
        share = at - np.float32(i)
        while n_wide < i + 2:
            _widen(coarse[n_wide], factor, wide[n_wide % 2])
            n_wide += 1
        above, below, row = wide[i % 2], wide[(i + 1) % 2], surface[r, left:right]
        for k in range(row.shape[0]):
            row[k] = (one - share) * above[k] + share * below[k]


class Gaussian:
    """One Gaussian; a wide one is computed on means of blocks of pixels, about σ wide."""

    def __init__(self, sigma_px: float) -> None:
        self.factor = COARSEST if sigma_px >= 7.5 else 2 if sigma_px >= 1.9 else 1
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

    def apply(self, surface: NDArray[np.float32], window: Window) -> None:
        """Blur in place within a window that is aligned to ``factor`` from the image's corner."""
        if self.factor == 1:
            smooth(surface, window, self.kernel)
            return
        top, bottom, left, right = window
        shape = (-(-(bottom - top) // self.factor) + 2, -(-(right - left) // self.factor) + 2)
        coarse = np.empty(shape, dtype=np.float32)
        _coarsen(surface, window, self.factor, coarse)
        smooth(coarse, (0, shape[0], 0, shape[1]), self.kernel)
        _refine(coarse, self.factor, window, surface)

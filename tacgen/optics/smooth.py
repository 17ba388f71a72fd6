"""Gaussian smoothing within a window, in numba: the same bits on every machine."""

import math
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from tacgen.core.compiled import njit
from tacgen.core.types import Window

HALVED_FROM_PX = (1.9, 7.5, 15.0)
"""Standard deviations from which a Gaussian is computed on blocks of 2×2, 4×4 and 8×8 pixels."""

BEYOND = 2  # blocks beyond each edge: two, so that blocks of blocks begin at the edge too

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
def copy_row(source: NDArray[Any], target: NDArray[Any]) -> None:
    """Copy a row to memory of its own: as vectors, which numba's copies of slices are not."""
    for k in range(target.shape[0]):
        target[k] = source[k]


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
def smooth(surface: NDArray[Any], window: Window, kernel: NDArray[Any]) -> None:
    """Blur ``surface`` in place within the window; beyond it the edge's values go on."""
    top, bottom, left, right = window
    radius, width, last = kernel.shape[0] - 1, right - left, bottom - 1
    # Only the rows that a column's sum needs are kept, each blurred along itself.
    n_kept = 2 * radius + 1
    kept = np.empty((n_kept, width), np.float32)
    line = np.empty(width + 2 * radius, np.float32)
    low, middle, high = line[radius - 4 :], line[radius : radius + width], line[radius + 1 :]
    before, after = (low[3:], low[2:], low[1:], low), (high, high[1:], high[2:], high[3:])
    n_blurred = 0
    for r in range(top, bottom):
        while top + n_blurred <= min(r + radius, last):
            row, out = surface[top + n_blurred, left:right], kept[n_blurred % n_kept]
            copy_row(row, middle)
            line[:radius] = row[0]
            line[radius + width :] = row[width - 1]
            _first_taps(middle, kernel, before, after, out)
            for j in range(5, radius, 2):
                low, high = line[radius - j - 1 :], line[radius + j :]
                _add_taps(kernel, j, (low[1:], low), (high, high[1:]), out)
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
def _halve(surface: NDArray[Any], window: Window, coarse: NDArray[Any]) -> None:
    """Means of blocks of 2×2 pixels, with ``BEYOND`` blocks more beyond each edge.

    What lies beyond the window equals its edge.
    """
    top, bottom, left, right = window
    width, last, first = right - left, bottom - 1, 2 * BEYOND
    line = np.empty(2 * coarse.shape[1], np.float32)
    within = line[first : first + width]
    for i in range(coarse.shape[0]):
        r = top + 2 * i - first
        upper = surface[min(max(r, top), last), left:right]
        lower = surface[min(max(r + 1, top), last), left:right]
        for k in range(width):
            within[k] = upper[k] + lower[k]
        line[:first] = within[0]
        line[first + width :] = within[width - 1]
        out = coarse[i]
        for j in range(out.shape[0]):
            even = np.uint64(2 * j)  # an index with a sign would keep numba from vectors
            out[j] = np.float32(0.25) * (line[even] + line[even + np.uint64(1)])


@njit(cache=True, nogil=True, inline="always")
def _blend(near: NDArray[Any], far: NDArray[Any], out: NDArray[Any]) -> None:
    """A quarter of the way from one row to another."""
    for k in range(out.shape[0]):
        out[k] = np.float32(0.75) * near[k] + np.float32(0.25) * far[k]


@njit(cache=True, nogil=True)
def _double(coarse: NDArray[Any], window: Window, surface: NDArray[Any]) -> None:
    """Interpolate between the middles of the blocks that ``_halve`` made."""
    top, bottom, left, right = window
    n_blocks = coarse.shape[1] - 2 * BEYOND
    wide = np.empty((2, 2 * n_blocks), np.float32)  # two rows of blocks, as wide as the window
    for i in range(BEYOND - 1, coarse.shape[0]):
        before, here, after = coarse[i, BEYOND - 1 :], coarse[i, BEYOND:], coarse[i, BEYOND + 1 :]
        above, below = wide[1 - i % 2], wide[i % 2]
        for j in range(n_blocks):
            even = np.uint64(2 * j)
            below[even] = np.float32(0.75) * here[j] + np.float32(0.25) * before[j]
            below[even + np.uint64(1)] = np.float32(0.75) * here[j] + np.float32(0.25) * after[j]
        r = top + 2 * (i - BEYOND) - 1  # the lower row of the block before
        if top <= r < bottom:
            _blend(above, below, surface[r, left:right])
        if top <= r + 1 < bottom:
            _blend(below, above, surface[r + 1, left:right])


class Gaussian:
    """One Gaussian; the wider, the larger the blocks of pixels on whose means it is computed.

    What it leaves of a wave is off by at most 3 % of the wave's height; by up to 16 % of a wave
    shorter than two blocks, which the blocks see as a longer one.
    """

    factor: int
    """Pixels along a side of the blocks."""
    reach_px: int
    """How far anything spreads."""

    def __init__(self, sigma_px: float) -> None:
        self._n_halvings = sum(sigma_px >= least for least in HALVED_FROM_PX)
        variance = sigma_px**2
        for _ in range(self._n_halvings):
            # Taking means and interpolating between them has a variance of 1/4 + 3/4 pixels².
            variance = (variance - 1) / 4
        self.kernel = half_kernel(math.sqrt(variance))
        self.factor, self.reach_px = 1, len(self.kernel) - 1
        for _ in range(self._n_halvings):
            self.factor, self.reach_px = 2 * self.factor, 2 * (self.reach_px + 2)

    def apply(self, surface: NDArray[np.float32], window: Window) -> None:
        """Blur in place within a window that is aligned to ``factor`` from the image's corner."""
        self._apply(surface, window, self._n_halvings)

    def _apply(self, surface: NDArray[np.float32], window: Window, n_halvings: int) -> None:
        if n_halvings == 0:
            smooth(surface, window, self.kernel)
            return
        top, bottom, left, right = window
        shape = tuple((n + 1) // 2 + 2 * BEYOND for n in (bottom - top, right - left))
        coarse = np.empty(shape, dtype=np.float32)
        _halve(surface, window, coarse)
        self._apply(coarse, (0, shape[0], 0, shape[1]), n_halvings - 1)
        _double(coarse, window, surface)

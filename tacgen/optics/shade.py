"""The look-up itself: from the slope of the gel and the place in the image to grey levels."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tacgen.optics.deform import Window
from tacgen.optics.table import N_FEATURES, LookupTable

_LANES = 4
_NODE = _LANES * N_FEATURES


def packed_nodes(table: LookupTable) -> NDArray[np.float32]:
    """The coefficients (n_slope, n_direction + 1, 24), the first direction repeated at the end.

    A node holds R, G, B and a zero for each feature in turn: whole vectors of the processor.
    """
    n_slope, n_direction = table.coefficients.shape[:2]
    nodes = np.zeros((n_slope, n_direction + 1, N_FEATURES, _LANES), dtype=np.float32)
    nodes[:, :-1, :, :3] = table.coefficients.transpose(0, 1, 3, 2)
    nodes[:, -1] = nodes[:, 0]
    return nodes.reshape(n_slope, n_direction + 1, _NODE)


@njit(cache=True, nogil=True, inline="always")
def _atan_of_quotient(numerator, denominator):  # type: ignore[no-untyped-def]
    """Arc tangent of numerator / denominator, both at least 0, to 1e-7 rad.

    Written out so that it gives the same bits with every C library, and works on whole vectors.

    Source
    ------
    Cephes ``atanf``: its range reduction at tan(π/8) and polynomial.
    """
    small, large = min(numerator, denominator), max(numerator, denominator)
    far = small > np.float32(0.41421356) * large
    top = small - large if far else small
    bottom = small + large if far else large
    x = top / max(bottom, np.float32(1e-30))
    z = x * x
    polynomial = np.float32(8.05374449538e-2) * z - np.float32(1.38776856032e-1)
    polynomial = polynomial * z + np.float32(1.99777106478e-1)
    polynomial = polynomial * z - np.float32(3.33329491539e-1)
    angle = polynomial * z * x + x
    angle = angle + np.float32(0.78539816) if far else angle
    return np.float32(1.5707963) - angle if numerator > denominator else angle


@njit(cache=True, nogil=True)
def _slope_coordinates(
    height_mm: NDArray,
    r: int,
    left: int,
    right: int,
    mm_per_px: float,
    per_slope: float,
    per_direction: float,
    slope: NDArray,
    direction: NDArray,
) -> None:
    """Coordinates in the table of the pixels [left, right) of row r, by central differences."""
    n_rows, n_columns = height_mm.shape
    above, below = max(r - 1, 0), min(r + 1, n_rows - 1)
    per_row = np.float32(1.0 / (mm_per_px * (below - above))) if below > above else np.float32(0)
    per_column = np.float32(0.5 / mm_per_px)
    up, here, down = height_mm[above], height_mm[r], height_mm[below]
    width = right - left
    for k in range(width):
        slope[k] = (down[left + k] - up[left + k]) * per_row
    first, last = max(left, 1), min(right, n_columns - 1)
    before, after, across = here[first - 1 :], here[first + 1 :], direction[first - left :]
    for k in range(last - first):
        across[k] = (after[k] - before[k]) * per_column
    if n_columns > 1:
        if left == 0:
            direction[0] = (here[1] - here[0]) * (per_column + per_column)
        if right == n_columns:
            direction[width - 1] = (here[n_columns - 1] - here[n_columns - 2]) * (
                per_column + per_column
            )
    else:
        direction[0] = 0
    half_turn = np.float32(math.pi)
    for k in range(width):
        gx, gy = direction[k], slope[k]
        one = np.float32(1)
        slope[k] = _atan_of_quotient(np.sqrt(gx * gx + gy * gy), one) * np.float32(per_slope)
        angle = _atan_of_quotient(abs(gy), abs(gx))
        angle = half_turn - angle if gx < 0 else angle
        angle = -angle if gy < 0 else angle
        direction[k] = (angle + half_turn) * np.float32(per_direction)


@njit(cache=True, nogil=True)
def shade_window(
    height_mm: NDArray,
    window: Window,
    mm_per_px: float,
    nodes: NDArray,
    max_slope_rad: float,
    interpolate: bool,
    background: NDArray,
    image: NDArray,
) -> None:
    """Write background + polynomial into ``image`` (H, W, 3) float32, within ``window``.

    Parameters
    ----------
    height_mm : (H, W) float32
        The deformed gel surface, gel frame.
    nodes : (n_slope, n_direction + 1, 24) float32
        See ``packed_nodes``.
    """
    n_rows, n_columns = height_mm.shape
    top, bottom, left, right = window
    n_slope, n_direction = nodes.shape[0], nodes.shape[1] - 1
    slope, direction = np.empty(right - left, np.float32), np.empty(right - left, np.float32)
    last_slope = n_slope - 2 if interpolate else n_slope - 1
    blend = np.empty(_NODE, np.float32)
    one, half = np.float32(1), np.float32(0.5)
    for r in range(top, bottom):
        _slope_coordinates(
            height_mm,
            r,
            left,
            right,
            mm_per_px,
            (n_slope - 1) / max_slope_rad,
            n_direction / (2 * math.pi),
            slope,
            direction,
        )
        v = (np.float32(r) + half) / np.float32(n_rows) - half
        image_row, background_row = image[r, left:right], background[r, left:right]
        for k in range(slope.shape[0]):
            u = (np.float32(left + k) + half) / np.float32(n_columns) - half
            i = min(np.int64(slope[k]), last_slope)
            j = min(np.int64(direction[k]), n_direction - 1)
            if interpolate:
                p = min(slope[k] - np.float32(i), one)
                q = min(direction[k] - np.float32(j), one)
                w11 = p * q
                w10, w01 = p - w11, q - w11
                w00 = one - p - w01
                n00, n01 = nodes[i, j], nodes[i, j + 1]
                n10, n11 = nodes[i + 1, j], nodes[i + 1, j + 1]
                for m in range(_NODE):
                    blend[m] = (w00 * n00[m] + w01 * n01[m]) + (w10 * n10[m] + w11 * n11[m])
            else:
                n00 = nodes[i, j]
                for m in range(_NODE):
                    blend[m] = n00[m]
            uu, vv, uv = u * u, v * v, u * v
            for channel in range(3):
                polynomial = blend[channel] * uu + blend[channel + 4] * vv + blend[channel + 8] * uv
                linear = blend[channel + 12] * u + blend[channel + 16] * v + blend[channel + 20]
                image_row[k, channel] = background_row[k, channel] + (polynomial + linear)


@njit(cache=True, nogil=True)
def quantize(image: NDArray, window: Window, rgb: NDArray) -> None:
    """Round ``image`` to 8 bits within ``window``."""
    top, bottom, left, right = window
    for r in range(top, bottom):
        source = image[r, left:right].reshape(-1)
        target = rgb[r, left:right].reshape(-1)
        for k in range(source.shape[0]):
            target[k] = np.uint8(
                min(max(source[k] + np.float32(0.5), np.float32(0)), np.float32(255))
            )

"""The look-up itself: from the slope of the gel and the place in the image to grey levels."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tacgen.optics.smooth import Window
from tacgen.optics.table import N_FEATURES, LookupTable
from tacgen.optics.vector import NODE_FLOATS, blend_nodes, blend_places

_LANES = NODE_FLOATS // N_FEATURES


def packed_nodes(table: LookupTable) -> NDArray[np.float32]:
    """The coefficients (n_slope, n_direction + 1, 24), the first direction repeated at the end.

    A node holds R, G, B and a zero for each feature in turn: whole vectors of the processor.
    """
    n_slope, n_direction = table.coefficients.shape[:2]
    nodes = np.zeros((n_slope, n_direction + 1, N_FEATURES, _LANES), dtype=np.float32)
    nodes[:, :-1, :, :3] = table.coefficients.transpose(0, 1, 3, 2)
    nodes[:, -1] = nodes[:, 0]
    return nodes.reshape(n_slope, n_direction + 1, NODE_FLOATS)


def packed_response(response: NDArray[np.float32]) -> NDArray[np.float32]:
    """A table's response (n_slope, n_direction + 1, n_rows, n_columns, 4).

    The first direction is repeated at the end, and a node holds R, G, B and a zero.
    """
    n_slope, n_direction, n_rows, n_columns, _ = response.shape
    packed = np.zeros((n_slope, n_direction + 1, n_rows, n_columns, _LANES), dtype=np.float32)
    packed[:, :-1, ..., :3] = response
    packed[:, -1] = packed[:, 0]
    return packed


def feature_factors(shape_px: tuple[int, int]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """What depends on u (W, 24) and on v (H, 24) in each feature of a node: u², v², uv, u, v, 1."""
    n_rows, n_columns = shape_px
    u = (np.arange(n_columns) + 0.5) / n_columns - 0.5
    v = (np.arange(n_rows) + 0.5) / n_rows - 0.5
    one_u, one_v = np.ones_like(u), np.ones_like(v)
    along_u = np.stack([u * u, one_u, u, u, one_u, one_u], axis=1)
    along_v = np.stack([one_v, v * v, v, one_v, v, one_v], axis=1)
    return (
        np.repeat(along_u, _LANES, axis=1).astype(np.float32),
        np.repeat(along_v, _LANES, axis=1).astype(np.float32),
    )


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
def _place_in_table(
    slope: NDArray,
    direction: NDArray,
    n_slope: int,
    n_direction: int,
    interpolate: bool,
    node_floats: int,
    offset: NDArray,
) -> None:
    """Turn coordinates into the node below (its offset) and the shares of the next ones."""
    last_slope = np.int32(n_slope - 2 if interpolate else n_slope - 1)
    last_direction = np.int32(n_direction - 1)
    row_length = np.int32((n_direction + 1) * node_floats)
    share = np.float32(1 if interpolate else 0)
    for k in range(slope.shape[0]):
        i = min(np.int32(slope[k]), last_slope)
        j = min(np.int32(direction[k]), last_direction)
        slope[k] = share * min(slope[k] - np.float32(i), np.float32(1))
        direction[k] = share * min(direction[k] - np.float32(j), np.float32(1))
        offset[k] = i * row_length + j * np.int32(node_floats)


@njit(cache=True, nogil=True)
def shade_window(
    height_mm: NDArray,
    window: Window,
    mm_per_px: float,
    nodes: NDArray,
    max_slope_rad: float,
    interpolate: bool,
    along: tuple[NDArray, NDArray],
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
    along : tuple of (W, 24) and (H, 24) float32
        See ``feature_factors``.
    """
    top, bottom, left, right = window
    n_slope, n_direction, width = nodes.shape[0], nodes.shape[1] - 1, right - left
    table, along_u, along_v = nodes.reshape(-1), along[0].reshape(-1), along[1].reshape(-1)
    slope, direction = np.empty(width, np.float32), np.empty(width, np.float32)
    offset = np.empty(width, np.int32)
    change = np.empty(3 * width + 1, np.float32)
    to_slope = (n_direction + 1) * NODE_FLOATS if interpolate else 0
    to_direction = NODE_FLOATS if interpolate else 0
    one = np.float32(1)
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
        _place_in_table(slope, direction, n_slope, n_direction, interpolate, NODE_FLOATS, offset)
        for k in range(width):
            p, q, here = slope[k], direction[k], np.int64(offset[k])
            w11 = p * q
            w10, w01 = p - w11, q - w11
            w00 = one - p - w01
            beside = here + to_direction
            blend_nodes(  # type: ignore[call-arg]  # numba passes the typing context itself
                table,
                (here, beside, here + to_slope, beside + to_slope),
                (w00, w01, w10, w11),
                along_u,
                (left + k) * NODE_FLOATS,
                along_v,
                r * NODE_FLOATS,
                change,
                3 * k,
            )
        image_row, background_row = (
            image[r, left:right].reshape(-1),
            background[r, left:right].reshape(-1),
        )
        for k in range(3 * width):
            image_row[k] = background_row[k] + change[k]


@njit(cache=True, nogil=True)
def shade_response(
    height_mm: NDArray,
    window: Window,
    mm_per_px: float,
    response: NDArray,
    max_slope_rad: float,
    background: NDArray,
    image: NDArray,
) -> None:
    """Write background + response into ``image`` (H, W, 3) float32, within ``window``.

    Parameters
    ----------
    height_mm : (H, W) float32
        The deformed gel surface, gel frame.
    response : (n_slope, n_direction + 1, n_rows, n_columns, 4) float32
        See ``packed_response``.
    """
    top, bottom, left, right = window
    n_slope, n_direction = response.shape[0], response.shape[1] - 1
    n_rows, n_columns = response.shape[2], response.shape[3]
    node_floats = n_rows * n_columns * _LANES
    width = right - left
    table = response.reshape(-1)
    slope, direction = np.empty(width, np.float32), np.empty(width, np.float32)
    offset, column = np.empty(width, np.int32), np.empty(width, np.int32)
    across = np.empty(width, np.float32)
    change = np.empty(3 * width + 1, np.float32)
    to_row, to_direction = n_columns * _LANES, node_floats
    to_slope = (n_direction + 1) * node_floats
    one = np.float32(1)
    for k in range(width):
        at = (left + k + 0.5) / image.shape[1] * (n_columns - 1)
        column[k] = min(int(at), n_columns - 2) * _LANES
        across[k] = at - column[k] // _LANES
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
        _place_in_table(slope, direction, n_slope, n_direction, True, node_floats, offset)
        at = (r + 0.5) / image.shape[0] * (n_rows - 1)
        row = min(int(at), n_rows - 2)
        down = np.float32(at - row)
        for k in range(width):
            p, q = slope[k], direction[k]
            here = np.int64(offset[k]) + row * to_row + column[k]
            w11 = p * q
            w10, w01 = p - w11, q - w11
            w00 = one - p - w01
            beside, above = here + to_direction, here + to_slope
            both = beside + to_slope
            d00, d01, d10, d11 = down * w00, down * w01, down * w10, down * w11
            blend_places(  # type: ignore[call-arg]  # numba passes the typing context itself
                table,
                (
                    here,
                    beside,
                    above,
                    both,
                    here + to_row,
                    beside + to_row,
                    above + to_row,
                    both + to_row,
                ),
                (w00 - d00, w01 - d01, w10 - d10, w11 - d11, d00, d01, d10, d11),
                across[k],
                change,
                3 * k,
            )
        image_row, background_row = (
            image[r, left:right].reshape(-1),
            background[r, left:right].reshape(-1),
        )
        for k in range(3 * width):
            image_row[k] = background_row[k] + change[k]


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

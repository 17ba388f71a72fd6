"""The look-up itself: from the slope of the gel and the place in the image to grey levels."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tacgen.core.compiled import njit
from tacgen.core.types import Window
from tacgen.optics.smooth import copy_row
from tacgen.optics.vector import NODE_FLOATS, blend_nodes, blend_places

N_FEATURES = 6  # x², y², xy, x, y, 1 in image position, Taxim's order
_LANES = NODE_FLOATS // N_FEATURES
CACHE_LINE_FLOATS = 16


class QuadraticNodes(NamedTuple):
    """A quadratic in position made ready for images of ``background`` (H, W, 3).

    ``nodes`` are ``packed_nodes``; ``u`` (W,) and ``v`` (H,) float32 are the places of columns and
    rows in the image.
    """

    mm_per_px: float
    nodes: NDArray[Any]
    max_slope_rad: float
    interpolate: bool
    u: NDArray[Any]
    v: NDArray[Any]
    background: NDArray[Any]


class ResponseNodes(NamedTuple):
    """A response made ready for images of ``background`` (H, W, 3).

    ``response`` is a ``packed_response`` and ``contact`` are ``contact_lines``, none where a
    contact adds nothing; ``rest_mm`` (H, W) is the gel at rest, gel frame.
    """

    mm_per_px: float
    response: NDArray[Any]
    max_slope_rad: float
    background: NDArray[Any]
    rest_mm: NDArray[Any]
    contact: NDArray[Any]
    contact_depth_mm: float


def packed_nodes(coefficients: NDArray[np.float32]) -> NDArray[np.float32]:
    """A table's coefficients (n_slope, n_direction + 1, 24), the first direction again at the end.

    A node holds R, G, B and a zero for each feature in turn: whole vectors of the processor.
    """
    n_slope, n_direction = coefficients.shape[:2]
    nodes = np.zeros((n_slope, n_direction + 1, N_FEATURES, _LANES), dtype=np.float32)
    nodes[:, :-1, :, :3] = coefficients.transpose(0, 1, 3, 2)
    nodes[:, -1] = nodes[:, 0]
    return _on_cache_lines(nodes.reshape(n_slope, n_direction + 1, NODE_FLOATS))


def _on_cache_lines(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """The same values from the first byte of a cache line on: no vector of 8 lies on two lines."""
    memory = np.empty(values.size + CACHE_LINE_FLOATS, dtype=np.float32)
    start = -(memory.ctypes.data // memory.itemsize) % CACHE_LINE_FLOATS
    aligned = memory[start : start + values.size].reshape(values.shape)
    aligned[...] = values
    return aligned


def packed_response(response: NDArray[np.float32]) -> NDArray[np.float32]:
    """A table's response (n_rows, n_columns, n_slope, n_direction + 1, 4).

    The first direction is repeated at the end, and a node holds R, G, B and a zero. All slopes at
    one place lie together: what neighbouring pixels of a rough gel look up stays in the cache.
    """
    n_slope, n_direction, n_rows, n_columns, _ = response.shape
    packed = np.zeros((n_rows, n_columns, n_slope, n_direction + 1, _LANES), dtype=np.float32)
    packed[..., :-1, :3] = response.transpose(2, 3, 0, 1, 4)
    packed[..., -1, :] = packed[..., 0, :]
    return packed


def packed_contact(change: NDArray[np.float32]) -> NDArray[np.float32]:
    """What a contact adds (n_rows, n_columns · 12): R, G, B, a zero, for 1, nx and ny in turn."""
    packed = np.zeros((*change.shape[:3], _LANES), dtype=np.float32)
    packed[..., :3] = change
    return packed.reshape(len(change), -1)


def contact_lines(change: NDArray[np.float32], width_px: int) -> NDArray[np.float32]:
    """What a contact adds (n_rows, 9, W): at the nodes' rows, linear between their columns.

    R, G and B for 1, nx and ny in turn.
    """
    lines = at_pixels(change.reshape(*change.shape[:2], 9), width_px, 1)
    return np.ascontiguousarray(lines.transpose(0, 2, 1))


def at_pixels(nodes: NDArray[np.float32], size_px: int, axis: int) -> NDArray[np.float32]:
    """Values at nodes, spread from edge to edge of the picture along an axis, at its pixels."""
    last = nodes.shape[axis] - 1
    at = (np.arange(size_px) + 0.5) / size_px * last
    before = np.minimum(at.astype(np.int64), last - 1)
    share = (at - before).astype(np.float32)
    values = np.moveaxis(nodes, axis, -1)
    between = (1 - share) * values[..., before] + share * values[..., before + 1]
    return np.ascontiguousarray(np.moveaxis(between, -1, axis), dtype=np.float32)


@njit(cache=True, nogil=True, inline="always")
def _atan_of_quotient(numerator, denominator):  # type: ignore[no-untyped-def]
    """Arc tangent of numerator / denominator, both at least 0, to 1e-7 rad.

    Written out so that it gives the same bits with every C library, and works on whole vectors.

    Source: Cephes ``atanf``: its range reduction at tan(π/8) and polynomial.
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
def _gradients(
    height_mm: NDArray[Any],
    r: int,
    span: NDArray[Any],
    mm_per_px: float,
    gx: NDArray[Any],
    gy: NDArray[Any],
) -> None:
    """Slopes along x and y of the pixels of a span [left, right) of row r: central differences."""
    left, right = span
    n_rows, n_columns = height_mm.shape
    above, below = max(r - 1, 0), min(r + 1, n_rows - 1)
    per_row = np.float32(1.0 / (mm_per_px * (below - above))) if below > above else np.float32(0)
    per_column = np.float32(0.5 / mm_per_px)
    up, here, down = height_mm[above], height_mm[r], height_mm[below]
    width = right - left
    up, down = up[left:right], down[left:right]
    for k in range(width):
        gy[k] = (down[k] - up[k]) * per_row
    first, last = max(left, 1), min(right, n_columns - 1)
    before, after, across = here[first - 1 :], here[first + 1 :], gx[first - left :]
    for k in range(last - first):
        across[k] = (after[k] - before[k]) * per_column
    if n_columns > 1:
        if left == 0:
            gx[0] = (here[1] - here[0]) * (per_column + per_column)
        if right == n_columns:
            gx[width - 1] = (here[n_columns - 1] - here[n_columns - 2]) * (per_column + per_column)
    else:
        gx[0] = 0


# numpy's way with divisions by zero: Python's check of each keeps a loop from vectors.
@njit(cache=True, nogil=True, error_model="numpy")
def _contact_row(
    heights_mm: tuple[NDArray[Any], NDArray[Any]],
    gx: NDArray[Any],
    gy: NDArray[Any],
    contact: tuple[NDArray[Any], float],
    place: tuple[int, Any, int],
    added: NDArray[Any],
) -> None:
    """Grey levels that the contact itself adds to a row of pixels, into ``added`` (5, width).

    R, G and B, 0 without contact; the cosine of the slope; and the share of what shows. The row's
    ``heights_mm`` are at rest and now, ``contact`` is its ``contact_lines`` and the depth at which
    half of it shows; ``place`` is the last line above the row, the share of the way to the next and
    the first column.
    """
    (rest, height), (lines, full_mm) = heights_mm, contact
    row, down, left = place
    right = left + gx.shape[0]
    one, full, zero = np.float32(1), np.float32(full_mm), np.float32(0)
    cosine, share = added[3], added[4]
    for k in range(gx.shape[0]):
        depth = max(rest[k] - height[k], zero)
        share[k] = depth / (depth + full)
    for k in range(gx.shape[0]):
        cosine[k] = one / np.sqrt(one + gx[k] * gx[k] + gy[k] * gy[k])
    for c in range(3):
        out = added[c]
        above, below = lines[row, c, left:right], lines[row + 1, c, left:right]
        for k in range(gx.shape[0]):
            out[k] = above[k] + down * (below[k] - above[k])
        above, below = lines[row, 3 + c, left:right], lines[row + 1, 3 + c, left:right]
        for k in range(gx.shape[0]):
            out[k] += gx[k] * cosine[k] * (above[k] + down * (below[k] - above[k]))
        above, below = lines[row, 6 + c, left:right], lines[row + 1, 6 + c, left:right]
        for k in range(gx.shape[0]):
            out[k] += gy[k] * cosine[k] * (above[k] + down * (below[k] - above[k]))
            out[k] *= share[k]


@njit(cache=True, nogil=True)
def _to_coordinates(
    gx: NDArray[Any], gy: NDArray[Any], per_slope: float, per_direction: float
) -> None:
    """Turn slopes into coordinates in the table: gx into the direction's, gy into the slope's."""
    half_turn = np.float32(math.pi)
    for k in range(gx.shape[0]):
        x, y = gx[k], gy[k]
        one = np.float32(1)
        gy[k] = _atan_of_quotient(np.sqrt(x * x + y * y), one) * np.float32(per_slope)
        angle = _atan_of_quotient(abs(y), abs(x))
        angle = half_turn - angle if x < 0 else angle
        angle = -angle if y < 0 else angle
        gx[k] = (angle + half_turn) * np.float32(per_direction)


@njit(cache=True, nogil=True)
def _place_in_table(
    slope: NDArray[Any],
    direction: NDArray[Any],
    shape: tuple[int, int],
    interpolate: bool,
    node_floats: int,
    offset: NDArray[Any],
) -> None:
    """Turn coordinates into the node below (its offset) and the shares of the next ones.

    ``shape`` is the table's number of slopes and of directions.
    """
    n_slope, n_direction = shape
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
def changed_spans(
    deformation_mm: NDArray[Any], window: Window, lit: Window, reach_px: int
) -> NDArray[np.int32]:
    """Columns [first, last) of each row of ``lit`` that are within reach of a deformation.

    ``deformation_mm`` (h, w) lies over ``window``. The deformed patch is seldom a rectangle: the
    corners of its window are at rest.
    """
    height, width = deformation_mm.shape
    own = np.empty((height, 2), np.int32)
    for r in range(height):
        first, last = 0, width
        while first < last and deformation_mm[r, first] == 0:
            first += 1
        while first < last and deformation_mm[r, last - 1] == 0:
            last -= 1
        own[r, 0], own[r, 1] = window[2] + first, window[2] + last
    spans = np.empty((lit[1] - lit[0], 2), np.int32)
    for i in range(spans.shape[0]):
        first, last = lit[3], lit[2]
        r = lit[0] + i - window[0]
        for near in range(max(r - reach_px, 0), min(r + reach_px + 1, height)):
            if own[near, 0] < own[near, 1]:
                first, last = min(first, own[near, 0]), max(last, own[near, 1])
        if first < last:
            first, last = max(first - reach_px, lit[2]), min(last + reach_px, lit[3])
        spans[i, 0], spans[i, 1] = first, max(first, last)
    return spans


def whole_spans(window: Window) -> NDArray[np.int32]:
    """The spans of a whole window."""
    top, bottom, left, right = window
    spans = np.empty((bottom - top, 2), dtype=np.int32)
    spans[:, 0], spans[:, 1] = left, right
    return spans


@njit(cache=True, nogil=True)
def restore(
    image: NDArray[Any],
    source: NDArray[Any],
    window: Window,
    spans: NDArray[Any],
    kept: Window,
    kept_spans: NDArray[Any],
) -> None:
    """Copy the spans of ``window`` from ``source`` to ``image``, but for the spans of ``kept``.

    Both are (H, W) or (H, W, 3).
    """
    each = image.size // (image.shape[0] * image.shape[1])
    for r in range(window[0], window[1]):
        left, right = each * spans[r - window[0], 0], each * spans[r - window[0], 1]
        first, last = right, right
        if kept[0] <= r < kept[1]:
            first, last = each * kept_spans[r - kept[0], 0], each * kept_spans[r - kept[0], 1]
            first = min(max(first, left), right)
            last = min(max(last, first), right)
        out, row = image[r].reshape(-1), source[r].reshape(-1)
        copy_row(row[left:first], out[left:first])
        copy_row(row[last:right], out[last:right])


@njit(cache=True, nogil=True)
def lower(
    rest_mm: NDArray[Any], deformation_mm: NDArray[Any], window: Window, height_mm: NDArray[Any]
) -> None:
    """Set ``window`` of ``height_mm`` (H, W) a ``deformation_mm`` (h, w) below the gel at rest."""
    top, bottom, left, right = window
    for r in range(top, bottom):
        rest, deeper, out = (
            rest_mm[r, left:right],
            deformation_mm[r - top],
            height_mm[r, left:right],
        )
        for k in range(out.shape[0]):
            out[k] = rest[k] - deeper[k]


@njit(cache=True, nogil=True)
def shade_window(
    height_mm: NDArray[Any],
    window: Window,
    spans: NDArray[Any],
    image: NDArray[Any],
    ready: QuadraticNodes,
) -> None:
    """Write background + polynomial into ``image`` (H, W, 3) float32, in the spans of ``window``.

    ``height_mm`` (H, W) is the deformed gel surface, gel frame.
    """
    mm_per_px, nodes, max_slope_rad, interpolate, u, v, background = ready
    top, bottom = window[:2]
    n_slope, n_direction = shape = nodes.shape[0], nodes.shape[1] - 1
    table = nodes.reshape(-1)
    widest = window[3] - window[2]
    slopes, directions = np.empty(widest, np.float32), np.empty(widest, np.float32)
    offset = np.empty(widest, np.int32)
    change = np.empty(3 * widest + 1, np.float32)
    to_slope = (n_direction + 1) * NODE_FLOATS if interpolate else 0
    to_direction = NODE_FLOATS if interpolate else 0
    per_slope, per_direction = (n_slope - 1) / max_slope_rad, n_direction / (2 * math.pi)
    one = np.float32(1)
    for r in range(top, bottom):
        left, right = spans[r - top]
        width = right - left
        if width == 0:
            continue
        slope, direction = slopes[:width], directions[:width]
        _gradients(height_mm, r, spans[r - top], mm_per_px, direction, slope)
        _to_coordinates(direction, slope, per_slope, per_direction)
        _place_in_table(slope, direction, shape, interpolate, NODE_FLOATS, offset)
        across, down = u[left:right], v[r]
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
                across[k],
                down,
                change,
                3 * k,
            )
        image_row = image[r, left:right].reshape(-1)
        background_row = background[r, left:right].reshape(-1)
        for k in range(3 * width):
            image_row[k] = background_row[k] + change[k]


@njit(cache=True, nogil=True)
def shade_response(
    height_mm: NDArray[Any],
    window: Window,
    spans: NDArray[Any],
    image: NDArray[Any],
    ready: ResponseNodes,
) -> None:
    """Write background + response + contact into ``image`` (H, W, 3), in the spans of ``window``.

    ``height_mm`` (H, W) is the deformed gel surface, gel frame.
    """
    mm_per_px, response, max_slope_rad, background, rest_mm, contact, contact_depth_mm = ready
    top, bottom = window[:2]
    n_rows, n_columns = response.shape[0], response.shape[1]
    n_slope, n_direction = shape = response.shape[2], response.shape[3] - 1
    to_slope = (n_direction + 1) * _LANES
    to_column = n_slope * to_slope
    to_row = n_columns * to_column
    widest = window[3] - window[2]
    table = response.reshape(-1)
    slopes, directions = np.empty(widest, np.float32), np.empty(widest, np.float32)
    offset, columns = np.empty(widest, np.int32), np.empty(widest, np.int32)
    shares = np.empty(widest, np.float32)
    change = np.empty(3 * widest + 1, np.float32)
    added = np.zeros((5, widest), np.float32)
    per_slope, per_direction = (n_slope - 1) / max_slope_rad, n_direction / (2 * math.pi)
    one = np.float32(1)
    for k in range(widest):
        at = (window[2] + k + 0.5) / image.shape[1] * (n_columns - 1)
        columns[k] = min(int(at), n_columns - 2)
        shares[k] = at - columns[k]
    for r in range(top, bottom):
        left, right = spans[r - top]
        width = right - left
        if width == 0:
            continue
        slope, direction = slopes[:width], directions[:width]
        column, across = columns[left - window[2] :], shares[left - window[2] :]
        at = (r + 0.5) / image.shape[0] * (n_rows - 1)
        row = min(int(at), n_rows - 2)
        down = np.float32(at - row)
        _gradients(height_mm, r, spans[r - top], mm_per_px, direction, slope)
        if contact.shape[0]:
            heights_mm = rest_mm[r, left:right], height_mm[r, left:right]
            lines = contact, contact_depth_mm
            _contact_row(heights_mm, direction, slope, lines, (row, down, left), added)
        _to_coordinates(direction, slope, per_slope, per_direction)
        _place_in_table(slope, direction, shape, True, _LANES, offset)
        for k in range(width):
            p, q = slope[k], across[k]
            here = np.int64(offset[k]) + row * to_row + column[k] * to_column
            w11 = p * q
            w10, w01 = p - w11, q - w11
            w00 = one - p - w01
            steeper, beside = here + to_slope, here + to_column
            both = beside + to_slope
            d00, d01, d10, d11 = down * w00, down * w01, down * w10, down * w11
            blend_places(  # type: ignore[call-arg]  # numba passes the typing context itself
                table,
                (
                    here,
                    beside,
                    steeper,
                    both,
                    here + to_row,
                    beside + to_row,
                    steeper + to_row,
                    both + to_row,
                ),
                (w00 - d00, w01 - d01, w10 - d10, w11 - d11, d00, d01, d10, d11),
                direction[k],
                change,
                3 * k,
            )
        image_row = image[r, left:right].reshape(-1)
        background_row = background[r, left:right].reshape(-1)
        for k in range(3 * width):
            image_row[k] = background_row[k] + change[k]
        if contact.shape[0]:
            for k in range(width):
                for c in range(3):
                    image_row[3 * k + c] += added[c, k]


@njit(cache=True, nogil=True)
def quantize(image: NDArray[Any], window: Window, spans: NDArray[Any], rgb: NDArray[Any]) -> None:
    """Round ``image`` to 8 bits in the spans of ``window``."""
    for r in range(window[0], window[1]):
        left, right = spans[r - window[0]]
        source = image[r, left:right].reshape(-1)
        target = rgb[r, left:right].reshape(-1)
        for k in range(source.shape[0]):
            target[k] = np.uint8(
                min(max(source[k] + np.float32(0.5), np.float32(0)), np.float32(255))
            )

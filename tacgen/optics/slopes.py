"""Colours to slopes: the lookup table inverted, for pictures of one size."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.core.compiled import njit
from tacgen.core.types import BoolArray, FloatArray, IntArray
from tacgen.optics.image_models import ImageModel

TILE_PX = 32
"""Over so few pixels the table's dependence on place is a small correction to a first guess."""
BLOCK_PX = 16
"""Pixels so near to each other are solved in turn: what they need of the table stays at hand."""
LATTICE_CELLS, LATTICE_MARGIN_GREY = 40, 30.0
"""Of a tile's colours each way, some 6 grey levels wide, and how far around those of the table."""
GRID_NODES = 101  # slopes a side: steps of 0.06, refined afterwards
LONGEST_STEP_NODES = 2.0
"""Longest step of Gauss–Newton, in nodes of the slope grid: so far colour is nearly linear."""
SLOPE_PRIOR_GREY = 0.3
"""Grey levels that a slope of 1 has to be worth: of two slopes alike in colour, the one nearer to
the gel at rest. More flattens steep walls, by 1 % of a deep press's volume at 1 grey level."""
SEARCH_PRIOR_GREY = 3.0
"""The same in the first search, whose colours are those of the middle of a tile: without it some
pixels start at a steep slope of like colour, and stay there."""
LEAST_CHANGE_GREY = 2.0  # over the three colours: what changes less starts from rest
STDERR_PIXELS = 4000  # of a contact: so many tell its residual to 1 %
MOST_OFF_GREY = 6.0
"""A guess that leads so near to a colour is right: what a table does not explain is 3 to 5 on real
presses. Others are searched for."""
REFINEMENTS = 3  # of each slope between the grid's nodes


class SlopeFinder:
    """Inverts an image model in pictures of one size; what all of them share is made once.

    ``rest`` (h, w, 2) are the slopes ∂h/∂x and ∂h/∂y of the gel at rest, ``steepest`` the largest
    that are searched; ``larger`` has been made for pictures of twice the size. ``rest_colors``
    (h, w, 3) are the grey levels that the model adds at rest.
    """

    def __init__(
        self,
        model: ImageModel,
        steepest: float,
        rest: FloatArray,
        larger: "SlopeFinder | None" = None,
    ) -> None:
        self._model, self.steepest, self.rest = model, steepest, rest
        self._shape = rest.shape[0], rest.shape[1]
        if larger is None:
            self.grid, self._tile_px = _cartesian(model, steepest), TILE_PX
            self._lattice = _Lattice(self.grid, steepest, self._shape)
        else:
            self.grid, self._lattice = larger.grid, larger._lattice
            self._tile_px = larger._tile_px // 2
        self.rest_colors = self._colors_everywhere(rest)
        self._near_rest = self._slopes_near_rest()
        self._contact = model.contact_light(self._shape)

    def without_contact_light(
        self, seen: FloatArray, slopes: FloatArray, depth_mm: FloatArray, bare: BoolArray
    ) -> FloatArray:
        """Grey levels (h, w, 3) less what a contact of these slopes and depths adds to them.

        On bare gel an error of the level would become light, slopes and a larger error.
        """
        return _without_contact(seen, *self._contact, slopes, depth_mm, bare)

    def stderr(
        self, seen: FloatArray, slopes: FloatArray, depth_mm: FloatArray, where: BoolArray
    ) -> float:
        """Standard error of the slopes in a region.

        Three grey levels less two slopes leave one residual a pixel; its mean square is taken as
        the variance of each grey level, and (JᵀJ)⁻¹ makes it one of the slopes.
        """
        at = np.flatnonzero(where)
        at = at[:: max(1, len(at) // STDERR_PIXELS)]
        if not len(at):
            return math.nan
        here, by_x, by_y = self._colors_at(slopes, at)
        wanted = seen.reshape(-1, 3)[at] + self.rest_colors.reshape(-1, 3)[at]
        light, half_mm = self._contact
        pixel = 1, len(at), 3
        shown = light.reshape(-1, 3, 3)[at][None], half_mm, slopes.reshape(-1, 2)[at][None]
        deep = depth_mm.ravel()[at][None], np.zeros(pixel[:2], np.bool_)
        wanted = _without_contact(wanted.reshape(pixel), *shown, *deep)[0]
        variance = np.square(wanted - here).sum() / len(at)
        xx, yy, xy = (np.einsum("ij,ij->i", *p) for p in ((by_x, by_x), (by_y, by_y), (by_x, by_y)))
        spread = (xx + yy) / np.maximum(xx * yy - xy**2, 1e-9)
        return float(np.sqrt(0.5 * variance * np.median(spread)))

    def slopes_of(
        self,
        change: FloatArray,
        guess: FloatArray | None = None,
        before: FloatArray | None = None,
    ) -> FloatArray:
        """(h, w, 2) slopes that explain a change of grey levels from the gel at rest.

        ``guess`` (h, w, 2) are slopes near to them, which are searched no farther than the change
        asks for, and stay where the change is that of ``before``, another one.
        """
        is_guessed = guess is not None
        slopes = np.empty_like(self.rest) if guess is None else guess.copy()
        asked = np.ones(self._shape, np.bool_) if before is None else _differs(change, before)
        self._lattice.make(change, self._tile_px)
        pixels = self._near_rest, self.rest, self.rest_colors, change, asked, slopes, is_guessed
        _find(self.grid, self.steepest, self._lattice.arrays, self._tile_px, *pixels)
        return slopes

    def _slopes_near_rest(self) -> FloatArray:
        """(h, w, 2, 2, 2, 3) how slopes change with grey levels, from the gel at rest.

        For slopes that grow or fall with x, and with y, by half a node: a table has kinks there.
        """
        by = np.empty((2, 2, *self._shape, 3))
        for axis in range(2):
            for falls in range(2):
                step = np.zeros(2)
                step[axis] = (0.5 - falls) * 2.0 * self.steepest / (GRID_NODES - 1)
                moved = self._colors_everywhere(self.rest + step) - self.rest_colors
                by[axis, falls] = moved / step[axis]
        solve = np.empty((*self._shape, 2, 2, 2, 3), np.float32)
        for x in range(2):
            for y in range(2):
                one, other = by[0, x], by[1, y]
                xx, yy, xy = (
                    np.einsum("hwc,hwc->hw", *pair)[..., None]
                    for pair in ((one, one), (other, other), (one, other))
                )
                xx, yy = xx + SLOPE_PRIOR_GREY**2, yy + SLOPE_PRIOR_GREY**2
                per = 1.0 / (xx * yy - xy**2)
                solve[..., x, y, 0, :] = (yy * one - xy * other) * per
                solve[..., x, y, 1, :] = (xx * other - xy * one) * per
        return solve

    def _colors_everywhere(self, slopes: FloatArray) -> FloatArray:
        """Grey levels (h, w, 3) that the table adds at slopes (h, w, 2)."""
        return self._colors_at(slopes, np.arange(slopes.size // 2))[0].reshape(*self._shape, 3)

    def _colors_at(
        self, slopes: FloatArray, at: IntArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Grey levels (n, 3) that the table adds at slopes (h, w, 2), and how they change
        with ∂h/∂x and with ∂h/∂y, at the pixels of these numbers (n,).
        """
        colors = np.empty((3, len(at), 3), np.float32)
        _interpolate(self.grid, self.steepest, slopes, at, colors)
        return colors[0], colors[1], colors[2]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def _corners(
    grid: NDArray[Any], place: tuple[float, float], node: tuple[int, int], to: NDArray[Any]
) -> None:
    """Grey levels of ``grid`` (see ``_cartesian``) at a place, in shares of the picture's height
    and width, and at a node of slopes and the three after it, x fastest; into ``to`` (12,).
    """
    n_rows, n_columns, m = grid.shape[:3]
    flat = grid.reshape(-1)
    v, u = place[0] * (n_rows - 1), place[1] * (n_columns - 1)
    row, column = min(int(v), n_rows - 2), min(int(u), n_columns - 2)
    down, across = np.float32(v - row), np.float32(u - column)
    size = 3 * m * m
    at = (row * n_columns + column) * size + (node[0] * m + node[1]) * 3
    both = down * across
    left, right = np.float32(1.0) - down - across + both, across - both
    lower_left = down - both
    # Unsigned, since a signed index may count from the end, which costs as much as the rest.
    a, b = np.uint64(at), np.uint64(at + size)
    c, d = np.uint64(at + n_columns * size), np.uint64(at + n_columns * size + size)
    six, next_row = np.uint64(6), np.uint64(3 * m)
    for t in range(six):
        to[t] = (
            left * flat[a + t] + right * flat[b + t] + lower_left * flat[c + t] + both * flat[d + t]
        )
    for t in range(six):
        s = t + next_row
        to[t + six] = (
            left * flat[a + s] + right * flat[b + s] + lower_left * flat[c + s] + both * flat[d + s]
        )


@njit(cache=True, nogil=True, error_model="numpy")
def _interpolate(
    grid: NDArray[Any],
    steepest: float,
    slopes: NDArray[Any],
    at: NDArray[Any],
    colors: NDArray[Any],
) -> None:
    """Grey levels at slopes (h, w, 2), and how they change with both, into ``colors`` (3, n, 3).

    At the pixels of these numbers (n,), linearly between the nodes of ``grid``.
    """
    height, width = slopes.shape[:2]
    m = grid.shape[2]
    per_slope = (m - 1) / (2.0 * steepest)
    near = np.empty(12, np.float32)
    for n in range(len(at)):
        r, k = at[n] // width, at[n] % width
        # Just below the last node, so that there always is a next one.
        x = min(max((slopes[r, k, 0] + steepest) * per_slope, 0.0), m - 1.001)
        y = min(max((slopes[r, k, 1] + steepest) * per_slope, 0.0), m - 1.001)
        i, j = int(y), int(x)
        _corners(grid, ((r + 0.5) / height, (k + 0.5) / width), (i, j), near)
        fy, fx = y - i, x - j
        for c in range(3):
            upper = near[c] + fx * (near[3 + c] - near[c])
            lower = near[6 + c] + fx * (near[9 + c] - near[6 + c])
            colors[0, n, c] = upper + fy * (lower - upper)
            by_x = (1.0 - fy) * (near[3 + c] - near[c]) + fy * (near[9 + c] - near[6 + c])
            colors[1, n, c], colors[2, n, c] = by_x * per_slope, (lower - upper) * per_slope


@njit(cache=True, nogil=True, error_model="numpy")
def _without_contact(
    seen: NDArray[Any],
    light: NDArray[Any],
    half_mm: float,
    slopes: NDArray[Any],
    depth_mm: NDArray[Any],
    bare: NDArray[Any],
) -> NDArray[Any]:
    """Grey levels (h, w, 3) less those of ``ImageModel.contact_light`` where it is not ``bare``."""
    height, width = seen.shape[:2]
    result = seen.copy()
    for r in range(height):
        for k in range(width):
            depth = depth_mm[r, k]
            if depth > 0 and not bare[r, k]:
                x, y = slopes[r, k, 0], slopes[r, k, 1]
                share = depth / (depth + half_mm)
                tilt = share / math.sqrt(1.0 + x * x + y * y)
                of = light[r, k]
                for c in range(3):
                    result[r, k, c] -= share * of[0, c] + tilt * (x * of[1, c] + y * of[2, c])
    return result


@njit(cache=True, nogil=True)
def _differs(one: NDArray[Any], other: NDArray[Any]) -> NDArray[Any]:
    """Where (h, w) two pictures (h, w, 3) differ."""
    height, width = one.shape[:2]
    result = np.empty((height, width), np.bool_)
    for r in range(height):
        for k in range(width):
            result[r, k] = (
                one[r, k, 0] != other[r, k, 0]
                or one[r, k, 1] != other[r, k, 1]
                or one[r, k, 2] != other[r, k, 2]
            )
    return result


@njit(cache=True, nogil=True, error_model="numpy")
def _search(
    grid: NDArray[Any],
    lattice: tuple[NDArray[Any], ...],
    wanted: tuple[float, float, float],
    least_grey2: float,
    tile: tuple[int, int],
) -> int:
    """Index in the grid's (m, m) of the slopes that the ``wanted`` colour is nearest to.

    Of those of the eight nearest cells of the tile, by the colours at the tile's middle;
    −1 where none is nearer than ``least_grey2``.
    """
    cells, corners, per_grey, flat_grey2 = lattice
    n, (p, q) = cells.shape[2], tile
    colors, of_cells, prices = grid.reshape(-1), cells.reshape(-1), flat_grey2
    first = (int(corners[p, q, 3]) * grid.shape[1] + int(corners[p, q, 4])) * len(flat_grey2)
    red, green, blue = np.float32(wanted[0]), np.float32(wanted[1]), np.float32(wanted[2])
    a = int((red - corners[p, q, 0]) * per_grey[p, q, 0] - 0.5)
    b = int((green - corners[p, q, 1]) * per_grey[p, q, 1] - 0.5)
    c = int((blue - corners[p, q, 2]) * per_grey[p, q, 2] - 0.5)
    of_tile, found, least = (p * cells.shape[1] + q) * n, -1, np.float32(least_grey2)
    for i in range(a, a + 2):
        of_red = (of_tile + min(max(i, 0), n - 1)) * n
        for j in range(b, b + 2):
            of_green = (of_red + min(max(j, 0), n - 1)) * n
            for k in range(c, c + 2):
                at = of_cells[np.uint64(of_green + min(max(k, 0), n - 1))]
                at_color = np.uint64(3 * (first + at))
                away = (red - colors[at_color]) ** 2
                away += (green - colors[at_color + np.uint64(1)]) ** 2
                away += (blue - colors[at_color + np.uint64(2)]) ** 2
                away += prices[np.uint64(at)]
                if away < least:
                    found, least = int(at), away
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _find(
    grid: NDArray[Any],
    steepest: float,
    lattice: tuple[NDArray[Any], ...],
    tile_px: int,
    near_rest: NDArray[Any],
    rest: NDArray[Any],
    rest_colors: NDArray[Any],
    change: NDArray[Any],
    asked: NDArray[Any],
    slopes: NDArray[Any],
    is_guessed: bool,
) -> None:
    """Write the ``slopes`` (h, w, 2) of a ``change`` from the colours at rest where ``asked``.

    Where they hold a guess that leads to the colour, it is not looked for in the ``lattice``. Where
    the gel at rest explains a colour as well as the ``lattice``'s slopes, or nearly all of it, the
    first guess is rest. Next to that ``near_rest`` gives the slopes, and no more is asked.
    Tile by tile, whose colours stay at hand.
    """
    height, width = slopes.shape[:2]
    last_row, last_column = lattice[1].shape[0] - 1, lattice[1].shape[1] - 1
    near, m = np.empty(12, np.float32), grid.shape[2]
    node = 2.0 * steepest / (m - 1)
    across = -(-width // BLOCK_PX)
    for block in range(across * -(-height // BLOCK_PX)):
        top, left = block // across * BLOCK_PX, block % across * BLOCK_PX
        tile = min(top // tile_px, last_row), min(left // tile_px, last_column)
        for r in range(top, min(top + BLOCK_PX, height)):
            for k in range(left, min(left + BLOCK_PX, width)):
                if not asked[r, k]:
                    continue
                at_rest = rest[r, k, 0], rest[r, k, 1]
                start, is_found = at_rest, False
                one, two, three = change[r, k, 0], change[r, k, 1], change[r, k, 2]
                by_rest = rest_colors[r, k]
                color = one + by_rest[0], two + by_rest[1], three + by_rest[2]
                place = (r + 0.5) / height, (k + 0.5) / width
                square = one * one + two * two + three * three
                if square > LEAST_CHANGE_GREY**2 and is_guessed:
                    guess = slopes[r, k, 0], slopes[r, k, 1]
                    start, off = _refined(grid, steepest, place, color, at_rest, guess, near)
                    is_found = off < MOST_OFF_GREY**2
                if square > LEAST_CHANGE_GREY**2 and not is_found:
                    start = at_rest
                    at = _search(grid, lattice, color, square, tile)
                    if at >= 0:
                        start = (at % m) * node - steepest, (at // m) * node - steepest
                elif not is_found:
                    i, j = 0, 0
                    for _ in range(2):
                        by = near_rest[r, k, i, j]
                        x = by[0, 0] * one + by[0, 1] * two + by[0, 2] * three
                        y = by[1, 0] * one + by[1, 1] * two + by[1, 2] * three
                        if (x < 0) == i and (y < 0) == j:
                            break
                        i, j = int(x < 0), int(y < 0)
                    is_found = max(abs(x), abs(y)) < node
                    start = at_rest[0] + x * is_found, at_rest[1] + y * is_found
                if not is_found:
                    start, _ = _refined(grid, steepest, place, color, at_rest, start, near)
                slopes[r, k, 0], slopes[r, k, 1] = start


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def _refined(
    grid: NDArray[Any],
    steepest: float,
    place: tuple[float, float],
    wanted: tuple[float, float, float],
    rest: tuple[float, float],
    start: tuple[float, float],
    near: NDArray[Any],
) -> tuple[tuple[float, float], float]:
    """Slopes by Gauss–Newton steps from ``start`` towards a ``wanted`` colour, and what is left.

    On the squared difference of colours, with a weak prior for the slopes at ``rest``; ``near``
    (12,) is room for colours.
    """
    m = grid.shape[2]
    per_slope = (m - 1) / (2.0 * steepest)
    prior, half = np.float32(SLOPE_PRIOR_GREY**2 / per_slope**2), np.float32(0.5 * (m - 1))
    rest_x, rest_y = np.float32(rest[0] * per_slope), np.float32(rest[1] * per_slope)
    x, y = np.float32(start[0] * per_slope), np.float32(start[1] * per_slope)
    last, longest, one = np.float32(m - 1.001), np.float32(LONGEST_STEP_NODES), np.float32(1.0)
    before_i, before_j, left = -1, -1, np.float32(0.0)
    for _ in range(REFINEMENTS):
        # In nodes from here on; just below the last one, so that there always is a next.
        u, v = min(x + half, last), min(y + half, last)
        i, j = int(v), int(u)
        if i != before_i or j != before_j:
            _corners(grid, place, (i, j), near)
            before_i, before_j = i, j
        fy, fx = np.float32(v - i), np.float32(u - j)
        xx, yy, xy, square = prior, prior, np.float32(0.0), np.float32(0.0)
        bx, by = prior * (rest_x - x), prior * (rest_y - y)
        for c in range(np.uint64(3)):
            first, second = near[c], near[c + np.uint64(3)]
            third, fourth = near[c + np.uint64(6)], near[c + np.uint64(9)]
            upper = first + fx * (second - first)
            by_y = third + fx * (fourth - third) - upper
            by_x = (one - fy) * (second - first) + fy * (fourth - third)
            off = np.float32(wanted[c]) - upper - fy * by_y
            xx += by_x * by_x
            yy += by_y * by_y
            xy += by_x * by_y
            square += off * off
            bx += by_x * off
            by += by_y * off
        per = one / (xx * yy - xy * xy)
        step_x = min(max((yy * bx - xy * by) * per, -longest), longest)
        step_y = min(max((xx * by - xy * bx) * per, -longest), longest)
        x, y, left = x + step_x, y + step_y, square - step_x * bx - step_y * by
        x, y = min(max(x, -half), half), min(max(y, -half), half)
        # Colours are nearly linear between four nodes: in there one step is enough.
        if int(y + half) == i and int(x + half) == j:
            break
    return (x / per_slope, y / per_slope), float(left)


def _cartesian(model: ImageModel, steepest: float) -> NDArray[np.float32]:
    """Grey levels (rows, columns, m, m, 3) that slopes (∂h/∂y, ∂h/∂x) on a square grid add at
    nodes of position, evenly from edge to edge of the image.
    """
    axis = np.linspace(-steepest, steepest, GRID_NODES)
    slope_y, slope_x = np.meshgrid(axis, axis, indexing="ij")
    grid = np.asarray(model.slope_colors(slope_x, slope_y), np.float32)
    return np.ascontiguousarray(grid.transpose(2, 3, 0, 1, 4))


class _Lattice:
    """The slopes of colours in the tiles of a picture, made where a picture asks for them.

    ``arrays`` are cells (rows, columns, n, n, n) of colour, which hold the index in the grid's
    (m, m) of the slopes whose colour at the middle of the tile is nearest; the corner of the first
    cell (rows, columns, 5) with the middle's row and column in the grid; cells a grey level
    (rows, columns, 3); the price (m · m,) of a slope's steepness.
    """

    def __init__(
        self, grid: NDArray[np.float32], steepest: float, shape_px: tuple[int, int]
    ) -> None:
        size = -(-shape_px[0] // TILE_PX), -(-shape_px[1] // TILE_PX)
        axis = np.linspace(-steepest, steepest, GRID_NODES)
        steepness = np.hypot(axis[:, None], axis[None, :]).ravel()
        self._grid, self._shape = grid, shape_px
        self._nodes = np.flatnonzero(steepness <= steepest)
        self._is_made = np.zeros(size, np.bool_)
        prices = ((SEARCH_PRIOR_GREY * steepness) ** 2).astype(np.float32)
        cells = np.empty((*size, *[LATTICE_CELLS] * 3), np.int16)
        self.arrays = cells, np.empty((*size, 5)), np.empty((*size, 3)), prices

    def make(self, change: FloatArray, tile_px: int) -> None:
        """Make the tiles in which a change of grey levels (h, w, 3) is to be explained."""
        asked = np.zeros_like(self._is_made)
        _tiles_of_change(change, tile_px, asked)
        for p, q in np.argwhere(asked & ~self._is_made).tolist():
            self._make(p, q)
            self._is_made[p, q] = True

    def _make(self, p: int, q: int) -> None:
        cells, corners, per_grey, prices = self.arrays
        first_px = np.array([p, q]) * TILE_PX
        ends = np.minimum(first_px + TILE_PX, self._shape)
        middle = (first_px + ends) / 2 / np.array(self._shape)
        row, column = np.rint(middle * (np.array(self._grid.shape[:2]) - 1)).astype(int).tolist()
        colors = self._grid[row, column].reshape(-1, 3)[self._nodes].astype(np.float64)
        first = colors.min(axis=0) - LATTICE_MARGIN_GREY
        width = (colors.max(axis=0) + LATTICE_MARGIN_GREY - first) / LATTICE_CELLS
        corners[p, q], per_grey[p, q] = (*first, row, column), 1.0 / width
        _fill(cells[p, q], colors - first, width, prices[self._nodes], self._nodes)


@njit(cache=True, nogil=True)
def _tiles_of_change(change: NDArray[Any], tile_px: int, asked: NDArray[Any]) -> None:
    """Mark the tiles (rows, columns) in which a change (h, w, 3) is more than nearly none."""
    rows, columns = asked.shape
    for r in range(change.shape[0]):
        p = min(r // tile_px, rows - 1)
        for k in range(change.shape[1]):
            one, two, three = change[r, k, 0], change[r, k, 1], change[r, k, 2]
            if one * one + two * two + three * three > LEAST_CHANGE_GREY**2:
                asked[p, min(k // tile_px, columns - 1)] = True


@njit(cache=True, nogil=True)
def _fill(
    cells: NDArray[Any],
    colors: NDArray[Any],
    width: NDArray[Any],
    flat_grey2: NDArray[Any],
    nodes: NDArray[Any],
) -> None:
    """Write into ``cells`` (n, n, n) the one of ``nodes`` (N,) nearest in ``colors`` (N, 3).

    Each node starts in its cell; sweeps to and fro hand the nearest one on to the next cells.
    """
    n = cells.shape[0]
    owner, far = np.full((n, n, n), -1, np.int32), np.full((n, n, n), np.inf)
    for k in range(len(nodes)):
        a, b, c = int(colors[k, 0] / width[0]), int(colors[k, 1] / width[1]), 0
        c = int(colors[k, 2] / width[2])
        away = flat_grey2[k] + _apart((a, b, c), width, colors[k])
        if away < far[a, b, c]:
            far[a, b, c], owner[a, b, c] = away, k
    for turn in range(4 * n**3):
        sweep, at = turn // n**3, turn % n**3
        step = 1 - 2 * (sweep % 2)
        at = at if step > 0 else n**3 - 1 - at
        a, b, c = at // (n * n), at // n % n, at % n
        before = np.int32(-1)
        for which in range(1, 8):
            # The neighbours that were swept before, along the axes and diagonals.
            i, j, k = a - which % 2 * step, b - which // 2 % 2 * step, c - which // 4 * step
            if min(i, j, k) < 0 or max(i, j, k) >= n:
                continue
            node = owner[i, j, k]
            if node < 0 or node == owner[a, b, c] or node == before:
                continue
            before = node
            away = flat_grey2[node] + _apart((a, b, c), width, colors[node])
            if away < far[a, b, c]:
                far[a, b, c], owner[a, b, c] = away, node
    for at in range(n**3):
        cells.flat[at] = nodes[owner.flat[at]]


@njit(cache=True, nogil=True)
def _apart(cell: tuple[int, int, int], width: NDArray[Any], color: NDArray[Any]) -> float:
    """Squared distance of a colour (3,) from the middle of a cell."""
    a, b, c = (
        (cell[0] + 0.5) * width[0] - color[0],
        (cell[1] + 0.5) * width[1] - color[1],
        (cell[2] + 0.5) * width[2] - color[2],
    )
    return float(a * a + b * b + c * c)

"""From a picture back to the gel's shape: the lookup table inverted, then Poisson's equation.

The table says what grey levels a slope has at a place; here each pixel's grey levels say its
slope. What the background picture says is subtracted, so that the gel at rest, dome or not, is
flat in the result.
"""

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn, idctn
from scipy.ndimage import binary_dilation, distance_transform_edt, gaussian_filter, label, maximum
from scipy.spatial import cKDTree

from tacgen.core.compiled import njit
from tacgen.core.errors import TableError
from tacgen.core.types import BoolArray, FloatArray
from tacgen.optics.drift import Drift, drift_of
from tacgen.optics.same_view import SAME_VIEW, other_view
from tacgen.optics.table import LookupTable

Tile = tuple[tuple[int, int], tuple[int, int]]
"""Bounds: (top, bottom), (left, right)."""

MAX_WIDTH_PX = 320
"""Pictures are averaged down to about this width: a shape needs no more, and noise goes."""
TILE_PX = 32
"""Over so few pixels the table's dependence on place is a small correction to a first guess."""
GRID_NODES = 101  # slopes a side: steps of 0.06, refined afterwards
STEEPEST_RAD = 1.25  # of the slopes searched; tables seldom reach further
LONGEST_STEP_NODES = 2.0
"""Longest step of Gauss–Newton, in nodes of the slope grid: so far colour is nearly linear."""
SLOPE_PRIOR_GREY = 0.3
"""Grey levels that a slope of 1 has to be worth: of two slopes alike in colour, the one nearer to
the gel at rest. More flattens steep walls, by 1 % of a deep press's volume at 1 grey level."""
SEARCH_PRIOR_GREY = 3.0
"""The same in the first search, whose colours are those of the middle of a tile: without it some
pixels start at a steep slope of like colour, and stay there."""
MOST_CHANGE_GREY = 12.0  # of half of all pixels, without drift: less than between two sensors
FAINTEST_GAIN = 0.2  # of a background that still is of the table's gel
MOST_UNLIKE_GREY = 4.0  # of two gels of one sensor it is 1, of two sensors 5 to 30
MOST_OFFSET_GREY = 20.0  # of a background beside its gain: as another gamma by a sixth makes
MOST_GAIN = 0.3  # lamps drift by some 5 % in a session
MOST_AT_STEEPEST = 0.01
"""Share of a contact's pixels at the table's steepest slope: up to it balls, edges and cylinders
were read within 5 %, beyond it deep flat punches up to 50 % too shallow."""
AT_STEEPEST = 0.97  # of the steepest slope: a step of the search grid below it
LEAST_CHANGE_GREY = (
    1.0  # over the three colours: what changes less is nearly at rest, and starts there
)
REFINEMENTS = 3  # of each slope between the grid's nodes
CONTACT_PASSES = 3
"""Slopes, depth and what a contact of that depth adds, in turn: a ball's depth is 6 % too large
after the first and 1 % after the third, and more change nothing."""
BLUR_PX = 0.7  # lowers the camera's noise; below a contact's finest feature
STEEP_SHARE = 0.9
"""The imprint's rim is the outermost contour at least so steep as the steepest one: where a gel
keeps to an object its walls get steeper outwards, beside it the gel levels off."""
RIM_LAYERS = 0.4
"""Share of the depth inside the rim whose layers tell how the object goes on beyond it."""
RIM_BLUR_PX = 1.0  # noise makes contours long
RIM_LEVELS, RIM_WINDOW = 46, 3  # of the depth; contours so many levels up and down are compared
CONTINUED_STDERR = 0.25  # of the volume outside the rim: half of it for a cone taken for a ball
CLEAR_OF_NOISE = 4.0  # standard errors of the level; a contact is deeper
LEAST_SHARE = 0.25  # of the deepest contact's depth that another one must have: dust has less
LEAST_FIRM_PX, MOST_MISFIT, STEEPEST_SINE = 100, 0.06, 0.9
"""A ball's flank is continued beyond the table where so many pixels below it, less deep by at most
half, have normals that are off by no more from a ball's, and up to the sine of this angle, 64°:
steeper, a pixel's height exceeds its width twice over."""


@dataclass(frozen=True, slots=True)
class SunkenObject:
    """How deep an object is below the gel at rest, ``depth_mm`` (h, w), 0 where it is not.

    Where ``seen`` (h, w) the gel's surface shows it; elsewhere it is continued.
    """

    depth_mm: FloatArray
    seen: BoolArray


@dataclass(frozen=True, slots=True)
class Shape:
    """What was reconstructed from a picture.

    ``depth_mm`` (h, w) is that of the gel's surface below the gel at rest, ``level_stderr_mm`` the
    standard error of that level: how uneven the gel is that nothing touches. ``slope_stderr`` is
    the standard error of the slopes in the contact, from what the table does not explain of the
    picture; NaN where nothing is deeper than the gel at rest. ``steepest_share`` is the share of
    the contact's pixels at the steepest slope that the table holds, ``unknown_share`` that of those
    whose slope does not follow from the rest of the contact either: walls may be steeper there, and
    the depth inside them is then too small. ``light_stderr`` is the relative standard error of how
    much brighter the light is than the table's, by which slopes are off.
    """

    depth_mm: FloatArray
    mm_per_px: float
    slope_stderr: float = math.nan
    steepest_share: float = 0.0
    level_stderr_mm: float = 0.0
    unknown_share: float = 0.0
    light_stderr: float = 0.0

    @property
    def is_lower_bound(self) -> bool:
        """Whether depth and volume are at least so large, behind walls too steep for the table."""
        return self.unknown_share > MOST_AT_STEEPEST

    def imprint(self, least_mm: float = 0.0) -> SunkenObject:
        """The object's imprint, of contacts deeper than ``least_mm`` and than the level's error.

        The gel sinks around a contact without touching the object. So the surface is taken as it is
        inside the contact's rim; from there to the level of the gel at rest the object's
        cross-section, which for a ball grows by the same area with every layer, is continued.
        """
        surface = np.maximum(self.depth_mm, 0.0)
        least_mm = max(least_mm, CLEAR_OF_NOISE * self.level_stderr_mm)
        depth, seen = np.zeros_like(surface), np.zeros(surface.shape, dtype=np.bool_)
        patches, count = label(surface > least_mm)
        deepest = np.asarray(maximum(surface, patches, range(1, count + 1)))
        clear = max(least_mm, LEAST_SHARE * float(surface.max()))
        for patch in np.flatnonzero(deepest > clear) + 1:
            one = _continued(surface, patches == patch, least_mm)
            np.maximum(depth, one.depth_mm, out=depth)
            seen |= one.seen
        return SunkenObject(depth, seen)

    @property
    def volume_mm3(self) -> float:
        """Volume that the object fills below the gel at rest."""
        return float(self.imprint().depth_mm.sum()) * self.mm_per_px**2

    def volume_stderr_mm3(self, imprint: SunkenObject | None = None) -> float:
        """Standard error of an imprint's volume.

        What the table does not explain is alike over a contact: slopes, and with them the volume,
        are off by the same share everywhere. The level of the gel at rest, and how the object goes
        on outside the rim, add theirs.
        """
        imprint = imprint or self.imprint()
        touched = imprint.depth_mm > 0
        if not touched.any():
            return 0.0
        pixel_mm2 = self.mm_per_px**2
        gy, gx = np.gradient(self.depth_mm, self.mm_per_px)
        steepness = math.sqrt(float(np.square([gx, gy])[:, touched].sum(axis=0).mean()))
        volume = float(imprint.depth_mm.sum()) * pixel_mm2
        parts = (
            volume * self.slope_stderr / max(steepness, self.slope_stderr),
            volume * self.light_stderr,
            float(touched.sum()) * pixel_mm2 * self.level_stderr_mm,
            CONTINUED_STDERR * float(imprint.depth_mm[~imprint.seen].sum()) * pixel_mm2,
        )
        return math.hypot(*parts)


class Reconstructor:
    """Inverts a table; made ready once for all pictures of a sensor.

    ``background`` (H, W, 3) is the RGB picture of the gel at rest, taken with the presses, and
    ``dome_radius_mm`` the gel's radius of curvature; 0: flat.

    Raises ``TableError`` if the background shows the gel turned, shifted or in another order of
    colours than the table's own.
    """

    def __init__(
        self, table: LookupTable, background: NDArray[np.uint8], dome_radius_mm: float = 0.0
    ) -> None:
        height, width = background.shape[:2]
        self._background = background
        self._table = table
        self._step = max(1, round(width / MAX_WIDTH_PX))
        self._shape = height // self._step, width // self._step
        self.mm_per_px = table.mm_per_px * self._step
        self._seen = _averaged(background.astype(np.float32), self._step, self._shape)
        self.steepest = float(np.tan(min(table.max_slope_rad, STEEPEST_RAD)))
        self._grid = _cartesian(table, self.steepest)
        self._rest = _rest_slopes(self._shape, self.mm_per_px, dome_radius_mm)
        self._rest_colors = self._colors_at(self._rest)[0]
        # The gel at rest as the table renders it: on a dome, its own background is another picture.
        dome = cv2.resize(self._rest_colors.astype(np.float32), (width, height))
        at_rest = table.background + dome
        _check_view(background, at_rest, "the background", "the table's")
        rest = _averaged(at_rest.astype(np.float32), self._step, self._shape)
        light = drift_of(self._seen - rest, rest, np.ones(self._shape), falls_outwards=True)
        # Over the background's contrast alone an offset looks like another gamma.
        offset = np.abs(light.offset).mean() / rest.mean()
        self._gain, self._gain_stderr = light.gain, np.hypot(light.gain_stderr, offset)
        brightness = _brightness(light)
        if brightness.min() < FAINTEST_GAIN:
            msg = (
                f"the background does not match the table's: it is {_gains(light)}: it is black, "
                "overexposed or of another sensor; take it anew, or calibrate this sensor"
            )
            raise TableError(msg)
        self.doubts = _doubts(light, self._step)
        height, width = self._shape
        tiles = [
            ((top, min(top + TILE_PX, height)), (left, min(left + TILE_PX, width)))
            for top in range(0, height, TILE_PX)
            for left in range(0, width, TILE_PX)
        ]
        self._trees = {tile: self._tree_of(tile) for tile in tiles}

    def shape_of(self, rgb: NDArray[np.uint8], hidden: NDArray[np.bool_] | None = None) -> Shape:
        """Depth of one picture (H, W, 3); ``hidden`` (H, W) marks pixels that show no gel.

        Raises ``TableError`` if it is turned, shifted or coloured otherwise than the background.
        """
        _check_view(rgb, self._background, "the image", "the background")
        change = _averaged(rgb.astype(np.float32), self._step, self._shape) - self._seen
        known = np.ones(self._shape, dtype=np.float32)
        if hidden is not None:
            covered = _averaged(hidden.astype(np.float32), self._step, self._shape)
            known = (covered < 0.25).astype(np.float32)
        drift = drift_of(change, self._seen, known)
        change = change - drift.added
        half = float(np.median(np.abs(change).max(axis=2)))
        if half > MOST_CHANGE_GREY or np.any(np.abs(_brightness(drift) - 1.0) > MOST_GAIN):
            msg = (
                f"the image does not match the background: it is {_gains(drift)} and half of it "
                f"differs by {half:.0f} grey levels more: it is of another sensor or light; take "
                "the background in the same session as the image"
            )
            raise TableError(msg)
        change = change / (drift.gain * self._gain)
        seen = gaussian_filter(_filled(change, known), (BLUR_PX, BLUR_PX, 0.0))
        change = seen
        bare = drift.bare if drift.bare.any() else known > 0
        before = None
        for _ in range(CONTACT_PASSES if self._table.image_model.sees_depth else 1):
            found = self._slopes_of(change, before)
            before = change, found
            depth = self._depth_of(found, known, bare)
            # On bare gel an error of the level would become light, slopes and a larger error.
            change = seen - self._contact_light(found, np.where(drift.bare, 0.0, depth))
        contact = (depth > 0.1 * depth.max()) & (known > 0)
        stderr = self._slope_stderr(found, change, contact)
        steep = contact & (np.hypot(*np.moveaxis(found, -1, 0)) >= AT_STEEPEST * self.steepest)
        share = unknown_share = float(steep.sum() / max(contact.sum(), 1))
        if share > MOST_AT_STEEPEST:
            found, unknown = self._with_flanks(found, depth, steep)
            depth = self._depth_of(found, known, bare)
            unknown_share = float(unknown.sum() / contact.sum())
        level = float(np.sqrt(np.mean(depth[_upper(-depth, bare)] ** 2)))
        light = float(self._gain_stderr[contact].mean()) if contact.any() else 0.0
        return Shape(depth, self.mm_per_px, stderr, share, level, unknown_share, light)

    def _depth_of(self, slopes: FloatArray, known: FloatArray, bare: BoolArray) -> FloatArray:
        """Depth (h, w), mm, of the surface of these slopes (h, w, 2) below the ``bare`` gel."""
        bent = _filled(slopes - self._rest, known)
        surface = integrate(bent[..., 0], bent[..., 1], self.mm_per_px)
        return np.asarray(np.median(surface[_upper(surface, bare)]) - surface)

    def _with_flanks(
        self, slopes: FloatArray, depth: FloatArray, steep: BoolArray
    ) -> tuple[FloatArray, BoolArray]:
        """Slopes, steeper than the table where the contact's bottom is a ball's, and where unknown.

        The tangential parts of a ball's unit normals are linear in place: fitted to the bottom,
        they tell the slope of the flanks, whose direction the table still sees.
        """
        firm = (depth > 0.5 * depth.max()) & ~binary_dilation(steep, iterations=2)
        if firm.sum() < LEAST_FIRM_PX:
            return slopes, steep
        normals = slopes / np.sqrt(1.0 + (slopes**2).sum(axis=-1, keepdims=True))
        rows, columns = np.indices(steep.shape)
        places = np.stack([columns, rows, np.ones_like(rows)], axis=-1).astype(float)
        fit, *_ = np.linalg.lstsq(places[firm], normals[firm], rcond=None)
        off = places[firm] @ fit - normals[firm]
        if (off**2).sum(axis=-1).mean() > MOST_MISFIT**2:
            return slopes, steep
        sine = np.hypot(*(places[steep] @ fit).T)
        least = math.sin(math.atan(AT_STEEPEST * self.steepest))
        unknown = steep.copy()
        unknown[steep] = (sine < least) | (sine > STEEPEST_SINE)
        steeper = np.tan(np.arcsin(np.clip(sine, least, STEEPEST_SINE)))
        slopes = slopes.copy()
        now = np.hypot(*slopes[steep].T)
        slopes[steep] *= np.where(unknown[steep], 1.0, np.maximum(steeper / now, 1.0))[:, None]
        return slopes, unknown

    def _contact_light(self, slopes: FloatArray, depth_mm: FloatArray) -> FloatArray:
        """Grey levels (h, w, 3) that a contact of these slopes and depths adds."""
        height, width = self._shape
        rows, columns = np.nonzero(depth_mm > 0)
        u, v = (columns + 0.5) / width - 0.5, (rows + 0.5) / height - 0.5
        pressed = slopes[rows, columns]
        added = np.zeros((height, width, 3))
        added[rows, columns] = self._table.image_model.contact_colors(
            pressed[:, 0], pressed[:, 1], depth_mm[rows, columns], u, v
        )
        return added

    def _slope_stderr(self, slopes: FloatArray, change: FloatArray, where: BoolArray) -> float:
        """Standard error of the slopes in a region.

        Three grey levels less two slopes leave one residual a pixel; its mean square is taken as
        the variance of each grey level, and (JᵀJ)⁻¹ makes it one of the slopes.
        """
        if not where.any():
            return math.nan
        here, by_x, by_y = (part[where] for part in self._colors_at(slopes))
        variance = (((change + self._rest_colors)[where] - here) ** 2).sum(axis=-1).mean()
        xx, yy, xy = (by_x**2).sum(-1), (by_y**2).sum(-1), (by_x * by_y).sum(-1)
        spread = (xx + yy) / np.maximum(xx * yy - xy**2, 1e-9)
        return float(np.sqrt(0.5 * variance * np.median(spread)))

    def _slopes_of(
        self, change: FloatArray, before: tuple[FloatArray, FloatArray] | None = None
    ) -> FloatArray:
        """(h, w, 2) slopes that explain a change of grey levels from the gel at rest.

        ``before`` are another change and its slopes, which stay where the change is the same.
        """
        asked = np.ones(self._shape, dtype=np.bool_)
        slopes = self._rest.copy()
        if before is not None:
            asked, slopes = (before[0] != change).any(axis=-1), before[1].copy()
        wanted = change + self._rest_colors
        self._search(change, wanted, asked, slopes)
        _refine(self._grid, self.steepest, wanted, self._rest, asked, slopes)
        return slopes

    def _search(
        self, change: FloatArray, wanted: FloatArray, asked: BoolArray, slopes: FloatArray
    ) -> None:
        """Write the slopes of the nearest colours where ``asked``, of those at a tile's middle.

        Where the gel at rest explains the colour as well, or nearly all of it, it is at rest.
        """
        slopes[asked] = self._rest[asked]
        axis = np.linspace(-self.steepest, self.steepest, self._grid.shape[0])
        square = (change**2).sum(axis=-1)
        asked = asked & (square > LEAST_CHANGE_GREY**2)
        for ((top, bottom), (left, right)), (tree, nodes) in self._trees.items():
            where = slice(top, bottom), slice(left, right)
            here = asked[where]
            colors = wanted[where][here]
            far, nearest = tree.query(np.column_stack([colors, np.zeros(len(colors))]))
            found = np.stack([axis[nodes[nearest, 1]], axis[nodes[nearest, 0]]], axis=-1)
            is_rest = square[where][here] <= far**2
            found[is_rest] = slopes[where][here][is_rest]
            slopes[where][here] = found

    def _colors_at(self, slopes: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Grey levels (h, w, 3) that the table adds at slopes (h, w, 2), and how they change
        with ∂h/∂x and with ∂h/∂y.
        """
        colors = np.empty((3, *self._shape, 3))
        _interpolate(self._grid, self.steepest, slopes, colors)
        return colors[0], colors[1], colors[2]

    def _tree_of(self, tile: Tile) -> tuple[cKDTree, NDArray[np.integer]]:
        """Colours of the slopes at the middle of a tile, searchable; and the slopes' indices."""
        (top, bottom), (left, right) = tile
        middle = np.array([top + bottom, left + right]) / 2 / np.array(self._shape)
        row, column = np.rint(middle * (np.array(self._grid.shape[2:4]) - 1)).astype(int)
        axis = np.linspace(-self.steepest, self.steepest, self._grid.shape[0])
        steepness = np.hypot(axis[:, None], axis[None, :])
        nodes = np.argwhere(steepness <= self.steepest)
        colors = self._grid[nodes[:, 0], nodes[:, 1], row, column]
        flatness = SEARCH_PRIOR_GREY * steepness[nodes[:, 0], nodes[:, 1]]
        return cKDTree(np.column_stack([colors, flatness])), nodes


def _continued(surface: FloatArray, patch: BoolArray, least_mm: float) -> SunkenObject:
    """A surface (h, w) as it is inside the rim of a contact, continued to level 0 outside.

    ``patch`` (h, w) is what of the contact is deeper than ``least_mm``.
    """
    deepest = float(surface[patch].max())
    rim = _rim_mm(np.where(patch, surface, least_mm), least_mm)
    inside = patch & (surface > rim)
    depth = np.where(inside, surface, 0.0)
    layers = rim + np.linspace(0.0, RIM_LAYERS, 12) * (deepest - rim)
    pixels = (surface[inside][:, None] > layers).sum(axis=0)
    growth = max(-float(np.polyfit(layers, pixels, 1)[0]), 0.0)
    outside = np.flatnonzero(~inside)
    beyond = min(round(growth * rim), len(outside))
    if beyond:
        distance = distance_transform_edt(~inside).ravel()[outside]
        nearest = outside[np.argsort(distance, kind="stable")[:beyond]]
        depth.flat[nearest] = rim * (1.0 - (np.arange(beyond) + 0.5) / (growth * rim))
    return SunkenObject(depth, np.asarray(inside))


def _rim_mm(surface: FloatArray, least_mm: float) -> float:
    """Level of the outermost contour of a contact about as steep as its steepest one, mm.

    By the co-area formula the area between two contours is their length times the mean of
    1/steepness; both are counted in pixels.
    """
    smooth = gaussian_filter(surface, RIM_BLUR_PX)
    levels = np.linspace(least_mm, float(smooth.max()), RIM_LEVELS)[:-1]
    step = levels[1] - levels[0]
    area = _above(smooth.ravel(), levels)
    neighbours = [(smooth[1:], smooth[:-1]), (smooth[:, 1:], smooth[:, :-1])]
    crossed = [
        _above(np.maximum(a, b).ravel(), levels) - _above(np.minimum(a, b).ravel(), levels)
        for a, b in neighbours
    ]
    length = np.pi / 4 * np.sum(crossed, axis=0)  # Cauchy–Crofton, for contours of all directions
    wide = RIM_WINDOW
    between = (area[: -2 * wide] - area[2 * wide :]) / (2 * wide * step)
    flatness = between / np.maximum(length[wide:-wide], 1.0)
    steep = np.flatnonzero(flatness <= flatness.min() / STEEP_SHARE)
    return float(levels[wide + steep[0]])


def _above(values: FloatArray, levels: FloatArray) -> FloatArray:
    """How many values exceed each level (n,), in increasing order."""
    return np.asarray(len(values) - np.searchsorted(np.sort(values), levels, side="right"), float)


@njit(cache=True, nogil=True)
def _color_at(
    grid: NDArray[Any], steepest: float, place: tuple[float, float], x: float, y: float, to: Any
) -> None:
    """Linear interpolation of ``grid`` (see ``_cartesian``) at a place, in shares of the picture's
    height and width, and at slopes x and y; into ``to`` (3, 3) go the grey levels and their
    derivatives by both slopes.
    """
    m, n_rows, n_columns = grid.shape[0], grid.shape[2], grid.shape[3]
    per_slope = (m - 1) / (2.0 * steepest)
    v, u = place[0] * (n_rows - 1), place[1] * (n_columns - 1)
    row, column = min(int(v), n_rows - 2), min(int(u), n_columns - 2)
    down, across = v - row, u - column
    # Just below the last node, so that there always is a next one.
    x = min(max((x + steepest) * per_slope, 0.0), m - 1.001)
    y = min(max((y + steepest) * per_slope, 0.0), m - 1.001)
    i, j = int(y), int(x)
    fy, fx = y - i, x - j
    upper_left = upper_right = lower_left = lower_right = 0.0
    for c in range(3):
        for which in range(4):
            p, q = i + which // 2, j + which % 2
            top = grid[p, q, row, column, c]
            top += across * (grid[p, q, row, column + 1, c] - top)
            low = grid[p, q, row + 1, column, c]
            low += across * (grid[p, q, row + 1, column + 1, c] - low)
            value = top + down * (low - top)
            if which == 0:
                upper_left = value
            elif which == 1:
                upper_right = value
            elif which == 2:
                lower_left = value
            else:
                lower_right = value
        left = upper_left + fy * (lower_left - upper_left)
        right = upper_right + fy * (lower_right - upper_right)
        upper = upper_left + fx * (upper_right - upper_left)
        lower = lower_left + fx * (lower_right - lower_left)
        to[0, c] = left + fx * (right - left)
        to[1, c] = (right - left) * per_slope
        to[2, c] = (lower - upper) * per_slope


@njit(cache=True, nogil=True)
def _interpolate(
    grid: NDArray[Any], steepest: float, slopes: NDArray[Any], colors: NDArray[Any]
) -> None:
    """``_color_at`` slopes (h, w, 2), each at its place, into ``colors`` (3, h, w, 3)."""
    height, width = slopes.shape[:2]
    for r in range(height):
        for k in range(width):
            place = (r + 0.5) / height, (k + 0.5) / width
            _color_at(grid, steepest, place, slopes[r, k, 0], slopes[r, k, 1], colors[:, r, k])


@njit(cache=True, nogil=True)
def _refine(
    grid: NDArray[Any],
    steepest: float,
    wanted: NDArray[Any],
    rest: NDArray[Any],
    asked: NDArray[Any],
    slopes: NDArray[Any],
) -> None:
    """Gauss–Newton steps of ``slopes`` (h, w, 2) where ``asked`` (h, w), towards ``wanted``.

    On the squared difference of colours, with a weak prior for the slopes ``rest`` (h, w, 2).
    """
    height, width = slopes.shape[:2]
    prior = SLOPE_PRIOR_GREY**2
    longest = LONGEST_STEP_NODES * 2.0 * steepest / (GRID_NODES - 1)
    to = np.empty((3, 3))
    for r in range(height):
        for k in range(width):
            if not asked[r, k]:
                continue
            place = (r + 0.5) / height, (k + 0.5) / width
            x, y = slopes[r, k]
            for _ in range(REFINEMENTS):
                _color_at(grid, steepest, place, x, y, to)
                xx, yy, xy = prior, prior, 0.0
                bx, by = prior * (rest[r, k, 0] - x), prior * (rest[r, k, 1] - y)
                for c in range(3):
                    off = wanted[r, k, c] - to[0, c]
                    xx += to[1, c] * to[1, c]
                    yy += to[2, c] * to[2, c]
                    xy += to[1, c] * to[2, c]
                    bx += to[1, c] * off
                    by += to[2, c] * off
                determinant = xx * yy - xy * xy
                step_x = (yy * bx - xy * by) / determinant
                step_y = (xx * by - xy * bx) / determinant
                x += min(max(step_x, -longest), longest)
                y += min(max(step_y, -longest), longest)
                x, y = min(max(x, -steepest), steepest), min(max(y, -steepest), steepest)
            slopes[r, k, 0], slopes[r, k, 1] = x, y


def _cartesian(table: LookupTable, steepest: float) -> NDArray[np.float32]:
    """Grey levels (m, m, rows, columns, 3) that slopes (∂h/∂y, ∂h/∂x) on a square grid add at
    nodes of position, evenly from edge to edge of the image.
    """
    axis = np.linspace(-steepest, steepest, GRID_NODES)
    slope_y, slope_x = np.meshgrid(axis, axis, indexing="ij")
    grid = table.image_model.slope_colors(slope_x, slope_y)
    return np.ascontiguousarray(grid, dtype=np.float32)


def _rest_slopes(shape_px: tuple[int, int], mm_per_px: float, dome_radius_mm: float) -> FloatArray:
    """(h, w, 2) slopes of the gel at rest: a sphere's, or 0."""
    rows, columns = np.indices(shape_px, dtype=np.float64)
    x = (columns - (shape_px[1] - 1) / 2) * mm_per_px
    y = (rows - (shape_px[0] - 1) / 2) * mm_per_px
    if dome_radius_mm <= 0:
        return np.zeros((*shape_px, 2))
    height = np.sqrt(np.maximum(dome_radius_mm**2 - x**2 - y**2, 1e-6))
    return np.stack([-x / height, -y / height], axis=-1)


def _check_view(image: NDArray[Any], rest: NDArray[Any], what: str, whose: str) -> None:
    """Raises ``TableError`` if a picture (H, W, 3) is proven to be of another view."""
    if wrong := other_view(image, rest):
        msg = f"{what} does not match {whose}: {wrong}; {SAME_VIEW}"
        raise TableError(msg)


def _brightness(light: Drift) -> FloatArray:
    """Gain of each channel (3,), its median over the picture."""
    return np.asarray(np.median(light.gain, axis=(0, 1)))


def _gains(light: Drift) -> str:
    gains = ", ".join(f"{gain:.2f}" for gain in _brightness(light))
    return f"{gains} times as bright (red, green, blue)"


def _doubts(light: Drift, step: int) -> tuple[str, ...]:
    """What is odd about a background, averaged over ``step`` px, in a light not the table's."""
    found = []
    if (imprint := light.imprint) is not None:
        odd = imprint.sentence("the table's", step)
        fix = "take it anew with nothing on the gel"
        found.append(f"{odd}: depth and force are then wrong; {fix}")
    if np.any(np.abs(_brightness(light) - 1.0) > MOST_GAIN + 0.01):
        found.append(
            f"the background is {_gains(light)} as the table's: calibrate again in this light"
        )
    if light.unlike_grey > MOST_UNLIKE_GREY:
        found.append(
            f"half of the background differs from the table's by {light.unlike_grey:.0f} grey "
            "levels beyond gain and offset: another sensor or gel; calibrate this one"
        )
    if np.abs(light.offset).max() > MOST_OFFSET_GREY:
        offsets = ", ".join(f"{offset:+.0f}" for offset in light.offset)
        found.append(
            f"beside its gain the background differs from the table's by {offsets} grey levels "
            "(red, green, blue): light from outside, or another gamma, to which the force is not "
            "corrected; take it as the presses of the table were"
        )
    return tuple(found)


def _upper(surface: FloatArray, bare: BoolArray) -> BoolArray:
    """The upper half (h, w) of what looks like bare gel: below flat faces lies none."""
    return np.asarray(bare & (surface >= np.median(surface[bare])))


def _averaged(image: FloatArray, step: int, shape_px: tuple[int, int]) -> FloatArray:
    if step == 1:
        return image
    return np.asarray(cv2.resize(image, (shape_px[1], shape_px[0]), interpolation=cv2.INTER_AREA))


def _filled(values: FloatArray, known: FloatArray) -> FloatArray:
    """Values (h, w, c) with the unknown pixels filled in from around them."""
    if known.all():
        return values
    result, sigma = np.where(known[..., None] > 0, values, 0.0), 3.0
    weight = gaussian_filter(known, sigma)
    smooth = gaussian_filter(result, (sigma, sigma, 0.0)) / np.maximum(weight, 1e-6)[..., None]
    return np.where(known[..., None] > 0, values, smooth)


def integrate(slope_x: FloatArray, slope_y: FloatArray, mm_per_px: float) -> FloatArray:
    """The surface (h, w), mm, whose slopes come nearest to the given ones; its mean is 0.

    Least squares by Poisson's equation with free edges, solved by cosine transforms.

    Source: Simchony, Chellappa & Shao 1990, Direct analytical methods for solving Poisson
    equations.
    """
    height, width = slope_x.shape
    # Slopes stand at pixels; differences between neighbours at the edges between them.
    across = 0.5 * (slope_x[:, 1:] + slope_x[:, :-1]) * mm_per_px
    down = 0.5 * (slope_y[1:] + slope_y[:-1]) * mm_per_px
    divergence = np.zeros((height, width))
    divergence[:, :-1] += across
    divergence[:, 1:] -= across
    divergence[:-1] += down
    divergence[1:] -= down
    rows = 2.0 - 2.0 * np.cos(np.pi * np.arange(height) / height)
    columns = 2.0 - 2.0 * np.cos(np.pi * np.arange(width) / width)
    eigenvalues = -(rows[:, None] + columns[None, :])
    eigenvalues[0, 0] = 1.0
    spectrum = dctn(divergence, norm="ortho") / eigenvalues
    spectrum[0, 0] = 0.0
    return np.asarray(idctn(spectrum, norm="ortho"))

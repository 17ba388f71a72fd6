"""From a picture back to the gel's shape: the lookup table inverted, then Poisson's equation.

The table says what grey levels a slope has at a place; here each pixel's grey levels say its
slope. What the background picture says is subtracted, so that the gel at rest, dome or not, is
flat in the result.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn, idctn
from scipy.ndimage import binary_dilation

from tacgen.core.compiled import njit
from tacgen.core.errors import TableError
from tacgen.core.types import BoolArray, FloatArray
from tacgen.optics.drift import Drift, drift_of
from tacgen.optics.same_view import SAME_VIEW, View
from tacgen.optics.slopes import SlopeFinder
from tacgen.optics.table import LookupTable

MAX_WIDTH_PX = 320
"""Pictures are averaged down to about this width: a shape needs no more, and noise goes."""
STEEPEST_RAD = 1.25  # of the slopes searched; tables seldom reach further
MOST_CHANGE_GREY = 12.0  # of half of all pixels, without drift: less than between two sensors
FAINTEST_GAIN = 0.2  # of a background that still is of the table's gel
MOST_UNLIKE_GREY = 4.0  # of two gels of one sensor it is 1, of two sensors 5 to 30
MOST_OFFSET_GREY = 20.0  # of a background beside its gain: as another gamma by a sixth makes
MOST_GAIN = 0.3  # lamps drift by some 5 % in a session
MOST_AT_STEEPEST = 0.01
"""Share of a contact's pixels at the table's steepest slope: up to it balls, edges and cylinders
were read within 5 %, beyond it deep flat punches up to 50 % too shallow."""
AT_STEEPEST = 0.97  # of the steepest slope: a step of the search grid below it
CONTACT_PASSES = 3
"""Slopes, depth and what a contact of that depth adds, in turn: a ball's depth is 6 % too large
after the first and 1 % after the third, and more change nothing."""
FILL_BLUR_PX = 3.0  # of what stands around dots, which fills them in
BLUR_PX = 0.7  # lowers the camera's noise; below a contact's finest feature
STEEP_SHARE = 0.9
"""The imprint's rim is the outermost contour at least so steep as the steepest one: where a gel
keeps to an object its walls get steeper outwards, beside it the gel levels off."""
LEVEL_STEP_PX, FACE_SHARE = 8, 0.5
"""Of the gel around a contact so many pixels are one; what is deeper than such a share of the
deepest, or touches no edge of the picture, is a flat face of the object, coloured as bare gel."""
TILT_HELD = 0.002
"""Of the picture's pixels, held level: bare gel that is seen in a corner alone does not tilt."""
RIM_LAYERS = 0.4
"""Share of the depth inside the rim whose layers tell how the object goes on beyond it."""
RIM_BLUR_PX, RIM_BORDER_PX = 1.0, 5  # noise makes contours long; so far the blur reaches
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
        above = (surface > least_mm).astype(np.uint8)
        count, patches, boxes, _ = cv2.connectedComponentsWithStats(above, connectivity=4)
        deepest = _deepest(surface, patches, count)
        clear = max(least_mm, LEAST_SHARE * float(surface.max()))
        for patch in np.flatnonzero(deepest > clear):
            x, y, width, height = boxes[patch, :4].tolist()
            box = slice(y, y + height), slice(x, x + width)
            one = _continued(surface, patches == patch, box, least_mm)
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
        gy, gx = (np.asarray(by) for by in np.gradient(self.depth_mm, self.mm_per_px))
        steepness = math.sqrt(float((gx[touched] ** 2 + gy[touched] ** 2).mean()))
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
        self._table = table
        self._step = max(1, round(width / MAX_WIDTH_PX))
        self._shape = height // self._step, width // self._step
        self.mm_per_px = table.mm_per_px * self._step
        self._seen = _averaged(background.astype(np.float32), self._step, self._shape)
        self.steepest = float(np.tan(min(table.max_slope_rad, STEEPEST_RAD)))
        model, size = table.image_model, self._shape
        at_rest = _rest_slopes(size, self.mm_per_px, dome_radius_mm)
        self._slopes = SlopeFinder(model, self.steepest, at_rest)
        self._coarse: SlopeFinder | None = None
        if model.sees_depth:
            half = size[0] // 2, size[1] // 2
            at_rest = _rest_slopes(half, 2.0 * self.mm_per_px, dome_radius_mm)
            self._coarse = SlopeFinder(model, self.steepest, at_rest, self._slopes)
        # The gel at rest as the table renders it: on a dome, its own background is another picture.
        dome = cv2.resize(self._slopes.rest_colors, (width, height))
        rest = _averaged((table.background + dome).astype(np.float32), self._step, self._shape)
        _check_view(self._seen, View(rest, self._step), "the background", "the table's")
        self._view = View(self._seen, self._step)
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

    def shape_of(self, rgb: NDArray[np.uint8], hidden: NDArray[np.bool_] | None = None) -> Shape:
        """Depth of one picture (H, W, 3); ``hidden`` (H, W) marks pixels that show no gel.

        Raises ``TableError`` if it is turned, shifted or coloured otherwise than the background.
        """
        picture = _averaged(rgb.astype(np.float32), self._step, self._shape)
        _check_view(picture, self._view, "the image", "the background")
        change = picture - self._seen
        known = np.ones(self._shape, dtype=np.float32)
        if hidden is not None:
            covered = _averaged(hidden.astype(np.float32), self._step, self._shape)
            known = (covered < 0.25).astype(np.float32)
        drift = drift_of(change, self._seen, known)
        change -= drift.added
        half = float(np.median(np.abs(change[::4, ::4]).max(axis=2)))
        if half > MOST_CHANGE_GREY or np.any(np.abs(_brightness(drift) - 1.0) > MOST_GAIN):
            msg = (
                f"the image does not match the background: it is {_gains(drift)} and half of it "
                f"differs by {half:.0f} grey levels more: it is of another sensor or light; take "
                "the background in the same session as the image"
            )
            raise TableError(msg)
        change /= drift.gain * self._gain
        blurred = cv2.GaussianBlur(_filled(change, known), (7, 7), BLUR_PX)
        seen: FloatArray = np.asarray(blurred, np.float32)
        bare = drift.bare if drift.bare.any() else known > 0
        of_slopes, nearly = seen, None
        if self._coarse is not None:
            nearly, deep = self._pressed(self._coarse, seen, known, drift)
            of_slopes = self._slopes.without_contact_light(seen, nearly, deep, drift.bare)
        found = self._slopes.slopes_of(of_slopes, nearly)
        depth = self._depth_of(self._slopes, found, known, bare)
        contact = (depth > 0.1 * depth.max()) & (known > 0)
        stderr = self._slopes.stderr(seen, found, np.where(drift.bare, 0.0, depth), contact)
        steepness = found[..., 0] ** 2 + found[..., 1] ** 2
        steep = contact & (steepness >= (AT_STEEPEST * self.steepest) ** 2)
        share = unknown_share = float(steep.sum() / max(contact.sum(), 1))
        if share > MOST_AT_STEEPEST:
            found, unknown = self._with_flanks(found, depth, steep)
            depth = self._depth_of(self._slopes, found, known, bare)
            unknown_share = float(unknown.sum() / contact.sum())
        some = depth[::2, ::2]
        level = float(np.sqrt(np.mean(some[_upper(-some, bare[::2, ::2])] ** 2)))
        light = float(self._gain_stderr[contact].mean()) if contact.any() else 0.0
        return Shape(depth, self.mm_per_px, stderr, share, level, unknown_share, light)

    def _pressed(
        self, coarse: SlopeFinder, seen: FloatArray, known: FloatArray, drift: Drift
    ) -> tuple[FloatArray, FloatArray]:
        """Slopes (h, w, 2) and depth (h, w), mm, of a picture, found at half its size."""
        size = coarse.rest.shape[1], coarse.rest.shape[0]
        small = np.asarray(cv2.resize(seen, size, interpolation=cv2.INTER_AREA), np.float32)
        shown = np.asarray(cv2.resize(known, size, interpolation=cv2.INTER_AREA) > 0.5, np.float32)
        off = cv2.resize(drift.bare.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
        bare = off if off.any() else shown > 0
        change, found = small, coarse.slopes_of(small)
        depth = self._depth_of(coarse, found, shown, bare)
        for _ in range(CONTACT_PASSES - 2):
            before, change = change, coarse.without_contact_light(small, found, depth, off)
            found = coarse.slopes_of(change, found, before)
            depth = self._depth_of(coarse, found, shown, bare)
        slopes, deep = (cv2.resize(part, seen.shape[1::-1]) for part in (found, depth))
        return np.asarray(slopes), np.asarray(deep)

    def _depth_of(
        self, finder: SlopeFinder, slopes: FloatArray, known: FloatArray, bare: BoolArray
    ) -> FloatArray:
        """Depth (h, w), mm, of the surface of these slopes (h, w, 2) below the ``bare`` gel."""
        bent = _filled(slopes - finder.rest, known)
        scale = self.mm_per_px * self._shape[1] / bent.shape[1]
        surface = integrate(bent[..., 0], bent[..., 1], scale)
        # The middle of its upper half: below flat faces lies no bare gel.
        level = float(np.quantile(surface[::2, ::2][bare[::2, ::2]], 0.75))
        return _levelled(np.asarray(level - surface), bare)

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


def _levelled(depth: FloatArray, bare: BoolArray) -> FloatArray:
    """Depth (h, w), mm, less the plane through that of the ``bare`` gel around the contacts.

    Slopes that a table reads too steep on one side of a deep contact lower all gel beyond it.
    """
    rows, columns = (np.arange(LEVEL_STEP_PX // 2, n, LEVEL_STEP_PX) for n in depth.shape)
    here = np.ix_(rows, columns)
    shallow = bare[here] & (depth[here] < FACE_SHARE * depth.max())
    _, patches = cv2.connectedComponents(shallow.astype(np.uint8), connectivity=4)
    edges = np.concatenate([patches[0], patches[-1], patches[:, 0], patches[:, -1]])
    i, j = np.nonzero(np.isin(patches, edges[edges > 0]))
    if not i.size:
        return depth
    v, u = (np.arange(n, dtype=np.float32) / n - 0.5 for n in depth.shape)
    x, y = u[columns[j]], v[rows[i]]
    basis = np.stack([np.ones_like(x), x, y])
    held = np.diag([0.0, 1.0, 1.0]) * TILT_HELD * patches.size
    seen = depth[rows[i], columns[j]]
    _, by_x, by_y = np.linalg.solve(basis @ basis.T + held, basis @ seen)
    at = np.quantile(seen - by_x * x - by_y * y, 0.25)
    along, down = (at + by_x * u).astype(depth.dtype), (by_y * v[:, None]).astype(depth.dtype)
    return np.asarray(depth - along - down)


def _continued(
    surface: FloatArray, patch: BoolArray, box: tuple[slice, ...], least_mm: float
) -> SunkenObject:
    """A surface (h, w) as it is inside the rim of a contact, continued to level 0 outside.

    ``patch`` (h, w), within ``box``, is what of the contact is deeper than ``least_mm``.
    """
    around = _wider(box, RIM_BORDER_PX)
    close = np.where(patch[around], surface[around], least_mm)
    deepest = float(close.max())
    rim = _rim_mm(close, least_mm)
    inside = patch & (surface > rim)
    depth = np.where(inside, surface, 0.0)
    layers = rim + np.linspace(0.0, RIM_LAYERS, 12) * (deepest - rim)
    pixels = _above(surface[inside], layers)
    growth = max(-float(np.polyfit(layers, pixels, 1)[0]), 0.0)
    # Of a disc about any of its pixels a quarter at least lies in the picture.
    near = _wider(box, math.ceil(math.sqrt(4.0 / math.pi * growth * rim)) + 1)
    outside = np.flatnonzero(~inside[near])
    beyond = min(round(growth * rim), len(outside))
    if beyond:
        walls = (~inside[near]).astype(np.uint8)
        away = cv2.distanceTransform(walls, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        distance = np.asarray(away).ravel()[outside]
        first = distance <= np.partition(distance, beyond - 1)[beyond - 1]
        nearest = outside[first][np.argsort(distance[first], kind="stable")[:beyond]]
        continued = rim * (1.0 - (np.arange(beyond) + 0.5) / (growth * rim))
        rows, columns = np.unravel_index(nearest, walls.shape)
        depth[near][rows, columns] = continued
    return SunkenObject(depth, np.asarray(inside))


def _wider(box: tuple[slice, ...], by_px: int) -> tuple[slice, ...]:
    """A box of a picture with so much around it."""
    return tuple(slice(max(part.start - by_px, 0), part.stop + by_px) for part in box)


def _rim_mm(surface: FloatArray, least_mm: float) -> float:
    """Level of the outermost contour of a contact about as steep as its steepest one, mm.

    By the co-area formula the area between two contours is their length times the mean of
    1/steepness; both are counted in pixels.
    """
    smooth = np.asarray(cv2.GaussianBlur(surface, (9, 9), RIM_BLUR_PX))
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


@njit(cache=True, nogil=True)
def _deepest(surface: NDArray[Any], patches: NDArray[Any], count: int) -> NDArray[Any]:
    """The largest value (count,) of a surface (h, w) in each patch; 0 for patch 0, none."""
    deepest = np.zeros(count, surface.dtype)
    for row in range(surface.shape[0]):
        for column in range(surface.shape[1]):
            patch = patches[row, column]
            if patch:
                deepest[patch] = max(deepest[patch], surface[row, column])
    return deepest


@njit(cache=True, nogil=True, error_model="numpy")
def _above(values: NDArray[Any], levels: NDArray[Any]) -> NDArray[Any]:
    """How many values (N,) exceed each level (n,), evenly spaced in increasing order."""
    n = len(levels)
    counts, per_step = np.zeros(n + 1), (n - 1) / (levels[-1] - levels[0])
    for value in values:
        passed = int(min(max(math.ceil((value - levels[0]) * per_step), 0.0), float(n)))
        counts[passed] += 1
    return counts[::-1].cumsum()[::-1][1:]


def _rest_slopes(shape_px: tuple[int, int], mm_per_px: float, dome_radius_mm: float) -> FloatArray:
    """(h, w, 2) slopes of the gel at rest: a sphere's, or 0."""
    rows, columns = np.indices(shape_px, dtype=np.float64)
    x = (columns - (shape_px[1] - 1) / 2) * mm_per_px
    y = (rows - (shape_px[0] - 1) / 2) * mm_per_px
    if dome_radius_mm <= 0:
        return np.zeros((*shape_px, 2), np.float32)
    height = np.sqrt(np.maximum(dome_radius_mm**2 - x**2 - y**2, 1e-6))
    return np.stack([-x / height, -y / height], axis=-1).astype(np.float32)


def _check_view(image: NDArray[Any], rest: View, what: str, whose: str) -> None:
    """Raises ``TableError`` if a picture (H, W, 3) is proven to be of another view."""
    if wrong := rest.other_view(image):
        msg = f"{what} does not match {whose}: {wrong}; {SAME_VIEW}"
        raise TableError(msg)


def _brightness(light: Drift) -> FloatArray:
    """Gain of each channel (3,), its median over the picture."""
    return np.asarray(np.median(light.gain[::4, ::4], axis=(0, 1)))


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
    result = np.where(known[..., None] > 0, values, np.float32(0.0))
    weight, around = (cv2.GaussianBlur(part, (0, 0), FILL_BLUR_PX) for part in (known, result))
    smooth = around / np.maximum(weight, 1e-6)[..., None]
    return np.where(known[..., None] > 0, values, smooth)


def integrate(slope_x: FloatArray, slope_y: FloatArray, mm_per_px: float) -> FloatArray:
    """The surface (h, w), mm, whose slopes come nearest to the given ones; its mean is 0.

    Least squares by Poisson's equation with free edges, solved by cosine transforms.

    Source: Simchony, Chellappa & Shao 1990, Direct analytical methods for solving Poisson
    equations.
    """
    divergence, eigenvalues = np.zeros_like(slope_x), _eigenvalues(slope_x.shape)
    # Slopes stand at pixels; differences between neighbours at the edges between them.
    across = (slope_x[:, 1:] + slope_x[:, :-1]) * (0.5 * mm_per_px)
    down = (slope_y[1:] + slope_y[:-1]) * (0.5 * mm_per_px)
    divergence[:, :-1] += across
    divergence[:, 1:] -= across
    divergence[:-1] += down
    divergence[1:] -= down
    spectrum = dctn(divergence, norm="ortho", overwrite_x=True)
    spectrum /= eigenvalues
    spectrum[0, 0] = 0.0
    return np.asarray(idctn(spectrum, norm="ortho", overwrite_x=True))


@lru_cache(maxsize=8)
def _eigenvalues(shape_px: tuple[int, int]) -> NDArray[np.float32]:
    """Of Poisson's equation with free edges; 1 in place of the first one, 0."""
    rows, columns = (2.0 - 2.0 * np.cos(np.pi * np.arange(n) / n) for n in shape_px)
    eigenvalues = -(rows[:, None] + columns[None, :])
    eigenvalues[0, 0] = 1.0
    return eigenvalues.astype(np.float32)

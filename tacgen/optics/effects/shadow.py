"""Cast shadows: where the gel's own relief hides a light."""

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from tacgen.core.compiled import njit
from tacgen.core.types import FloatArray, Window
from tacgen.optics.effects import effect as base
from tacgen.optics.table import Leds, LookupTable, leds_of_table

DEFAULT_STRENGTH = 0.8
"""Share of a light that its shadow removes; the gel scatters the rest into the shadow."""
PENUMBRA_MM = 0.2
"""How far a ray must pass below the relief for its light to be hidden whole: a light 2 mm wide,
25 mm away, behind an edge 2.5 mm away."""
NEAR_PENUMBRA = 1.0
"""Of lamps that stand near, and behind a diffuser as wide as it is far away: one is hidden whole
where the relief rises by so much more steeply than to where it begins to hide it."""

LENGTHS_MM = (1.0, 2.0, 4.0, 7.0)
"""Shadows of 1 mm of relief that a fit tries: lights 45° to 8° above the gel."""
NEAR_START = MappingProxyType({"length_mm": 4.0, "lamp_distance_mm": 15.0, "penumbra": 2.0})
"""Where a fit of near lamps begins: between low strips of lamps beside the gel and a wide diffuser
farther off."""
FIRST_STRENGTH, FIRST_NEAR_STRENGTH = 0.4, 0.2
"""Where a fit begins: half of what is expected of a lamp at a side, and of all light there."""

NEAR_GRID_MM = 0.13
"""Largest blocks on which shadows of near lamps, with their wide penumbra, are computed: pixel by
pixel they differ by 0.1 grey levels RMS on a GelSight, whose shadow is 10 deep, and by 0.5 on a
Mini, of 18, at three times the cost."""
FAR_AWAY_MM = 1e4
"""Where a lamp stands whose rays count as parallel."""
LEAST_PX = 1e-6  # so that no pixel is reached both across rows and across columns

_NOTHING_MM = np.float32(1e6)
Span: TypeAlias = tuple[int, int, int]


@njit(cache=True, nogil=True)
def _passed(
    values: NDArray[Any], lamp_column: float, away: float, span: Span, out: NDArray[Any]
) -> None:
    """Values (width + 2) of the row before where rays to columns ``span`` pass it, into ``out``.

    ``span`` is the first, that under the lamp and the last; the row is ``away`` from the lamp.
    """
    left, middle, right = span[0], span[1], span[2]
    aside, column = np.float32(1 / away), np.float32(lamp_column)
    # Loops from 0 over slices are worked on as vectors.
    here, beyond = values[left + 1 : middle + 1], values[left + 2 : middle + 2]
    first, part = column - np.float32(left), out[left:middle]
    for k in range(part.shape[0]):
        part[k] = here[k] + (first - np.float32(k)) * aside * (beyond[k] - here[k])
    here, beyond = values[middle + 1 : right + 1], values[middle:right]
    first, part = np.float32(middle) - column, out[middle:right]
    for k in range(part.shape[0]):
        part[k] = here[k] + (first + np.float32(k)) * aside * (beyond[k] - here[k])


# numpy's way with divisions by zero: Python's check of each keeps a loop from vectors.
@njit(cache=True, nogil=True, error_model="numpy")
def _sweep(
    height_mm: NDArray[Any],
    lamp_row: float,
    lamp_column: float,
    lamp_mm: float,
    penumbra: float,
    least: float,
    shade: NDArray[Any],
) -> bool:
    """Shade of a lamp at the pixels that it reaches across rows rather than columns.

    Those are ``least`` columns fewer than rows, or more, from ``lamp_row`` and ``lamp_column``,
    px, above which it stands by ``lamp_mm``; the others of ``shade`` stay. A ``penumbra`` of 0 is
    that of a lamp far away. Returns whether there is any shade.

    The lowest relief met on the way from the lamp is carried on from row to row, along the ray
    that goes past it, so that each pixel costs one step however long its shadow is.
    """
    n_rows, width = height_mm.shape
    level, aged, slope = (
        np.zeros(width, np.float32),
        np.zeros(width, np.float32),
        np.zeros(width, np.float32),
    )
    darkest, lamp = np.zeros(width, np.float32), np.float32(lamp_mm)
    none, whole, steep = np.float32(0), np.float32(1), np.float32(1 / PENUMBRA_MM)
    for outwards in (-1, 1):
        # Rows farther away reach more columns: beyond these, nothing was met yet.
        met = np.full(width + 2, _NOTHING_MM, np.float32)
        last = met.copy()
        age = np.zeros(width + 2, np.float32)  # rows since the relief was met
        if outwards > 0:
            r = max(math.ceil(lamp_row) + 1, 0)
        else:
            r = min(math.floor(lamp_row) - 1, n_rows - 1)
        while 0 <= r < n_rows:
            away = abs(r - lamp_row)
            left = min(max(math.ceil(lamp_column - away + least), 0), width)
            right = max(min(math.floor(lamp_column + away - least) + 1, width), left)
            span = (left, min(max(math.ceil(lamp_column), left), right), right)
            further = np.float32(1 / max(away - 1, 1e-3))
            row, out, most = height_mm[r, left:right], shade[r, left:right], darkest[left:right]
            here, ray = met[left + 1 : right + 1], level[left:right]
            _passed(met, lamp_column, away, span, level)
            if penumbra > 0:
                _passed(age, lamp_column, away, span, aged)
                _passed(last, lamp_column, away, span, slope)
                per_mm, rows = np.float32(1 / penumbra), age[left + 1 : right + 1]
                to_lamp = np.float32(away)
                since, own = aged[left:right], slope[left:right]
                for k in range(out.shape[0]):
                    ray[k] += (ray[k] + lamp) * further
                    own[k] += (own[k] + lamp) * further
                    # By how much the horizon, and the gel's own slope, exceed the lamp's height.
                    per = per_mm / max(row[k] + lamp, np.float32(0.1) * lamp)
                    met_at = since[k] + whole
                    horizon = (row[k] - ray[k]) * per * (to_lamp - met_at) / met_at
                    slope_here = (row[k] - own[k]) * per * (to_lamp - whole)
                    beyond = min(max(horizon, none), whole) - min(max(slope_here, none), whole)
                    out[k] = max(beyond, none)
                    most[k] = max(most[k], out[k])
                    rows[k] = met_at if row[k] > ray[k] else none
                    here[k] = min(row[k], ray[k])
                last[1:-1] = height_mm[r]
                last[0], last[-1] = last[1], last[-2]
            else:
                for k in range(out.shape[0]):
                    ray[k] += (ray[k] + lamp) * further
                    hidden = min(max((row[k] - ray[k]) * steep, none), whole)
                    out[k] = hidden
                    most[k] = max(most[k], hidden)
                    here[k] = min(row[k], ray[k])
            r += outwards
    return bool(darkest.any())


def cast_shadow(
    height_mm: NDArray[np.float32],
    mm_per_px: float,
    direction: tuple[float, float, float],
    *,
    lamp_distance_mm: float = 0.0,
    penumbra: float = NEAR_PENUMBRA,
    middle_px: tuple[float, float] = (0.0, 0.0),
) -> NDArray[np.float32] | None:
    """How much of a light is hidden from each pixel: 0 in the open, 1 in full shadow.

    None where there is no shadow at all. Of a lamp near, less what the pixel's own slope hides.

    Parameters
    ----------
    height_mm : (h, w) float32
        The deformed gel surface, gel frame; the lights and the camera look at it from below.
    mm_per_px : float
    direction : tuple of float
        Unit vector from the gel's middle towards the light; its z counts as negative.
    lamp_distance_mm : float
        How far from the middle it stands, along the gel; 0 for far away.
    penumbra : float
        Of a lamp near: it is hidden whole where the tangent of the horizon's elevation is 1 +
        ``penumbra`` times the lamp's.
    middle_px : tuple of float
        Row and column of the gel's middle in ``height_mm``.

    Source
    ------
    Si & Yuan 2022, Taxim, §III-D steps rays from each light; this carries them row by row, from a
    lamp that may be near.
    """
    x, y, z = direction
    flat = math.hypot(x, y)
    if flat < 1e-6:
        return None
    away_mm = lamp_distance_mm or FAR_AWAY_MM
    row_px, column_px = (
        middle + away_mm * part / flat / mm_per_px
        for middle, part in zip(middle_px, (y, x), strict=True)
    )
    lamp = away_mm * abs(z) / flat, penumbra if lamp_distance_mm else 0.0
    n_rows, n_columns = height_mm.shape
    # How far the window's edges are from the lamp: most windows are reached in one way alone.
    rows_px, columns_px = (
        (abs(min(max(at, 0), n - 1) - at), max(abs(at), abs(n - 1 - at)))
        for at, n in ((row_px, n_rows), (column_px, n_columns))
    )
    shade = np.zeros(height_mm.shape, dtype=np.float32)
    found = rows_px[1] >= columns_px[0] and _sweep(height_mm, row_px, column_px, *lamp, 0.0, shade)
    if columns_px[1] > rows_px[0]:
        turned = np.ascontiguousarray(height_mm.T)
        across = np.zeros(turned.shape, dtype=np.float32)
        if _sweep(turned, column_px, row_px, *lamp, LEAST_PX, across):
            shade = shade + across.T if found else np.ascontiguousarray(across.T)
            found = True
    return shade if found else None


def shadow_reach_mm(depth_mm: float, leds: Leds) -> float:
    """The longest shadow that relief of a given depth casts, mm."""
    slopes = [abs(z) / max(math.hypot(x, y), 1e-6) for (x, y, z), _ in leds]
    return depth_mm / max(min(slopes, default=1.0), 1e-3)


def unlit_image(table: LookupTable) -> NDArray[np.float32]:
    """Grey levels (H, W, 3) of a slope that faces away from each channel's light.

    What remains of a channel in full shadow: the table has it from the slopes that its presses
    turned away, in which the light's own share is missing and all else is there.
    """
    n_rows, n_columns = table.shape_px
    u = ((np.arange(n_columns) + 0.5) / n_columns - 0.5)[None, :]
    v = ((np.arange(n_rows) + 0.5) / n_rows - 0.5)[:, None]
    unlit = np.array(table.background, dtype=np.float32)
    for channel in range(3):
        nodes = table.coefficients[:, :, channel].reshape(-1, table.coefficients.shape[-1])
        a, b, c, d, e, f = nodes[np.argmin(nodes[:, 5])].astype(np.float64)
        unlit[..., channel] += (a * u * u + b * v * v + c * u * v + d * u + e * v + f).astype(
            np.float32
        )
    return unlit


@njit(cache=True, nogil=True)
def _darken(
    shade: NDArray[Any], share: NDArray[Any], unlit: NDArray[Any], image: NDArray[Any]
) -> None:
    for r in range(image.shape[0]):
        for k in range(image.shape[1]):
            hidden = shade[r, k]
            if hidden > 0:
                for channel in range(3):
                    light = max(image[r, k, channel] - unlit[r, k, channel], np.float32(0))
                    image[r, k, channel] -= share[channel] * hidden * light


def cast_shadows(
    height_mm: NDArray[np.float32],
    mm_per_px: float,
    leds: Leds,
    strength: FloatArray,
    unlit: NDArray[np.float32],
    image: NDArray[np.float32],
    middle_px: tuple[float, float],
) -> None:
    """Darken ``image`` (h, w, 3) in place where the relief (h, w) hides lights far away.

    A light that is wholly hidden loses ``strength`` (3,) of its share in what each channel has
    above ``unlit`` (h, w, 3). ``middle_px`` is as for ``cast_shadow``.
    """
    total = np.maximum(np.sum([rgb for _, rgb in leds], axis=0), 1e-9)
    for direction, rgb in leds:
        share = (strength * np.asarray(rgb) / total).astype(np.float32)
        shade = cast_shadow(height_mm, mm_per_px, direction, middle_px=middle_px)
        if shade is not None:
            _darken(shade, share, unlit, image)


@njit(cache=True, nogil=True)
def _block_means(
    height_mm: NDArray[Any], corner: tuple[int, int], block: int, means: NDArray[Any]
) -> None:
    """Means of the blocks of a surface (H, W) from block ``corner`` (row, column) on."""
    n_rows, n_columns = height_mm.shape
    left, width = corner[1] * block, means.shape[1]
    line = np.empty(width * block, np.float32)
    for i in range(means.shape[0]):
        top = (corner[0] + i) * block
        bottom = min(top + block, n_rows)
        line[:] = np.float32(0)
        out = line[: min(line.shape[0], n_columns - left)]
        for r in range(top, bottom):
            row = height_mm[r, left:]
            for k in range(out.shape[0]):
                out[k] += row[k]
        for j in range(width):
            size = min(block, out.shape[0] - j * block)
            total = np.float32(0)
            for k in range(j * block, j * block + size):
                total += out[k]
            means[i, j] = total / np.float32((bottom - top) * size)


@njit(cache=True, nogil=True)
def _dim(
    shades: NDArray[Any],
    strengths: NDArray[Any],
    first: tuple[int, int],
    block: int,
    image: NDArray[Any],
) -> None:
    """Take a share of each channel (3,), where its lamp's shade is 1, from an ``image`` (h, w, 3).

    ``shades`` (3, rows, columns) stand in the middles of blocks, as of ``_block_means``, and are
    linear between them.
    """
    n_rows, n_columns = shades.shape[1:]
    half, per_px = np.float32(0.5), np.float32(1 / block)
    columns = np.empty(n_columns, np.bool_)
    for j in range(n_columns):
        columns[j] = shades[:, :, j].any()
    shaded = np.nonzero(columns)[0]
    if shaded.size == 0:
        return
    # Half a block beyond the last shade it is 0.
    left = max((shaded[0] - 1) * block - first[1], 0)
    right = min((shaded[-1] + 2) * block - first[1], image.shape[1])
    before, share = np.empty(right - left, np.uint32), np.empty(right - left, np.float32)
    for k in range(right - left):
        at = max((np.float32(left + k + first[1]) + half) * per_px - half, np.float32(0))
        before[k] = np.uint32(min(np.int32(at), max(n_columns - 2, 0)))
        share[k] = min(at - np.float32(before[k]), np.float32(1))
    after = before + np.uint32(n_columns > 1)
    line, dimmed = np.empty(n_columns, np.float32), np.empty(right - left, np.float32)
    for r in range(image.shape[0]):
        at = max((np.float32(r + first[0]) + half) * per_px - half, np.float32(0))
        above = min(int(at), max(n_rows - 2, 0))
        below, down = min(above + 1, n_rows - 1), min(at - np.float32(above), np.float32(1))
        row = image[r, left:right]
        for c in range(3):
            upper, lower = shades[c, above], shades[c, below]
            if not (upper.any() or lower.any()):
                continue
            for j in range(n_columns):
                line[j] = -strengths[c] * (upper[j] + down * (lower[j] - upper[j]))
            for k in range(dimmed.shape[0]):
                dark = line[before[k]]
                dimmed[k] = dark + share[k] * (line[after[k]] - dark)
            for k in range(dimmed.shape[0]):
                row[k, c] += row[k, c] * dimmed[k]


def near_shadows(
    surface_mm: NDArray[np.float32],
    window: Window,
    mm_per_px: float,
    leds: Leds,
    strengths: FloatArray,
    image: NDArray[np.float32],
    *,
    lamp_distance_mm: float,
    penumbra: float,
) -> None:
    """Darken ``image`` (h, w, 3) of a window in place where a surface (H, W) hides near lamps.

    The lamps, ``leds``, are one of each channel, which loses its share of ``strengths`` (3,) where
    its lamp is wholly hidden; the rest is as for ``cast_shadow``.
    """
    block = max(1, int(NEAR_GRID_MM / mm_per_px))
    top, bottom, left, right = window
    rows, columns = (math.ceil(n / block) for n in (bottom, right))
    corner, first = (top // block, left // block), (top % block, left % block)
    height_mm = np.empty((rows - corner[0], columns - corner[1]), np.float32)
    _block_means(surface_mm, corner, block, height_mm)
    middle = [0.5 * n / block - 0.5 - at for n, at in zip(surface_mm.shape, corner, strict=True)]
    shades = np.zeros((3, *height_mm.shape), np.float32)
    for shade, (direction, _) in zip(shades, leds, strict=True):
        cast = cast_shadow(
            height_mm,
            block * mm_per_px,
            direction,
            lamp_distance_mm=lamp_distance_mm,
            penumbra=penumbra,
            middle_px=(middle[0], middle[1]),
        )
        if cast is not None:
            shade[...] = cast
    _dim(shades, strengths.astype(np.float32), first, block, image)


def _lowered(leds: Leds, length_mm: float) -> Leds:
    """The same lights at the height at which 1 mm of relief casts a shadow of ``length_mm``."""
    rise = 1 / math.hypot(1, length_mm)
    lowered = []
    for (x, y, _), rgb in leds:
        flat = max(math.hypot(x, y), 1e-9)
        scale = length_mm * rise / flat
        lowered.append(((x * scale, y * scale, -rise), rgb))
    return tuple(lowered)


class Shadow(base.OpticalEffect):
    """The gel's relief hides a share of each light.

    ``strength`` is that of all colours, ``strength_r``, ``_g`` and ``_b`` those of each.
    ``length_mm`` is that of the shadow of 1 mm of relief in the gel's middle; 0 keeps the lights'
    own height. ``lamp_distance_mm`` is how far from there the lamps stand, 0 for far away: those
    are of one colour each, as the table shows them, the shares are of all light in it, and
    ``penumbra`` is as for ``cast_shadow``.
    """

    name = "shadow"
    stage = base.Stage.SHADOW
    parameters = MappingProxyType(
        {
            "strength": base.OpticalParameter(0.0, 0.0, 1.0, step=0.02),
            **{
                f"strength_{channel}": base.OpticalParameter(0.0, 0.0, 1.0, step=0.02)
                for channel in base.CHANNELS
            },
            "length_mm": base.OpticalParameter(0.0, 0.0, 20.0, "mm"),
            "lamp_distance_mm": base.OpticalParameter(0.0, 0.0, 1000.0, "mm"),
            "penumbra": base.OpticalParameter(NEAR_PENUMBRA, 0.2, 10.0, step=0.05, prior=3.0),
        }
    )

    def prepare(self, table: LookupTable, leds: Leds, **values: float) -> dict[str, Any]:
        """The lights at their height, and the gel without them."""
        is_near, length_mm = values.get("lamp_distance_mm", 0.0) > 0, values.get("length_mm", 0.0)
        leds = leds_of_table(table) if is_near or not leds else leds
        every = values.get("strength", DEFAULT_STRENGTH)
        return {
            "leds": _lowered(leds, float(length_mm)) if length_mm else leds,
            "unlit": None if is_near else unlit_image(table),
            "farthest_mm": 0.5 * math.hypot(*table.shape_px) * table.mm_per_px,
            "strengths": np.array([values.get(f"strength_{c}", every) for c in base.CHANNELS]),
        }

    def reach_mm(
        self,
        depth_mm: float,
        *,
        leds: Leds = (),
        lamp_distance_mm: float = 0.0,
        farthest_mm: float = 0.0,
        **_: Any,
    ) -> float:
        """The longest shadow: of a near lamp that at the picture's far corner."""
        reach_mm = shadow_reach_mm(depth_mm, leds)
        if lamp_distance_mm <= 0:
            return reach_mm
        below_lamp = max(1 - reach_mm / lamp_distance_mm, 1e-3)  # share of the lamp's height
        return min(reach_mm * (1 + farthest_mm / lamp_distance_mm) / below_lamp, 2 * farthest_mm)

    def apply(self, array: FloatArray, patch: base.Patch, **values: Any) -> FloatArray:
        """Darken what the relief of the patch hides."""
        image = array.copy()
        self.change(image, patch, **values)
        return image

    def change(
        self,
        image: FloatArray,
        patch: base.Patch,
        *,
        strengths: FloatArray | None = None,
        lamp_distance_mm: float = 0.0,
        penumbra: float = NEAR_PENUMBRA,
        leds: Leds = (),
        unlit: FloatArray | None = None,
        **_: Any,
    ) -> None:
        """Darken what the relief of the patch hides."""
        if patch.height_mm is None or strengths is None:
            return
        if unlit is None:
            near_shadows(
                patch.height_mm,
                patch.window,
                patch.mm_per_px,
                leds,
                strengths,
                image,
                lamp_distance_mm=lamp_distance_mm,
                penumbra=penumbra,
            )
            return
        top, bottom, left, right = patch.window
        shape_px = patch.height_mm.shape
        height_mm = np.ascontiguousarray(patch.height_mm[top:bottom, left:right])
        unlit = unlit[top:bottom, left:right]
        middle = (shape_px[0] - 1) / 2 - top, (shape_px[1] - 1) / 2 - left
        cast_shadows(height_mm, patch.mm_per_px, leds, strengths, unlit, image, middle)

    def candidates(self, scene: base.PressScene) -> list[base.OpticalCandidate]:
        """Of lamps far away one strength, and one of a few lengths; of near ones all of it."""
        far = {"strength": self.parameters["strength"]}
        starts = tuple({"strength": FIRST_STRENGTH, "length_mm": x} for x in LENGTHS_MM)
        near = {f"strength_{c}": self.parameters[f"strength_{c}"] for c in base.CHANNELS}
        start = {**dict.fromkeys(near, FIRST_NEAR_STRENGTH), **NEAR_START}
        near["length_mm"] = base.OpticalParameter(0.0, 0.5, 12.0, "mm", step=0.1)
        near["lamp_distance_mm"] = base.OpticalParameter(0.0, 4.0, 60.0, "mm", step=0.5)
        near["penumbra"] = self.parameters["penumbra"]
        return [
            base.OpticalCandidate(self.name, "cast by the dent", far, starts=starts),
            base.OpticalCandidate(
                self.name, "cast by the dent, lamps near", near, starts=(start,), rigid=True
            ),
        ]


SHADOW = base.register(Shadow())


def with_cast_shadows(
    effects: Mapping[str, Mapping[str, float]],
) -> Mapping[str, Mapping[str, float]]:
    """The effects, and cast shadows of the usual strength where they name none."""
    return {SHADOW.name: {}, **effects}

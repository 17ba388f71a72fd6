"""Cast shadows: where the gel's own relief hides a light."""

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from tacgen.core.compiled import njit
from tacgen.core.types import FloatArray
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


@njit(cache=True, nogil=True)
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
    **lamp: Any,
) -> None:
    """Darken ``image`` (h, w, 3) in place where the relief (h, w) hides lights.

    A light that is wholly hidden loses ``strength`` (3,) of its share in what each channel has
    above ``unlit`` (h, w, 3). ``lamp`` is as for ``cast_shadow``.
    """
    total = np.maximum(np.sum([rgb for _, rgb in leds], axis=0), 1e-9)
    for direction, rgb in leds:
        share = (strength * np.asarray(rgb) / total).astype(np.float32)
        shade = cast_shadow(height_mm, mm_per_px, direction, **lamp)
        if shade is not None:
            _darken(shade, share, unlit, image)


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
            "unlit": np.zeros_like(table.background) if is_near else unlit_image(table),
            "strengths": np.array([values.get(f"strength_{c}", every) for c in base.CHANNELS]),
        }

    def reach_mm(self, depth_mm: float, *, leds: Leds = (), **_: Any) -> float:
        """The longest shadow."""
        return shadow_reach_mm(depth_mm, leds)

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
        if patch.height_mm is not None and unlit is not None and strengths is not None:
            top, bottom, left, right = patch.window
            height, width = unlit.shape[:2]
            cast_shadows(
                np.ascontiguousarray(patch.height_mm),
                patch.mm_per_px,
                leds,
                strengths,
                unlit[top:bottom, left:right],
                image,
                lamp_distance_mm=lamp_distance_mm,
                penumbra=penumbra,
                middle_px=((height - 1) / 2 - top, (width - 1) / 2 - left),
            )

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

"""From the deformed surface of the gel to the sensor's picture of it."""

import copy
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.core.errors import TableError
from tacgen.core.types import FloatArray, Window
from tacgen.optics import shade
from tacgen.optics.effects import (
    OpticalEffect,
    Patch,
    Stage,
    check_effects,
    optical_effects,
    with_cast_shadows,
)
from tacgen.optics.markers import draw_markers
from tacgen.optics.noise import CameraNoise
from tacgen.optics.smooth import grown
from tacgen.optics.table import Leds, LookupTable

Effects = Mapping[str, Mapping[str, float]]
"""Effect → parameter → value, as in a table."""


DEPTH_LEVELS = 8
"""Into which a deformation is cut to see how far the shadows of each of its depths reach."""


@dataclass(frozen=True, slots=True)
class ActiveEffect:
    """An effect with the values that a table gives it, and what it prepared of the table."""

    effect: OpticalEffect
    values: dict[str, Any]

    def reach_px(self, depth_mm: float, mm_per_px: float) -> int:
        """Pixels around a deformation that it changes; 0 for those of the deformation alone."""
        return math.ceil(self.effect.reach_mm(depth_mm, **self.values) / mm_per_px)


class Shader:
    """A table made ready: from height maps to float grey levels, in any window of the image.

    A table with the effect casts ``shadows`` in any case; empty ``leds`` are read off the table.

    Raises ``TableError`` if the table names effects that are unknown.
    """

    def __init__(self, table: LookupTable, *, shadows: bool = False, leds: Leds = ()) -> None:
        self.table = table
        self._background = np.ascontiguousarray(table.background, dtype=np.float32)
        self._shade = table.image_model.shade(self._background, table.mm_per_px)
        n_rows, n_columns = table.shape_px
        self._u = ((np.arange(n_columns) + 0.5) / n_columns - 0.5).astype(np.float32)
        self._v = ((np.arange(n_rows) + 0.5) / n_rows - 0.5).astype(np.float32)
        self._prepare_effects(shadows=shadows, leds=leds)

    def with_effects(self, effects: Effects) -> "Shader":
        """The same table with other effects; what the look-up needs is shared."""
        other = copy.copy(self)
        other.table = replace(self.table, effects=effects)
        other._prepare_effects(shadows=False, leds=())
        return other

    def _prepare_effects(self, *, shadows: bool, leds: Leds) -> None:
        table = self.table
        check_effects(table.effects)
        effects = with_cast_shadows(table.effects) if shadows else table.effects

        def active(first: Stage, last: Stage) -> list[ActiveEffect]:
            return [
                ActiveEffect(effect, {**values, **effect.prepare(table, leds, **values)})
                for effect in optical_effects(first, last)
                if (values := effects.get(effect.name)) is not None
            ]

        self._surface = active(Stage.SURFACE, Stage.SURFACE)
        self._image = active(Stage.SHADOW, Stage.CAMERA)

    @property
    def slope_reach_px(self) -> int:
        """How far from a deformation it changes slopes."""
        return 1 + sum(self._margin_px(active) for active in self._surface)

    def image_reach_px(self, depth_mm: float) -> int:
        """How far from a deformation of this depth it changes an image that is lit."""
        reaches = [active.reach_px(depth_mm, self.table.mm_per_px) for active in self._image]
        return max((reach + 1 for reach in reaches if reach), default=0)

    def seen_window(self, deformation_mm: NDArray[np.float32], window: Window) -> Window:
        """Where a deformation (h, w) over a window changes the image: shallow parts reach less."""
        lit = grown(window, self.slope_reach_px, self.table.shape_px)
        seen = grown(lit, self.image_reach_px(0.0), self.table.shape_px)
        by_row, by_column = (deformation_mm.max(axis=k, initial=0.0) for k in (1, 0))
        deepest_mm = float(by_row.max(initial=0.0))
        for k in range(DEPTH_LEVELS):
            rows, columns = (
                np.flatnonzero(by > k / DEPTH_LEVELS * deepest_mm) for by in (by_row, by_column)
            )
            if not rows.size:
                break
            deep = (
                *(window[0] + int(rows[0]), window[0] + int(rows[-1]) + 1),
                *(window[2] + int(columns[0]), window[2] + int(columns[-1]) + 1),
            )
            reach_px = self.image_reach_px((k + 1) / DEPTH_LEVELS * deepest_mm)
            part = grown(deep, reach_px, self.table.shape_px)
            seen = (
                *(min(seen[0], part[0]), max(seen[1], part[1])),
                *(min(seen[2], part[2]), max(seen[3], part[3])),
            )
        return seen

    def _margin_px(self, active: ActiveEffect) -> int:
        return active.reach_px(0.0, self.table.mm_per_px) + 2

    @property
    def finishes(self) -> bool:
        """Whether ``finish`` does anything."""
        return bool(self._image)

    def light(
        self,
        height_map_mm: NDArray[np.float32],
        window: Window,
        image: NDArray[np.float32],
        spans: NDArray[np.int32] | None = None,
    ) -> None:
        """Look the grey levels of ``window`` up, into ``image`` (H, W, 3).

        ``height_map_mm`` (H, W) is the whole deformed surface, C-contiguous. With ``spans``, only
        those columns [first, last) of each row of the window.
        """
        spans = shade.whole_spans(window) if spans is None else spans
        for active in self._surface:
            height_map_mm = self._on_surface(active, height_map_mm, window)
        self._shade(height_map_mm, window, spans, image)

    def finish(
        self, height_map_mm: NDArray[np.float32], window: Window, image: NDArray[np.float32]
    ) -> None:
        """Apply the effects that come after the look-up to ``window`` of a lit ``image``."""
        top, bottom, left, right = window
        patch = self._patch(height_map_mm, window)
        for active in self._image:
            active.effect.change(image[top:bottom, left:right], patch, **active.values)

    def _patch(self, height_map_mm: NDArray[np.float32], window: Window) -> Patch:
        top, bottom, left, right = window
        return Patch(
            self._background[top:bottom, left:right],
            self._u[None, left:right],
            self._v[top:bottom, None],
            self.table.mm_per_px,
            window,
            height_map_mm,
        )

    def _on_surface(
        self, active: ActiveEffect, height_map_mm: NDArray[np.float32], window: Window
    ) -> NDArray[np.float32]:
        """The surface after an effect, right within ``window`` and a pixel around it."""
        around = grown(window, self._margin_px(active), height_map_mm.shape)
        top, bottom, left, right = around
        cut = np.ascontiguousarray(height_map_mm[top:bottom, left:right])
        changed = height_map_mm.copy()
        changed[top:bottom, left:right] = active.effect.apply(
            cut, self._patch(height_map_mm, around), **active.values
        )
        return changed


def render_rgb(
    height_map_mm: NDArray[np.floating],
    table: LookupTable,
    *,
    shadows: bool = False,
    rng: np.random.Generator | None = None,
    leds: Leds = (),
) -> NDArray[np.uint8]:
    """The picture of a deformed gel.

    Parameters
    ----------
    height_map_mm : (H, W)
        The deformed gel surface, gel frame, mm: as it is, dome included, not smoothed any more.
    table : LookupTable
        The sensor's, of the same resolution.
    shadows : bool
        Cast shadows.
    rng : Generator, optional
        Draws the camera's noise of ``table.noise_grey``; no noise without it.
    leds : tuple, optional
        The sensor's lights, for shadows; read off the table by default.

    Returns
    -------
    (H, W, 3) uint8
        RGB.

    Raises
    ------
    TableError
        If the height map is not of the table's resolution, or not finite.

    Source
    ------
    Si & Yuan 2022, Taxim, Eq. 3.
    """
    height = np.ascontiguousarray(height_map_mm, dtype=np.float32)
    check_height_map(height, table)
    image = np.empty((*table.shape_px, 3), dtype=np.float32)
    whole = (0, table.shape_px[0], 0, table.shape_px[1])
    shader = Shader(table, shadows=shadows, leds=leds)
    shader.light(height, whole, image)
    shader.finish(height, whole, image)
    rgb = np.empty(image.shape, dtype=np.uint8)
    if rng is not None and table.noise_grey > 0:
        CameraNoise(table.noise_grey).quantize(image, rng, rgb)
    else:
        shade.quantize(image, whole, shade.whole_spans(whole), rgb)
    return rgb


def check_height_map(height_map_mm: NDArray[np.floating], table: LookupTable) -> None:
    """Refuse a height map that ``table`` cannot render.

    Raises ``TableError`` if its shape is not the table's or it is not finite.
    """
    if height_map_mm.shape != table.shape_px:
        msg = (
            f"height map of {height_map_mm.shape} for a table of {table.shape_px} (rows, columns): "
            "use the table that was calibrated at this resolution"
        )
        raise TableError(msg)
    if not np.isfinite(height_map_mm).all():
        msg = "height map holds values that are not finite: the gel has a height everywhere"
        raise TableError(msg)


class Renderer:
    """Renders frame after frame of one sensor, touching only what a contact changes.

    The picture is the same, bit for bit, as ``render_rgb`` of the whole surface, unless shadows are
    on and the gel's dome is so steep that at rest it shades itself.

    ``rest_map_mm`` (H, W) is the gel at rest, gel frame. Empty ``leds`` are read off the table; a
    ``marker_radius_mm`` of 0 draws no markers.
    """

    def __init__(
        self,
        table: LookupTable,
        rest_map_mm: NDArray[np.floating],
        *,
        shadows: bool = False,
        leds: Leds = (),
        marker_radius_mm: float = 0.0,
    ) -> None:
        self._rest_mm = np.ascontiguousarray(rest_map_mm, dtype=np.float32)
        check_height_map(self._rest_mm, table)
        self._shader = Shader(table, shadows=shadows, leds=leds)
        self._noise = CameraNoise(table.noise_grey)
        self._marker_radius_mm = marker_radius_mm
        self._whole = (0, table.shape_px[0], 0, table.shape_px[1])
        self._rest_lit = np.empty((*table.shape_px, 3), dtype=np.float32)
        self._shader.light(self._rest_mm, self._whole, self._rest_lit)
        self._rest_image = self._rest_lit.copy()
        self._shader.finish(self._rest_mm, self._whole, self._rest_image)
        self._rest_rgb = np.empty(self._rest_image.shape, dtype=np.uint8)
        shade.quantize(
            self._rest_image, self._whole, shade.whole_spans(self._whole), self._rest_rgb
        )
        self._height_mm = self._rest_mm.copy()
        self._deformed: Window = (0, 0, 0, 0)  # where the height map may not be at rest
        self._image = self._rest_image.copy()
        # Where the image may not be that of the gel at rest, and in which columns of each row.
        self._changed: Window = (0, 0, 0, 0)
        self._changed_spans = shade.whole_spans(self._changed)

    def draw(
        self,
        deformation_mm: NDArray[np.float32],
        window: Window,
        *,
        markers_mm: FloatArray | None = None,
    ) -> None:
        """Draw the gel with a deformation (h, w), into the gel, over a window.

        ``markers_mm`` (n, 2) is where the markers now are.
        """
        self._deform(deformation_mm, window)
        shader = self._shader
        lit = grown(window, shader.slope_reach_px, self._rest_mm.shape)
        spans = shade.changed_spans(deformation_mm, window, lit, shader.slope_reach_px)
        seen, drawn = lit, spans
        if shader.finishes:
            seen = shader.seen_window(deformation_mm, window)
            drawn = shade.whole_spans(seen)
            shade.restore(self._image, self._rest_lit, seen, drawn, lit, spans)
        before = self._changed, self._changed_spans
        shade.restore(self._image, self._rest_image, *before, seen, drawn)
        shader.light(self._height_mm, lit, self._image, spans)
        shader.finish(self._height_mm, seen, self._image)
        self._changed, self._changed_spans = seen, drawn
        if self._marker_radius_mm > 0 and markers_mm is not None:
            self._changed, self._changed_spans = self._whole, shade.whole_spans(self._whole)
            draw_markers(
                self._image, markers_mm, self._marker_radius_mm, self._shader.table.mm_per_px
            )

    def expose(
        self, rng: np.random.Generator | None = None, rgb: NDArray[np.uint8] | None = None
    ) -> NDArray[np.uint8]:
        """A picture (H, W, 3) of what was drawn last, at first the gel at rest, written into
        ``rgb``, if given; ``rng`` draws the camera's noise.
        """
        if rgb is None:
            rgb = np.empty(self._image.shape, dtype=np.uint8)
        if rng is not None and self._noise.sigma_grey > 0:
            self._noise.quantize(self._image, rng, rgb)
        else:
            rgb[...] = self._rest_rgb
            shade.quantize(self._image, self._changed, self._changed_spans, rgb)
        return rgb

    def _deform(self, deformation_mm: NDArray[np.float32], window: Window) -> None:
        """Bring the height map from the deformation before to this one."""
        before, spans = self._deformed, shade.whole_spans(self._deformed)
        now = shade.whole_spans(window)
        shade.restore(self._height_mm, self._rest_mm, before, spans, window, now)
        shade.lower(self._rest_mm, deformation_mm, window, self._height_mm)
        self._deformed = window

"""From the deformed surface of the gel to the picture that the sensor takes of it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tacgen.core.errors import TableError
from tacgen.optics.effects import EFFECTS, Patch, check_effects
from tacgen.optics.markers import draw_markers
from tacgen.optics.noise import CameraNoise
from tacgen.optics.shade import feature_factors, packed_nodes, quantize, shade_window
from tacgen.optics.shadow import (
    DEFAULT_STRENGTH,
    Leds,
    cast_shadows,
    leds_of_table,
    shadow_reach_mm,
    unlit_image,
)
from tacgen.optics.smooth import Window, grown
from tacgen.optics.table import LookupTable


class Shader:
    """A table made ready: from height maps to float grey levels, in any window of the image.

    Parameters
    ----------
    table : LookupTable
    shadows : bool
        Cast shadows; a table with the effect ``shadow`` casts them in any case.
    leds : tuple
        The sensor's lights; read off the table where empty.

    Raises
    ------
    TableError
        If the table names effects that are unknown.
    """

    def __init__(self, table: LookupTable, *, shadows: bool = False, leds: Leds = ()) -> None:
        check_effects(table.effects)
        self.table = table
        self._nodes = packed_nodes(table)
        self._along = feature_factors(table.shape_px)
        self._interpolate = table.interpolation == "linear" and self._nodes.shape[0] > 1
        self._background = np.ascontiguousarray(table.background, dtype=np.float32)
        n_rows, n_columns = table.shape_px
        self._u = ((np.arange(n_columns) + 0.5) / n_columns - 0.5).astype(np.float32)
        self._v = ((np.arange(n_rows) + 0.5) / n_rows - 0.5).astype(np.float32)
        self._surface = self._effects_of("surface")
        self._image = self._effects_of("image")
        self._leds: Leds = ()
        self._shadow_strength = 0.0
        cast = table.effects.get("shadow")
        if shadows or cast is not None:
            leds = leds or leds_of_table(table)
            self._shadow_strength = float((cast or {}).get("strength", DEFAULT_STRENGTH))
            length_mm = (cast or {}).get("length_mm")
            self._unlit = unlit_image(table)
            self._leds = _lowered(leds, float(length_mm)) if length_mm else leds

    def _effects_of(self, stage: str) -> list[tuple[str, dict[str, float]]]:
        return [
            (name, dict(self.table.effects[name]))
            for name, effect in EFFECTS.items()
            if effect.stage == stage and name in self.table.effects
        ]

    @property
    def slope_reach_px(self) -> int:
        """How far from a deformation it changes slopes."""
        return 1 + sum(self._margin_px(parameters) for _, parameters in self._surface)

    def shadow_reach_px(self, depth_mm: float) -> int:
        """How far from a deformation of this depth its shadows can fall."""
        if not self._leds:
            return 0
        return math.ceil(shadow_reach_mm(depth_mm, self._leds) / self.table.mm_per_px) + 1

    def _margin_px(self, parameters: dict[str, float]) -> int:
        return math.ceil(4 * parameters.get("sigma_mm", 0.0) / self.table.mm_per_px) + 2

    @property
    def finishes(self) -> bool:
        """Whether ``finish`` does anything."""
        return bool(self._leds or self._image)

    def light(
        self, height_map_mm: NDArray[np.float32], window: Window, image: NDArray[np.float32]
    ) -> None:
        """Look the grey levels of ``window`` up, into ``image`` (H, W, 3).

        ``height_map_mm`` (H, W) is the whole deformed surface, C-contiguous.
        """
        for name, parameters in self._surface:
            height_map_mm = self._on_surface(name, parameters, height_map_mm, window)
        shade_window(
            height_map_mm,
            window,
            self.table.mm_per_px,
            self._nodes,
            self.table.max_slope_rad,
            self._interpolate,
            self._along,
            self._background,
            image,
        )

    def finish(
        self, height_map_mm: NDArray[np.float32], window: Window, image: NDArray[np.float32]
    ) -> None:
        """Cast the shadows and apply the image's effects to ``window`` of a lit ``image``."""
        top, bottom, left, right = window
        if self._leds:
            relief = np.ascontiguousarray(height_map_mm[top:bottom, left:right])
            cast_shadows(
                relief,
                self.table.mm_per_px,
                self._leds,
                self._shadow_strength,
                self._unlit[top:bottom, left:right],
                image[top:bottom, left:right],
            )
        for name, parameters in self._image:
            patch = self._patch(window)
            image[top:bottom, left:right] = EFFECTS[name].apply(
                image[top:bottom, left:right], patch, **parameters
            )

    def _patch(self, window: Window) -> Patch:
        top, bottom, left, right = window
        return Patch(
            self._background[top:bottom, left:right],
            self._u[left:right],
            self._v[top:bottom],
            self.table.mm_per_px,
        )

    def _on_surface(
        self,
        name: str,
        parameters: dict[str, float],
        height_map_mm: NDArray[np.float32],
        window: Window,
    ) -> NDArray[np.float32]:
        """The surface after an effect, right within ``window`` and a pixel around it."""
        margin = self._margin_px(parameters)
        around = grown(window, margin, height_map_mm.shape)
        top, bottom, left, right = around
        cut = np.ascontiguousarray(height_map_mm[top:bottom, left:right])
        changed = height_map_mm.copy()
        changed[top:bottom, left:right] = EFFECTS[name].apply(
            cut, self._patch(around), **parameters
        )
        return changed


def _lowered(leds: Leds, length_mm: float) -> Leds:
    """The same lights at the height at which 1 mm of relief casts a shadow of ``length_mm``."""
    rise = 1 / math.hypot(1, length_mm)
    lowered = []
    for (x, y, _), rgb in leds:
        flat = max(math.hypot(x, y), 1e-9)
        scale = length_mm * rise / flat
        lowered.append(((x * scale, y * scale, -rise), rgb))
    return tuple(lowered)


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
        Of the same resolution.
    shadows : bool
        Cast shadows.
    rng : Generator, optional
        Draws the camera's noise of ``table.noise_grey``; no noise without it.
    leds : tuple, optional
        The sensor's lights, for shadows; read off the table where left out.

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
    if rng is not None:
        CameraNoise(table.noise_grey).add(image, rng)
    rgb = np.empty(image.shape, dtype=np.uint8)
    quantize(image, whole, rgb)
    return rgb


def check_height_map(height_map_mm: NDArray[np.floating], table: LookupTable) -> None:
    """Refuse a height map that ``table`` cannot render.

    Raises
    ------
    TableError
        If its shape is not the table's or it is not finite.
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

    The picture is the same, bit for bit, as ``render_rgb`` of the whole surface.

    Parameters
    ----------
    table : LookupTable
    rest_map_mm : (H, W)
        The gel at rest, gel frame, mm.
    shadows : bool
    leds : tuple
        The sensor's lights; read off the table where empty.
    marker_radius_mm : float
        Draw markers of this radius; 0 draws none.
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
        quantize(self._rest_image, self._whole, self._rest_rgb)
        self._height_mm = self._rest_mm.copy()
        self._image = self._rest_image.copy()

    def render(
        self,
        deformation_mm: NDArray[np.float32],
        window: Window,
        *,
        markers_mm: NDArray[np.float64] | None = None,
        rng: np.random.Generator | None = None,
    ) -> NDArray[np.uint8]:
        """The picture of the gel deformed within a window.

        Parameters
        ----------
        deformation_mm : (h, w) float32
            Into the gel, over the window; the gel is at rest outside it.
        window : tuple of int
            Top, bottom, left, right; may be empty.
        markers_mm : (n, 2) float64, optional
            Where the markers now are; needs the renderer to have markers.
        rng : Generator, optional
            Draws the camera's noise.
        """
        seen = self._deformed(deformation_mm, window) if deformation_mm.size else window
        marked = self._marker_radius_mm > 0 and markers_mm is not None
        if marked and markers_mm is not None:
            draw_markers(
                self._image, markers_mm, self._marker_radius_mm, self._shader.table.mm_per_px
            )
        if rng is not None:
            self._noise.add(self._image, rng)
        changed = self._whole if marked or rng is not None else seen
        top, bottom, left, right = changed
        if changed == self._whole:
            rgb = np.empty(self._image.shape, dtype=np.uint8)
        else:
            rgb = self._rest_rgb.copy()
        quantize(self._image, changed, rgb)
        self._image[top:bottom, left:right] = self._rest_image[top:bottom, left:right]
        return rgb

    def _deformed(self, deformation_mm: NDArray[np.float32], window: Window) -> Window:
        """Put the deformed gel's grey levels into the image; returns the window they fill."""
        shader, shape_px = self._shader, self._rest_mm.shape
        top, bottom, left, right = window
        rest, height = (
            self._rest_mm[top:bottom, left:right],
            self._height_mm[top:bottom, left:right],
        )
        np.subtract(rest, deformation_mm, out=height)
        lit = grown(window, shader.slope_reach_px, shape_px)
        seen = lit
        if shader.finishes:
            seen = grown(lit, shader.shadow_reach_px(float(deformation_mm.max())), shape_px)
            area = np.s_[seen[0] : seen[1], seen[2] : seen[3]]
            self._image[area] = self._rest_lit[area]
        shader.light(self._height_mm, lit, self._image)
        shader.finish(self._height_mm, seen, self._image)
        height[...] = rest
        return seen

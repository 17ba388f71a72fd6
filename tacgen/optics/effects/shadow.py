"""Cast shadows: where the gel's own relief hides a light."""

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

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

LENGTHS_MM = (1.0, 2.0, 4.0, 7.0)
"""Shadows of 1 mm of relief that a fit tries: lights 45° to 8° above the gel."""
FIRST_STRENGTH = 0.4
"""Where a fit begins: half of what is expected of a lamp at a side."""

_NOTHING_MM = np.float32(1e6)


@njit(cache=True, nogil=True)
def _sweep(
    height_mm: NDArray[Any],
    across_px: float,
    rise_mm: float,
    downwards: bool,
    per_mm: float,
    shade: NDArray[Any],
) -> bool:
    """Shade of a light met by going to the row before (downwards) or after, ``across_px`` aside.

    Returns whether there is any.

    The lowest relief met on the way, lifted by the ray's rise, is carried along from row to row,
    so that each pixel costs one step however long its shadow is.
    """
    n_rows, width = height_mm.shape
    weight = np.float32(abs(across_px))
    stay = np.float32(1) - weight
    side = 1 if across_px >= 0 else -1
    rise = np.float32(rise_mm)
    met = np.full(width + 2, _NOTHING_MM, np.float32)
    level = np.full(width, _NOTHING_MM, np.float32)
    darkest = np.zeros(width, np.float32)
    for i in range(n_rows):
        r = i if downwards else n_rows - 1 - i
        row, out = height_mm[r], shade[r]
        aside, centre = met[1 + side :], met[1:]
        if i > 0:
            for k in range(width):
                level[k] = (stay * centre[k] + weight * aside[k]) + rise
        for k in range(width):
            hidden = (row[k] - level[k]) * np.float32(per_mm)
            out[k] = min(max(hidden, np.float32(0)), np.float32(1))
            darkest[k] = max(darkest[k], out[k])
        for k in range(width):
            centre[k] = min(row[k], level[k])
    return bool(darkest.any())


def cast_shadow(
    height_mm: NDArray[np.float32], mm_per_px: float, direction: tuple[float, float, float]
) -> NDArray[np.float32] | None:
    """How much of a light is hidden from each pixel: 0 in the open, 1 in full shadow.

    None where there is no shadow at all.

    Parameters
    ----------
    height_mm : (h, w) float32
        The deformed gel surface, gel frame; the lights and the camera look at it from below.
    mm_per_px : float
    direction : tuple of float
        Unit vector from the gel towards the light; its z counts as negative.

    Source
    ------
    Si & Yuan 2022, Taxim, §III-D steps rays from each light; this carries them row by row.
    """
    x, y, z = direction
    flat = math.hypot(x, y)
    if flat < 1e-6:
        return None
    x, y, rise = x / flat, y / flat, abs(z) / flat
    along_rows = abs(y) >= abs(x)
    relief = height_mm if along_rows else np.ascontiguousarray(height_mm.T)
    main, across = (y, x) if along_rows else (x, y)
    shade = np.empty(relief.shape, dtype=np.float32)
    step_mm = mm_per_px / abs(main)
    if not _sweep(relief, across / abs(main), rise * step_mm, main < 0, 1 / PENUMBRA_MM, shade):
        return None
    return shade if along_rows else np.ascontiguousarray(shade.T)


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
    strength: float,
    unlit: NDArray[np.float32],
    image: NDArray[np.float32],
) -> None:
    """Darken ``image`` (h, w, 3) in place where the relief (h, w) hides lights.

    A light that is wholly hidden loses ``strength`` of its share in what each channel has above
    ``unlit`` (h, w, 3).
    """
    total = np.maximum(np.sum([rgb for _, rgb in leds], axis=0), 1e-9)
    for direction, rgb in leds:
        share = (strength * np.asarray(rgb) / total).astype(np.float32)
        shade = cast_shadow(height_mm, mm_per_px, direction)
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

    ``length_mm`` is that of the shadow of 1 mm of relief; 0 keeps the lights' own height.
    """

    name = "shadow"
    stage = base.Stage.SHADOW
    parameters = MappingProxyType(
        {
            "strength": base.OpticalParameter(0.0, 0.0, 1.0, step=0.02),
            "length_mm": base.OpticalParameter(0.0, 0.0, 20.0, "mm"),
        }
    )

    def prepare(self, table: LookupTable, leds: Leds, **values: float) -> dict[str, Any]:
        """The lights at their height, and the gel without them."""
        leds, length_mm = leds or leds_of_table(table), values.get("length_mm", 0.0)
        return {
            "leds": _lowered(leds, float(length_mm)) if length_mm else leds,
            "unlit": unlit_image(table),
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
        strength: float = DEFAULT_STRENGTH,
        leds: Leds = (),
        unlit: FloatArray | None = None,
        **_: Any,
    ) -> None:
        """Darken what the relief of the patch hides."""
        if patch.height_mm is not None and unlit is not None:
            top, bottom, left, right = patch.window
            cast_shadows(
                np.ascontiguousarray(patch.height_mm),
                patch.mm_per_px,
                leds,
                strength,
                unlit[top:bottom, left:right],
                image,
            )

    def candidates(self, scene: base.PressScene) -> list[base.OpticalCandidate]:
        """One strength, and one of a few lengths."""
        strength = {"strength": self.parameters["strength"]}
        starts = tuple({"strength": FIRST_STRENGTH, "length_mm": x} for x in LENGTHS_MM)
        return [base.OpticalCandidate(self.name, "cast by the dent", strength, starts=starts)]


SHADOW = base.register(Shadow())


def with_cast_shadows(
    effects: Mapping[str, Mapping[str, float]],
) -> Mapping[str, Mapping[str, float]]:
    """The effects, and cast shadows of the usual strength where they name none."""
    return {SHADOW.name: {}, **effects}

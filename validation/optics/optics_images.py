"""An independent source of ball presses with one optical effect: nothing of tacgen is imported.

A far-lit Lambertian gel with a faint gloss under a ball (its cap, a tensed skin by K0 outside);
two kinds of sensor. Effects by other formulas than the diagnosis fits: shadow by marching to the
lamps, blur by a Gaussian on the surface, illumination by one lamp at a finite distance, vignetting
by cos⁴, saturation soft at its knee, colours mixed in the camera.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.special import k0, k1

Floats = NDArray[np.float64]

SENSORS: dict[str, dict[str, Any]] = {
    "three": {
        "shape": (120, 160), "mm_per_px": 0.12, "ball_mm": 2.0, "skin_mm": 0.35, "noise": 1.2,
        "lamps": (((0.87, 0.0), (95, 8, 6)), ((-0.43, 0.75), (6, 90, 8)),
                  ((-0.43, -0.75), (8, 6, 90))),
        "height": 0.3, "base": (105.0, 110.0, 100.0), "gloss": 0.15,
    },
    "four": {
        "shape": (150, 130), "mm_per_px": 0.1, "ball_mm": 2.5, "skin_mm": 0.2, "noise": 2.0,
        "lamps": (((0.9, 0.1), (70, 5, 5)), ((-0.1, 0.9), (5, 75, 10)),
                  ((-0.9, -0.1), (10, 10, 80)), ((0.1, -0.9), (25, 25, 25))),
        "height": 0.25, "base": (120.0, 95.0, 115.0), "gloss": 0.05,
    },
}  # fmt: skip

STRENGTHS = {
    "press_center": 0.08,  # contact radii of scatter
    "scale": 0.15,  # labelled radii too large by
    "illumination": 0.5,  # how much brighter a lamp is on its own side
    "shadow": 0.5,  # share of a lamp that is hidden
    "blur": 0.25,  # mm
    "background_gain": 0.05,  # scatter of each picture's exposure and channel
    "vignetting": 0.4,  # loss of light at the corners
    "cross_talk": 0.2,  # share of a channel that leaks
    "saturation": 0.6,  # share of what is brighter than the gel at rest that the camera clips
}


@dataclass(frozen=True)
class Presses:
    images: NDArray[np.uint8]
    background: NDArray[np.uint8]
    center_px: Floats
    radius_px: Floats
    ball_mm: float
    mm_per_px: float


def _through_camera(grey: Floats, effect: str, size: float, x: Floats, y: Floats) -> Floats:
    """Grey levels with the camera's vignetting or cross-talk, where that is the effect."""
    if effect == "vignetting":
        off = np.hypot(x, y) / np.hypot(x, y).max()
        tangent = np.sqrt(max((1 - size) ** -0.5 - 1, 0))
        grey = grey * (1 + (tangent * off) ** 2)[..., None] ** -2
    if effect == "cross_talk":
        leak = np.array(
            [
                [1 - size, size * 0.7, size * 0.3],
                [0.1 * size, 1 - 0.6 * size, 0.5 * size],
                [0.5 * size, 0.2 * size, 1 - 0.7 * size],
            ]
        )
        grey = grey @ leak
    return grey


def make(kind: str, effect: str, strength: float, seed: int, count: int = 28) -> Presses:
    """``count`` presses with ``effect`` at ``strength`` × its nominal; ``effect`` may be ''."""
    rng = np.random.default_rng([seed, sum(map(ord, kind + effect))])
    made = SENSORS[kind]
    size = strength * STRENGTHS.get(effect, 1.0)
    height, width = made["shape"]
    rows, columns = np.mgrid[:height, :width].astype(float)
    ball, scale = made["ball_mm"], made["mm_per_px"]
    x, y = (columns - (width - 1) / 2) * scale, (rows - (height - 1) / 2) * scale

    def photograph(surface: Floats, gain: Any, extra: Floats | None = None) -> Floats:
        grey = _light(made, x, y, surface, effect, size)
        if extra is not None:
            grey = grey + extra
        grey = _through_camera(grey, effect, size, x, y)
        return grey * gain

    rest = photograph(0 * x, 1.0)
    at_px, radii_px, pictures = [], [], []
    for k in range(count):
        cx, cy = rng.uniform(0.2, 0.8) * width, rng.uniform(0.2, 0.8) * height
        contact = ball * rng.uniform(0.45, 0.72)
        surface = _dent(
            x - (cx - (width - 1) / 2) * scale,
            y - (cy - (height - 1) / 2) * scale,
            contact,
            ball,
            made["skin_mm"],
        )
        if effect == "blur":
            surface = gaussian_filter(surface, size / scale)
        gain = 1 + (size * rng.normal(size=3) if effect == "background_gain" else np.zeros(3))
        extra = None
        if effect == "scratch":
            extra = (
                -40 * size * np.exp(-(((x - 2.0) / 1.5) ** 2 + ((y + 1.0) / 0.6) ** 2))[..., None]
            )
        if effect == "ageing":  # the dent's colours fade as presses go by
            fade = 1 - 0.5 * size * k / count
            pictures.append(rest + (photograph(surface, 1.0) - rest) * fade)
        else:
            pictures.append(photograph(surface, gain, extra))
        at_px.append(np.array([cx, cy]))
        radii_px.append(contact / scale)
    images = np.array(pictures)
    background = rest
    if effect == "saturation":
        rest_level = max(made["base"])
        level = rest_level + (1 - size) * (np.quantile(np.array(pictures), 0.9999) - rest_level)
        images, background = (
            np.asarray(level - 2 * np.logaddexp(0, (level - a) / 2)) for a in (images, rest)
        )
    centers, radii = np.array(at_px), np.array(radii_px)
    if effect == "press_center":
        centers = centers + size * radii[:, None] * rng.normal(size=centers.shape)
    if effect == "scale":
        radii = radii * (1 + size)

    def shot(a: Floats) -> NDArray[np.uint8]:
        return np.rint(np.clip(a + rng.normal(0, made["noise"], a.shape), 0, 255)).astype(np.uint8)

    return Presses(shot(images), shot(background), centers, radii, ball, scale)


def _dent(dx: Floats, dy: Floats, contact: float, ball: float, skin: float) -> Floats:
    r = np.hypot(dx, dy)
    rim = contact / np.sqrt(ball**2 - contact**2)
    edge = -rim * skin * k0(contact / skin) / k1(contact / skin)
    cap = ball - np.sqrt(ball**2 - np.minimum(r, contact) ** 2)
    inside = edge + cap - (ball - np.sqrt(ball**2 - contact**2))
    outside = edge * k0(np.maximum(r, contact) / skin) / k0(contact / skin)
    return np.where(r < contact, inside, outside)


def _light(
    made: dict[str, Any], x: Floats, y: Floats, surface: Floats, effect: str, size: float
) -> Floats:
    scale = made["mm_per_px"]
    slope_y, slope_x = np.gradient(surface, scale)
    length = np.sqrt(1 + slope_x**2 + slope_y**2)
    grey = np.tile(np.array(made["base"]), (*x.shape, 1))
    for (lx, ly), rgb in made["lamps"]:
        rise = made["height"]
        norm = np.sqrt(lx * lx + ly * ly + rise * rise)
        facing = (slope_x * lx + slope_y * ly + rise) / (length * norm)
        level = rise / norm
        glint = made["gloss"] * (np.maximum(facing, 0) ** 6 - level**6)
        lit = np.maximum(facing, 0) - level + glint
        if effect == "shadow":
            hidden = _hidden(surface, scale, lx / norm, ly / norm, rise / norm)
            lit = lit - size * hidden * np.maximum(facing, 0)
        if effect == "illumination":
            lit = lit * np.exp(size * (x * lx + y * ly) / (0.5 * np.abs(x).max()) / 2)
        grey = grey + lit[..., None] * np.array(rgb)
    return grey


def _hidden(surface: Floats, scale: float, lx: float, ly: float, lz: float) -> Floats:
    flat = np.hypot(lx, ly)
    rows, columns = np.indices(surface.shape, dtype=float)
    worst = np.zeros(surface.shape)
    for step in np.arange(1.0, 4.0 / scale, 1.0):
        seen = map_coordinates(
            surface, [rows + step * ly / flat, columns + step * lx / flat], order=1, mode="nearest"
        )
        worst = np.maximum(worst, surface - step * scale * lz / flat - seen)
    return np.clip(worst / 0.08, 0, 1)

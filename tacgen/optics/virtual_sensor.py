"""A virtual GelSight: coloured lights, a painted gel and a camera, by physics and not by table.

It replaces a real sensor: its ball presses are what the shipped tables are fitted to, and
what tests compare the table renderer with. It shares no code with the renderer. Its figures are
those that agree best with real presses of a GelSight (``docs/explanation/contact_optics.md``).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

from tacgen.core.records import Sensor
from tacgen.core.types import FloatArray

KNEE = 0.9  # share of full scale at which the camera begins to saturate


@dataclass(frozen=True, slots=True)
class Led:
    """A light inside the sensor: where it is in the gel frame (z < 0) and its RGB strength."""

    position_mm: tuple[float, float, float]
    rgb: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Paint:
    """The gel's reflective skin: Lambertian, with a broad highlight."""

    diffuse: float = 0.85
    specular: float = 0.08
    shininess: float = 6.0


@dataclass(frozen=True, slots=True)
class VirtualSensor:
    """A vision-based tactile sensor made of a few physical parts.

    The camera looks along −z of the gel frame, orthographically. ``ambient_rgb`` is scattered in
    the gel and reaches every slope alike; so does ``glare``, which leaks from each light along the
    gel: a lobe at the window's edge, of this share of the light's strength. Irradiance 1 at the
    gel's centre, at rest, is the share ``exposure`` of full scale, and the camera's response is
    grey = 255 (exposure · irradiance)^(1/gamma), softly saturating. ``shadow`` is the share of a
    light that its cast shadow removes; the skin bridges what is finer than ``blur_mm``: a Gaussian
    on the height map. ``noise_grey`` is the standard deviation of the camera's noise.
    """

    height_px: int
    width_px: int
    mm_per_px: float
    leds: tuple[Led, ...]
    paint: Paint = field(default_factory=Paint)
    ambient_rgb: tuple[float, float, float] = (0.95, 0.95, 0.95)
    glare: float = 0.3
    exposure: float = 0.30
    gamma: float = 1.0
    shadow: float = 0.0
    blur_mm: float = 0.0
    noise_grey: float = 0.0

    @classmethod
    def like(
        cls,
        sensor: Sensor,
        *,
        distance_mm: float | None = None,
        shadow: float = 0.0,
        blur_mm: float = 0.0,
        noise_grey: float = 0.0,
    ) -> "VirtualSensor":
        """The virtual counterpart of ``sensor``, its lights around the window.

        ``distance_mm`` is that of each light from the gel's centre; by default 2.4 times half of
        the window's diagonal.
        """
        half_mm = 0.5 * math.hypot(*sensor.shape_px) * sensor.mm_per_px
        reach_mm = distance_mm or 2.4 * half_mm
        leds = tuple(
            Led((x * reach_mm, y * reach_mm, z * reach_mm), rgb) for (x, y, z), rgb in sensor.leds
        )
        return cls(
            sensor.height_px,
            sensor.width_px,
            sensor.mm_per_px,
            leds,
            shadow=shadow,
            blur_mm=blur_mm,
            noise_grey=noise_grey,
        )

    def render(
        self, height_map_mm: NDArray[np.floating], rng: np.random.Generator | None = None
    ) -> NDArray[np.uint8]:
        """The picture (H, W, 3), RGB, of a gel surface (H, W) in the gel frame, mm."""
        return np.rint(np.clip(self.grey_levels(height_map_mm, rng), 0, 255)).astype(np.uint8)

    def grey_levels(
        self, height_map_mm: NDArray[np.floating], rng: np.random.Generator | None = None
    ) -> NDArray[np.float64]:
        """The same before rounding to 8 bits."""
        height = np.asarray(height_map_mm, dtype=np.float64)
        if self.blur_mm > 0:
            height = gaussian_filter(height, self.blur_mm / self.mm_per_px, mode="nearest")
        slope_y, slope_x = (np.asarray(g) for g in np.gradient(height, self.mm_per_px))
        rows, columns = np.indices(height.shape)
        x_mm = np.asarray((columns + 0.5 - self.width_px / 2) * self.mm_per_px)
        y_mm = np.asarray((rows + 0.5 - self.height_px / 2) * self.mm_per_px)
        hidden = [
            self.shadow * self._hidden(height, led) if self.shadow > 0 else 0.0 for led in self.leds
        ]
        grey = self.shade(x_mm, y_mm, height, slope_x, slope_y, hidden)
        if rng is not None and self.noise_grey > 0:
            grey = grey + rng.normal(0, self.noise_grey, grey.shape)
        return grey

    def shade(
        self,
        x_mm: FloatArray,
        y_mm: FloatArray,
        z_mm: FloatArray,
        slope_x: FloatArray,
        slope_y: FloatArray,
        hidden: Sequence[FloatArray | float] | None = None,
    ) -> NDArray[np.float64]:
        """Grey levels (…, 3) of surface points with given slopes.

        ``hidden`` is the share of each light that does not arrive. The brightness of each light is
        given at the gel's centre; it falls off with the square of the distance.
        """
        length = np.sqrt(1 + slope_x**2 + slope_y**2)
        normal = np.stack([slope_x / length, slope_y / length, -1 / length], axis=-1)
        point = np.stack(np.broadcast_arrays(x_mm, y_mm, z_mm), axis=-1)
        view = np.array([0.0, 0.0, -1.0])
        light = np.zeros(normal.shape) + np.asarray(self.ambient_rgb)
        for led, lost in zip(self.leds, hidden or [0.0] * len(self.leds), strict=True):
            ray = np.asarray(led.position_mm) - point
            distance = np.linalg.norm(ray, axis=-1, keepdims=True)
            ray = ray / distance
            half = ray + view
            half = half / np.linalg.norm(half, axis=-1, keepdims=True)
            facing = np.maximum(0, (normal * ray).sum(axis=-1))
            glint = np.maximum(0, (normal * half).sum(axis=-1)) ** self.paint.shininess
            falloff = np.linalg.norm(led.position_mm) ** 2 / distance[..., 0] ** 2
            reflected = self.paint.diffuse * facing + self.paint.specular * glint * (facing > 0)
            light += ((1 - lost) * falloff * reflected)[..., None] * np.asarray(led.rgb)
        light += self._leaked(point)
        response = (self.exposure * light) ** (1 / self.gamma)
        # A soft shoulder: linear up to KNEE of full scale, reaching it only at infinity.
        over = np.maximum(0, response - KNEE)
        return np.asarray(
            255 * (np.minimum(response, KNEE) + (1 - KNEE) * (1 - np.exp(-over / (1 - KNEE))))
        )

    def _leaked(self, point: FloatArray) -> FloatArray:
        """Glare (…, 3) at surface points (…, 3)."""
        half_mm = 0.5 * math.hypot(self.height_px, self.width_px) * self.mm_per_px
        light = np.zeros(point.shape)
        for led in self.leds:
            x, y, _ = led.position_mm
            edge = half_mm / max(math.hypot(x, y), 1e-9)
            square = (point[..., 0] - edge * x) ** 2 + (point[..., 1] - edge * y) ** 2
            lobe = np.exp(-0.5 * square / (0.4 * half_mm) ** 2)
            light += self.glare * lobe[..., None] * np.asarray(led.rgb)
        return light

    def _hidden(self, height: NDArray[np.float64], led: Led) -> NDArray[np.float64]:
        """How much of a light the relief hides from each pixel: rays stepped to the light."""
        x, y, z = led.position_mm
        rows, columns = np.indices(height.shape, dtype=np.float64)
        to_column = (x / self.mm_per_px + self.width_px / 2 - 0.5) - columns
        to_row = (y / self.mm_per_px + self.height_px / 2 - 0.5) - rows
        length_px = np.hypot(to_column, to_row)
        relief_mm = float(height.max() - height.min())
        rise = (height - z) / np.maximum(length_px, 1e-6)
        reach_px = min(float(length_px.max()), relief_mm / max(float(rise.min()), 1e-9))
        worst = np.zeros(height.shape)
        for step_px in np.arange(1.0, reach_px, 1.0):
            share = step_px / np.maximum(length_px, 1e-6)
            place = [rows + share * to_row, columns + share * to_column]
            met = map_coordinates(height, place, order=1, mode="nearest")
            worst = np.maximum(worst, np.where(share < 1, height - rise * step_px - met, 0))
        return np.clip(worst / 0.1, 0, 1)

"""The gel at rest: its dome, and the pixel grid of its window."""

import numpy as np

from tacgen.contact.raster import Float64
from tacgen.core.errors import ContactError
from tacgen.core.records import Sensor
from tacgen.core.types import FloatArray

GEL_MARGIN_MM = 5.0
"""Of gel around the window, where a sensor's file does not say: between the 2.5 mm around that of
the GelSight of Si et al. and the 7 mm to the rim of a GelSight Mini, 32 × 28 mm."""


def pixel_centers_mm(sensor: Sensor) -> tuple[FloatArray, FloatArray]:
    """Centres of the pixels: x of every column (W,) and y of every row (H,), gel frame, mm."""
    s = sensor.mm_per_px
    x_mm = (np.arange(sensor.width_px) + 0.5 - sensor.width_px / 2) * s
    y_mm = (np.arange(sensor.height_px) + 0.5 - sensor.height_px / 2) * s
    return x_mm, y_mm


def px_to_mm(places_px: FloatArray, shape_px: tuple[int, int], mm_per_px: float) -> FloatArray:
    """Columns and rows (…, 2) of a picture (height, width) as places x, y in the gel frame, mm."""
    middle = np.array(shape_px[::-1]) / 2 - 0.5
    return np.asarray((places_px - middle) * mm_per_px)


def mm_to_px(places_mm: FloatArray, shape_px: tuple[int, int], mm_per_px: float) -> FloatArray:
    """Places x, y (…, 2) in the gel frame, mm, as columns and rows of a picture."""
    return np.asarray(places_mm / mm_per_px + np.array(shape_px[::-1]) / 2 - 0.5)


def gel_size_mm(sensor: Sensor) -> tuple[float, float]:
    """Width and height of the whole gel, at least those of the window, mm."""
    window = sensor.width_px * sensor.mm_per_px, sensor.height_px * sensor.mm_per_px
    given = sensor.gel_size_mm or (window[0] + 2 * GEL_MARGIN_MM, window[1] + 2 * GEL_MARGIN_MM)
    return max(window[0], given[0]), max(window[1], given[1])


def gel_map_mm(sensor: Sensor) -> Float64:
    """Rest height of the gel surface (H, W), gel frame, mm: the sag of a sphere cap.

    0 at the centre of the window, negative around it; 0 everywhere for a flat gel (dome radius 0).
    Raises ``ContactError`` if the dome is smaller than the window it should span.
    """
    radius = sensor.dome_radius_mm
    if radius == 0:
        return np.zeros(sensor.shape_px)
    x_mm, y_mm = pixel_centers_mm(sensor)
    square = x_mm[None, :] ** 2 + y_mm[:, None] ** 2
    if square.max() >= radius**2:
        msg = (
            f"sensor {sensor.name}: dome_radius_mm = {radius:g} does not reach the corners of its "
            f"window, {np.sqrt(square.max()):.1f} mm from the centre; "
            "give a larger radius, or 0 for a flat gel"
        )
        raise ContactError(msg)
    # −r²/(R + √(R² − r²)) is −(R − √(R² − r²)) without its cancellation near the centre.
    return -square / (radius + np.sqrt(radius**2 - square))

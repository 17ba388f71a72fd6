"""The tables that ship: ball presses on the virtual sensor, through the calibration of a real one.

``python -m scripts.make_default_tables`` makes them again, beside the sensors' YAML files.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tacgen.calibrate.lookup.table_fit import fit_lookup
from tacgen.contact.gel import gel_map_mm, pixel_centers_mm
from tacgen.contact.indentation import contact_depth
from tacgen.core.arrays import FloatArray
from tacgen.core.records import Sensor
from tacgen.core.resources import packaged
from tacgen.optics.deform import deform
from tacgen.optics.table import LookupTable, save_table
from tacgen.optics.virtual_sensor import VirtualSensor
from tacgen.presses.press_images import PressImages
from tacgen.sensor.description import load_sensor
from validation.optics.sampled_table import with_reference

SENSORS = ("gelsight", "gelsight_mini", "digit")
BALLS_MM = ((2.0, 1.1), (2.5, 0.9), (4.0, 0.9))
"""Radius and depth of the presses; the steepest slope of the first is 63°."""
PRESSES_PER_BALL = 16
NOISE_GREY = 1.0


def ball_height_map_mm(
    sensor: Sensor, center_mm: tuple[float, float], radius_mm: float, depth_mm: float
) -> tuple[FloatArray, FloatArray]:
    """The gel (H, W), gel frame, and its indentation (H, W), ``depth_mm`` after first touch."""
    x_mm, y_mm = pixel_centers_mm(sensor)
    square = (x_mm[None, :] - center_mm[0]) ** 2 + (y_mm[:, None] - center_mm[1]) ** 2
    rest_mm = gel_map_mm(sensor)
    with np.errstate(invalid="ignore"):
        surface = np.where(
            square < radius_mm**2, -np.sqrt(np.maximum(radius_mm**2 - square, 0)), np.inf
        )
    gap = surface - rest_mm
    depth = contact_depth(gap - gap.min(), depth_mm)
    return rest_mm - deform(depth, sensor.mm_per_px), depth


def ball_presses(sensor: Sensor, virtual: VirtualSensor, rng: np.random.Generator) -> PressImages:
    """Labelled ball presses all over the pad, as the virtual sensor sees them."""
    images, centers, radii, balls = [], [], [], []
    half_mm = 0.5 * sensor.mm_per_px * np.array([sensor.width_px, sensor.height_px])
    for radius_mm, depth_mm in BALLS_MM:
        contact_mm = float(np.sqrt(2 * radius_mm * depth_mm - depth_mm**2))
        free_mm = half_mm - contact_mm - 0.3
        for x_mm, y_mm in _spread(PRESSES_PER_BALL, rng) * free_mm:
            height, depth = ball_height_map_mm(sensor, (x_mm, y_mm), radius_mm, depth_mm)
            images.append(virtual.render(height, rng))
            rows, columns = np.nonzero(depth)
            centers.append((columns.mean(), rows.mean()))
            radii.append(np.sqrt(rows.size / np.pi))
            balls.append(radius_mm)
    return PressImages(
        images=np.stack(images),
        background=replace(virtual, noise_grey=0.0).render(gel_map_mm(sensor)),
        names=tuple(f"{k:02d}.png" for k in range(len(images))),
        center_px=np.array(centers),
        radius_px=np.array(radii),
        ball_radius_mm=np.array(balls),
        mm_per_px=sensor.mm_per_px,
        dome_radius_mm=sensor.dome_radius_mm,
        sensor=sensor.name,
    )


def _spread(n: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Places (n, 2) in [−1, 1]², one in each cell of a grid, anywhere within it."""
    side = round(n**0.5)
    cells = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(-1, 2)
    return np.asarray((cells + rng.random(cells.shape)) / side * 2 - 1)


def make_default_table(sensor: Sensor) -> LookupTable:
    """The table of the virtual counterpart of ``sensor``: pressed, fitted, made small."""
    virtual = VirtualSensor.like(sensor, noise_grey=NOISE_GREY)
    rng = np.random.default_rng(np.random.SeedSequence(20260101, spawn_key=(sensor.height_px,)))
    # Pressed on a flat gel: under a dome the contact's circle and the ball's axis part, which the
    # geometry of the fit does not know; what a slope looks like is the same on both.
    fitted = fit_lookup(ball_presses(replace(sensor, dome_radius_mm=0.0), virtual, rng))
    small = replace(
        fitted,
        coefficients=fitted.coefficients.astype(np.float16).astype(np.float32),
        noise_grey=NOISE_GREY,
        provenance={**fitted.provenance, "source": "virtual sensor, scripts.make_default_tables"},
    )
    rest_mm = gel_map_mm(sensor)
    return with_reference(small, rest_mm, virtual.grey_levels(rest_mm))


def main(folder: Path) -> None:
    """Write the tables of the shipped sensors into ``folder``."""
    for name in SENSORS:
        path = folder / f"{name}.table.npz"
        save_table(make_default_table(load_sensor(name, needs_table=False)), path)
        sys.stderr.write(f"{path}\n")


if __name__ == "__main__":
    main(packaged("recipes") / "sensors")

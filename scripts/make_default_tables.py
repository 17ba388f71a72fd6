"""The tables that ship, through the calibration of any sensor, beside the sensors' YAML files.

``python -m scripts.make_default_tables`` makes those of the virtual sensors again, and
``python -m scripts.make_default_tables FOLDER`` those of real ones, from the presses in the folder
``calib`` of the package ``taxim`` 1.4.1 (MIT; Si & Yuan 2022 and T. Schneider).
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from tacgen.calibrate.lookup.table_fit import calibrate, fit_lookup
from tacgen.contact.gel import gel_map_mm, pixel_centers_mm
from tacgen.contact.indentation import contact_depth
from tacgen.core.arrays import FloatArray
from tacgen.core.records import Sensor
from tacgen.core.resources import packaged
from tacgen.optics.deform import deform
from tacgen.optics.table import LookupTable, save_table
from tacgen.optics.virtual_sensor import VirtualSensor
from tacgen.presses.press_folder import read_presses
from tacgen.presses.press_images import PressImages
from tacgen.presses.screening import usable_presses
from tacgen.sensor.description import load_sensor
from validation.optics.sampled_table import with_reference

SENSORS = ("virtual_gelsight", "gelsight_mini", "digit")
REAL = {"gelsight": 0.0295}
"""Sensors with real presses, and mm/px of their pictures."""
PRESS_RADIUS_MM = 2.0
"""Of Taxim's ball."""
SMALL = (24, 48, 13)
"""Nodes of slope, of direction and along the longer side of a table that ships."""
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


def real_presses(name: str, calib: Path) -> PressImages:
    """The presses of a real sensor, at the resolution of the one that ships."""
    sensor, scale = load_sensor(name, needs_table=False), REAL[name]
    presses = read_presses(
        calib / name / "dataPack.npz", mm_per_px=scale, ball_radius_mm=PRESS_RADIUS_MM
    )
    by = presses.shape_px[0] // sensor.height_px
    rows, columns = sensor.shape_px

    def binned(images: NDArray[np.uint8]) -> NDArray[np.uint8]:
        blocks = images.reshape(-1, rows, by, columns, by, 3)
        return np.rint(blocks.mean(axis=(2, 4))).astype(np.uint8)

    return replace(
        presses,
        images=binned(presses.images),
        background=binned(presses.background[None])[0],
        center_px=(presses.center_px + 0.5) / by - 0.5,
        radius_px=presses.radius_px / by,
        mm_per_px=scale * by,
        dome_radius_mm=sensor.dome_radius_mm,
        sensor=name,
    )


def make_real_table(name: str, calib: Path) -> LookupTable:
    """The table of the presses of a real sensor, made small."""
    presses = usable_presses(real_presses(name, calib))
    table = calibrate(presses).table
    assert table.response is not None
    spread = [np.percentile(presses.center_px[:, k], (0, 100)).round() for k in (0, 1)]
    steepest = np.degrees(table.max_slope_rad)
    note = (
        "pressed at columns {:.0f} to {:.0f}, rows {:.0f} to {:.0f}".format(*spread[0], *spread[1])
        + f", slopes up to {steepest:.0f} degrees; beyond that it extrapolates"
    )
    shape = table.response.shape
    n_slope, n_direction, n_columns = SMALL
    n_rows = max(2, round(n_columns * shape[2] / shape[3]))
    sizes = (n_slope, n_direction, n_rows, n_columns)
    at = [np.linspace(0, n - 1, size) for n, size in zip(shape, sizes, strict=False)]
    at[1] = np.arange(n_direction) * shape[1] / n_direction  # directions wrap around
    closed = np.concatenate([table.response, table.response[:, :1]], axis=1)
    background = np.round(table.background * 16) / 16
    return replace(
        table,
        background=background.astype(np.float32),
        coefficients=table.coefficients.astype(np.float16).astype(np.float32),
        response=resampled(closed, at),
        contact=table.contact
        and replace(table.contact, change=resampled(table.contact.change, at[2:])),
        sensor=name,
        provenance={
            **table.provenance,
            "source": f"{len(presses)} real ball presses of the package taxim 1.4.1",
            "license": "MIT",
            "date": "2026-11-27",
            "command": "python -m scripts.make_default_tables FOLDER",
            "note": note,
        },
    )


def resampled(values: NDArray[np.float32], at: list[FloatArray]) -> NDArray[np.float32]:
    """Values on a grid of nodes, linear between them, at other places along its first axes."""
    axes = [np.arange(n, dtype=float) for n in values.shape[: len(at)]]
    points = np.stack(np.meshgrid(*at, indexing="ij"), axis=-1)
    return np.asarray(RegularGridInterpolator(axes, values)(points), np.float32)


def main(folder: Path, calib: Path | None) -> None:
    """Write the tables of the virtual sensors into ``folder``, or those of the real ones."""
    if calib is not None:
        for name in REAL:
            path = folder / f"{name}.table.npz"
            save_table(make_real_table(name, calib), path)
            sys.stderr.write(f"{path}\n")
        return
    for name in SENSORS:
        path = folder / f"{name}.table.npz"
        save_table(make_default_table(load_sensor(name, needs_table=False)), path)
        sys.stderr.write(f"{path}\n")


if __name__ == "__main__":
    given = sys.argv[1:]
    main(packaged("recipes") / "sensors", Path(given[0]) if given else None)

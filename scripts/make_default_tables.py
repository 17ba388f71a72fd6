"""The tables that ship, through the calibration of any sensor, beside the sensors' YAML files.

``python -m scripts.make_default_tables`` makes that of the virtual sensor again, and
``python -m scripts.make_default_tables NAME=PRESSES ...`` those of real ones, from the presses that
``REAL`` names: a folder of pictures, or the package's ``dataPack.npz``.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from scripts.reference_background import with_reference
from tacgen.calibrate.lookup.score import TableScore, score_table
from tacgen.calibrate.lookup.table_fit import Calibration, calibrate, fit_lookup
from tacgen.contact.gel import gel_map_mm, pixel_centers_mm
from tacgen.contact.indentation import contact_depth
from tacgen.core.records import Sensor
from tacgen.core.resources import packaged
from tacgen.core.sensors import load_sensor
from tacgen.core.types import FloatArray
from tacgen.optics.deform import deform
from tacgen.optics.image_models import Response, nearest_quadratic
from tacgen.optics.table import LookupTable, save_table
from tacgen.optics.virtual_sensor import VirtualSensor
from tacgen.presses.press_folder import read_presses
from tacgen.presses.press_images import PressImages
from tacgen.presses.screening import usable_presses

VIRTUAL = "virtual_gelsight"


@dataclass(frozen=True, slots=True)
class Source:
    """Real presses whose licence allows to ship what is fitted to them."""

    presses: str
    """Whose they are, at which state."""
    license: str
    ball_radius_mm: float


REAL = {
    "gelsight": Source("the package taxim 1.4.1, calib/gelsight", "MIT", 2.0),
    "digit": Source("vocdex/Taxim at 4d65458, data/11_14_2022/sphere2", "MIT", 3.0),
    "gelsight_mini": Source("FabPrez/Taxim at 580824b, gsmini_ball5.0", "MIT", 2.5),
}
SMALL = (16, 32)
"""Nodes of slope and direction of a table that ships, half of the fit's: 0.15 grey levels."""
BACKGROUND_STEP_GREY, RESPONSE_STEP_GREY = 0.5, 0.25
"""What its numbers are rounded to: errors of 0.14 and 0.07 grey levels, in a third of the bytes."""
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


def real_presses(name: str, path: Path) -> PressImages:
    """The presses at ``path`` of a real sensor, with the scale and the dome of its YAML file."""
    sensor, source = load_sensor(name, needs_table=False), REAL[name]
    presses = read_presses(path, mm_per_px=sensor.mm_per_px, ball_radius_mm=source.ball_radius_mm)
    return usable_presses(replace(presses, dome_radius_mm=sensor.dome_radius_mm, sensor=name))


def made_small(table: LookupTable) -> LookupTable:
    """The same on fewer nodes and in rounded numbers: as it ships."""
    assert table.response is not None
    shape, (n_slope, n_direction) = table.response.shape, SMALL
    at = [np.linspace(0, shape[0] - 1, n_slope), np.arange(n_direction) * shape[1] / n_direction]
    closed = np.concatenate([table.response, table.response[:, :1]], axis=1)  # directions wrap
    response = _rounded(resampled(closed, at), RESPONSE_STEP_GREY)
    model = Response(response, table.max_slope_rad)
    quadratic = nearest_quadratic(model, table.max_slope_rad, n_slope, n_direction)
    return replace(
        table,
        background=_rounded(table.background, BACKGROUND_STEP_GREY),
        coefficients=quadratic.astype(np.float16).astype(np.float32),
        response=response,
    )


def heldout_score(found: Calibration) -> TableScore:
    """Of the small tables of the folds, each on the presses that were held out of it."""
    presses = found.presses.presses
    scores = [
        iter(score_table(made_small(table), presses.select(found.folds == fold)).presses)
        for fold, table in zip(np.unique(found.folds), found.fold_tables, strict=True)
    ]
    return TableScore(tuple(next(scores[k]) for k in found.folds.tolist()), presses.n_experiments)


def make_real_table(name: str, path: Path) -> LookupTable:
    """The table of the presses of a real sensor, made small, with its own held-out error."""
    found = calibrate(real_presses(name, path))
    presses, source, table = found.presses.presses, REAL[name], made_small(found.table)
    heldout = heldout_score(found).as_dict()
    del heldout["images"]
    left, top = presses.center_px.min(axis=0)
    right, bottom = presses.center_px.max(axis=0)
    note = (
        f"pressed at columns {left:.0f} to {right:.0f}, rows {top:.0f} to {bottom:.0f}, "
        f"slopes up to {np.degrees(table.max_slope_rad):.0f} degrees; beyond that it extrapolates"
    )
    return replace(
        table,
        sensor=name,
        provenance={
            **table.provenance,
            "heldout": heldout,
            "source": f"{len(presses)} real ball presses of {source.presses}",
            "license": source.license,
            "date": "2026-11-29",
            "command": f"python -m scripts.make_default_tables {name}=PRESSES",
            "note": note,
        },
    )


def _rounded(values: NDArray[np.float32], step: float) -> NDArray[np.float32]:
    return np.asarray(np.round(values / step) * step, np.float32)


def resampled(values: NDArray[np.float32], at: list[FloatArray]) -> NDArray[np.float32]:
    """Values on a grid of nodes, linear between them, at other places along its first axes."""
    axes = [np.arange(n, dtype=float) for n in values.shape[: len(at)]]
    points = np.stack(np.meshgrid(*at, indexing="ij"), axis=-1)
    return np.asarray(RegularGridInterpolator(axes, values)(points), np.float32)


def main(given: list[str]) -> None:
    """Write the virtual sensor's table, or those of ``given`` as NAME=PRESSES."""
    folder = packaged("recipes") / "sensors"
    for pair in given or [VIRTUAL]:
        name, _, presses = pair.partition("=")
        path = folder / f"{name}.table.npz"
        if presses:
            save_table(make_real_table(name, Path(presses)), path)
        else:
            save_table(make_default_table(load_sensor(name, needs_table=False)), path)
        sys.stderr.write(f"{path}\n")


if __name__ == "__main__":
    main(sys.argv[1:])

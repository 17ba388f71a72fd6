"""A world small enough for tests: a block, a coarse sensor, and the table that goes with it."""

from pathlib import Path

import numpy as np

from tacgen.optics import LookupTable, save_table

RECIPE = """
name: small
seed: 5
objects: [sugar_box]
sensor: coarse
grid: {force_n: [3, 25], y_mm: [0], z_mm: [60, 90, 140]}
dataset: {shard_size: 2}
physics: {lift_mm: 40, success_rise_mm: 30}
"""
SHORT_LIFT = {"lift_mm": 40.0, "success_rise_mm": 30.0}
"""As in the recipe: decides between held and slipped as the whole lift does, in half the time."""


def write_world(folder: Path, **sections: str) -> Path:
    """A user's folder with a coarse sensor; the path of a recipe for six grasps in three shards.

    ``sections`` are lines of YAML that replace or add top-level keys.
    """
    sensors = folder / "recipes" / "sensors"
    sensors.mkdir(parents=True, exist_ok=True)
    (sensors / "coarse.yaml").write_text(
        "name: coarse\nheight_px: 48\nwidth_px: 64\nmm_per_px: 0.3\ngel_depth_mm: 2.0\n"
        "dome_radius_mm: 30\ntable: coarse.npz\n"
        "markers: {rows: 5, columns: 7, pitch_mm: 2.5, radius_mm: 0.4}\n"
    )
    save_table(slope_table((48, 64), 0.3), sensors / "coarse.npz")
    lines = [line for line in RECIPE.strip().splitlines() if line.split(":")[0] not in sections]
    path = folder / "small.yaml"
    path.write_text("\n".join([*lines, *(f"{key}: {text}" for key, text in sections.items())]))
    return path


def slope_table(shape_px: tuple[int, int], mm_per_px: float) -> LookupTable:
    """Three lights at 120°: each channel changes with the slope towards its light."""
    n_slope, n_direction = 30, 36
    slope = np.tan(np.linspace(0, 1.2, n_slope))[:, None]
    direction = -np.pi + 2 * np.pi * np.arange(n_direction) / n_direction
    coefficients = np.zeros((n_slope, n_direction, 3, 6), np.float32)
    for channel, towards in enumerate((0.5, 2.6, 4.7)):
        coefficients[:, :, channel, 5] = 90 * slope * np.cos(direction - towards)
    background = np.full((*shape_px, 3), 110, np.float32)
    return LookupTable(coefficients, background, mm_per_px, 1.2, noise_grey=1.0)

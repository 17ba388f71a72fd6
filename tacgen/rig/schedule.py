"""The true course of a rig session: forces, positions, clock and temperature, without noise."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.core.arrays import FloatArray
from tacgen.rig.rig_recipe import RigRecipe, Schedule, Temperature

Columns = dict[str, NDArray[Any]]

PRESS, NOISE, CAMERA, ORDER = range(4)
"""Streams of random numbers: a press's course, its samples' noise, its camera, a round's order."""


def press_rng(recipe: RigRecipe, press: int, stream: int) -> np.random.Generator:
    """Random numbers by identity: the same press gets the same, whatever else is pressed."""
    sequence = np.random.SeedSequence(recipe.seed, spawn_key=(press, stream))
    return np.random.default_rng(sequence)


def true_session(recipe: RigRecipe) -> Columns:
    """Columns of a press log but for the response: what was done, exactly."""
    parts: list[Columns] = []
    clock_s = 0.0
    for press in range(recipe.schedule.presses):
        part = _true_press(recipe, press, clock_s)
        clock_s = float(part["time_s"][-1]) + recipe.schedule.rest_s
        parts.append(part)
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _true_press(recipe: RigRecipe, press: int, start_s: float) -> Columns:
    schedule, rng = recipe.schedule, press_rng(recipe, press, PRESS)
    indenter = recipe.indenters[_turn_of(recipe, press)]
    time_s, normal_n, sheared = _course(schedule, rng)
    peak_n = rng.uniform(*schedule.force_n)
    ratio, angle = rng.uniform(*schedule.shear_ratio), rng.uniform(-np.pi, np.pi)
    x_mm, y_mm = rng.uniform(*schedule.x_mm), rng.uniform(*schedule.y_mm)
    n = len(time_s)
    columns: Columns = {
        "trial": np.full(n, press, dtype=np.int64),
        "time_s": start_s + time_s,
        "indenter": np.full(n, indenter.name),
        "radius_mm": np.full(n, indenter.radius_mm),
        "x_mm": np.full(n, x_mm),
        "y_mm": np.full(n, y_mm),
        "force_normal_n": peak_n * normal_n,
        "force_shear_x_n": peak_n * ratio * np.cos(angle) * sheared,
        "force_shear_y_n": peak_n * ratio * np.sin(angle) * sheared,
    }
    if recipe.temperature is not None:
        columns["temperature_c"] = _room(recipe.temperature, columns["time_s"])
    return columns


def _turn_of(recipe: RigRecipe, press: int) -> int:
    """Which ball presses: all in turn, in an order drawn for every round of the session."""
    n_balls = len(recipe.indenters)
    place = press % n_balls
    return int(press_rng(recipe, press - place, ORDER).permutation(n_balls)[place])


def _course(
    schedule: Schedule, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Time, share of the peak normal force, and share of the peak shear force."""
    lengths = np.array([schedule.load_s, schedule.hold_s, 0.5 * schedule.shear_s,
                        0.5 * schedule.shear_s, schedule.unload_s])  # fmt: skip
    lengths *= rng.uniform(1.0 - schedule.jitter, 1.0 + schedule.jitter, len(lengths))
    ends = np.r_[0.0, np.cumsum(lengths)]
    time_s = np.arange(0.0, ends[-1] + 0.5 / schedule.rate_hz, 1.0 / schedule.rate_hz)
    normal = np.interp(time_s, ends, [0.0, 1.0, 1.0, 1.0, 1.0, 0.0])
    sheared = np.interp(time_s, ends, [0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
    return time_s, normal, sheared


def _room(temperature: Temperature, time_s: FloatArray) -> FloatArray:
    swing = np.sin(2.0 * np.pi * time_s / temperature.period_s)
    return np.asarray(temperature.mean_c + temperature.swing_c * swing)

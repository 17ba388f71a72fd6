"""The true course of a rig session: forces, positions, clock and temperature, without noise."""

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tacgen.contact.effects import find_effect
from tacgen.contact.effects.tilt import TILT
from tacgen.core.errors import RecipeError
from tacgen.core.records import csv_problem
from tacgen.core.types import FloatArray
from tacgen.rig.rig_recipe import RigRecipe, Temperature

Columns = dict[str, NDArray[Any]]

PRESS, NOISE, CAMERA, ORDER, MARKERS, ASKEW = range(6)
"""Streams of random numbers: a press's course, its samples' noise, its camera, a round's order, its
dots' noise, its tilt."""
TILT_DEG = 5.0  # standard deviation about each axis, of presses that an effect lets tilt matter to


def press_rng(recipe: RigRecipe, press: int, stream: int) -> np.random.Generator:
    """Random numbers by identity: the same press gets the same, whatever else is pressed."""
    sequence = np.random.SeedSequence(recipe.seed, spawn_key=(press, stream))
    return np.random.default_rng(sequence)


@dataclass(frozen=True, slots=True)
class Press:
    """One press: load, hold, shear out and back, unload, and the rest that follows.

    ``shear_ratio`` is the peak shear force over ``force_n``, in the direction ``shear_angle_rad``
    of the gel's plane; ``x_mm`` and ``y_mm`` are the contact's centre in the gel frame.
    """

    indenter: str
    force_n: float
    shear_ratio: float
    shear_angle_rad: float
    x_mm: float
    y_mm: float
    load_s: float
    hold_s: float
    shear_out_s: float
    shear_back_s: float
    unload_s: float
    rest_s: float


SHORTEST_S = 1e-3  # of a range that begins at 0: a fiftieth of a usual sample
PRESS_COLUMNS = tuple(field.name for field in fields(Press))
"""Columns of a file of presses to follow."""


def true_session(recipe: RigRecipe) -> Columns:
    """Columns of a press log but for the response: what was done, exactly."""
    parts: list[Columns] = []
    clock_s = 0.0
    for number, press in enumerate(session_presses(recipe)):
        parts.append(press_course(recipe, press, number, clock_s))
        clock_s = float(parts[-1]["time_s"][-1]) + press.rest_s
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def session_presses(recipe: RigRecipe) -> list[Press]:
    """The presses of a session: those drawn from the schedule, then those it follows."""
    drawn = [draw_press(recipe, number) for number in range(recipe.schedule.presses)]
    path = recipe.schedule.follow_path
    names = [indenter.name for indenter in recipe.indenters]
    return drawn if path is None else drawn + read_presses(path, names)


def read_presses(path: Path, indenters: Sequence[str]) -> list[Press]:
    """The presses of a CSV file with the columns ``PRESS_COLUMNS``, made with ``indenters``.

    Raises ``RecipeError`` that names the file and what is wrong.
    """
    try:
        table = pd.read_csv(path, dtype=str, keep_default_na=False)
    except (OSError, ValueError) as error:
        msg = f"{path}: cannot be read as presses to follow: {csv_problem(error)}"
        raise RecipeError(msg) from None
    if not isinstance(table.index, pd.RangeIndex):
        msg = f"{path}: its rows have more cells than its header; quote cells with commas"
        raise RecipeError(msg)
    if missing := [name for name in PRESS_COLUMNS if name not in table]:
        msg = f"{path}: lacks the columns {', '.join(missing)}; give one row for each press"
        raise RecipeError(msg)
    numbers = table[list(PRESS_COLUMNS[1:])].apply(pd.to_numeric, errors="coerce")
    presses = []
    for row, values in enumerate(numbers.to_dict("records")):
        indenter, where = table["indenter"][row], f"{path}, row {row + 2}"
        if bad := [name for name, value in values.items() if not _is_possible(name, value)]:
            name = str(bad[0])
            msg = f"{where}: {name} = {table[name][row]!r} cannot be made; correct it"
            raise RecipeError(msg)
        if indenter not in indenters:
            msg = (
                f"{where}: indenter {indenter!r} is none of the recipe's "
                f"({', '.join(indenters)}); add it under `indenters:` or correct the row"
            )
            raise RecipeError(msg)
        presses.append(Press(indenter, **{str(name): value for name, value in values.items()}))
    return presses


def _is_possible(name: Hashable, value: float) -> bool:
    """Whether a press can have that figure; NaN is none."""
    if name in ("shear_angle_rad", "x_mm", "y_mm"):
        return math.isfinite(value)
    return (
        0 < value < math.inf if name in ("force_n", "load_s", "unload_s") else 0 <= value < math.inf
    )


def draw_press(recipe: RigRecipe, number: int) -> Press:
    """The press of that number as the schedule draws it."""
    schedule, rng = recipe.schedule, press_rng(recipe, number, PRESS)
    load, hold, shear, unload = (
        _duration(given, rng)
        for given in (schedule.load_s, schedule.hold_s, schedule.shear_s, schedule.unload_s)
    )
    lengths = np.array([load, hold, 0.5 * shear, 0.5 * shear, unload])
    lengths *= rng.uniform(1.0 - schedule.jitter, 1.0 + schedule.jitter, len(lengths))
    force_n = rng.uniform(*schedule.force_n)
    ratio, angle = rng.uniform(*schedule.shear_ratio), rng.uniform(-np.pi, np.pi)
    x_mm, y_mm = rng.uniform(*schedule.x_mm), rng.uniform(*schedule.y_mm)
    indenter = recipe.indenters[_turn_of(recipe, number)].name
    load_s, hold_s, out_s, back_s, unload_s = lengths.tolist()
    return Press(
        indenter=indenter,
        force_n=force_n,
        shear_ratio=ratio,
        shear_angle_rad=angle,
        x_mm=x_mm,
        y_mm=y_mm,
        load_s=load_s,
        hold_s=hold_s,
        shear_out_s=out_s,
        shear_back_s=back_s,
        unload_s=unload_s,
        rest_s=schedule.rest_s,
    )


def _duration(given: float | tuple[float, float], rng: np.random.Generator) -> float:
    """A length of time; one of a range is drawn evenly on a logarithmic scale."""
    if not isinstance(given, tuple):
        return given
    low, high = np.log(np.maximum(given, SHORTEST_S))
    return float(np.exp(rng.uniform(low, high))) if given[1] > 0 else 0.0


def press_course(recipe: RigRecipe, press: Press, number: int, start_s: float) -> Columns:
    """The columns of one press, sampled at the schedule's rate from ``start_s`` on."""
    radii_mm = {indenter.name: indenter.radius_mm for indenter in recipe.indenters}
    lengths = (press.load_s, press.hold_s, press.shear_out_s, press.shear_back_s, press.unload_s)
    ends = np.r_[0.0, np.cumsum(lengths)]
    rate_hz = recipe.schedule.rate_hz
    time_s = np.arange(0.0, ends[-1] + 0.5 / rate_hz, 1.0 / rate_hz)
    normal = np.interp(time_s, ends, [0.0, 1.0, 1.0, 1.0, 1.0, 0.0])
    sheared = np.interp(time_s, ends, [0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
    n, peak_n = len(time_s), press.force_n
    columns: Columns = {
        "trial": np.full(n, number, dtype=np.int64),
        "time_s": start_s + time_s,
        "indenter": np.full(n, press.indenter),
        "radius_mm": np.full(n, radii_mm[press.indenter]),
        "x_mm": np.full(n, press.x_mm),
        "y_mm": np.full(n, press.y_mm),
        "force_normal_n": peak_n * normal,
        "force_shear_x_n": peak_n * press.shear_ratio * np.cos(press.shear_angle_rad) * sheared,
        "force_shear_y_n": peak_n * press.shear_ratio * np.sin(press.shear_angle_rad) * sheared,
    }
    if recipe.temperature is not None:
        columns["temperature_c"] = _room(recipe.temperature, columns["time_s"])
    if any(set(TILT) <= set(find_effect(e.channel, e.name).needs) for e in recipe.effects):
        tilt_deg = press_rng(recipe, number, ASKEW).normal(0.0, TILT_DEG, len(TILT))
        columns |= {name: np.full(n, one) for name, one in zip(TILT, tilt_deg, strict=True)}
    return columns


def _turn_of(recipe: RigRecipe, press: int) -> int:
    """Which ball presses: all in turn, in an order drawn for every round of the session."""
    n_balls = len(recipe.indenters)
    place = press % n_balls
    return int(press_rng(recipe, press - place, ORDER).permutation(n_balls)[place])


def _room(temperature: Temperature, time_s: FloatArray) -> FloatArray:
    swing = np.sin(2.0 * np.pi * time_s / temperature.period_s)
    return np.asarray(temperature.mean_c + temperature.swing_c * swing)

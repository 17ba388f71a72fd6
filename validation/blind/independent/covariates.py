"""What else is known of each press: where, with what, by whom, how warm, how humid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from validation.blind.independent.draws import Floats, uniform

Names = NDArray[np.str_]


@dataclass(frozen=True)
class Covariates:
    """One value a trial, (K,), but of the temperature, which has one a fine step, (K, N)."""

    x_mm: Floats
    y_mm: Floats
    indenter: Names
    radius_mm: Floats
    """NaN for a flat indenter."""
    temperature_c: Floats
    humidity_percent: Floats
    operator: Names
    operators: tuple[str, ...]


def draw_covariates(
    rng: np.random.Generator, progress: Floats, sampled: NDArray[np.bool_], many_indenters: bool
) -> Covariates:
    """The covariates of a session; ``progress`` (K, N) runs from 0 to 1 over it."""
    n_trials = len(progress)
    x_mm, y_mm = _draw_positions(rng, n_trials)
    indenter, radius_mm = _draw_indenters(rng, n_trials, many_indenters)
    temperature_c = _draw_temperature(rng, progress, sampled)
    humidity = uniform(rng, 35, 55) + uniform(rng, 4, 9) * rng.normal(size=n_trials)
    operator, operators = _draw_operators(rng, n_trials)
    return Covariates(
        x_mm=x_mm,
        y_mm=y_mm,
        indenter=indenter,
        radius_mm=radius_mm,
        temperature_c=temperature_c,
        humidity_percent=np.clip(humidity, 10, 90),
        operator=operator,
        operators=operators,
    )


def _draw_positions(rng: np.random.Generator, n_trials: int) -> tuple[Floats, Floats]:
    """Places on the gel: a grid in a random order, or anywhere."""
    if rng.random() >= 0.4:
        return rng.uniform(-8, 8, n_trials), rng.uniform(-8, 8, n_trials)
    n_lines = int(rng.integers(3, 6))
    lines = np.linspace(-1, 1, n_lines) * uniform(rng, 5, 8)
    x, y = np.meshgrid(lines, lines)
    rounds = [rng.permutation(n_lines**2) for _ in range(n_trials // n_lines**2 + 1)]
    order = np.concatenate(rounds)[:n_trials]
    return x.ravel()[order], y.ravel()[order]


def _draw_indenters(rng: np.random.Generator, n_trials: int, many: bool) -> tuple[Names, Floats]:
    """Balls and perhaps a flat punch: at random, in turn, or in blocks."""
    n_balls = int(rng.integers(3 if many else 1, 5))
    balls_mm = sorted(rng.choice([2.0, 3.0, 4.0, 6.35], n_balls, replace=False))
    heads = [(f"ball_{radius:g}mm", float(radius)) for radius in balls_mm]
    if rng.random() < 0.35:
        heads.append(("flat_8mm", np.nan))
    n_heads = len(heads)
    if rng.random() < 0.5:
        order = rng.integers(n_heads, size=n_trials)
    else:
        order = rng.permutation(np.arange(n_trials) % n_heads)
    if rng.random() < 0.3:
        blocks = rng.permutation(np.tile(np.arange(n_heads), 3))
        order = np.repeat(blocks, -(-n_trials // (3 * n_heads)))[:n_trials]
    names, radii_mm = zip(*heads, strict=True)
    return np.array(names)[order], np.array(radii_mm)[order]


def _draw_temperature(
    rng: np.random.Generator, progress: Floats, sampled: NDArray[np.bool_]
) -> Floats:
    """A room that wanders, perhaps a heated plate, with most of the trend in time taken out."""
    course = np.zeros_like(progress)
    for _ in range(3):
        size, periods = rng.normal(), uniform(rng, 1, 3.5)
        course += size * np.sin(2 * np.pi * (progress * periods + rng.random()))
    if rng.random() < 0.4:
        n_trials = len(progress)
        levels = rng.uniform(-1, 1, n_trials)
        plate = np.repeat(levels, int(rng.integers(1, 5)))[:n_trials]
        course = 0.5 * course / course.std() + 1.5 * plate[:, None]
    trend = np.polyfit(progress[sampled], course[sampled], 1)
    course = course - uniform(rng, 0.6, 1) * np.polyval(trend, progress)
    mean_c, range_c = uniform(rng, 20, 28), uniform(rng, 3, 8)
    return mean_c + course * range_c / np.ptp(course[sampled])


def _draw_operators(rng: np.random.Generator, n_trials: int) -> tuple[Names, tuple[str, ...]]:
    """Who pressed, in turns or in short shifts, and all who did."""
    shuffled = rng.permutation(["anna", "bo", "chen", "dmitri", "eve"])
    names = shuffled[: int(rng.integers(2, 5))]
    if rng.random() < 0.5:
        order = rng.permutation(np.arange(n_trials) % len(names))
    else:
        length = max(2, n_trials // int(rng.integers(8, 13)))
        shifts = np.concatenate([rng.permutation(len(names)) for _ in range(20)])
        order = np.repeat(shifts, length)[:n_trials]
    return names[order], tuple(str(name) for name in names)

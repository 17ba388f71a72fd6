"""Press schedules: what forces a rig applies over a trial, and when."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class TrialLoad:
    """One press: time from its start (n,), normal force (n,), shear force (n, 2)."""

    time_s: Floats
    force_normal_n: Floats
    force_shear_n: Floats


def _polyline(knots_s: Floats, knots: Floats, time_s: Floats) -> Floats:
    return np.interp(time_s, knots_s, knots)


def triangle(time_s: Floats, peak_n: float, rng: np.random.Generator) -> Floats:
    """Up at one speed, down at another, a moment of nothing at both ends."""
    end = time_s[-1]
    apex = rng.uniform(0.35, 0.65) * end
    return _polyline(
        np.array([0.0, 0.06 * end, apex, 0.93 * end, end]), np.array([0, 0, peak_n, 0, 0.0]), time_s
    )


def trapezoid(time_s: Floats, peak_n: float, rng: np.random.Generator) -> Floats:
    """Up, hold, down."""
    end = time_s[-1]
    rise, fall = rng.uniform(0.1, 0.25) * end, rng.uniform(0.7, 0.85) * end
    knots_s = np.array([0.0, 0.04 * end, rise, fall, 0.96 * end, end])
    return _polyline(knots_s, np.array([0, 0, peak_n, peak_n, 0, 0.0]), time_s)


def staircase(time_s: Floats, peak_n: float, rng: np.random.Generator) -> Floats:
    """Steps up and steps down with short ramps between the treads."""
    end = time_s[-1]
    n_up = int(rng.integers(2, 5))
    levels = np.r_[0.0, np.arange(1, n_up + 1), np.arange(n_up - 1, -1, -1)] * peak_n / n_up
    starts = np.linspace(0.0, end, len(levels) + 1)[:-1]
    ramp = 0.25 * (starts[1] - starts[0])
    knots_s = np.ravel(np.column_stack([starts, starts + (starts[1] - starts[0]) - ramp]))
    return _polyline(knots_s, np.repeat(levels, 2), time_s)


def wandering(time_s: Floats, peak_n: float, rng: np.random.Generator) -> Floats:
    """A smooth random force between nothing and the peak."""
    end = time_s[-1]
    n_knots = int(rng.integers(6, 11))
    levels = rng.uniform(0.05, 1.0, n_knots) * peak_n
    levels[[0, -1]] = 0.0
    levels[rng.integers(1, n_knots - 1)] = peak_n
    phase = np.clip(time_s / end, 0.0, 1.0) * (n_knots - 1)
    low = np.minimum(phase.astype(int), n_knots - 2)
    eased = 0.5 - 0.5 * np.cos(np.pi * (phase - low))
    return levels[low] + (levels[low + 1] - levels[low]) * eased


def cycles(time_s: Floats, peak_n: float, rng: np.random.Generator) -> Floats:
    """Several loads and unloads whose peaks differ."""
    end = time_s[-1]
    n_cycles = int(rng.integers(2, 5))
    index = np.minimum((time_s / end * n_cycles).astype(int), n_cycles - 1)
    heights = rng.uniform(0.4, 1.0, n_cycles)
    heights[rng.integers(n_cycles)] = 1.0
    return peak_n * heights[index] * np.sin(np.pi * time_s / end * n_cycles) ** 2


def sinusoid(time_s: Floats, peak_n: float, rng: np.random.Generator) -> Floats:
    """Up to a mean, an oscillation about it, and off."""
    end = time_s[-1]
    turns, depth = int(rng.integers(2, 6)), rng.uniform(0.3, 0.9)
    on = np.clip(time_s / (0.12 * end), 0, 1) * np.clip((0.97 - time_s / end) / 0.1, 0, 1)
    wave = 0.5 - 0.5 * np.cos(2 * np.pi * turns * time_s / end)
    return peak_n * on * (1.0 - depth + depth * wave)


def quick_release(time_s: Floats, peak_n: float, rng: np.random.Generator) -> Floats:
    """A slow ramp, a short hold, and let go."""
    end = time_s[-1]
    top = rng.uniform(0.5, 0.7) * end
    knots_s = np.array([0.0, 0.05 * end, top, 0.85 * end, 0.9 * end, end])
    return _polyline(knots_s, np.array([0, 0, peak_n, peak_n, 0, 0.0]), time_s)


SCHEDULES = {
    "triangle": triangle,
    "trapezoid": trapezoid,
    "staircase": staircase,
    "wandering": wandering,
    "cycles": cycles,
    "sinusoid": sinusoid,
    "quick_release": quick_release,
}


def shear_course(
    time_s: Floats, force_normal_n: Floats, ratio: float, rng: np.random.Generator
) -> Floats:
    """Tangential force (n, 2), at most ``ratio`` × the normal force, ramped or cycled."""
    end = time_s[-1]
    angle = rng.uniform(-np.pi, np.pi)
    direction = np.array([np.cos(angle), np.sin(angle)])
    window = np.clip((time_s / end - 0.15) / 0.15, 0, 1) * np.clip(
        (0.9 - time_s / end) / 0.15, 0, 1
    )
    if rng.random() < 0.5:
        turns = int(rng.integers(1, 4))
        course = np.sin(2 * np.pi * turns * time_s / end + rng.uniform(0, 2 * np.pi))
    else:
        course = np.ones_like(time_s)
    return (ratio * force_normal_n * window * course)[:, None] * direction


def draw_trial(
    schedule: str, peak_n: float, shear_ratio: float, n_samples: float, rng: np.random.Generator
) -> TrialLoad:
    """One press by a schedule, of about ``n_samples`` samples; its length is drawn too."""
    duration_s = rng.uniform(3.0, 12.0)
    count = max(int(n_samples * rng.uniform(0.7, 1.3)), 20)
    time_s = np.linspace(0.0, duration_s, count)
    force = SCHEDULES[schedule](time_s, peak_n, rng)
    return TrialLoad(time_s, force, shear_course(time_s, force, shear_ratio, rng))

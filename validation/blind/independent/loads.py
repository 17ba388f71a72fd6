"""The forces of each press: a schedule's profile on the camera's clock, within the friction."""

from __future__ import annotations

from collections.abc import Set
from dataclasses import dataclass

import numpy as np

from validation.blind.independent.draws import Floats, log_uniform, uniform
from validation.blind.independent.rigs import Plan, Rig
from validation.blind.independent.schedules import SCHEDULES, SHEARING

FINE_STEPS = 6
"""Steps of the fine clock in a camera frame: what depends on the history is integrated on it."""


@dataclass(frozen=True)
class Load:
    """One press on the fine clock: time (n,), normal force (n,) and shear force (n, 2)."""

    time_s: Floats
    force_n: Floats
    shear_n: Floats


@dataclass(frozen=True)
class Habits:
    """What all presses of a session share."""

    friction: float
    share_of_friction: float
    """The shear force is at most this share of the friction."""
    slips: bool
    frame_rate_hz: int
    speed_n_per_s: float
    speed_spread: float
    slowest_n_per_s: float
    directions: str
    n_compass: int
    plane_rad: float
    jitter: float
    least_force_n: float


def draw_habits(
    rng: np.random.Generator,
    rig: Rig,
    normal: Set[str],
    shear: Set[str],
    least_force_n: float,
) -> Habits:
    """Friction, speed, frame rate and directions of a session."""
    friction, slips = uniform(rng, 0.5, 1.1), "slip" in shear
    share_of_friction = 0.98 if slips else uniform(rng, 0.5, 0.75)
    frame_rate_hz = int(rng.choice(rig.frame_rates_hz))
    speed_spread = uniform(rng, 1.2, 4)
    speed = log_uniform(rng, *rig.speeds_n_per_s)
    directions = str(rng.choice(["random", "compass", "plane"], p=[0.5, 0.4, 0.1]))
    if shear & {"anisotropy", "zero_offset"} and directions == "plane":
        directions = "compass"
    return Habits(
        friction=friction,
        share_of_friction=share_of_friction,
        slips=slips,
        frame_rate_hz=frame_rate_hz,
        speed_n_per_s=speed,
        speed_spread=speed_spread,
        slowest_n_per_s=4.0 if "latency" in normal else 0.5,
        directions=directions,
        n_compass=int(rng.choice([4, 6, 8])),
        plane_rad=rng.random() * np.pi,
        jitter=rig.jitter,
        least_force_n=least_force_n,
    )


def draw_loads(
    rng: np.random.Generator, plan: Plan, peaks_n: Floats, habits: Habits
) -> tuple[list[Load], tuple[str, ...]]:
    """The presses of a session, and the names of the schedules among them."""
    near_slip = rng.random(peaks_n.size) < uniform(rng, 0.6, 0.9)
    near_slip[:2] = True
    loads, used = [], set()
    for peak_n, near in zip(peaks_n, near_slip, strict=True):
        schedule = str(rng.choice(plan.schedules, p=plan.shares))
        loads.append(_draw_load(rng, schedule, float(peak_n), bool(near), habits))
        used.add(schedule)
    return loads, tuple(sorted(used))


def _draw_load(
    rng: np.random.Generator, schedule: str, peak_n: float, near_slip: bool, habits: Habits
) -> Load:
    """One press by a schedule, at 20 to 300 frames."""
    spread = habits.speed_spread
    speed = habits.speed_n_per_s * log_uniform(rng, 1 / spread, spread)
    speed = float(np.clip(speed, habits.slowest_n_per_s, 40))
    profile = SCHEDULES[schedule](rng, peak_n, speed)
    time_s = _fine_clock(rng, profile.duration_s, habits)
    normal = np.interp(time_s, profile.time_s, profile.normal)
    along = np.interp(time_s, profile.time_s, profile.along)
    across = np.interp(time_s, profile.time_s, profile.across)
    least_n = habits.least_force_n
    force_n = least_n + (peak_n - least_n) * np.clip(normal, 0, None)
    angle = _draw_direction(rng, habits)
    share = _draw_share_of_friction(rng, schedule, near_slip, habits)
    x = np.cos(angle) * along - np.sin(angle) * across
    y = np.sin(angle) * along + np.cos(angle) * across
    shear_n = np.stack([x, y], 1) * share * habits.friction * peak_n
    return Load(time_s, force_n, _within_friction(shear_n, force_n, habits))


def _fine_clock(rng: np.random.Generator, duration_s: float, habits: Habits) -> Floats:
    """Times of the frames, which a camera does not keep quite, and of the steps between them."""
    n_frames = int(np.clip(round(duration_s * habits.frame_rate_hz), 20, 300))
    frames_s = np.linspace(0, duration_s, n_frames)
    if habits.jitter:
        jitter = rng.uniform(-habits.jitter, habits.jitter, n_frames - 2)
        frames_s[1:-1] += jitter * duration_s / n_frames
    steps = np.arange((n_frames - 1) * FINE_STEPS + 1) / FINE_STEPS
    return np.interp(steps, np.arange(n_frames), frames_s)


def _draw_direction(rng: np.random.Generator, habits: Habits) -> float:
    """Main direction of a press's shear, rad."""
    if habits.directions == "random":
        return rng.random() * 2 * np.pi
    if habits.directions == "compass":
        point = rng.integers(habits.n_compass)
        return float(2 * np.pi * point / habits.n_compass + 0.03 * rng.normal())
    return float(habits.plane_rad + np.pi * rng.integers(2) + 0.1 * rng.normal())


def _draw_share_of_friction(
    rng: np.random.Generator, schedule: str, near_slip: bool, habits: Habits
) -> float:
    """The largest shear force over the friction at the peak of the normal force."""
    if habits.slips:
        return uniform(rng, 0.9, 1.15) if near_slip else uniform(rng, 0.2, 0.7)
    low, high = (0.3, 1) if schedule in SHEARING else (0.05, 0.35)
    return uniform(rng, low, high) * habits.share_of_friction


def _within_friction(shear_n: Floats, force_n: Floats, habits: Habits) -> Floats:
    """The shear force (n, 2), cut to its share of what friction holds at each moment."""
    size_n = np.hypot(shear_n[:, 0], shear_n[:, 1])
    limit_n = habits.share_of_friction * habits.friction * force_n
    cut = np.where(size_n > limit_n, limit_n / np.maximum(size_n, 1e-9), 1)
    return shear_n * cut[:, None]

"""Rigs that press, and the schedules that a session runs on one."""

from __future__ import annotations

from collections.abc import Set
from dataclasses import dataclass

import numpy as np

from validation.blind.independent.draws import Floats, uniform
from validation.blind.independent.schedules import SHEARING


@dataclass(frozen=True)
class Rig:
    """A machine or a hand: what it can do, and how fast."""

    schedules: tuple[str, ...]
    frame_rates_hz: tuple[int, ...]
    speeds_n_per_s: tuple[float, float]
    jitter: float
    """Of the camera's clock, as a share of the time between two frames."""


RIGS = {
    "linear_stage": Rig(
        (
            "ramp_hold_release",
            "staircase",
            "cyclic_partial",
            "dwell_recover",
            "depth_relax",
            "approach_stop",
            "sine_sweep",
        ),
        (10, 15, 25, 30),
        (0.8, 8),
        0.0,
    ),
    "ur5": Rig(
        (
            "ramp_hold_release",
            "cyclic_partial",
            "press_drag",
            "oblique",
            "circle_drag",
            "approach_stop",
            "depth_relax",
            "tap",
        ),
        (10, 20, 30),
        (2, 20),
        0.15,
    ),
    "gripper": Rig(
        ("tap", "grip_pull", "ramp_hold_release", "press_drag", "dwell_recover"),
        (25, 30, 60),
        (4, 30),
        0.1,
    ),
    "hand": Rig(("human", "tap", "oblique", "press_drag"), (15, 25, 30), (3, 25), 0.2),
    "franka": Rig(
        ("press_drag", "circle_drag", "oblique", "sine_sweep", "staircase", "human"),
        (15, 30, 60),
        (2, 15),
        0.05,
    ),
}

NORMAL_SEEN_IN = {
    "hysteresis": (
        "ramp_hold_release",
        "cyclic_partial",
        "staircase",
        "oblique",
        "human",
        "sine_sweep",
    ),
    "creep": ("ramp_hold_release", "staircase", "dwell_recover", "press_drag", "depth_relax"),
    "latency": ("tap", "sine_sweep", "cyclic_partial", "human", "ramp_hold_release"),
    "shear_coupling": ("press_drag", "circle_drag", "grip_pull", "human"),
}
SHEAR_SEEN_IN = {
    "slip": ("press_drag", "grip_pull", "circle_drag", "oblique", "human"),
    "normal_coupling": ("press_drag", "grip_pull", "circle_drag", "human"),
    "anisotropy": ("press_drag", "circle_drag", "oblique", "human", "grip_pull"),
    "creep": ("press_drag", "oblique", "grip_pull"),
    "hysteresis": ("press_drag", "circle_drag", "human", "grip_pull"),
    "zero_offset": ("press_drag", "circle_drag", "oblique", "grip_pull"),
}
"""Schedules of which one must run in most trials, for the effect to be seen."""


@dataclass(frozen=True)
class Plan:
    """The schedules of a session with their shares, and whether shear is logged."""

    schedules: tuple[str, ...]
    shares: Floats
    has_shear: bool


def draw_plan(rng: np.random.Generator, rig: Rig, normal: Set[str], shear: Set[str]) -> Plan:
    """Schedules that show the effects asked for, mostly, and a few others of the rig."""
    coupled = bool(shear) or "shear_coupling" in normal
    has_shear = coupled or rng.random() < 0.8
    drawn = []
    for seen_in in _needed(normal, shear):
        possible = [name for name in seen_in if name in rig.schedules] or list(seen_in)
        drawn.append(str(rng.choice(possible)))
    main = list(dict.fromkeys(drawn))
    others = _other_schedules(rng, rig, "hysteresis" in normal, coupled)
    others = [name for name in others if name not in main]
    weights = np.array([3.0] * len(main) + [1.0] * len(others))
    return Plan((*main, *others), weights / weights.sum(), has_shear)


def _needed(normal: Set[str], shear: Set[str]) -> list[tuple[str, ...]]:
    """For each effect that not every schedule shows, those that do."""
    needed = [NORMAL_SEEN_IN[name] for name in sorted(normal) if name in NORMAL_SEEN_IN]
    needed += [SHEAR_SEEN_IN[name] for name in sorted(shear) if name in SHEAR_SEEN_IN]
    return needed or ([SHEARING] if shear else [])


def _other_schedules(rng: np.random.Generator, rig: Rig, unloads: bool, coupled: bool) -> list[str]:
    """One to three of the rig's, less those that would hide the effects."""
    n_others = min(len(rig.schedules), int(rng.integers(1, 4)))
    names = [str(name) for name in rng.choice(rig.schedules, size=n_others, replace=False)]
    if unloads:
        names = [name for name in names if name != "approach_stop"]
    if coupled:
        names = [name for name in names if name in SHEARING or rng.random() < 0.3]
    return names


def draw_n_trials(rng: np.random.Generator, names: Set[str]) -> int:
    """12 to 80 trials, more where an effect is seen only between them."""
    fewest = 15 if "conditioning" in names else 12
    if names & _BETWEEN_TRIALS:
        fewest = 18
    return int(rng.integers(fewest, 81 if rng.random() < 0.7 else 31))


_BETWEEN_TRIALS = {
    "saturation",
    "geometry",
    "operator",
    "temperature",
    "position",
    "humidity_percent",
    "time_s",
}


def draw_peaks(rng: np.random.Generator, n_trials: int, saturates: bool) -> tuple[float, Floats]:
    """The rig's greatest force, and the peak force of each trial, N.

    Where the response has a ceiling, a third of the trials or more press as hard as the rig can.
    """
    highest_n = uniform(rng, 4, 15)
    lowest_n = max(1.0, highest_n * uniform(rng, 0.12, 0.4))
    manner = rng.integers(3)
    if saturates:
        peaks_n = rng.uniform(lowest_n, highest_n, n_trials)
        hard = rng.random(n_trials) < uniform(rng, 0.4, 0.65)
        hard[rng.permutation(n_trials)[: max(6, n_trials // 3)]] = True
        peaks_n[hard] = highest_n * rng.uniform(0.96, 1, hard.sum())
    elif manner == 0:
        peaks_n = rng.uniform(lowest_n, highest_n, n_trials)
    elif manner == 1:
        levels = np.linspace(lowest_n, highest_n, int(rng.integers(3, 6)))
        peaks_n = rng.choice(levels, n_trials) * rng.uniform(0.97, 1.03, n_trials)
    else:
        peaks_n = np.exp(rng.uniform(np.log(lowest_n), np.log(highest_n), n_trials))
    return highest_n, peaks_n

"""Made-up press logs whose effects are known, by formulas other than those that are fitted.

A case is a log of ball presses by a rig with noise in volume and force. The strength of an effect
is the RMS of what it changes, in units of the noise, after the best compliance has been fitted.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from validation.contact.forms import (
    NORMAL_FORMS,
    OUTSIDE_FORMS,
    Array,
    Columns,
    Form,
    Truth,
)
from validation.contact.shear_forms import SHEAR_FORMS

__all__ = ["NORMAL_FORMS", "OUTSIDE_FORMS", "SHEAR_FORMS", "Columns", "blank_log", "make_case"]


def blank_log(rng: np.random.Generator, n_trials: int = 0, n_samples: int = 0) -> Truth:
    """Forces and covariates of a session, the response linear and without noise."""
    n_trials = n_trials or int(rng.integers(30, 81))
    n_samples = n_samples or int(rng.integers(60, 160))
    period = 1.0 / rng.choice([10.0, 20.0, 30.0])
    phase = np.arange(n_samples) * period
    peak = rng.uniform(0.3, 1.0, n_trials) * rng.uniform(5.0, 15.0)
    force = np.stack([p * _schedule(rng, n_samples) for p in peak])
    pull = np.stack([_pull(rng, f / p) for f, p in zip(force, peak, strict=True)])
    angle = rng.uniform(0, 2 * np.pi, n_trials)
    share = rng.uniform(0.15, 0.6, n_trials)
    shear = (pull * force * share[:, None])[..., None] * np.stack(
        [np.cos(angle), np.sin(angle)], axis=-1
    )[:, None, :]
    gaps = rng.uniform(5.0, 40.0, n_trials) + phase[-1]
    trial = np.repeat(np.arange(n_trials), n_samples)
    time = np.repeat(np.cumsum(gaps), n_samples) + np.tile(phase, n_trials)
    columns = _covariates(rng, n_trials, trial) | {"trial": trial, "time_s": time}
    k_n, k_s = rng.uniform(3.0, 12.0), rng.uniform(0.3, 2.0)
    force, shear = force.ravel(), shear.reshape(-1, 2)
    return Truth(columns, trial, np.tile(phase, n_trials), force, shear, k_n * force, k_s * shear)


def _schedule(rng: np.random.Generator, n: int) -> Array:
    """Share of the peak load along one trial: up, hold, down, in different ways."""
    kind = rng.choice(["trapezoid", "triangle", "stairs", "smooth"])
    up, down = rng.uniform(0.15, 0.35), rng.uniform(0.65, 0.85)
    s = np.linspace(0.0, 1.0, n)
    if kind == "triangle":
        return np.interp(s, [0.03, 0.5, 0.97], [0.0, 1.0, 0.0])
    shape = np.interp(s, [0.03, up, down, 0.97], [0.0, 1.0, 1.0, 0.0])
    if kind == "stairs":
        steps = np.floor(shape * 4 + 1e-9) / 4
        width = max(3, n // 30)
        return np.convolve(np.pad(steps, width, mode="edge"), np.ones(width) / width, "same")[
            width:-width
        ]
    return shape if kind == "trapezoid" else np.sin(0.5 * np.pi * shape) ** 2


def _pull(rng: np.random.Generator, load: Array) -> Array:
    s = np.linspace(0.0, 1.0, load.size)
    start = rng.uniform(0.3, 0.4)
    return np.interp(s, [start, start + 0.12, start + 0.22, start + 0.33], [0.0, 1.0, 1.0, 0.0])


def _covariates(rng: np.random.Generator, n_trials: int, trial: NDArray[np.int64]) -> Columns:
    wander = np.cumsum(rng.normal(size=n_trials))
    each: Columns = {
        "indenter": np.full(n_trials, "ball"),
        "radius_mm": rng.choice([2.0, 3.0, 4.0, 6.0], n_trials),
        "x_mm": rng.uniform(-6, 6, n_trials),
        "y_mm": rng.uniform(-5, 5, n_trials),
        "temperature_c": 23 + 2 * rng.normal(size=n_trials) + 0.4 * wander,
        "operator": rng.choice(["ada", "bob", "eve"], n_trials),
        "humidity": rng.uniform(0.3, 0.6, n_trials),
    }
    return {name: values[trial] for name, values in each.items()}


def make_case(
    effects: Sequence[tuple[str, str, int]],
    strength: float,
    rng: np.random.Generator,
    truth: Truth | None = None,
) -> tuple[Columns, dict[str, float]]:
    """A log with ``effects`` (channel, name, form) and the RMS noise of each channel.

    ``channel`` is ``normal``, ``shear`` or ``outside`` (acts on the volume).
    """
    truth = truth or blank_log(rng)
    force_noise = rng.uniform(0.002, 0.008) * truth.force_n.max()
    k_n = float(truth.volume_mm3.max() / truth.force_n.max())
    shear_max = float(np.abs(truth.shear_n).max())
    k_s = float(np.abs(truth.shear_mm).max() / shear_max)
    volume_noise = rng.uniform(0.008, 0.025) * truth.volume_mm3.max()
    motion_noise = rng.uniform(0.01, 0.03) * float(np.abs(truth.shear_mm).max())
    noise = {
        "normal": float(np.hypot(volume_noise, k_n * force_noise)),
        "shear": float(np.hypot(motion_noise, k_s * force_noise)),
    }
    volume, motion = truth.volume_mm3, truth.shear_mm
    for channel, name, form in effects:
        forms = {"normal": NORMAL_FORMS, "shear": SHEAR_FORMS, "outside": OUTSIDE_FORMS}[channel]
        target = "shear" if channel == "shear" else "normal"
        current = Truth(
            truth.columns, truth.trial, truth.phase_s, truth.force_n, truth.shear_n, volume, motion
        )
        changed = _of_strength(forms[name][form], current, target, strength * noise[target], rng)
        volume, motion = (volume, changed) if target == "shear" else (changed, motion)
    n = truth.trial.size
    columns = dict(truth.columns)
    columns["force_normal_n"] = truth.force_n + force_noise * rng.normal(size=n)
    columns["volume_mm3"] = volume + volume_noise * rng.normal(size=n)
    for axis, letter in enumerate("xy"):
        force = truth.shear_n[:, axis] + force_noise * rng.normal(size=n)
        columns[f"force_shear_{letter}_n"] = force
        columns[f"shear_{letter}_mm"] = motion[:, axis] + motion_noise * rng.normal(size=n)
    return columns, noise


def _of_strength(
    form: Form, truth: Truth, target: str, rms: float, rng: np.random.Generator
) -> Array:
    """The form at the strength whose change, less the best compliance, has this RMS."""
    plain = truth.shear_mm if target == "shear" else truth.volume_mm3
    seed = int(rng.integers(1 << 31))
    low, high = 0.0, 1e-4

    def size(strength: float) -> float:
        changed = form(truth, strength, np.random.default_rng(seed))
        share = float((changed * plain).sum() / (plain * plain).sum())
        return float(np.sqrt(((changed - share * plain) ** 2).mean()))

    if rms <= 0:
        return plain
    while size(high) < rms and high < 50.0:
        low, high = high, high * 2.0
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if size(middle) < rms else (low, middle)
    return form(truth, 0.5 * (low + high), np.random.default_rng(seed))

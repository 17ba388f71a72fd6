"""Effects of contact in forms of their own, written without sight of the ones that are fitted.

An effect is a function of a trial's course and one amplitude; amplitude 0 is no effect. Effects
of the load act on the force before the compliance, effects of the gain multiply it, effects of
the output act on the response (volume, or marker motion along x and y).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Trial:
    """What happens in one press, without noise; shared values stand in ``session``."""

    time_s: Floats
    load: Floats
    """(n, 1) normal force, or (n, 2) shear force: what drives the channel."""
    force_normal_n: Floats
    force_shear_n: Floats
    start_s: float
    number: int
    x_mm: float
    y_mm: float
    radius_mm: float
    temperature_c: Floats
    labels: Mapping[str, object]
    session_s: float
    n_trials: int
    peak_n: float
    """Largest load of the session along this channel."""

    @property
    def clock_s(self) -> Floats:
        return self.start_s + self.time_s


Form = Callable[[Floats, Trial, float, Mapping[str, float]], Floats]


def _uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(rng.uniform(low, high))


# --- the load's history -----------------------------------------------------------------------


def _superpose(load: Floats, time_s: Floats, kernel: Callable[[Floats], Floats]) -> Floats:
    """Boltzmann superposition of load increments with ``kernel`` of the time since each."""
    increments = np.diff(load, axis=0, prepend=0.0 * load[:1])
    since = time_s[:, None] - time_s[None, :]
    return np.where(since >= 0, kernel(np.maximum(since, 0.0)), 0.0) @ increments


def creep_log(load: Floats, trial: Trial, amplitude: float, p: Mapping[str, float]) -> Floats:
    return load + amplitude * _superpose(
        load, trial.time_s, lambda since: np.log1p(since / p["tau_s"])
    )


def creep_stretched(load: Floats, trial: Trial, amplitude: float, p: Mapping[str, float]) -> Floats:
    return load + amplitude * _superpose(
        load, trial.time_s, lambda since: 1.0 - np.exp(-np.sqrt(since / p["tau_s"]))
    )


def hysteresis_preisach(
    load: Floats, trial: Trial, amplitude: float, p: Mapping[str, float]
) -> Floats:
    """Many play operators of different widths: what they hold back is given out later."""
    widths = trial.peak_n * np.array([0.03, 0.08, 0.15, 0.25, 0.4]) * p["width"]
    lag = np.zeros_like(load)
    for width in widths:
        held = np.zeros(load.shape[1])
        for index, now in enumerate(load):
            held = np.clip(held, now - width, now + width)
            lag[index] += (held - now) / len(widths)
    return load + amplitude * lag


def hysteresis_return(
    load: Floats, trial: Trial, amplitude: float, p: Mapping[str, float]
) -> Floats:
    """Unloading follows a bulged line from the last turning point back to nothing."""
    size = np.sqrt((load**2).sum(axis=1))
    result = load.copy()
    apex = 0.0
    for index in range(len(size)):
        apex = max(size[index], apex) if size[index] > 0.02 * trial.peak_n else 0.0
        if apex > 0.0:
            part = size[index] / apex
            result[index] = load[index] * (1.0 + amplitude * (1.0 - part) * p["width"])
    return result


def latency_delay(load: Floats, trial: Trial, amplitude: float, p: Mapping[str, float]) -> Floats:
    when = trial.time_s - amplitude * p["sign"]
    return np.column_stack([np.interp(when, trial.time_s, column) for column in load.T])


# --- the load itself --------------------------------------------------------------------------


def offset_force(load: Floats, trial: Trial, amplitude: float, p: Mapping[str, float]) -> Floats:
    direction = np.array([np.cos(p["angle"]), np.sin(p["angle"])])
    return load + amplitude * p["sign"] * (direction if load.shape[1] == 2 else 1.0)


def stiffening_tanh(load: Floats, trial: Trial, amplitude: float, p: Mapping[str, float]) -> Floats:
    return load * (1.0 - p["sign"] * amplitude * np.tanh(load / (p["scale"] * trial.peak_n)))


def stiffening_log(load: Floats, trial: Trial, amplitude: float, p: Mapping[str, float]) -> Floats:
    return load / (1.0 + amplitude * np.log1p(np.maximum(load, 0) / (p["scale"] * trial.peak_n)))


def coupling_shear(load: Floats, trial: Trial, amplitude: float, p: Mapping[str, float]) -> Floats:
    tangential = np.hypot(*trial.force_shear_n.T)[:, None]
    return load + p["sign"] * amplitude * tangential ** p["power"]


def slip_tanh(load: Floats, trial: Trial, amplitude: float, p: Mapping[str, float]) -> Floats:
    """The nearer to the friction limit, the less the gel follows; ``amplitude`` is 1/μ."""
    size = np.hypot(*load.T)
    limit = np.maximum(trial.force_normal_n, 1e-9) / max(amplitude, 1e-9)
    ratio = size / limit
    follow = np.where(ratio > 1e-6, np.tanh(ratio) / np.maximum(ratio, 1e-6), 1.0)
    return load * follow[:, None]


def slip_hard(load: Floats, trial: Trial, amplitude: float, p: Mapping[str, float]) -> Floats:
    """Rigid–plastic: proportional up to μ times the normal force, constant ratio beyond."""
    size = np.hypot(*load.T)
    limit = np.maximum(trial.force_normal_n, 0.0) / max(amplitude, 1e-9)
    return load * np.minimum(1.0, limit / np.maximum(size, 1e-9))[:, None]


def coupling_normal(load: Floats, trial: Trial, amplitude: float, p: Mapping[str, float]) -> Floats:
    peak = max(float(trial.labels["session_peak_n"]), 1e-9)  # type: ignore[arg-type]
    share = np.tanh(trial.force_normal_n / (p["scale"] * peak))
    return load * (1.0 + p["sign"] * amplitude * share)[:, None]


def anisotropy(load: Floats, trial: Trial, amplitude: float, p: Mapping[str, float]) -> Floats:
    cos, sin = np.cos(p["axis"]), np.sin(p["axis"])
    turn = np.array([[cos, sin], [-sin, cos]])
    matrix = turn.T @ np.diag([1.0 + amplitude, 1.0 - amplitude]) @ turn
    return load @ matrix.T


# --- gains ------------------------------------------------------------------------------------


def drift_quadratic(load: Floats, trial: Trial, amplitude: float, p: Mapping[str, float]) -> Floats:
    phase = trial.clock_s / trial.session_s
    return load * (1.0 + p["sign"] * amplitude * phase * (0.4 + 0.6 * phase))[:, None]


def drift_settling(load: Floats, trial: Trial, amplitude: float, p: Mapping[str, float]) -> Floats:
    phase = trial.clock_s / trial.session_s
    return load * (1.0 + p["sign"] * amplitude * (1.0 - np.exp(-phase / 0.6)))[:, None]


def position_bump(load: Floats, trial: Trial, amplitude: float, p: Mapping[str, float]) -> Floats:
    away = (trial.x_mm - p["x_mm"]) ** 2 + (trial.y_mm - p["y_mm"]) ** 2
    return load * (1.0 + p["sign"] * amplitude * np.exp(-0.5 * away / p["width_mm"] ** 2))


def position_tilt(load: Floats, trial: Trial, amplitude: float, p: Mapping[str, float]) -> Floats:
    along = np.cos(p["angle"]) * trial.x_mm + np.sin(p["angle"]) * trial.y_mm
    return load * (1.0 + amplitude * np.tanh(along / p["width_mm"]))


def geometry_log(load: Floats, trial: Trial, amplitude: float, p: Mapping[str, float]) -> Floats:
    return load * (1.0 + p["sign"] * amplitude * np.log(trial.radius_mm / 3.0))


def geometry_inverse(
    load: Floats, trial: Trial, amplitude: float, p: Mapping[str, float]
) -> Floats:
    return load * (1.0 + p["sign"] * amplitude * (3.0 / trial.radius_mm - 1.0))


def temperature_arrhenius(
    load: Floats, trial: Trial, amplitude: float, p: Mapping[str, float]
) -> Floats:
    return load * np.exp(p["sign"] * amplitude * (trial.temperature_c - 23.0))[:, None]


def conditioning_harmonic(
    load: Floats, trial: Trial, amplitude: float, p: Mapping[str, float]
) -> Floats:
    return load * (1.0 + p["sign"] * amplitude / (1.0 + trial.number / p["presses"]) ** 2)


def conditioning_logistic(
    load: Floats, trial: Trial, amplitude: float, p: Mapping[str, float]
) -> Floats:
    fade = 1.0 / (1.0 + np.exp((trial.number - 2.0 * p["presses"]) / (0.4 * p["presses"])))
    return load * (1.0 + p["sign"] * amplitude * fade)


def operator_gain(load: Floats, trial: Trial, amplitude: float, p: Mapping[str, float]) -> Floats:
    return load * (1.0 + amplitude * float(trial.labels["operator_code"]))  # type: ignore[arg-type]


def oscillation(load: Floats, trial: Trial, amplitude: float, p: Mapping[str, float]) -> Floats:
    phase = 2.0 * np.pi * p["periods"] * trial.clock_s / trial.session_s + p["angle"]
    return load * (1.0 + amplitude * np.sin(phase))[:, None]


def humidity_gain(load: Floats, trial: Trial, amplitude: float, p: Mapping[str, float]) -> Floats:
    humidity = float(trial.labels["humidity_percent"])  # type: ignore[arg-type]
    return load * (1.0 + p["sign"] * amplitude * (humidity - 45.0) / 10.0)


def softer(load: Floats, trial: Trial, amplitude: float, p: Mapping[str, float]) -> Floats:
    return load * (1.0 + p["sign"] * amplitude)


# --- the response -----------------------------------------------------------------------------


def offset_response(load: Floats, trial: Trial, amplitude: float, p: Mapping[str, float]) -> Floats:
    """An offset of the response alone, in units of force so that it scales like the others."""
    return offset_force(load, trial, amplitude, p)


def saturation_soft(load: Floats, trial: Trial, amplitude: float, p: Mapping[str, float]) -> Floats:
    """Bends over near a ceiling; ``amplitude`` is peak load / ceiling."""
    ratio = np.abs(load) * amplitude / trial.peak_n
    return load / (1.0 + ratio ** p["sharpness"]) ** (1.0 / p["sharpness"])


def saturation_hard(load: Floats, trial: Trial, amplitude: float, p: Mapping[str, float]) -> Floats:
    return np.minimum(load, trial.peak_n / max(amplitude, 1e-9))


# --- the catalogue ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Effect:
    """Forms of one effect, where in the chain it acts, and how its constants are drawn."""

    forms: tuple[Form, ...]
    stage: int
    """0 history, 1 load, 2 gain, 3 response."""
    largest: float
    """Amplitudes above this make no physical sense."""
    smallest: float = 0.0


def draw_constants(rng: np.random.Generator) -> dict[str, float]:
    """Constants for every form; each form takes those it knows."""
    return {
        "tau_s": _uniform(rng, 0.3, 1.5),
        "width": _uniform(rng, 0.7, 1.3),
        "sign": float(rng.choice([-1.0, 1.0])),
        "angle": _uniform(rng, -np.pi, np.pi),
        "axis": _uniform(rng, -0.25, 0.25) + float(rng.choice([0.0, np.pi / 2])),
        "scale": _uniform(rng, 0.4, 1.0),
        "power": _uniform(rng, 1.0, 1.5),
        "x_mm": _uniform(rng, -3.0, 3.0),
        "y_mm": _uniform(rng, -3.0, 3.0),
        "width_mm": _uniform(rng, 3.0, 6.0),
        "presses": _uniform(rng, 1.5, 4.0),
        "periods": _uniform(rng, 2.5, 6.0),
        "sharpness": _uniform(rng, 6.0, 12.0),
    }


NORMAL = {
    "zero_offset": Effect((offset_force, offset_response), 1, 5.0),
    "stiffening": Effect((stiffening_tanh, stiffening_log), 1, 0.8),
    "creep": Effect((creep_log, creep_stretched), 0, 2.0),
    "hysteresis": Effect((hysteresis_preisach, hysteresis_return), 0, 2.0),
    "drift": Effect((drift_quadratic, drift_settling), 2, 0.8),
    "position": Effect((position_bump, position_tilt), 2, 0.8),
    "geometry": Effect((geometry_log, geometry_inverse), 2, 0.6),
    "shear_coupling": Effect((coupling_shear,), 1, 3.0),
    "temperature": Effect((temperature_arrhenius,), 2, 0.2),
    "latency": Effect((latency_delay,), 0, 1.0),
    "conditioning": Effect((conditioning_harmonic, conditioning_logistic), 2, 2.0),
    "saturation": Effect((saturation_soft, saturation_hard), 3, 3.0),
}
SHEAR = {
    "slip": Effect((slip_tanh, slip_hard), 1, 20.0),
    "normal_coupling": Effect((coupling_normal,), 2, 0.8),
    "anisotropy": Effect((anisotropy,), 2, 0.9),
    "creep": Effect((creep_log, creep_stretched), 0, 2.0),
    "hysteresis": Effect((hysteresis_preisach,), 0, 2.0),
    "zero_offset": Effect((offset_force, offset_response), 3, 5.0),
}
UNLISTED = {
    "operator": Effect((operator_gain,), 2, 0.8),
    "time_s": Effect((oscillation,), 2, 0.8),
    "humidity_percent": Effect((humidity_gain,), 2, 0.8),
}
"""Effects that no list holds, by the covariate that they follow."""
LOCAL = {"compliance_change": Effect((softer,), 2, 0.8)}
"""Effects that show only where they act in a part of the log."""

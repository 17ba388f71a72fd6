"""Further forms of the same effects, other again than those in `blind_effects`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from validation.blind.blind_effects import NORMAL, SHEAR, UNLISTED, Effect, Floats, Form, Trial

Constants = Mapping[str, float]


def _gain(load: Floats, relative: Floats | float) -> Floats:
    return load * np.maximum(1.0 + np.broadcast_to(relative, load.shape[0]), 0.02)[:, None]


# --- the load's history -----------------------------------------------------------------------


def creep_since_contact(load: Floats, trial: Trial, amplitude: float, p: Constants) -> Floats:
    """Grows as a power of the time since the load first stood above a little."""
    pressed = np.hypot.reduce(load, axis=1) > 0.05 * trial.peak_n
    start = trial.time_s[int(np.argmax(pressed))] if pressed.any() else trial.time_s[-1]
    since = np.maximum(trial.time_s - start, 0.0)
    return _gain(load, amplitude * (since / 5.0) ** 0.4)


def creep_burgers(load: Floats, trial: Trial, amplitude: float, p: Constants) -> Floats:
    """A Kelvin body and a dashpot in series, stepped explicitly."""
    kelvin, flow = np.zeros(load.shape[1]), np.zeros(load.shape[1])
    result = load.copy()
    for index in range(1, len(load)):
        step = trial.time_s[index] - trial.time_s[index - 1]
        kelvin = kelvin + (load[index] - kelvin) * (1.0 - np.exp(-step / p["tau_s"]))
        flow = flow + load[index] * step / 30.0
        result[index] += amplitude * (kelvin + flow)
    return result


def hysteresis_bouc_wen(load: Floats, trial: Trial, amplitude: float, p: Constants) -> Floats:
    state = np.zeros(load.shape[1])
    result = load.copy()
    sharp = 6.0 / (p["width"] * trial.peak_n)
    for index in range(1, len(load)):
        step = load[index] - load[index - 1]
        # Exact for a load that moves evenly: a step of Euler's overshoots where the load is let go.
        state = np.sign(step) + (state - np.sign(step)) * np.exp(-sharp * np.abs(step))
        result[index] -= amplitude * trial.peak_n * state
    return result


def hysteresis_branch(load: Floats, trial: Trial, amplitude: float, p: Constants) -> Floats:
    """Another power of the load on the way back from its greatest so far."""
    size = np.hypot.reduce(load, axis=1)
    share = np.clip(size / np.maximum(np.maximum.accumulate(size), 1e-9), 1e-9, 1.0)
    return load * (share ** (-0.5 * amplitude))[:, None]


def latency_lag(load: Floats, trial: Trial, amplitude: float, p: Constants) -> Floats:
    """Two equal first-order filters, as a camera's exposure and its buffer make."""
    result = load.copy()
    for _ in range(2):
        state = result[0].copy()
        for index in range(1, len(load)):
            step = trial.time_s[index] - trial.time_s[index - 1]
            state = state + (result[index] - state) * -np.expm1(-2.0 * step / max(amplitude, 1e-9))
            result[index] = state
    return result


# --- the load itself --------------------------------------------------------------------------


def stiffening_power(load: Floats, trial: Trial, amplitude: float, p: Constants) -> Floats:
    """V ∝ F^(1 ± amplitude), as a ball on a layer has."""
    share = np.abs(load) / trial.peak_n
    return np.sign(load) * trial.peak_n * share ** (1.0 + 0.5 * p["sign"] * amplitude)


def stiffening_quadratic(load: Floats, trial: Trial, amplitude: float, p: Constants) -> Floats:
    return load * (1.0 - p["sign"] * amplitude * np.abs(load) / trial.peak_n)


def coupling_ratio(load: Floats, trial: Trial, amplitude: float, p: Constants) -> Floats:
    ratio = np.hypot(*trial.force_shear_n.T) / np.maximum(trial.force_normal_n, 0.3)
    return _gain(load, p["sign"] * amplitude * ratio**2)


def coupling_quadrature(load: Floats, trial: Trial, amplitude: float, p: Constants) -> Floats:
    size = np.hypot(*trial.force_shear_n.T)[:, None]
    return np.sqrt(np.maximum(load, 0.0) ** 2 + amplitude * size**2)


def slip_mindlin(load: Floats, trial: Trial, amplitude: float, p: Constants) -> Floats:
    """Cattaneo-Mindlin growth; ``amplitude`` is 1/μ."""
    size = np.hypot(*load.T)
    fraction = np.clip(amplitude * size / np.maximum(trial.force_normal_n, 0.05), 1e-6, 1.0)
    return load * ((1.0 - (1.0 - fraction) ** (2.0 / 3.0)) / (2.0 / 3.0 * fraction))[:, None]


def slip_onset(load: Floats, trial: Trial, amplitude: float, p: Constants) -> Floats:
    """Nothing up to a ratio, then a growth in proportion to what is above it."""
    ratio = np.hypot(*load.T) / np.maximum(trial.force_normal_n, 0.05)
    return _gain(load, 4.0 * amplitude * np.maximum(ratio - 0.22, 0.0))


def coupling_cube_root(load: Floats, trial: Trial, amplitude: float, p: Constants) -> Floats:
    """Stiffness goes with the patch's radius, which goes with the cube root of the load."""
    peak = max(float(trial.labels["session_peak_n"]), 1e-9)  # type: ignore[arg-type]
    share = np.clip(trial.force_normal_n / peak, 0.03, 1.0)
    return _gain(load, amplitude * (share ** (-1.0 / 3.0) - 1.0))


def coupling_linear(load: Floats, trial: Trial, amplitude: float, p: Constants) -> Floats:
    peak = max(float(trial.labels["session_peak_n"]), 1e-9)  # type: ignore[arg-type]
    return _gain(load, p["sign"] * amplitude * trial.force_normal_n / peak)


def anisotropy_one_axis(load: Floats, trial: Trial, amplitude: float, p: Constants) -> Floats:
    return load * np.array([1.0 + p["sign"] * amplitude, 1.0])


def anisotropy_turned(load: Floats, trial: Trial, amplitude: float, p: Constants) -> Floats:
    """The camera is mounted a little turned."""
    cos, sin = np.cos(amplitude), np.sin(amplitude)
    return load @ np.array([[cos, -sin], [sin, cos]]).T


# --- gains ------------------------------------------------------------------------------------


def drift_linear(load: Floats, trial: Trial, amplitude: float, p: Constants) -> Floats:
    return _gain(load, p["sign"] * amplitude * trial.clock_s / trial.session_s)


def drift_root(load: Floats, trial: Trial, amplitude: float, p: Constants) -> Floats:
    return _gain(load, p["sign"] * amplitude * (trial.clock_s / trial.session_s) ** 1.5)


def position_bowl(load: Floats, trial: Trial, amplitude: float, p: Constants) -> Floats:
    return _gain(load, p["sign"] * amplitude * ((trial.x_mm / 6) ** 2 + (trial.y_mm / 4.5) ** 2))


def position_linear(load: Floats, trial: Trial, amplitude: float, p: Constants) -> Floats:
    along = np.cos(p["angle"]) * trial.x_mm + np.sin(p["angle"]) * trial.y_mm
    return _gain(load, amplitude * along / 6.0)


def geometry_root(load: Floats, trial: Trial, amplitude: float, p: Constants) -> Floats:
    return _gain(load, p["sign"] * amplitude * (np.sqrt(trial.radius_mm / 3.0) - 1.0))


def temperature_linear(load: Floats, trial: Trial, amplitude: float, p: Constants) -> Floats:
    return _gain(load, p["sign"] * amplitude * (trial.temperature_c - 23.0))


def temperature_bent(load: Floats, trial: Trial, amplitude: float, p: Constants) -> Floats:
    warm = trial.temperature_c - 23.0
    return _gain(load, p["sign"] * amplitude * (warm + 0.06 * warm**2))


def conditioning_exponential(load: Floats, trial: Trial, amplitude: float, p: Constants) -> Floats:
    return _gain(load, p["sign"] * amplitude * np.exp(-trial.number / p["presses"]))


def saturation_exponential(load: Floats, trial: Trial, amplitude: float, p: Constants) -> Floats:
    """Linear, then an exponential approach to the ceiling over the last stretch."""
    ceiling = trial.peak_n / max(amplitude, 1e-9)
    knee, width = 0.8 * ceiling, 0.2 * ceiling
    above = np.maximum(load - knee, 0.0)
    return np.where(load > knee, knee + width * -np.expm1(-above / width), load)


# --- outside the lists ------------------------------------------------------------------------


def operator_one(load: Floats, trial: Trial, amplitude: float, p: Constants) -> Floats:
    """One of them presses otherwise."""
    return _gain(load, p["sign"] * amplitude * (trial.labels["operator"] == "bo"))


def operator_added(load: Floats, trial: Trial, amplitude: float, p: Constants) -> Floats:
    code = float(trial.labels["operator_code"])  # type: ignore[arg-type]
    return load + amplitude * code * trial.peak_n


def oscillation_added(load: Floats, trial: Trial, amplitude: float, p: Constants) -> Floats:
    phase = 2.0 * np.pi * p["periods"] * trial.clock_s / trial.session_s + p["angle"]
    return load + amplitude * trial.peak_n * np.sin(phase)[:, None]


def oscillation_fast(load: Floats, trial: Trial, amplitude: float, p: Constants) -> Floats:
    """A period of a few seconds: several in a trial."""
    phase = 2.0 * np.pi * trial.clock_s / (2.0 + 2.0 * p["tau_s"]) + p["angle"]
    return _gain(load, amplitude * np.sin(phase))


def oscillation_square(load: Floats, trial: Trial, amplitude: float, p: Constants) -> Floats:
    """On and off, tens of seconds each, as a heater switches."""
    phase = 2.0 * np.pi * trial.clock_s / (60.0 + 200.0 * p["tau_s"]) + p["angle"]
    return _gain(load, amplitude * np.sign(np.sin(phase)))


def humidity_bent(load: Floats, trial: Trial, amplitude: float, p: Constants) -> Floats:
    humidity = float(trial.labels["humidity_percent"])  # type: ignore[arg-type]
    return _gain(load, p["sign"] * amplitude * np.expm1((humidity - 45.0) / 15.0))


_FURTHER: dict[str, dict[str, tuple[Form, ...]]] = {
    "normal": {
        "creep": (creep_since_contact, creep_burgers),
        "hysteresis": (hysteresis_bouc_wen, hysteresis_branch),
        "latency": (latency_lag,),
        "stiffening": (stiffening_power, stiffening_quadratic),
        "shear_coupling": (coupling_ratio, coupling_quadrature),
        "drift": (drift_linear, drift_root),
        "position": (position_bowl, position_linear),
        "geometry": (geometry_root,),
        "temperature": (temperature_linear, temperature_bent),
        "conditioning": (conditioning_exponential,),
        "saturation": (saturation_exponential,),
    },
    "shear": {
        "creep": (creep_since_contact, creep_burgers),
        "hysteresis": (hysteresis_bouc_wen,),
        "slip": (slip_mindlin, slip_onset),
        "normal_coupling": (coupling_cube_root, coupling_linear),
        "anisotropy": (anisotropy_one_axis, anisotropy_turned),
    },
    "unlisted": {
        "operator": (operator_one, operator_added),
        "time_s": (oscillation_added, oscillation_fast, oscillation_square),
        "humidity_percent": (humidity_bent,),
    },
}


def _extended(catalogue: Mapping[str, Effect], kind: str) -> dict[str, Effect]:
    more = _FURTHER[kind]
    return {
        name: replace(effect, forms=(*effect.forms, *more.get(name, ())))
        for name, effect in catalogue.items()
    }


ALL_NORMAL = _extended(NORMAL, "normal")
ALL_SHEAR = _extended(SHEAR, "shear")
ALL_UNLISTED = _extended(UNLISTED, "unlisted")

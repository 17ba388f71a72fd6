"""Effects by formulas other than those that are fitted, for made-up press logs.

A case is a log of ball presses by a rig with noise in volume and force. The strength of an effect
is the RMS of what it changes, in units of the noise, after the best compliance has been fitted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.core.types import FloatArray

Columns = dict[str, NDArray[Any]]
Array = FloatArray


@dataclass(frozen=True)
class Truth:
    """The noiseless log under construction: forces, covariates and responses."""

    columns: Columns
    trial: NDArray[np.int64]
    phase_s: Array
    force_n: Array
    shear_n: Array
    volume_mm3: Array
    shear_mm: Array

    def per_trial(self, values: Array) -> Array:
        """One value a trial, for every sample."""
        return values[self.trial]


Form = Callable[[Truth, float, np.random.Generator], Array]
"""Strength 0 gives the plain response; the result is the changed one."""


def _gain(function: Callable[[Truth, np.random.Generator], Array]) -> Form:
    """A form whose strength multiplies a relative change of the compliance."""

    def form(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
        return truth.volume_mm3 * (1.0 + strength * function(truth, rng))

    return form


def load_share(truth: Truth) -> Array:
    """Load as a share of the largest one."""
    return np.clip(truth.force_n, 0.0, None) / truth.force_n.max()


def _session(truth: Truth) -> Array:
    time = truth.columns["time_s"]
    return (time - time.min()) / np.ptp(time)


def _rational(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
    return truth.volume_mm3 / (1.0 + strength * load_share(truth))


def _since_contact(truth: Truth) -> Array:
    touched = truth.force_n > 0.03 * truth.force_n.max()
    start = np.full(truth.trial.max() + 1, np.inf)
    np.minimum.at(start, truth.trial[touched], truth.phase_s[touched])
    return np.clip(truth.phase_s - truth.per_trial(start), 0.0, None)


def duration_s(truth: Truth) -> float:
    """Duration of the longest trial."""
    return float(truth.phase_s.max())


def _log_creep(truth: Truth, rng: np.random.Generator) -> Array:
    return np.log1p(_since_contact(truth) / (0.03 * duration_s(truth)))


def _power_creep(truth: Truth, rng: np.random.Generator) -> Array:
    return (_since_contact(truth) / duration_s(truth)) ** 0.3


def trial_rows(trial: NDArray[np.int64]) -> list[tuple[int, int]]:
    """First row and stop of each trial."""
    edges = np.concatenate([[0], np.flatnonzero(np.diff(trial)) + 1, [trial.size]])
    return list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))


def _kelvin(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
    """A Kelvin body in series, stepped from sample to sample."""
    tau = duration_s(truth) * rng.uniform(0.08, 0.5)
    return truth.volume_mm3 + strength * relaxing(truth, truth.volume_mm3, tau)


def relaxing(truth: Truth, drive: Array, tau: float) -> Array:
    """What a first-order lag makes of ``drive``, from rest in each trial."""
    state = np.zeros_like(drive)
    for first, stop in trial_rows(truth.trial):
        q = np.zeros(drive.shape[1:])
        for i in range(first + 1, stop):
            step = truth.phase_s[i] - truth.phase_s[i - 1]
            q = q + (0.5 * (drive[i] + drive[i - 1]) - q) * -np.expm1(-step / tau)
            state[i] = q
    return state


def _bouc_wen(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
    """A Bouc-Wen internal variable driven by the load."""
    u = load_share(truth)
    z = np.zeros_like(u)
    sharp = rng.uniform(4.0, 8.0)
    for first, stop in trial_rows(truth.trial):
        for i in range(first + 1, stop):
            du = u[i] - u[i - 1]
            z[i] = z[i - 1] + sharp * (du - abs(du) * z[i - 1])
    return truth.volume_mm3 - strength * truth.volume_mm3.max() * z


def _back(truth: Truth) -> tuple[Array, Array]:
    """Share of the trial's peak, and 1 on the way back from it."""
    u, share, back = load_share(truth), np.zeros(truth.trial.size), np.zeros(truth.trial.size)
    for first, stop in trial_rows(truth.trial):
        part = u[first:stop]
        peak = np.maximum.accumulate(part)
        share[first:stop] = part / np.maximum(peak, 1e-9)
        last = part.size - 1 - int(np.argmax(part[::-1]))
        back[first + last + 1 : stop] = 1.0
    return share, back


def _root_unloading(truth: Truth, rng: np.random.Generator) -> Array:
    share, back = _back(truth)
    return back * np.sqrt(np.clip(1.0 - share, 0.0, 1.0))


def _step_unloading(truth: Truth, rng: np.random.Generator) -> Array:
    share, back = _back(truth)
    return back * (1.0 - share**6)


def _saturating_drift(truth: Truth, rng: np.random.Generator) -> Array:
    return -np.expm1(-_session(truth) / rng.uniform(0.3, 0.8))


def _sine_bump(truth: Truth, rng: np.random.Generator) -> Array:
    return np.sin(np.pi * 0.5 * _session(truth)) ** 2


def _bump(truth: Truth, rng: np.random.Generator) -> Array:
    x, y = truth.columns["x_mm"], truth.columns["y_mm"]
    cx, cy = rng.uniform(-3, 3, 2)
    return np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * rng.uniform(4, 7) ** 2))


def _cosine_edge(truth: Truth, rng: np.random.Generator) -> Array:
    x, y = truth.columns["x_mm"], truth.columns["y_mm"]
    return np.cos(np.pi * np.hypot(x / 9.0, y / 8.0) / 2)


def _tilt(truth: Truth, rng: np.random.Generator) -> Array:
    angle = rng.uniform(0, 2 * np.pi)
    return (truth.columns["x_mm"] * np.cos(angle) + truth.columns["y_mm"] * np.sin(angle)) / 7


def _root_radius(truth: Truth, rng: np.random.Generator) -> Array:
    return np.sqrt(truth.columns["radius_mm"]) - np.sqrt(truth.columns["radius_mm"]).mean()


def _curvature(truth: Truth, rng: np.random.Generator) -> Array:
    return 1.0 / truth.columns["radius_mm"]


def shear_share(truth: Truth) -> Array:
    """|F_s| / F_n, F_n no less than a twentieth of its largest."""
    return np.linalg.norm(truth.shear_n, axis=1) / np.maximum(
        truth.force_n, 0.05 * truth.force_n.max()
    )


def _lift(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
    size = np.hypot(truth.force_n, np.sqrt(strength) * np.linalg.norm(truth.shear_n, axis=1))
    return truth.volume_mm3 * size / np.maximum(np.abs(truth.force_n), 1e-9)


def _tilting(truth: Truth, rng: np.random.Generator) -> Array:
    return 1.0 - 1.0 / np.sqrt(1.0 + 4.0 * shear_share(truth) ** 2)


def _warm(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
    warmth = truth.columns["temperature_c"] - truth.columns["temperature_c"].mean()
    return truth.volume_mm3 * np.exp(strength * warmth)


def _arrhenius(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
    kelvin = truth.columns["temperature_c"] + 273.15
    return truth.volume_mm3 * np.exp(strength * 3e3 * (1 / kelvin.mean() - 1 / kelvin))


def _late(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
    result = np.empty_like(truth.volume_mm3)
    for first, stop in trial_rows(truth.trial):
        time = truth.phase_s[first:stop]
        result[first:stop] = np.interp(time - strength, time, truth.volume_mm3[first:stop])
    return result


def _early(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
    return _late(truth, -strength, rng)


def _lagging(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
    return relaxing(truth, truth.volume_mm3, strength) if strength > 0 else truth.volume_mm3


def _power_conditioning(truth: Truth, rng: np.random.Generator) -> Array:
    return 1.0 / (1.0 + truth.trial.astype(np.float64))


def _exponential_conditioning(truth: Truth, rng: np.random.Generator) -> Array:
    return np.exp(-truth.trial / rng.uniform(1.5, 4.0))


def _first_ones(truth: Truth, rng: np.random.Generator) -> Array:
    return np.clip(1.0 - truth.trial / rng.uniform(3.0, 6.0), 0.0, None)


def _clipped(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
    return np.minimum(truth.volume_mm3, truth.volume_mm3.max() / (1.0 + strength))


def _tanh_limit(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
    if strength <= 0:
        return truth.volume_mm3
    limit = truth.volume_mm3.max() / strength
    return limit * np.tanh(truth.volume_mm3 / limit)


def _soft_minimum(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
    limit, width = truth.volume_mm3.max() / (1.0 + strength), 0.06 * truth.volume_mm3.max()
    floor = np.logaddexp(0.0, -limit / width)
    return limit - width * (np.logaddexp(0.0, (limit - truth.volume_mm3) / width) + floor * 0)


NORMAL_FORMS: dict[str, tuple[Form, ...]] = {
    "zero_offset": (
        lambda truth, s, rng: truth.volume_mm3 + s * truth.volume_mm3.max(),
        lambda truth, s, rng: truth.volume_mm3 - s * truth.volume_mm3.max(),
    ),
    "stiffening": (
        _gain(lambda truth, rng: np.tanh(load_share(truth) * 2.0)),
        _gain(lambda truth, rng: -np.expm1(-load_share(truth) / 0.4)),
        _gain(lambda truth, rng: -(load_share(truth) ** 1.3)),
        _rational,
    ),
    "creep": (_gain(_log_creep), _gain(_power_creep), _kelvin),
    "hysteresis": (_bouc_wen, _gain(_root_unloading), _gain(_step_unloading)),
    "drift": (
        _gain(lambda truth, rng: _session(truth)),
        _gain(_saturating_drift),
        _gain(_sine_bump),
    ),
    "position": (_gain(_bump), _gain(_cosine_edge), _gain(_tilt)),
    "geometry": (_gain(_root_radius), _gain(_curvature)),
    "shear_coupling": (_lift, _gain(_tilting), _gain(lambda t, rng: shear_share(t))),
    "temperature": (_warm, _arrhenius),
    "latency": (_late, _early, _lagging),
    "conditioning": (
        _gain(_power_conditioning),
        _gain(_exponential_conditioning),
        _gain(_first_ones),
    ),
    "saturation": (_clipped, _tanh_limit, _soft_minimum),
}


def _by_operator(truth: Truth, rng: np.random.Generator) -> Array:
    return (truth.columns["operator"] == "ada") * 1.0


def _wave(truth: Truth, rng: np.random.Generator) -> Array:
    session = np.ptp(truth.columns["time_s"])
    period = session / rng.uniform(4.0, 25.0)
    phase = rng.uniform(0, 2 * np.pi)
    return np.sin(2 * np.pi * truth.columns["time_s"] / period + phase)


OUTSIDE_FORMS: dict[str, tuple[Form, ...]] = {
    "operator": (
        _gain(_by_operator),
        lambda t, s, rng: t.volume_mm3 + s * t.volume_mm3.max() * _by_operator(t, rng),
    ),
    "time_s": (
        _gain(_wave),
        lambda t, s, rng: t.volume_mm3 + s * t.volume_mm3.max() * _wave(t, rng),
    ),
    "humidity": (_gain(lambda truth, rng: truth.columns["humidity"]),),
}

"""Made-up press logs whose effects are known, by formulas other than those that are fitted.

A case is a log of ball presses by a rig with noise in volume and force. The strength of an effect
is the RMS of what it changes, in units of the noise, after the best compliance has been fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Columns = dict[str, NDArray[Any]]
Array = NDArray[np.float64]


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


def _load(truth: Truth) -> Array:
    return np.clip(truth.force_n, 0.0, None) / truth.force_n.max()


def _session(truth: Truth) -> Array:
    time = truth.columns["time_s"]
    return (time - time.min()) / np.ptp(time)


def _rational(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
    return truth.volume_mm3 / (1.0 + strength * _load(truth))


def _since_contact(truth: Truth) -> Array:
    touched = truth.force_n > 0.03 * truth.force_n.max()
    start = np.full(truth.trial.max() + 1, np.inf)
    np.minimum.at(start, truth.trial[touched], truth.phase_s[touched])
    return np.clip(truth.phase_s - truth.per_trial(start), 0.0, None)


def _duration(truth: Truth) -> float:
    return float(truth.phase_s.max())


def _log_creep(truth: Truth, rng: np.random.Generator) -> Array:
    return np.log1p(_since_contact(truth) / (0.03 * _duration(truth)))


def _power_creep(truth: Truth, rng: np.random.Generator) -> Array:
    return (_since_contact(truth) / _duration(truth)) ** 0.3


def _steps(trial: NDArray[np.int64]) -> list[tuple[int, int]]:
    edges = np.concatenate([[0], np.flatnonzero(np.diff(trial)) + 1, [trial.size]])
    return list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))


def _kelvin(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
    """A Kelvin body in series, stepped from sample to sample."""
    tau = _duration(truth) * rng.uniform(0.08, 0.5)
    return truth.volume_mm3 + strength * _relaxing(truth, truth.volume_mm3, tau)


def _relaxing(truth: Truth, drive: Array, tau: float) -> Array:
    state = np.zeros_like(drive)
    for first, stop in _steps(truth.trial):
        q = np.zeros(drive.shape[1:])
        for i in range(first + 1, stop):
            step = truth.phase_s[i] - truth.phase_s[i - 1]
            q = q + (0.5 * (drive[i] + drive[i - 1]) - q) * -np.expm1(-step / tau)
            state[i] = q
    return state


def _bouc_wen(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
    """A Bouc-Wen internal variable driven by the load."""
    u = _load(truth)
    z = np.zeros_like(u)
    sharp = rng.uniform(4.0, 8.0)
    for first, stop in _steps(truth.trial):
        for i in range(first + 1, stop):
            du = u[i] - u[i - 1]
            z[i] = z[i - 1] + sharp * (du - abs(du) * z[i - 1])
    return truth.volume_mm3 - strength * truth.volume_mm3.max() * z


def _back(truth: Truth) -> tuple[Array, Array]:
    """Share of the trial's peak, and 1 on the way back from it."""
    u, share, back = _load(truth), np.zeros(truth.trial.size), np.zeros(truth.trial.size)
    for first, stop in _steps(truth.trial):
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


def _shear_share(truth: Truth) -> Array:
    return np.linalg.norm(truth.shear_n, axis=1) / np.maximum(
        truth.force_n, 0.05 * truth.force_n.max()
    )


def _lift(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
    size = np.hypot(truth.force_n, np.sqrt(strength) * np.linalg.norm(truth.shear_n, axis=1))
    return truth.volume_mm3 * size / np.maximum(np.abs(truth.force_n), 1e-9)


def _tilting(truth: Truth, rng: np.random.Generator) -> Array:
    return 1.0 - 1.0 / np.sqrt(1.0 + 4.0 * _shear_share(truth) ** 2)


def _warm(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
    warmth = truth.columns["temperature_c"] - truth.columns["temperature_c"].mean()
    return truth.volume_mm3 * np.exp(strength * warmth)


def _arrhenius(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
    kelvin = truth.columns["temperature_c"] + 273.15
    return truth.volume_mm3 * np.exp(strength * 3e3 * (1 / kelvin.mean() - 1 / kelvin))


def _late(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
    result = np.empty_like(truth.volume_mm3)
    for first, stop in _steps(truth.trial):
        time = truth.phase_s[first:stop]
        result[first:stop] = np.interp(time - strength, time, truth.volume_mm3[first:stop])
    return result


def _early(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
    return _late(truth, -strength, rng)


def _lagging(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
    return _relaxing(truth, truth.volume_mm3, strength) if strength > 0 else truth.volume_mm3


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
        _gain(lambda truth, rng: np.tanh(_load(truth) * 2.0)),
        _gain(lambda truth, rng: -np.expm1(-_load(truth) / 0.4)),
        _gain(lambda truth, rng: -(_load(truth) ** 1.3)),
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
    "shear_coupling": (_lift, _gain(_tilting), _gain(lambda t, rng: _shear_share(t))),
    "temperature": (_warm, _arrhenius),
    "latency": (_late, _early, _lagging),
    "conditioning": (
        _gain(_power_conditioning),
        _gain(_exponential_conditioning),
        _gain(_first_ones),
    ),
    "saturation": (_clipped, _tanh_limit, _soft_minimum),
}


def _shear_gain(function: Callable[[Truth, np.random.Generator], Array]) -> Form:
    def form(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
        return truth.shear_mm * (1.0 + strength * function(truth, rng))[:, None]

    return form


def _mindlin(truth: Truth, rng: np.random.Generator) -> Array:
    share = np.clip(_shear_share(truth) / (1.02 * _shear_share(truth).max()), 1e-6, 1.0)
    return 1.5 * (1 - (1 - share) ** (2 / 3)) / share - 1


def _onset(truth: Truth, rng: np.random.Generator) -> Array:
    share = _shear_share(truth) / _shear_share(truth).max()
    return np.clip(share - 0.5, 0.0, None) ** 2


def _stretched(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
    angle = rng.uniform(0, np.pi)
    axis = np.array([np.cos(angle), np.sin(angle)])
    return truth.shear_mm + strength * np.outer(truth.shear_mm @ axis, axis)


def _one_axis(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
    return truth.shear_mm * np.array([1.0 + strength, 1.0])


def _shear_kelvin(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
    tau = _duration(truth) * rng.uniform(0.06, 0.3)
    return truth.shear_mm + strength * _relaxing(truth, truth.shear_mm, tau)


def _shear_logarithm(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
    loaded = (
        np.linalg.norm(truth.shear_n, axis=1) > 0.03 * np.linalg.norm(truth.shear_n, axis=1).max()
    )
    start = np.full(truth.trial.max() + 1, np.inf)
    np.minimum.at(start, truth.trial[loaded], truth.phase_s[loaded])
    since = np.clip(truth.phase_s - truth.per_trial(start), 0.0, None)
    return truth.shear_mm * (1 + strength * np.log1p(since / (0.02 * _duration(truth))))[:, None]


def _shear_memory(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
    """A share of the largest motion so far stays behind."""
    size = np.linalg.norm(truth.shear_mm, axis=1)
    result = truth.shear_mm.copy()
    for first, stop in _steps(truth.trial):
        best = first
        for i in range(first, stop):
            best = i if size[i] > size[best] else best
            result[i] += strength * (truth.shear_mm[best] - truth.shear_mm[i])
    return result


def _shear_bouc_wen(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
    scale = np.linalg.norm(truth.shear_n, axis=1).max()
    u, z = truth.shear_n / scale, np.zeros_like(truth.shear_n)
    for first, stop in _steps(truth.trial):
        for i in range(first + 1, stop):
            du = u[i] - u[i - 1]
            z[i] = z[i - 1] + 5.0 * (du - np.abs(du) * z[i - 1])
    return truth.shear_mm - strength * np.linalg.norm(truth.shear_mm, axis=1).max() * z


def _shear_offset(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
    angle = rng.uniform(0, 2 * np.pi)
    size = np.linalg.norm(truth.shear_mm, axis=1).max()
    return truth.shear_mm + strength * size * np.array([np.cos(angle), np.sin(angle)])


SHEAR_FORMS: dict[str, tuple[Form, ...]] = {
    "slip": (_shear_gain(_mindlin), _shear_gain(_onset)),
    "normal_coupling": (
        _shear_gain(lambda truth, rng: np.clip(_load(truth), 0.05, 1.0) ** (-1 / 3)),
        _shear_gain(lambda truth, rng: np.exp(-_load(truth))),
    ),
    "anisotropy": (_stretched, _one_axis),
    "creep": (_shear_kelvin, _shear_logarithm),
    "hysteresis": (_shear_memory, _shear_bouc_wen),
    "zero_offset": (_shear_offset,),
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

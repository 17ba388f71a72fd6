"""A small second generator of press logs, to check the first: one formula an effect, its own rig.

It shares no line with the package or with ``validation.blind.generator``, whose record of a case
it fills. ``draw_case`` is deterministic in its seed and effects.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from validation.blind.generator import Case

Floats = NDArray[np.float64]
Wanted = Sequence[tuple[str, float]]
Effect = Callable[[Floats, "Session", float], Floats]
"""The load (n, c) that an effect of an amplitude makes of a load; c is 1, or 2 in shear."""

SLIP_AT = 0.6  # ratio of shear to normal force at which a contact would slide
STRONGEST = 8.0  # amplitude that the search for a strength ends at
N_SEARCHED = 50  # halvings of that search


@dataclass(frozen=True)
class Session:
    """Loads and conditions of all samples (n,); ``force_shear_n`` is (n, 2), ``place_mm`` too."""

    trial: NDArray[np.int64]
    time_s: Floats
    clock_s: Floats
    force_n: Floats
    force_shear_n: Floats
    place_mm: Floats
    radius_mm: Floats
    temperature_c: Floats
    humidity_percent: Floats
    operator: NDArray[np.str_]
    phase: Floats  # (8,) of 0 to 1: constants of the effects

    @cached_property
    def blocks(self) -> list[slice]:
        """The rows of each trial."""
        bounds = np.searchsorted(self.trial, np.arange(self.trial[-1] + 2))
        return [slice(i, j) for i, j in pairwise(bounds)]

    @property
    def ratio(self) -> Floats:
        """Shear over normal force (n,), 0 where nothing is pressed."""
        pressed = self.force_n > 0.02 * self.force_n.max()
        size = np.linalg.norm(self.force_shear_n, axis=1)
        return np.where(pressed, size / np.maximum(self.force_n, 1e-9), 0.0)


def _gain(of: Callable[[Session], Floats]) -> Effect:
    """A compliance that is higher by the amplitude times a function (n,) of the conditions."""
    return lambda load, s, a: load * (1.0 + a * of(s))[:, None]


def _logarithmic_creep(load: Floats, s: Session, a: float) -> Floats:
    """Each step of the load goes on growing with the logarithm of its age."""
    result = load.copy()
    tau_s = 0.1 + 0.4 * s.phase[0]
    for rows in s.blocks:
        time, own = s.time_s[rows], load[rows]
        steps = np.diff(own, axis=0, prepend=0.0 * own[:1])
        age = np.maximum(time[:, None] - time[None, :], 0.0)
        result[rows] += a * 0.2 * np.log1p(age / tau_s) @ steps
    return result


def _maxwell_slip(load: Floats, s: Session, a: float) -> Floats:
    """Three springs that slide at a share of the largest load each hold back what is between."""
    result = load.copy()
    for rows in s.blocks:
        for share in (0.05, 0.15, 0.4):
            most, held = share * float(np.abs(load).max()), np.zeros(load.shape[1])
            steps = np.diff(load[rows], axis=0, prepend=0.0 * load[:1])
            for row, step in zip(range(rows.start, rows.stop), steps, strict=True):
                held = held + step
                held = held * min(1.0, most / (float(np.linalg.norm(held)) + 1e-12))
                result[row] -= a * 0.2 * held
    return result


def _delayed(load: Floats, s: Session, a: float) -> Floats:
    result = load.copy()
    for rows in s.blocks:
        result[rows, 0] = np.interp(s.time_s[rows] - 0.1 * a, s.time_s[rows], load[rows, 0])
    return result


def _stretched(load: Floats, s: Session, a: float) -> Floats:
    """A direction in which the gel gives more than across it."""
    angle = np.pi * s.phase[1]
    along = np.array([np.cos(angle), np.sin(angle)])
    return load + a * (load @ along)[:, None] * along


def _offset(load: Floats, s: Session, a: float) -> Floats:
    angle = 2 * np.pi * s.phase[2]
    along = np.ones(1) if load.shape[1] == 1 else np.array([np.cos(angle), np.sin(angle)])
    return load + a * 0.2 * float(np.abs(load).max()) * along


def _sliding(load: Floats, s: Session, a: float) -> Floats:
    near = np.minimum(s.ratio / SLIP_AT, 1.0)
    return load * (1.0 + a * near**3 / (1.2 - near))[:, None]


def _bottomed(load: Floats, s: Session, a: float) -> Floats:
    limit = float(load.max()) / max(a, 1e-9)
    return limit * -np.expm1(-load / limit)


def _bump(s: Session) -> Floats:
    away = np.hypot(*(s.place_mm - 4.0 * (s.phase[3:5] - 0.5)).T)
    return np.asarray(np.cos(np.pi * np.minimum(away / 6.0, 1.0)))


NORMAL: dict[str, Effect] = {
    "zero_offset": _offset,
    "stiffening": _gain(lambda s: -np.log1p(s.force_n / s.force_n.mean())),
    "creep": _logarithmic_creep,
    "hysteresis": _maxwell_slip,
    "drift": _gain(lambda s: np.sqrt(s.clock_s / s.clock_s[-1])),
    "position": _gain(_bump),
    "geometry": _gain(lambda s: s.radius_mm.mean() / s.radius_mm),
    "shear_coupling": _gain(lambda s: s.ratio**2),
    "temperature": _gain(lambda s: np.expm1(0.05 * (s.temperature_c - 24.0))),
    "latency": _delayed,
    "conditioning": _gain(lambda s: 0.5 ** (s.trial / 3.0)),
    "saturation": _bottomed,
}
SHEAR: dict[str, Effect] = {
    "slip": _sliding,
    "normal_coupling": _gain(lambda s: 1.0 / (1.0 + s.force_n / s.force_n.mean())),
    "anisotropy": _stretched,
    "creep": _logarithmic_creep,
    "hysteresis": _maxwell_slip,
    "zero_offset": _offset,
}
UNLISTED: dict[str, Effect] = {
    "operator": _gain(lambda s: (s.operator == s.operator[0]).astype(np.float64)),
    "time_s": _gain(
        lambda s: np.sin(2 * np.pi * ((3 + 4 * s.phase[5]) * s.clock_s / s.clock_s[-1]))
    ),
    "humidity_percent": _gain(lambda s: (s.humidity_percent - 45.0) / 20.0),
}
ORDER = ("zero_offset", "latency", "creep", "hysteresis", "stiffening", "slip", "", "saturation")
"""In which effects act; the others, on the compliance, in the place of ""."""


def draw_case(seed: int, *, normal: Wanted = (), shear: Wanted = ()) -> Case:
    """One session of 24 to 60 presses, each effect as strong as asked for.

    ``normal`` and ``shear`` are (effect, RMS of what the compliance alone leaves over, in units
    of the noise).
    """
    rng = np.random.default_rng([seed & 0xFFFFFFFF, zlib.crc32(repr((normal, shear)).encode())])
    session = _session(rng)
    noise_share, gauge_share = rng.uniform(0.005, 0.03), rng.uniform(0.0, 0.3)
    loads = {"normal": session.force_n[:, None], "shear": session.force_shear_n}
    k = {"normal": float(rng.uniform(2.0, 9.0)), "shear": float(rng.uniform(0.2, 3.0))}
    size = {name: float(np.sqrt((load**2).sum(axis=1).mean())) for name, load in loads.items()}
    noise = {name: float(noise_share * k[name] * size[name]) for name in loads}
    response, reached = {}, {}
    for name, wanted, known in (("normal", normal, NORMAL), ("shear", shear, SHEAR)):
        driven = loads[name]
        for effect, strength in sorted(wanted, key=_place):
            acting = {**known, **UNLISTED}[effect]
            aim = strength * noise[name] / k[name]
            amplitude, got = _amplitude(acting, loads[name], session, aim)
            reached[name, effect] = got * k[name] / noise[name]
            driven = acting(driven, session, amplitude)
        response[name] = k[name] * driven
    gauge = {name: float(gauge_share * noise_share * size[name]) for name in loads}
    listed = [tuple(n for n, _ in wanted if n not in UNLISTED) for wanted in (normal, shear)]
    hidden = [next((n for n, _ in w if n in UNLISTED), "") for w in (normal, shear)]
    return Case(
        frame=_frame(session, response, noise, gauge, rng),
        normal=listed[0],
        shear=listed[1],
        unexplained={"normal": hidden[0], "shear": hidden[1]},
        reached=reached,
        volume_mm3=response["normal"][:, 0],
        shear_mm=response["shear"],
        k_n_mm3_per_n=k["normal"],
        k_s_mm_per_n=k["shear"],
        noise_mm3=noise["normal"],
        noise_mm=noise["shear"],
        floor_mm3=float(np.hypot(noise["normal"], k["normal"] * gauge["normal"])),
        floor_mm=float(np.hypot(noise["shear"], k["shear"] * gauge["shear"])),
        schedules=("knots",),
        form_names=tuple(name for name, _ in (*normal, *shear)),
        inside={},
    )


def _place(one: tuple[str, float]) -> int:
    return ORDER.index(one[0] if one[0] in ORDER else "")


def _session(rng: np.random.Generator) -> Session:
    """Presses that rise, hold, sag, rise and end, through knots; shear follows in one direction."""
    n_trials, rate_hz = int(rng.integers(24, 61)), float(rng.uniform(10.0, 40.0))
    peak_n, radii = (
        float(rng.uniform(4.0, 12.0)),
        rng.choice([2.0, 3.0, 4.0, 6.0], 3, replace=False),
    )
    columns: dict[str, list[Floats]] = {name: [] for name in ("time", "clock", "force", "shear")}
    counts, clock_s = [], 0.0
    for _ in range(n_trials):
        time_s = np.arange(0.0, float(rng.uniform(3.0, 8.0)), 1.0 / rate_hz)
        high, low = rng.uniform(0.3, 1.0, 2) * peak_n, rng.uniform(0.1, 0.9)
        knots = [0.0, 0.0, high[0], high[0], low * high[0], high[1], 0.0, 0.0]
        edges = np.array([0.0, 0.08, 0.25, 0.45, 0.58, 0.72, 0.92, 1.0]) * time_s[-1]
        force = PchipInterpolator(edges, knots)(time_s)
        angle, share = rng.uniform(0.0, 2 * np.pi), rng.uniform(0.05, 0.5)
        pull = share * force * np.sin(np.pi * rng.integers(1, 4) * time_s / time_s[-1])
        columns["time"].append(time_s)
        columns["clock"].append(clock_s + time_s)
        columns["force"].append(force)
        columns["shear"].append(np.outer(pull, [np.cos(angle), np.sin(angle)]))
        counts.append(time_s.size)
        clock_s += time_s[-1] + float(rng.uniform(2.0, 30.0))
    of_trial = np.repeat(np.arange(n_trials), counts)
    wave = np.sin(np.arange(n_trials) * rng.uniform(0.3, 1.2) + rng.uniform(0, 6))
    operators = np.array(["kim", "lee", "ana"])[rng.integers(0, 3, n_trials)]
    joined = {name: np.concatenate(parts) for name, parts in columns.items()}
    return Session(
        trial=of_trial,
        time_s=joined["time"],
        clock_s=joined["clock"],
        force_n=joined["force"],
        force_shear_n=joined["shear"],
        place_mm=rng.uniform(-5.0, 5.0, (n_trials, 2))[of_trial],
        radius_mm=rng.choice(radii, n_trials)[of_trial],
        temperature_c=(24.0 + 3.0 * wave + rng.standard_normal(n_trials))[of_trial],
        humidity_percent=rng.uniform(30.0, 60.0, n_trials)[of_trial],
        operator=operators[of_trial],
        phase=rng.uniform(size=8),
    )


def _amplitude(acting: Effect, load: Floats, s: Session, aim: float) -> tuple[float, float]:
    """The amplitude at which a compliance alone leaves an RMS of ``aim``, and what it leaves."""

    def left(amplitude: float) -> float:
        driven = acting(load, s, amplitude)
        k = float((load * driven).sum() / (load**2).sum())
        return float(np.sqrt(((driven - k * load) ** 2).mean()))

    low, high = 0.0, STRONGEST
    for _ in range(N_SEARCHED):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if left(middle) > aim else (middle, high)
        if high - low < 1e-3 * high:
            break
    return high, left(high)


def _frame(
    s: Session,
    response: dict[str, Floats],
    noise: dict[str, float],
    gauge: dict[str, float],
    rng: np.random.Generator,
) -> pd.DataFrame:
    """What the rig writes down: white noise, every condition."""
    measured = {
        name: one + noise[name] * rng.standard_normal(one.shape) for name, one in response.items()
    }
    shear_n = s.force_shear_n + gauge["shear"] * rng.standard_normal(s.force_shear_n.shape)
    return pd.DataFrame(
        {
            "trial": s.trial,
            "time_s": s.clock_s.round(4),
            "indenter": [f"ball_{2 * radius:g}mm" for radius in s.radius_mm],
            "radius_mm": s.radius_mm,
            "x_mm": s.place_mm[:, 0].round(3),
            "y_mm": s.place_mm[:, 1].round(3),
            "force_normal_n": s.force_n + gauge["normal"] * rng.standard_normal(s.force_n.size),
            "force_shear_x_n": shear_n[:, 0],
            "force_shear_y_n": shear_n[:, 1],
            "volume_mm3": measured["normal"][:, 0],
            "shear_x_mm": measured["shear"][:, 0],
            "shear_y_mm": measured["shear"][:, 1],
            "temperature_c": s.temperature_c.round(2),
            "humidity_percent": s.humidity_percent.round(1),
            "operator": s.operator,
        }
    )

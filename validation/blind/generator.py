"""A second, independent source of press logs whose truth is known.

Nothing here shares a line with the package: schedules, formulas, noise and columns are its own,
so a tool that does well here does not merely recognise its own equations. ``draw_case`` is
deterministic in its seed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

import validation.blind.blind_effects as forms
from validation.blind.blind_forms import ALL_NORMAL, ALL_SHEAR, ALL_UNLISTED
from validation.blind.blind_schedules import SCHEDULES, draw_trial

Floats = NDArray[np.float64]
Wanted = Sequence[tuple[str, float]]
"""(effect, strength) pairs; strength is RMS of what k alone leaves over, in units of the noise."""


@dataclass(frozen=True)
class Case:
    """A press log and what is true of it.

    ``frame`` holds the contract's columns with noise; ``volume_mm3`` (n,) and ``shear_mm`` (n, 2)
    are without noise. ``normal`` and ``shear`` name the effects, ``unexplained`` the covariate
    that a channel follows though no listed effect does ("" where none). ``reached`` are the
    strengths that were reached, by channel and effect; ``floor_`` is the noise of the response with
    the gauge's, times k. ``inside`` are the trials in which a local effect acts, by its name.
    """

    frame: pd.DataFrame
    normal: tuple[str, ...]
    shear: tuple[str, ...]
    unexplained: Mapping[str, str]
    reached: Mapping[tuple[str, str], float]
    volume_mm3: Floats
    shear_mm: Floats
    k_n_mm3_per_n: float
    k_s_mm_per_n: float
    noise_mm3: float
    noise_mm: float
    floor_mm3: float
    floor_mm: float
    schedules: tuple[str, ...]
    form_names: tuple[str, ...]
    inside: Mapping[str, frozenset[int]]


@dataclass(frozen=True)
class _Active:
    """An effect with its form, constants and amplitude."""

    name: str
    effect: forms.Effect
    form: forms.Form
    constants: Mapping[str, float]
    amplitude: float = 0.0
    inside: frozenset[int] | None = None
    """Trials in which it acts; None: in all."""


def draw_case(
    seed: int,
    *,
    normal: Wanted = (),
    shear: Wanted = (),
    n_trials: int | None = None,
    noise_share: float | None = None,
    force_noise_share: float | None = None,
    with_shear: bool | None = None,
    distractors: bool | None = None,
    local: Mapping[str, str] | None = None,
) -> Case:
    """One session on a rig.

    Parameters
    ----------
    seed : int
    normal, shear : sequence of (name, strength)
        Effects of each channel: the contract's names, or ``operator``, ``time_s`` and
        ``humidity_percent`` for effects that no list holds.
    n_trials : int, optional
        12 to 80 when drawn, of 20 to 400 samples.
    noise_share, force_noise_share : float, optional
        Noise of the response and of the gauge, as a share of the RMS response (or force).
    with_shear, distractors : bool, optional
        Whether there are shear columns, and covariates that mean nothing.
    local : mapping, optional
        Effects that act only in a ``region`` of the gel, a ``stretch`` of the session or with one
        ``indenter``.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    local = local or {}
    names = {name for name, _ in (*normal, *shear)} | {_SEEN_BY[kind] for kind in local.values()}
    n_trials = int(rng.integers(12, 81) if n_trials is None else n_trials)
    needs_shear = bool(shear) or "shear_coupling" in names
    with_shear = needs_shear or (rng.random() < 0.8 if with_shear is None else with_shear)
    distractors = rng.random() < 0.5 if distractors is None else distractors
    schedules = _choose_schedules(names, rng)
    trials = _draw_session(n_trials, schedules, names, bool(with_shear), rng)
    inside = {name: _inside(kind, trials, [seed, 1]) for name, kind in local.items()}
    k_n, k_s = float(rng.uniform(2.0, 9.0)), float(rng.uniform(0.2, 3.0))
    noise_share = float(rng.uniform(0.005, 0.03)) if noise_share is None else noise_share
    gauge = float(rng.uniform(0.0, 0.4)) * noise_share
    gauge = gauge if force_noise_share is None else force_noise_share

    volume, noise_mm3, active, reached = _respond(
        "normal", trials, normal, inside, k_n, noise_share, rng
    )
    shear_mm, noise_mm, active_s, reached_s = _respond(
        "shear", trials, shear, inside, k_s, noise_share, rng
    )
    frame = _frame(trials, volume, noise_mm3, shear_mm, noise_mm, gauge, rng)
    frame = _add_columns(frame, trials, names, bool(with_shear), bool(distractors), rng)
    gauge_n, gauge_s = (gauge * _rms(trials, name) for name in ("force_normal_n", "force_shear_n"))
    unlisted = {
        channel: next((name for name, _ in wanted if name in forms.UNLISTED), "")
        for channel, wanted in (("normal", normal), ("shear", shear))
    }
    return Case(
        frame=frame,
        normal=tuple(name for name, _ in normal if name in {**forms.NORMAL, **forms.LOCAL}),
        shear=tuple(name for name, _ in shear if name in {**forms.SHEAR, **forms.LOCAL}),
        unexplained=unlisted,
        reached={**reached, **reached_s},
        volume_mm3=volume[:, 0],
        shear_mm=shear_mm,
        k_n_mm3_per_n=k_n,
        k_s_mm_per_n=k_s,
        noise_mm3=noise_mm3,
        noise_mm=noise_mm,
        floor_mm3=float(np.hypot(noise_mm3, k_n * gauge_n)),
        floor_mm=float(np.hypot(noise_mm, k_s * gauge_s)),
        schedules=schedules,
        form_names=tuple(one.form.__name__ for one in (*active, *active_s)),
        inside=inside,
    )


_SEEN_BY = {"region": "position", "stretch": "drift", "indenter": "geometry"}
"""An effect that needs the same columns."""


def _inside(kind: str, trials: list[forms.Trial], seed: list[int]) -> frozenset[int]:
    """Trials of one part of the gel, of the session, or of one ball: eight trials to two thirds."""
    rng = np.random.default_rng(seed)
    for _ in range(100):
        share, above = rng.uniform(0.25, 0.6), rng.random() < 0.5
        if kind == "indenter":
            value = np.array([trial.radius_mm for trial in trials])
            held = value == rng.choice(np.unique(value))
        else:
            axis = str(rng.choice(["x_mm", "y_mm"])) if kind == "region" else "number"
            value = np.array([getattr(trial, axis) for trial in trials])
            limit = np.quantile(value, 1 - share if above else share)
            held = value > limit if above else value <= limit
        if 8 <= held.sum() <= 0.65 * len(trials):
            break
    return frozenset(int(number) for number in np.flatnonzero(held))


def _choose_schedules(names: set[str], rng: np.random.Generator) -> tuple[str, ...]:
    """One or two schedules that an effect can be seen in: creep needs a hold, and so on."""
    pool = sorted(SCHEDULES)
    if "creep" in names or "latency" in names:
        first = str(rng.choice(["trapezoid", "staircase", "wandering", "sinusoid"]))
    elif "hysteresis" in names:
        first = str(rng.choice(["triangle", "cycles", "staircase", "sinusoid"]))
    else:
        first = str(rng.choice(pool))
    return tuple(dict.fromkeys((first, str(rng.choice(pool)))))


def _draw_session(
    n_trials: int,
    schedules: tuple[str, ...],
    names: set[str],
    with_shear: bool,
    rng: np.random.Generator,
) -> list[forms.Trial]:
    n_balls = int(rng.integers(3, 5) if "geometry" in names else rng.integers(1, 5))
    radii = np.sort(rng.choice([1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0], n_balls, replace=False))
    peak_n = float(rng.uniform(4.0, 12.0))
    walk = np.cumsum(rng.standard_normal(n_trials))
    weather = 3.0 * np.sin(rng.uniform(0, 6.28) + np.arange(n_trials) * rng.uniform(0.15, 0.5))
    warmth = 23.0 + weather + 0.3 * walk / max(1.0, np.abs(walk).max())
    operators = _operators(n_trials, rng)
    n_samples = float(np.exp(rng.uniform(np.log(20.0), np.log(min(400.0, 12_000 / n_trials)))))
    clock, raw = 0.0, []
    for number in range(n_trials):
        ratio = float(rng.uniform(0.1, 0.5)) * (rng.random() < 0.85) if with_shear else 0.0
        force = peak_n * rng.uniform(0.35, 1.0)
        load = draw_trial(str(rng.choice(schedules)), force, ratio, n_samples, rng)
        radius = float(rng.choice(radii))
        x_mm, y_mm = rng.uniform(-6.0, 6.0), rng.uniform(-4.5, 4.5)
        labels = {
            "operator": operators[number],
            "operator_code": {"ann": -1.0, "bo": 0.2, "cy": 1.0}[operators[number]],
            "humidity_percent": float(np.clip(45 + 8 * rng.standard_normal(), 20, 80)),
        }
        raw.append((load, clock, number, x_mm, y_mm, radius, warmth[number], labels))
        clock += load.time_s[-1] + float(rng.uniform(4.0, 40.0))
    highest = max(load.force_normal_n.max() for load, *_ in raw)
    return [
        forms.Trial(
            time_s=load.time_s,
            load=load.force_normal_n[:, None],
            force_normal_n=load.force_normal_n,
            force_shear_n=load.force_shear_n,
            start_s=start,
            number=number,
            x_mm=float(x_mm),
            y_mm=float(y_mm),
            radius_mm=radius,
            temperature_c=warm + 0.002 * load.time_s,
            labels={**labels, "session_peak_n": float(highest)},
            session_s=clock,
            n_trials=n_trials,
            peak_n=float(highest),
        )
        for load, start, number, x_mm, y_mm, radius, warm, labels in raw
    ]


def _rms(trials: list[forms.Trial], name: str) -> float:
    """RMS of a force of all trials, as the gauge's noise is a share of it."""
    return float(np.sqrt((np.concatenate([getattr(trial, name) for trial in trials]) ** 2).mean()))


def _operators(n_trials: int, rng: np.random.Generator) -> list[str]:
    """Who pressed: in shifts, or anyone at any time."""
    if rng.random() < 0.5:
        return [str(name) for name in rng.choice(["ann", "bo", "cy"], n_trials)]
    length = int(rng.integers(2, 6))
    return [("ann", "bo", "cy")[(number // length) % 3] for number in range(n_trials)]


def _respond(
    channel: str,
    trials: list[forms.Trial],
    wanted: Wanted,
    inside: Mapping[str, frozenset[int]],
    compliance: float,
    noise_share: float,
    rng: np.random.Generator,
) -> tuple[Floats, float, list[_Active], dict[tuple[str, str], float]]:
    """Noise-free response (n, c), the noise, the effects in it and the strengths reached."""
    catalogue = {
        **(ALL_NORMAL if channel == "normal" else ALL_SHEAR),
        **ALL_UNLISTED,
        **forms.LOCAL,
    }
    if channel == "shear":
        peak = max(float(np.hypot(*trial.force_shear_n.T).max()) for trial in trials)
        trials = [replace(t, load=t.force_shear_n, peak_n=max(peak, 1e-6)) for t in trials]
    load = np.concatenate([trial.load for trial in trials])
    noise = noise_share * compliance * float(np.sqrt((load**2).mean()))
    chain: list[_Active] = []
    reached = {}
    for name, strength in wanted:
        effect = catalogue[name]
        form = effect.forms[int(rng.integers(len(effect.forms)))]
        one = _Active(name, effect, form, forms.draw_constants(rng), inside=inside.get(name))
        one, got = _amplitude_for(one, trials, load, compliance, strength * noise)
        reached[channel, name] = got / max(noise, 1e-12)
        chain.append(one)
    return compliance * _drive(chain, trials), noise, chain, reached


def _drive(chain: Sequence[_Active], trials: list[forms.Trial]) -> Floats:
    ordered = sorted(chain, key=lambda one: one.effect.stage)
    parts = []
    for trial in trials:
        load = trial.load
        for one in ordered:
            if one.inside is None or trial.number in one.inside:
                load = one.form(load, trial, one.amplitude, one.constants)
        parts.append(load)
    return np.concatenate(parts)


def _amplitude_for(
    one: _Active, trials: list[forms.Trial], load: Floats, compliance: float, wanted: float
) -> tuple[_Active, float]:
    """The amplitude whose residual, after the best k, has RMS ``wanted``; and the RMS reached."""

    def residual(amplitude: float) -> float:
        driven = compliance * _drive([replace(one, amplitude=amplitude)], trials)
        k = float((load * driven).sum() / (load**2).sum())
        return float(np.sqrt(((driven - k * load) ** 2).mean()))

    low, high = 0.0, one.effect.largest
    if wanted <= 0.0:
        return one, 0.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if residual(middle) > wanted else (middle, high)
        if high - low < 1e-3 * high:
            break
    return replace(one, amplitude=high), residual(high)


def _noise(n_by_trial: list[int], columns: int, size: float, rng: np.random.Generator) -> Floats:
    """White noise, part of it slightly correlated from frame to frame, of RMS ``size``."""
    share, memory = rng.uniform(0.0, 0.5), rng.uniform(0.2, 0.6)
    parts = []
    for n_samples in n_by_trial:
        white = rng.standard_normal((n_samples, columns))
        slow = rng.standard_normal((n_samples, columns))
        for index in range(1, n_samples):
            slow[index] = memory * slow[index - 1] + np.sqrt(1 - memory**2) * slow[index]
        parts.append(size * (np.sqrt(1 - share) * white + np.sqrt(share) * slow))
    return np.concatenate(parts)


def _frame(
    trials: list[forms.Trial],
    volume: Floats,
    noise_mm3: float,
    shear_mm: Floats,
    noise_mm: float,
    gauge_share: float,
    rng: np.random.Generator,
) -> pd.DataFrame:
    counts = [len(trial.time_s) for trial in trials]
    normal = np.concatenate([trial.force_normal_n for trial in trials])
    tangential = np.concatenate([trial.force_shear_n for trial in trials])
    gauge_n = gauge_share * _rms(trials, "force_normal_n")
    gauge_s = gauge_share * _rms(trials, "force_shear_n")
    measured = tangential + gauge_s * rng.standard_normal(tangential.shape)
    moved = shear_mm + _noise(counts, 2, noise_mm, rng)
    return pd.DataFrame(
        {
            "trial": np.repeat([trial.number for trial in trials], counts),
            "time_s": np.round(np.concatenate([trial.clock_s for trial in trials]), 4),
            "indenter": np.repeat([f"ball_{2 * trial.radius_mm:g}mm" for trial in trials], counts),
            "radius_mm": np.repeat([trial.radius_mm for trial in trials], counts),
            "x_mm": np.repeat([round(trial.x_mm, 3) for trial in trials], counts),
            "y_mm": np.repeat([round(trial.y_mm, 3) for trial in trials], counts),
            "force_normal_n": normal + gauge_n * rng.standard_normal(len(normal)),
            "force_shear_x_n": measured[:, 0],
            "force_shear_y_n": measured[:, 1],
            "volume_mm3": volume[:, 0] + _noise(counts, 1, noise_mm3, rng)[:, 0],
            "shear_x_mm": moved[:, 0],
            "shear_y_mm": moved[:, 1],
        }
    )


def _add_columns(
    frame: pd.DataFrame,
    trials: list[forms.Trial],
    names: set[str],
    with_shear: bool,
    distractors: bool,
    rng: np.random.Generator,
) -> pd.DataFrame:
    counts = [len(trial.time_s) for trial in trials]
    n_trials = len(trials)
    added: dict[str, object] = {}
    if "temperature" in names or rng.random() < 0.6:
        warm = np.concatenate([trial.temperature_c for trial in trials])
        added["temperature_c"] = np.round(warm + 0.02 * rng.standard_normal(len(warm)), 3)
    for name in ("operator", "humidity_percent"):
        if name in names or distractors:
            added[name] = np.repeat([trial.labels[name] for trial in trials], counts)
    if distractors:
        lamp = 350.0 - 0.1 * np.arange(n_trials) + 2.0 * rng.standard_normal(n_trials)
        added["led_current_ma"] = np.repeat(np.round(lamp, 2), counts)
        added["rig_mode"] = np.repeat(rng.choice(["auto", "manual"], n_trials), counts)
        added["firmware"] = "v2"
        added["supply"] = np.repeat(
            10.0 ** rng.uniform(-4, 4) * rng.standard_normal(n_trials), counts
        )
    frame = frame.assign(**added)
    for columns, effect in (
        (["x_mm", "y_mm"], "position"),
        (["indenter", "radius_mm"], "geometry"),
    ):
        if effect not in names and rng.random() < 0.25:
            frame = frame.drop(columns=columns)
    if not with_shear:
        frame = frame.drop(columns=[name for name in frame.columns if "shear" in name])
    return frame

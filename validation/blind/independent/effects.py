"""What an effect is, and those that act alike on the normal and the shear channel."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from validation.blind.independent.draws import Floats, log_uniform, uniform
from validation.blind.independent.memory import integral, kelvin_voigt, like
from validation.blind.independent.session import Clock, Session


class Stage(IntEnum):
    """Where an effect acts on the way from the force to what is logged, in this order.

    Up to ``LOAD`` it alters the force that drives the compliance, from ``GAIN`` to ``RESPONSE``
    the response, and at ``GAUGE`` the force that is logged.
    """

    HISTORY = 0
    LOAD = 1
    GAIN = 2
    CEILING = 3
    CLOCK = 4
    RESPONSE = 5
    GAUGE = 6


@dataclass(frozen=True)
class Effect:
    """A form of an effect with its constants drawn; ``act`` takes a course and an amplitude."""

    form: str
    stage: Stage
    act: Callable[[Floats, float], Floats]
    largest: float
    """Amplitudes above this make no physical sense."""


Draw = Callable[[np.random.Generator, Session, float], Effect]
"""Draws one of an effect's forms; the number is its sign, -1 or 1."""


def additive(form: str, history: Floats, largest: float) -> Effect:
    """What happened before adds to the load."""
    return Effect(form, Stage.HISTORY, lambda load, a: load + a * history, largest)


def gain(form: str, relative: Floats, largest: float = 0.5) -> Effect:
    """A compliance that is larger by a share of its own."""
    return Effect(form, Stage.GAIN, lambda x, a: x * (1 + a * like(relative, x)), largest)


def centred(values: Floats, clock: Clock) -> Floats:
    """One value a fine step, less the mean over the frames, at most 1 in size."""
    steps = np.broadcast_to(values, clock.sampled.shape)
    frames = steps[clock.sampled]
    return (steps - frames.mean()) / (np.abs(frames - frames.mean()).max() + 1e-12)


def draw_creep(rng: np.random.Generator, session: Session, load: Floats) -> Effect:
    """Kelvin-Voigt bodies, a power law, a Maxwell body's flow, or the logarithm of time."""
    clock, form = session.clock, rng.integers(5)
    typical_s = np.median(clock.duration_s)
    if form == 0:
        tau_s = typical_s * log_uniform(rng, 0.08, 0.8)
        return additive("creep:standard_solid", kelvin_voigt(clock, load, tau_s), 2.0)
    if form == 1:
        quick_s = typical_s * log_uniform(rng, 0.03, 0.2)
        slow_s, share = quick_s * log_uniform(rng, 5, 20), uniform(rng, 0.3, 0.7)
        quick, slow = kelvin_voigt(clock, load, quick_s), kelvin_voigt(clock, load, slow_s)
        return additive("creep:two_kelvin", share * quick + (1 - share) * slow, 2.0)
    if form == 2:
        return additive("creep:power_law", _power_law(rng, clock, load, typical_s), 8.0)
    if form == 3:
        return additive("creep:maxwell_flow", integral(clock.time_s, load) / typical_s, 1.0)
    start_s = typical_s * log_uniform(rng, 0.02, 0.3)
    return additive("creep:log_time", load * like(np.log1p(clock.time_s / start_s), load), 0.5)


def _power_law(rng: np.random.Generator, clock: Clock, load: Floats, typical_s: float) -> Floats:
    """Creep that grows as a power of time, as a sum of Kelvin-Voigt bodies (Prony series)."""
    power = uniform(rng, 0.15, 0.45)
    taus_s = typical_s * np.geomspace(0.01, 30, 8)
    shares = taus_s**power / (taus_s**power).sum()
    history = np.zeros_like(load)
    for share, tau_s in zip(shares, taus_s, strict=True):
        history += share * kelvin_voigt(clock, load, tau_s)
    return history


def _draw_operator(rng: np.random.Generator, session: Session, sign: float) -> Effect:
    """A compliance of each operator's own, or of one alone."""
    names = session.covariates.operators
    if rng.random() < 0.5:
        values, form = np.zeros(len(names)), "operator:one_odd"
        side = rng.choice([-1, 1])
        values[rng.integers(len(names))] = side
    else:
        spread = np.linspace(-1, 1, len(names)) + 0.15 * rng.normal(size=len(names))
        values, form = rng.permutation(spread), "operator:spread"
    by_trial = np.array([values[names.index(name)] for name in session.covariates.operator])
    return gain(form, centred(by_trial[:, None], session.clock))


def _draw_humidity(rng: np.random.Generator, session: Session, sign: float) -> Effect:
    """A compliance that goes with the humidity, or is least at some humidity."""
    humidity = session.covariates.humidity_percent
    wet, side = (humidity - humidity.mean()) / humidity.std(), rng.choice([-1, 1])
    if rng.random() < 0.5:
        return gain("humidity:linear", side * centred(wet[:, None], session.clock))
    away = (wet - uniform(rng, -0.7, 0.7)) ** 2
    return gain("humidity:quadratic", side * centred(away[:, None], session.clock))


def _draw_oscillation(rng: np.random.Generator, session: Session, sign: float) -> Effect:
    """A compliance that comes and goes over the session."""
    periods, phase = uniform(rng, 2, 6), rng.random()
    wave = np.sin(2 * np.pi * (periods * session.clock.progress + phase))
    if rng.random() < 0.5:
        return gain("time_s:sine", wave)
    if rng.random() < 0.5:
        return gain("time_s:square", np.tanh(2.5 * wave))
    return gain("time_s:triangle", 2 / np.pi * np.arcsin(wave))


UNLISTED: dict[str, Draw] = {
    "operator": _draw_operator,
    "humidity_percent": _draw_humidity,
    "time_s": _draw_oscillation,
}
"""Effects of no list, by the covariate that they follow; they draw their signs themselves."""

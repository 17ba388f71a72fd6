"""Effects on the indented volume, each in several forms.

``a`` is an effect's amplitude, of which 0 is no effect.
"""

from __future__ import annotations

import numpy as np

from validation.blind.independent.draws import Floats, uniform
from validation.blind.independent.effects import (
    UNLISTED,
    Draw,
    Effect,
    Stage,
    additive,
    centred,
    draw_creep,
    gain,
)
from validation.blind.independent.memory import dahl, delayed, play, relaxed, running_mean
from validation.blind.independent.session import Session


def draw_normal_effect(rng: np.random.Generator, session: Session, name: str) -> Effect:
    """An effect of the normal channel in a form of its own."""
    sign = float(rng.choice([-1, 1]))
    return {**NORMAL, **UNLISTED}[name](rng, session, sign)


def _draw_zero_offset(rng: np.random.Generator, session: Session, sign: float) -> Effect:
    """A volume that is there without a press, or a gauge that was not tared."""
    size_mm3 = session.k_n_mm3_per_n * session.peak_n
    if rng.random() < 0.5:
        return Effect(
            "zero_offset:volume", Stage.RESPONSE, lambda x, a: x + sign * a * size_mm3, 0.5
        )
    return Effect("zero_offset:gauge", Stage.GAUGE, lambda x, a: x + a * session.peak_n, 0.5)


def _draw_stiffening(rng: np.random.Generator, session: Session, sign: float) -> Effect:
    """A curve that bends: a power, a parabola, a hyperbola, an exponential, or a soft toe."""
    peak_n, form = session.peak_n, rng.integers(5)
    middle_n = 0.5 * peak_n

    def exponential(load: Floats, a: float) -> Floats:
        return sign * np.expm1(sign * a * load / peak_n) * peak_n / a

    if form == 0:
        return Effect(
            "stiffening:power",
            Stage.LOAD,
            lambda x, a: middle_n * np.sign(x) * (np.abs(x) / middle_n) ** (1 + sign * a),
            0.5,
        )
    if form == 1:
        return Effect(
            "stiffening:quadratic",
            Stage.LOAD,
            lambda x, a: x * (1 + sign * a * x / peak_n),
            0.4 if sign < 0 else 1.5,
        )
    if form == 2:
        return Effect(
            "stiffening:rational",
            Stage.LOAD,
            lambda x, a: x / (1 - sign * a * np.abs(x) / peak_n),
            3.0 if sign < 0 else 0.5,
        )
    if form == 3:
        return Effect("stiffening:exponential", Stage.LOAD, exponential, 2.5)
    toe_n = peak_n * uniform(rng, 0.1, 0.4)
    return Effect(
        "stiffening:toe",
        Stage.LOAD,
        lambda x, a: x * (1 + sign * a * np.exp(-np.abs(x) / toe_n)),
        0.6,
    )


def _draw_creep(rng: np.random.Generator, session: Session, sign: float) -> Effect:
    """The volume grows while the force is held."""
    return draw_creep(rng, session, session.force_n)


def _draw_hysteresis(rng: np.random.Generator, session: Session, sign: float) -> Effect:
    """Loops that lose work: play operators (Prandtl-Ishlinskii), or Dahl's friction."""
    force_n, peak_n, form = session.force_n, session.peak_n, rng.integers(3)
    if form == 0:
        widths_n = peak_n * np.geomspace(0.02, uniform(rng, 0.15, 0.35), 5)
        weights = np.exp(-np.arange(5) * uniform(rng, -0.2, 0.5))
        weights /= weights.sum()
        history = np.zeros_like(force_n)
        for weight, width_n in zip(weights, widths_n, strict=True):
            history += weight * play(force_n, width_n)
        return additive("hysteresis:play_stack", history, 3.0)
    # As much as leaves the volume growing with the force.
    width = uniform(rng, 0.12, 0.4)
    friction = dahl(force_n, width * peak_n)
    if form == 1:
        return additive("hysteresis:dahl", -peak_n * friction, 0.42 * width)
    return additive("hysteresis:friction_of_load", -force_n * friction, 0.38 * width)


def _draw_drift(rng: np.random.Generator, session: Session, sign: float) -> Effect:
    """A compliance that changes over the session one way: evenly, at first, or in the middle."""
    progress, form, fade = session.clock.progress, rng.integers(4), uniform(rng, 0.15, 0.5)
    middle = uniform(rng, 0.3, 0.7)
    name, course = (
        ("drift:linear", progress),
        ("drift:warm_up", 1 - np.exp(-progress / fade)),
        ("drift:root", np.sqrt(progress)),
        ("drift:logistic", 1 / (1 + np.exp(-(progress - middle) / 0.08))),
    )[form]
    return gain(name, sign * centred(course, session.clock))


def _draw_position(rng: np.random.Generator, session: Session, sign: float) -> Effect:
    """A compliance that differs over the gel: a tilt, a bowl, a spot, or a clamped membrane."""
    form = rng.integers(4)
    x, y = session.covariates.x_mm[:, None] / 8, session.covariates.y_mm[:, None] / 8
    angle = rng.random() * 2 * np.pi
    x_middle, y_middle = rng.uniform(-0.5, 0.5, 2)
    width = uniform(rng, 0.45, 0.8)
    x_away, y_away = x - x_middle, y - y_middle
    membrane = np.cos(np.pi / 2 * x_away) * np.cos(np.pi / 2 * y_away)
    name, shape = (
        ("position:tilt", x * np.cos(angle) + y * np.sin(angle)),
        ("position:bowl", x_away**2 + y_away**2),
        ("position:spot", np.exp(-(x_away**2 + y_away**2) / 2 / width**2)),
        ("position:membrane", membrane + 0.4 * x),
    )[form]
    return gain(name, sign * centred(shape, session.clock))


def _draw_geometry(rng: np.random.Generator, session: Session, sign: float) -> Effect:
    """A compliance for each radius, by a law, or for each indenter, by none."""
    form, radius_mm = rng.integers(3), session.covariates.radius_mm
    of_flat_mm = uniform(rng, 8, 14)
    radius_mm = np.where(np.isnan(radius_mm), of_flat_mm, radius_mm)
    if form == 0:
        name, values = "geometry:power", radius_mm ** uniform(rng, -1, 1)
    elif form == 1:
        name, values = "geometry:saturating", 1 - np.exp(-radius_mm / uniform(rng, 2, 5))
    else:
        heads, number = np.unique(session.covariates.indenter, return_inverse=True)
        name = "geometry:each_its_own"
        values = rng.permutation(np.linspace(-1, 1, len(heads)))[number]
    return gain(name, sign * centred(values[:, None], session.clock))


def _draw_shear_coupling(rng: np.random.Generator, session: Session, sign: float) -> Effect:
    """A volume that follows the shear force: a junction that grows (Tabor 1959), and others."""
    form, shear_n = rng.integers(4), session.shear_size_n
    largest_n, ratio = shear_n.max(), shear_n / session.force_n
    if form == 0:
        return gain("shear_coupling:gain", sign * shear_n / largest_n, 0.6)
    if form == 1:
        return Effect("shear_coupling:additive", Stage.LOAD, lambda x, a: x + a * shear_n, 0.6)
    if form == 2:
        return Effect(
            "shear_coupling:junction", Stage.GAIN, lambda x, a: x * np.sqrt(1 + a * ratio**2), 8.0
        )
    return gain("shear_coupling:ratio", -((ratio / session.friction) ** 2), 0.6)


def _draw_temperature(rng: np.random.Generator, session: Session, sign: float) -> Effect:
    """A compliance that follows the temperature: a line, Arrhenius' law, or a softening."""
    form, warm_c = rng.integers(3), session.covariates.temperature_c
    relative = centred(warm_c, session.clock)
    if form == 0:
        return gain("temperature:linear", sign * relative)
    if form == 1:
        mean_k = warm_c[session.clock.sampled].mean() + 273.15
        # An activation energy over the gas constant, in units of 30 000 K.
        power = 3e4 * (1 / mean_k - 1 / (warm_c + 273.15))
        return Effect("temperature:arrhenius", Stage.GAIN, lambda x, a: x * np.exp(a * power), 1.5)
    step = np.tanh(2 * relative - uniform(rng, -0.5, 0.5))
    return gain("temperature:softening", sign * centred(step, session.clock))


def _draw_latency(rng: np.random.Generator, session: Session, sign: float) -> Effect:
    """A camera that is late or early, or that blurs what is past into the frame."""
    time_s = session.clock.time_s
    act, name, largest_s = (
        (lambda x, a: delayed(time_s, x, a), "latency:camera_late", 0.8),
        (lambda x, a: delayed(time_s, x, -a), "latency:camera_early", 0.8),
        (lambda x, a: relaxed(time_s, x, a, start=x[:, 0]), "latency:low_pass", 0.8),
        (lambda x, a: running_mean(time_s, x, a), "latency:frame_averaging", 1.2),
    )[rng.integers(4)]
    return Effect(name, Stage.CLOCK, act, largest_s)


def _draw_conditioning(rng: np.random.Generator, session: Session, sign: float) -> Effect:
    """A gel that the first presses change, most often one that they soften."""
    n_trials = len(session.force_n)
    number = np.arange(n_trials)[:, None] * 1.0
    few = uniform(rng, 1.5, max(2.5, min(8, n_trials / 7)))
    sign = -1.0 if rng.random() < 0.7 else 1.0
    form, power = rng.integers(3), uniform(rng, 0.7, 1.6)
    name, left = (
        ("conditioning:exponential", np.exp(-number / few)),
        ("conditioning:hyperbolic", 1 / (1 + number / few) ** 2),
        ("conditioning:power", np.power(number + 1, -power)),
    )[form]
    return gain(name, sign * left, 0.7)


def _draw_saturation(rng: np.random.Generator, session: Session, sign: float) -> Effect:
    """A volume that stops at a ceiling, which is ``a`` below the largest, or slows down there."""
    form, width = rng.integers(3), uniform(rng, 0.08, 0.2)
    top_mm3 = session.k_n_mm3_per_n * session.peak_n
    soft_mm3 = width * top_mm3

    def ceiling(volume: Floats, a: float) -> Floats:
        knee_mm3 = top_mm3 * (1 - a)
        over = np.maximum(volume - knee_mm3, 0)
        beyond = (
            np.zeros_like(over),
            soft_mm3 * -np.expm1(-over / soft_mm3),
            over / (1 + over / soft_mm3),
        )[form]
        return np.minimum(volume, knee_mm3) + beyond

    name = ("saturation:hard", "saturation:exponential", "saturation:rational")[form]
    return Effect(name, Stage.CEILING, ceiling, 0.65)


NORMAL: dict[str, Draw] = {
    "zero_offset": _draw_zero_offset,
    "stiffening": _draw_stiffening,
    "creep": _draw_creep,
    "hysteresis": _draw_hysteresis,
    "drift": _draw_drift,
    "position": _draw_position,
    "geometry": _draw_geometry,
    "shear_coupling": _draw_shear_coupling,
    "temperature": _draw_temperature,
    "latency": _draw_latency,
    "conditioning": _draw_conditioning,
    "saturation": _draw_saturation,
}

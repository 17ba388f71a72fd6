"""Effects on the markers' motion, each in several forms.

``a`` is an effect's amplitude, of which 0 is no effect.
"""

from __future__ import annotations

import numpy as np

from validation.blind.independent.draws import uniform
from validation.blind.independent.effects import (
    UNLISTED,
    Draw,
    Effect,
    Stage,
    additive,
    draw_creep,
    gain,
)
from validation.blind.independent.memory import dahl, like, vector_play
from validation.blind.independent.session import Session


def draw_shear_effect(rng: np.random.Generator, session: Session, name: str) -> Effect:
    """An effect of the shear channel in a form of its own."""
    sign = float(rng.choice([-1, 1]))
    return {**SHEAR, **UNLISTED}[name](rng, session, sign)


def _draw_slip(rng: np.random.Generator, session: Session, sign: float) -> Effect:
    """More or less motion near the friction: Mindlin's partial slip (1949), and others."""
    form, knee = rng.integers(4), uniform(rng, 0.6, 0.8)
    share = session.shear_size_n / (session.friction * session.force_n)
    share = np.maximum(np.clip(share, 0, 1), 1e-6)
    name, relative, largest = (
        ("slip:mindlin", 1.5 * (1 - (1 - share) ** (2 / 3)) / share - 1, 3.0),
        ("slip:rebound", -(np.clip((share - knee) / (1 - knee), 0, 1) ** 2), 0.8),
        ("slip:runaway", -np.log(1 - 0.95 * share) / (0.95 * share) - 1, 2.0),
        ("slip:gross", 1 / (1 + np.exp(-(share - 0.5 - knee / 2) / 0.03)), 1.0),
    )[form]
    return gain(name, relative, largest)


def _draw_normal_coupling(rng: np.random.Generator, session: Session, sign: float) -> Effect:
    """A compliance that follows the normal force; of a sphere, by its cube root (Mindlin 1949)."""
    form, force = rng.integers(4), session.force_n / session.peak_n
    if form == 0:
        return Effect(
            "normal_coupling:rational", Stage.GAIN, lambda x, a: x / like(1 + a * force, x), 4.0
        )
    if form == 1:
        return Effect(
            "normal_coupling:power",
            Stage.GAIN,
            lambda x, a: x * like((force + 0.03) ** (sign * a), x),
            0.5,
        )
    if form == 2:
        return gain("normal_coupling:linear", sign * (force - 0.5), 0.9)
    return gain("normal_coupling:sphere", (force + 0.02) ** (-1 / 3) - 1, 1.5)


def _draw_anisotropy(rng: np.random.Generator, session: Session, sign: float) -> Effect:
    """A compliance that differs along two axes, those of the camera or others."""
    form = rng.integers(3)
    angle = uniform(rng, 0.25, np.pi / 2 - 0.25) if form == 2 else 0.0
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    axes = np.array([1.0, -1.0]) * sign
    if form == 1:
        axes = np.array([1.0, 0.0]) if sign > 0 else np.array([0.0, 1.0])
    matrix = turn @ np.diag(axes) @ turn.T
    name = ("anisotropy:x_and_y", "anisotropy:one_axis", "anisotropy:turned")[form]
    return Effect(name, Stage.GAIN, lambda x, a: x + a * x @ matrix, 0.6)


def _draw_creep(rng: np.random.Generator, session: Session, sign: float) -> Effect:
    """The markers move on while the force is held."""
    return draw_creep(rng, session, session.shear_n)


def _draw_hysteresis(rng: np.random.Generator, session: Session, sign: float) -> Effect:
    """Loops that lose work: play in the plane, or Dahl's friction in the plane or on each axis."""
    shear_n, form, width = session.shear_n, rng.integers(3), uniform(rng, 0.12, 0.35)
    largest_n = session.shear_size_n.max()
    if form == 0:
        widths_n = largest_n * np.geomspace(0.02, uniform(rng, 0.12, 0.3), 4)
        history = np.mean([vector_play(shear_n, width_n) for width_n in widths_n], axis=0)
        return additive("hysteresis:vector_play", history, 3.0)
    # As much as leaves the motion growing with the force.
    if form == 1:
        friction = dahl(shear_n, width * largest_n)
        return additive("hysteresis:vector_dahl", -largest_n * friction, 0.42 * width)
    of_axes = [dahl(shear_n[..., axis], width * largest_n) for axis in (0, 1)]
    return additive("hysteresis:axis_dahl", -largest_n * np.stack(of_axes, -1), 0.42 * width)


def _draw_zero_offset(rng: np.random.Generator, session: Session, sign: float) -> Effect:
    """Markers that rest beside their places, or a gauge that was not tared."""
    angle = rng.random() * 2 * np.pi
    offset_n = np.array([np.cos(angle), np.sin(angle)]) * session.shear_size_n.max()
    offset_mm = session.k_s_mm_per_n * offset_n
    if rng.random() < 0.5:
        return Effect("zero_offset:markers", Stage.RESPONSE, lambda x, a: x + a * offset_mm, 0.5)
    return Effect("zero_offset:gauge", Stage.GAUGE, lambda x, a: x + a * offset_n, 0.5)


SHEAR: dict[str, Draw] = {
    "slip": _draw_slip,
    "normal_coupling": _draw_normal_coupling,
    "anisotropy": _draw_anisotropy,
    "creep": _draw_creep,
    "hysteresis": _draw_hysteresis,
    "zero_offset": _draw_zero_offset,
}

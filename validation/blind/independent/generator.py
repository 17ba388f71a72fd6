"""Press logs whose truth is known, from a generator that shares no line with the others.

Its rigs, schedules, forms of effects, noise and covariates are its own; only the record of a case
is that of ``validation.blind.generator``. ``draw_case`` is deterministic in its seed and effects.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

from validation.blind.generator import Case
from validation.blind.independent.draws import log_uniform, uniform
from validation.blind.independent.drive import Channel, Drive, Wanted
from validation.blind.independent.effects import UNLISTED, Stage
from validation.blind.independent.frame import log_frame
from validation.blind.independent.normal_effects import draw_normal_effect
from validation.blind.independent.session import Session, draw_session
from validation.blind.independent.shear_effects import draw_shear_effect

N_ATTEMPTS = 4
"""Sessions drawn at most, before the best is taken of those that show an effect too weakly."""


@dataclass(frozen=True)
class Attempt:
    """A session with its responses, and the generators of its noise and of its columns."""

    session: Session
    normal: Channel
    shear: Channel
    score: float
    """1 where all effects are as strong as asked for; less where one is not or hardly shows."""
    noise_rng: np.random.Generator
    columns_rng: np.random.Generator


def draw_case(seed: int, *, normal: Wanted = (), shear: Wanted = ()) -> Case:
    """One session on a rig.

    Parameters
    ----------
    seed : int
    normal, shear : sequence of (name, strength)
        Effects of each channel: the contract's names, or ``operator``, ``time_s`` and
        ``humidity_percent`` for effects that no list holds.
    """
    attempt = _best_attempt(seed, normal, shear)
    session = attempt.session
    frame = log_frame(
        session,
        attempt.normal,
        attempt.shear,
        _followed(normal, shear),
        noise_rng=attempt.noise_rng,
        columns_rng=attempt.columns_rng,
    )
    k_n, k_s = session.k_n_mm3_per_n, session.k_s_mm_per_n
    channels = {"normal": attempt.normal, "shear": attempt.shear}
    return Case(
        frame=frame,
        normal=_listed(normal),
        shear=_listed(shear),
        unexplained={"normal": _unlisted(normal), "shear": _unlisted(shear)},
        reached={
            (channel, name): strength
            for channel, driven in channels.items()
            for name, strength in driven.reached.items()
        },
        volume_mm3=attempt.normal.response,
        shear_mm=attempt.shear.response,
        k_n_mm3_per_n=k_n,
        k_s_mm_per_n=k_s,
        noise_mm3=session.noise_mm3,
        noise_mm=session.noise_mm,
        floor_mm3=float(np.hypot(session.noise_mm3, k_n * session.gauge_noise_n)),
        floor_mm=float(np.hypot(session.noise_mm, k_s * session.gauge_noise_shear_n)),
        schedules=session.schedules,
        form_names=tuple(effect.form for driven in channels.values() for effect, _ in driven.chain),
        inside={},
    )


def _listed(wanted: Wanted) -> tuple[str, ...]:
    """The effects that a list holds."""
    return tuple(name for name, _ in wanted if name not in UNLISTED)


def _unlisted(wanted: Wanted) -> str:
    """The covariate that the channel follows though no listed effect does, or nothing."""
    return next((name for name, _ in wanted if name in UNLISTED), "")


def _followed(normal: Wanted, shear: Wanted) -> set[str]:
    """Effects whose covariates must be logged."""
    return {name for name, _ in normal} | {name for name, _ in shear}


def _best_attempt(seed: int, normal: Wanted, shear: Wanted) -> Attempt:
    """The first session that shows all effects as asked for, or the one that shows them best."""
    best = _attempt(seed, normal, shear, 0)
    for number in range(1, N_ATTEMPTS):
        if best.score > 0.99:
            break
        other = _attempt(seed, normal, shear, number)
        best = other if other.score > best.score else best
    return best


def _attempt(seed: int, normal: Wanted, shear: Wanted, number: int) -> Attempt:
    """Draw a session, and drive both channels with its forces."""
    asked = tuple(
        tuple((str(name), float(strength)) for name, strength in wanted)
        for wanted in (normal, shear)
    )
    entropy = [seed & 0xFFFFFFFF, zlib.crc32(repr(asked).encode()), number]
    session_rng, columns_rng, effects_rng, noise_rng = (
        np.random.default_rng([*entropy, stream]) for stream in range(4)
    )
    session = draw_session(
        session_rng,
        {name for name, _ in normal},
        {name for name, _ in shear},
        k_n_mm3_per_n=uniform(effects_rng, 2, 9),
        k_s_mm_per_n=log_uniform(effects_rng, 0.2, 3),
    )
    of_normal = Drive(
        session.clock, session.force_n, session.k_n_mm3_per_n, session.noise_mm3
    ).channel(normal, lambda name: draw_normal_effect(effects_rng, session, name))
    of_shear = Drive(
        session.clock, session.shear_n, session.k_s_mm_per_n, session.noise_mm
    ).channel(shear, lambda name: draw_shear_effect(effects_rng, session, name))
    score = min(_share_reached(normal, of_normal), _share_reached(shear, of_shear))
    if not _ceiling_shows(session, of_normal):
        score -= 0.5
    return Attempt(session, of_normal, of_shear, score, noise_rng, columns_rng)


def _share_reached(wanted: Wanted, channel: Channel) -> float:
    """The least strength reached over that asked for, at most 1."""
    shares = [channel.reached[name] / strength for name, strength in wanted if strength > 0]
    return min([1.0, *shares])


def _ceiling_shows(session: Session, channel: Channel) -> bool:
    """Whether a quarter of the trials come to the ceiling, four at least, where there is one."""
    tops_n = session.force_n.max(axis=1)
    return all(
        (tops_n > session.peak_n * (1 - amplitude)).sum() >= max(4, np.ceil(tops_n.size / 4))
        for effect, amplitude in channel.chain
        if effect.stage is Stage.CEILING and amplitude > 0
    )

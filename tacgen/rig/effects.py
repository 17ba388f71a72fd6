"""Effects of the registry at a wanted strength: their amounts are solved for."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.contact.effects import Effect, LoadHistory, find_effect
from tacgen.contact.law import ContactLaw, FittedEffect, respond
from tacgen.core.errors import RecipeError
from tacgen.core.records import Estimate
from tacgen.core.types import FloatArray
from tacgen.rig.rig_recipe import RigEffect, RigRecipe

MAX_DOUBLINGS = 40  # a trillion times the start: no magnitude is larger
LARGEST_START = 1e-3  # small against the strength of any effect


@dataclass(frozen=True, slots=True)
class SessionTruth:
    """The law that the gel really has in a session, and the response without noise."""

    law: ContactLaw
    volume_mm3: FloatArray
    shear_mm: FloatArray


def true_response(recipe: RigRecipe, columns: Mapping[str, NDArray[Any]]) -> SessionTruth:
    """Volume (N,) and marker motion (N, 2) of the true course, with every effect of the recipe."""
    history = LoadHistory(columns)
    k = {"normal": recipe.law.k_n_mm3_per_n, "shear": recipe.law.k_s_mm_per_n}
    noise = {"normal": recipe.noise.volume_mm3, "shear": recipe.noise.marker_sum_mm}
    fitted = [
        _with_parameters(given, history, k[given.channel], noise[given.channel])
        for given in recipe.effects
    ]
    law = ContactLaw(
        law="volume_linear",
        k_n_mm3_per_n=Estimate(k["normal"], 0.0, "mm3/N"),
        k_s_mm_per_n=Estimate(k["shear"] or np.nan, 0.0, "mm/N"),
        effects=tuple(fitted),
    )
    volume, shear = law.predict(columns)
    return SessionTruth(law, volume, shear)


def _with_parameters(
    given: RigEffect, history: LoadHistory, compliance: float, noise: float
) -> FittedEffect:
    effect = find_effect(given.channel, given.name).only(given.where)
    fixed = effect.complete({**effect.references(history), **given.parameters})
    values = fixed
    if given.strength is not None:
        values = _solve_strength(effect, given, history, fixed, compliance, noise)
    estimates = {
        name: Estimate(value, 0.0, effect.parameter(name).unit) for name, value in values.items()
    }
    return FittedEffect(given.name, given.channel, estimates, given.where)


def _solve_strength(
    effect: Effect,
    given: RigEffect,
    history: LoadHistory,
    fixed: Mapping[str, float],
    compliance: float,
    noise: float,
) -> dict[str, float]:
    """The parameters at which the residual of the best linear law is strength × noise."""
    wanted = float(given.strength or 0.0) * noise
    variants = effect.variants(history, fixed)
    unreachable = (
        f"effects: {given.name!r} ({given.channel}) cannot reach a strength of "
        f"{given.strength:g} × the noise with this schedule; lower it, lower the noise, or "
        f"press so that it shows ({effect.about})"
    )
    if not variants:
        raise RecipeError(unreachable)
    variant = variants[0]
    shaped = {**fixed, **variant.shapes, **given.parameters}
    probe = {k: v for k, v in variant.probes[0].items() if k not in given.parameters}
    load = history.load(effect.channel)
    if wanted == 0.0 or not probe:
        return shaped

    def at(size: float) -> dict[str, float]:
        return shaped | {name: _scaled(effect, name, one, size) for name, one in probe.items()}

    def residual(size: float) -> float:
        response = respond(history, effect.channel, compliance, [(effect, at(size))])
        power = float((load**2).sum())
        k = float((load * response).sum()) / power if power > 0 else 0.0
        return float(np.sqrt(((response - k * load) ** 2).sum(axis=1).mean()))

    size = _size_for(residual, wanted)
    if size is None:
        raise RecipeError(unreachable)
    return at(size)


def _scaled(effect: Effect, name: str, probe: float, size: float) -> float:
    """The probe's amount ``size`` times as far from doing nothing, within its bounds."""
    parameter = effect.parameter(name)
    if np.isinf(parameter.identity):
        # A limit does nothing at infinity: nearer is stronger.
        return max(probe / max(size, 1e-12), parameter.low)
    value = parameter.identity + size * (probe - parameter.identity)
    return float(np.clip(value, parameter.low, parameter.high))


def _size_for(residual: Callable[[float], float], wanted: float) -> float | None:
    """The size at which ``residual`` first reaches ``wanted``; None where it never does."""
    low, high = 0.0, LARGEST_START
    for _ in range(MAX_DOUBLINGS):
        if residual(high) >= wanted:
            break
        low, high = high, 1.6 * high
    else:
        return None
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if residual(middle) >= wanted else (middle, high)
    return high

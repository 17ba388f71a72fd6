"""Shear effects by formulas other than those that are fitted, for made-up press logs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from validation.contact.forms import (
    Array,
    Form,
    Truth,
    duration_s,
    load_share,
    relaxing,
    shear_share,
    trial_rows,
)


def _shear_gain(function: Callable[[Truth, np.random.Generator], Array]) -> Form:
    def form(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
        return truth.shear_mm * (1.0 + strength * function(truth, rng))[:, None]

    return form


def _mindlin(truth: Truth, rng: np.random.Generator) -> Array:
    share = np.clip(shear_share(truth) / (1.02 * shear_share(truth).max()), 1e-6, 1.0)
    return 1.5 * (1 - (1 - share) ** (2 / 3)) / share - 1


def _onset(truth: Truth, rng: np.random.Generator) -> Array:
    share = shear_share(truth) / shear_share(truth).max()
    return np.clip(share - 0.5, 0.0, None) ** 2


def _stretched(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
    angle = rng.uniform(0, np.pi)
    axis = np.array([np.cos(angle), np.sin(angle)])
    return truth.shear_mm + strength * np.outer(truth.shear_mm @ axis, axis)


def _one_axis(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
    return truth.shear_mm * np.array([1.0 + strength, 1.0])


def _shear_kelvin(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
    tau = duration_s(truth) * rng.uniform(0.06, 0.3)
    return truth.shear_mm + strength * relaxing(truth, truth.shear_mm, tau)


def _shear_logarithm(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
    loaded = (
        np.linalg.norm(truth.shear_n, axis=1) > 0.03 * np.linalg.norm(truth.shear_n, axis=1).max()
    )
    start = np.full(truth.trial.max() + 1, np.inf)
    np.minimum.at(start, truth.trial[loaded], truth.phase_s[loaded])
    since = np.clip(truth.phase_s - truth.per_trial(start), 0.0, None)
    return truth.shear_mm * (1 + strength * np.log1p(since / (0.02 * duration_s(truth))))[:, None]


def _shear_memory(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
    """A share of the largest motion so far stays behind."""
    size = np.linalg.norm(truth.shear_mm, axis=1)
    result = truth.shear_mm.copy()
    for first, stop in trial_rows(truth.trial):
        best = first
        for i in range(first, stop):
            best = i if size[i] > size[best] else best
            result[i] += strength * (truth.shear_mm[best] - truth.shear_mm[i])
    return result


def _shear_bouc_wen(truth: Truth, strength: float, rng: np.random.Generator) -> Array:
    scale = np.linalg.norm(truth.shear_n, axis=1).max()
    u, z = truth.shear_n / scale, np.zeros_like(truth.shear_n)
    for first, stop in trial_rows(truth.trial):
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
        _shear_gain(lambda truth, rng: np.clip(load_share(truth), 0.05, 1.0) ** (-1 / 3)),
        _shear_gain(lambda truth, rng: np.exp(-load_share(truth))),
    ),
    "anisotropy": (_stretched, _one_axis),
    "creep": (_shear_kelvin, _shear_logarithm),
    "hysteresis": (_shear_memory, _shear_bouc_wen),
    "zero_offset": (_shear_offset,),
}

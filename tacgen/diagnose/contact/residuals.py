"""What the residual of a model still depends on."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.contact.effects.tilt import TILT
from tacgen.core.types import FloatArray
from tacgen.diagnose.contact import scores
from tacgen.diagnose.contact.candidates import follows_load, known_columns, max_levels
from tacgen.diagnose.contact.channel import TARGETS, ChannelData
from tacgen.diagnose.contact.model import Fit
from tacgen.diagnose.evidence import Dependence

DEGREE = 3  # in a covariate that a residual is tested for
NAMED = ("x_mm", "y_mm", "radius_mm", "temperature_c", "indenter", *TILT)
"""Columns of a press log that a residual may follow; every column that is not known may too."""
EACH_PRESS, COURSE = "press", "course_of_the_press"
"""What a residual follows that no column explains: a gain or zero of each press, or its course."""


def covariates_of(data: ChannelData, skip: Sequence[str] = ()) -> dict[str, NDArray[Any]]:
    """Everything a residual may follow, (N,) each: load, history, place, time, other columns."""
    history = data.history
    load = history.force_normal_n if data.channel == "normal" else history.shear_size_n
    _, unloading = history.reversal(data.channel)
    peak_row, _ = history.reversal("normal")
    found: dict[str, NDArray[Any]] = {
        "load": load,
        "unloading": unloading.astype(np.float64),
        "load_rate": _rate(load, history.time_s, history.starts),
        "peak_so_far": history.normal_smooth_n[peak_row],
        "time_in_trial_s": history.time_in_trial_s,
        "time_s": history.time_s,
        "trial": history.trial,
    }
    found = {name: values for name, values in found.items() if name not in skip}
    if history.has("force_shear_x_n", "force_shear_y_n"):
        found["shear_direction"] = np.arctan2(*history.force_shear_n.T[::-1])
        found["shear_force" if data.channel == "normal" else "force_normal_n"] = (
            history.shear_size_n if data.channel == "normal" else history.force_normal_n
        )
    if history.has(*TILT):
        found["tilt"] = np.hypot(*(history.column(name) for name in TILT))
    known = {*known_columns(), *TARGETS[data.channel]} - set(NAMED)
    for name, values in data.columns.items():
        numeric = np.issubdtype(np.asarray(values).dtype, np.number)
        if name in known or name in skip:
            continue
        if name in NAMED or not numeric or not follows_load(data, name):
            found[name] = history.column(name) if numeric else history.text(name)
    return found


def dependences(
    data: ChannelData, fit: Fit, rng: np.random.Generator, skip: Sequence[str] = ()
) -> tuple[Dependence, ...]:
    """Test the residual of ``fit`` against every covariate, strongest first.

    Units of resampling are trials (`scores.p_values`); each covariate enters as a
    cubic, or as levels, on the compliance and added; its gain is the share of the held-out sum of
    squares, noise included, that this explains.
    """
    response = fit.model.law_response(data)
    blocks: dict[str, FloatArray] = {}
    for name, values in covariates_of(data, skip).items():
        basis = [function[:, None] for function in _basis(values, max_levels(data))]
        axes = 0.1 * data.span * np.eye(data.n_outputs)
        functions = [f * response for f in basis] + [f * axis for axis in axes for f in basis]
        if functions:
            blocks[name] = np.stack([data.reduce(f) for f in functions], axis=1)
    if not blocks:
        return ()
    # Corrections stay as fitted: between neighbours, their similar columns are nearly singular.
    own = replace(fit, jacobian=fit.jacobian[:, ~fit.prior[:, :-1].any(axis=0)])
    grams, (*groups, ones), base = scores.fit_grams(data, own, [*blocks.values(), data.ones])
    shuffled = scores.shuffles(data.unit_trial, data.rules.n_shuffles, rng, data.unit_rows)
    shuffled = shuffled.of_blocks(data.memory_rows(fit.residual))
    p_values = scores.p_values(grams, base, groups, shuffled, ones, parts_of_trials=data.few_trials)
    sets = [base, *([*base, *group] for group in groups)]
    without, *losses = scores.cv_losses(grams, data.folds(), sets, scores.RIDGE).sum(axis=1)
    total = data.noise_loss + max(float(without), 0.0)
    found = [
        Dependence(name, float(p), float(without - loss) / total)
        for name, p, loss in zip(blocks, p_values, losses, strict=True)
    ]
    return tuple(sorted(found, key=lambda d: (d.p_value, -d.gain)))


def of_each_press(data: ChannelData, fit: Fit) -> tuple[float, str]:
    """The share of the residual's squares that a gain and a zero of each trial explain; and which.

    Fitted to one half of a trial's rows and scored on the other: blocks of ``rules.own_block`` rows
    in turn, shorter ones where a trial has not four of them.
    """
    history, rows = data.history, np.arange(data.history.n_samples)
    residual = data.target - fit.model.response(data)
    design = np.column_stack([fit.model.law_response(data) / data.span, np.ones(rows.size)])
    weight = np.sqrt(data.weight)[:, None]
    lengths = np.diff(history.starts)[history.trial_index]
    block = np.clip(lengths // 4, 1, data.rules.own_block)
    odd = (rows - history.starts[history.trial_index]) // block % 2 == 1

    def explained(columns: slice) -> float:
        left = residual.copy()
        for trial in range(history.n_trials):
            own = history.trial_index == trial
            for scored in (odd, ~odd):
                kept, other = own & ~scored, own & scored
                root = design[kept, columns] * weight[kept]
                found = np.linalg.lstsq(root, residual[kept] * weight[kept], rcond=1e-3)[0]
                left[other] -= design[other, columns] @ found
        before, after = (float((one**2 * weight**2).sum()) for one in (residual, left))
        return 1.0 - after / max(before, 1e-300)

    both = explained(slice(None))
    for name, columns in (("a gain", slice(None, -1)), ("a zero", slice(-1, None))):
        if explained(columns) >= data.rules.share_of_both * both > 0:
            return both, name
    return both, "a gain and a zero"


def _basis(values: NDArray[Any], most_levels: int) -> list[FloatArray]:
    """Functions (N,) of a covariate; none where it is constant or has no repeats."""
    if not np.issubdtype(values.dtype, np.number):
        levels, counts = np.unique(values, return_counts=True)
        common = levels[np.argsort(-counts)][:most_levels]
        if levels.size < 2 or counts.max() < 2:
            return []
        return [(values == level).astype(np.float64) for level in common[1:]]
    finite = np.isfinite(values)
    spread = float(values[finite].std()) if finite.any() else 0.0
    if spread <= 1e-9 * (1.0 + float(np.abs(values[finite]).max(initial=0.0))):
        return []
    scaled = np.nan_to_num((values - values[finite].mean()) / spread, nan=0.0)
    degree = min(DEGREE, np.unique(scaled[:2000]).size - 1)
    return [np.clip(scaled, -3, 3) ** power for power in range(1, degree + 1)]


def _rate(load: FloatArray, time_s: FloatArray, starts: NDArray[np.int64]) -> FloatArray:
    """d|load|/dt (N,), clipped to its bulk; 0 for trials of one sample."""
    rate = np.zeros_like(load)
    for first, stop in pairwise(starts):
        if stop - first > 2 and np.all(np.diff(time_s[first:stop]) > 0):
            rate[first:stop] = np.gradient(load[first:stop], time_s[first:stop])
    bulk = np.quantile(np.abs(rate), 0.98) if rate.size else 0.0
    return np.clip(rate, -bulk, bulk)

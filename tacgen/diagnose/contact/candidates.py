"""Every effect and covariate that could explain a residual, as columns of a linear model."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tacgen.contact.effects import Effect, Variant, all_effects
from tacgen.contact.law import respond
from tacgen.core.types import FloatArray
from tacgen.diagnose.contact.channel import TARGETS, ChannelData
from tacgen.diagnose.contact.model import HOWS, Covariate, Fit, Model, references_of
from tacgen.presses.press_log import CONTRACT

_ROUNDING = 1e-6  # of a column's sum of squares: what rounding leaves where two are the same


@dataclass(frozen=True)
class Candidate:
    """A variant of an effect, or a covariate, and its reduced columns (R, M)."""

    name: str
    columns: FloatArray
    effect: Effect | None = None
    variant: Variant | None = None
    covariate: Covariate | None = None

    @property
    def is_effect(self) -> bool:
        """Whether it is a registered effect."""
        return self.effect is not None

    @property
    def is_local(self) -> bool:
        """Whether it is an effect that acts in a part of the log only."""
        return self.effect is not None and self.effect.where is not None

    @property
    def n_parameters(self) -> int:
        """Number of parameters that a fit frees: of an oscillation, the frequency too.

        Of what acts in a part of the log only, where that part ends.
        """
        if self.variant is not None:
            return len(self.variant.free) + self.is_local
        found = self.covariate is not None and self.covariate.kind == "oscillation"
        return int(self.columns.shape[1]) + found

    @property
    def form(self) -> object:
        """Its function: candidates of one form differ only in where their fit starts."""
        return self.variant.form if self.variant is not None else self.label

    @property
    def label(self) -> str:
        """Its name for a reader."""
        if self.variant is not None:
            return f"{self.name}: {self.variant.label}"
        return self.covariate.label if self.covariate is not None else self.name


def known_columns() -> frozenset[str]:
    """Columns of a press log that have a meaning: every other one is a covariate."""
    return frozenset({*CONTRACT, *(name for effect in all_effects() for name in effect.needs)})


def effect_candidates(
    data: ChannelData, model: Model, effects: Sequence[Effect]
) -> list[Candidate]:
    """The variants of ``effects``, linearised at ``model`` by the difference each probe makes."""
    acting = [(term.effect, term.values) for term in model.terms]

    def reduced(*more: tuple[Effect, Mapping[str, float]]) -> FloatArray:
        terms = [*acting, *more]
        return data.reduce(respond(data.history, data.channel, model.compliance, terms))

    plain = reduced()
    candidates = []
    for effect in effects:
        references = references_of(effect, data)
        for variant in effect.variants(data.history, references):
            given = {**references, **variant.shapes}
            columns = [
                reduced((effect, effect.complete({**given, **probe}))) - plain
                for probe in variant.probes
            ]
            stacked = np.stack(columns, axis=1)
            if np.isfinite(stacked).all() and np.abs(stacked).max() > 0:
                candidates.append(Candidate(effect.name, stacked, effect, variant))
    return candidates


def log_covariates(data: ChannelData) -> list[Covariate]:
    """Covariates of every column that the contract does not know."""
    found: list[Covariate] = []
    for name, values in data.columns.items():
        if name in known_columns() or name in TARGETS[data.channel]:
            continue
        if not np.issubdtype(np.asarray(values).dtype, np.number):
            found += text_covariates(name, data)
        elif not follows_load(data, name):
            found += numeric_covariates(name, data)
    return found


def max_levels(data: ChannelData) -> int:
    """Most levels of a text column that the trials are enough to compare."""
    return data.history.n_trials // data.rules.trials_per_level


def text_covariates(column: str, data: ChannelData) -> list[Covariate]:
    """Both forms for a text column; none if it has one level, or hardly any level twice."""
    text = data.history.text(column)
    per_trial = text[data.history.starts[:-1]]
    names, counts = np.unique(per_trial, return_counts=True)
    used = tuple(map(str, names[counts >= 2]))
    if not (2 <= names.size <= max_levels(data) and used):
        return []
    # On the compliance one level is the reference; an added one may be of any level, so that
    # what is added to one of them alone is not taken for a zero offset beside the others; the two
    # are never in one model (`candidates.confounded`).
    every = len(used) == names.size
    levels = {"gain": used[1:] if every else used, "added": used}
    return [Covariate(column, "levels", how, levels=levels[how]) for how in HOWS]


def numeric_covariates(column: str, data: ChannelData) -> list[Covariate]:
    """Line and parabola, on the compliance and added; none if the column is constant."""
    values = data.history.column(column)
    finite = values[np.isfinite(values)]
    spread = float(finite.std()) if finite.size else 0.0
    if finite.size < 0.5 * values.size or spread <= 1e-9 * (1.0 + float(np.abs(finite).max())):
        return []
    line = Covariate(column, "polynomial", "gain", center=float(finite.mean()), scale=spread)
    return [replace(line, how=how, degree=degree) for degree in (1, 2) for how in HOWS]


def covariate_candidates(
    data: ChannelData, fit: Fit, covariates: Sequence[Covariate]
) -> list[Candidate]:
    """Their columns at the fitted law's response."""
    response = fit.model.law_response(data)
    return [
        Candidate(
            covariate.column,
            np.stack([data.reduce(c) for c in covariate.columns(data, response)], axis=1),
            covariate=covariate,
        )
        for covariate in covariates
    ]


def confounded(
    data: ChannelData, linear: Model, effects: Sequence[Effect], covariates: Sequence[Covariate]
) -> frozenset[tuple[str, str]]:
    """Labels of variants and covariates of which the one can do what the other does.

    A column of the variant is a sum of the covariate's and the compliance's: a zero offset of an
    added covariate's of every level. Side by side in a model, the law could be off by any amount
    that the covariate takes back, and of the two only the law is used.
    """
    response = linear.law_response(data)
    compliance = data.reduce(response)[:, None]
    variants = effect_candidates(data, linear, effects)
    if not variants:
        return frozenset()
    labels = [one.label for one in variants for _ in range(one.columns.shape[1])]
    every = np.concatenate([one.columns for one in variants], axis=1)
    own = _beside(compliance, every)
    size, own_size = ((columns**2).sum(axis=0) for columns in (every, own))
    # Where the compliance alone can do it, that is not the covariate's doing.
    is_own = own_size > _ROUNDING * size
    found = set()
    for covariate in covariates:
        columns = np.stack([data.reduce(c) for c in covariate.columns(data, response)], axis=1)
        left = (_beside(_beside(compliance, columns), own) ** 2).sum(axis=0)
        same = np.flatnonzero(is_own & (left <= _ROUNDING * own_size))
        found |= {(labels[i], covariate.label) for i in same}
    return frozenset(found)


def _beside(columns: FloatArray, values: FloatArray) -> FloatArray:
    """``values`` (R, M) less what a sum of ``columns`` (R, K) can be of them."""
    inverse = np.linalg.pinv(columns.T @ columns, rcond=1e-10, hermitian=True)
    return np.asarray(values - columns @ (inverse @ (columns.T @ values)))


def follows_load(data: ChannelData, name: str) -> bool:
    """Whether a numeric column is, within trials, mostly a function of load, turn and time.

    A depth or a gripper's width is another reading of the press, not a condition of it: the law
    must not be excused by it.
    """
    history = data.history
    values = np.nan_to_num(history.column(name))
    load = history.force_normal_n / history.normal_span_n
    _, unloading = history.reversal("normal")
    time = history.time_in_trial_s / max(float(history.time_in_trial_s.max()), 1e-9)
    basis = [load, load**2, load**3, unloading * 1.0, unloading * load, time, time**2]
    design = np.stack([_within(b, history.trial_index) for b in basis], axis=1)
    centred = _within(values, history.trial_index)
    total = float(centred @ centred)
    if total <= 1e-6 * float(((values - values.mean()) ** 2).sum()):
        return False
    left = centred - design @ np.linalg.lstsq(design, centred, rcond=None)[0]
    return float(left @ left) < data.rules.max_share_beside_load * total


def _within(values: FloatArray, trial_index: NDArray[np.int64]) -> FloatArray:
    """Values less their trial's mean."""
    mean: FloatArray = np.bincount(trial_index, values) / np.bincount(trial_index)
    return values - mean[trial_index]

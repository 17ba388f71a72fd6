"""A contact law under fit: a compliance and effects, each in one variant, refitted jointly."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from tacgen.calibrate.contact.slope_fit import clustered, widened
from tacgen.contact.effects import Effect, Variant
from tacgen.contact.law import respond
from tacgen.core.types import BoolArray, FloatArray
from tacgen.diagnose.contact.channel import ChannelData

_MAX_STEPS = 25  # of Gauss-Newton; it ends earlier where it has converged
_MAX_KNOWN = 40  # responses of a law's first effects that a fit keeps
_MAX_LOG_STEP = 0.5  # longest step of what is fitted on a logarithmic scale: a factor of 1.6 each

Known: TypeAlias = dict[tuple[str | float, ...], FloatArray] | None


How = Literal["gain", "added"]
HOWS: tuple[How, ...] = ("gain", "added")


@dataclass(frozen=True)
class Covariate:
    """A dependence on ``column`` that acts on the compliance (``gain``) or is added.

    ``kind`` is its form: ``levels`` of a text column, a ``polynomial`` in a numeric one, a
    ``oscillation`` of ``frequency_hz`` in the session's clock.
    """

    column: str
    kind: Literal["levels", "polynomial", "oscillation"]
    how: How
    levels: tuple[str, ...] = ()
    center: float = 0.0
    scale: float = 1.0
    degree: int = 1
    frequency_hz: float = 0.0
    p_search: float = 0.0  # p of having found it among all frequencies that were looked at

    @property
    def label(self) -> str:
        """Its name for a reader."""
        if self.kind == "oscillation":
            period = f"period {1 / self.frequency_hz:.4g} s"
            harmonics = f", {self.degree} harmonics" if self.degree > 1 else ""
            return f"oscillation in {self.column}, {period} ({self.how}{harmonics})"
        power = f", degree {self.degree}" if self.kind == "polynomial" else ""
        return f"{self.column} ({self.how}{power})"

    def basis(self, data: ChannelData) -> list[FloatArray]:
        """Functions of the covariate, each (N,)."""
        return data.history.once(self, lambda: self._basis(data))

    def _basis(self, data: ChannelData) -> list[FloatArray]:
        if self.kind == "levels":
            held = (data.history.is_text(self.column, level) for level in self.levels)
            return [one.astype(np.float64) for one in held]
        values = data.history.column(self.column)
        if self.kind == "oscillation":
            phase = 2.0 * np.pi * self.frequency_hz * (values - self.center)
            orders = range(1, self.degree + 1)
            return [wave(order * phase) for order in orders for wave in (np.cos, np.sin)]
        scaled = np.nan_to_num((values - self.center) / self.scale, nan=0.0)
        return [scaled**power for power in range(1, self.degree + 1)]

    def columns(self, data: ChannelData, response: FloatArray) -> list[FloatArray]:
        """Columns (N, C) of the linear model, scaled by the response or, for each output, added."""
        if self.how == "gain":
            return [basis[:, None] * response for basis in self.basis(data)]
        axes = 0.1 * data.span * np.eye(response.shape[1])
        return [basis[:, None] * axis for axis in axes for basis in self.basis(data)]


@dataclass(frozen=True)
class Term:
    """An effect in one variant, with the values of all of its parameters."""

    effect: Effect
    variant: Variant
    values: Mapping[str, float]

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.effect.name


@dataclass(frozen=True)
class CovariateTerm:
    """A covariate with a coefficient for each of its columns."""

    covariate: Covariate
    coefficients: tuple[float, ...]


@dataclass(frozen=True)
class Model:
    """A compliance, effects, and covariates that no effect explains but that must not mislead."""

    compliance: float
    terms: tuple[Term, ...] = ()
    covariates: tuple[CovariateTerm, ...] = ()

    def without(self, name: str, covariate: Covariate | None) -> "Model":
        """The model less ``covariate``, or less the effect ``name``."""
        if covariate is None:
            return replace(self, terms=tuple(t for t in self.terms if t.name != name))
        kept = tuple(term for term in self.covariates if term.covariate != covariate)
        return replace(self, covariates=kept)

    def law_response(self, data: ChannelData, known: Known = None) -> FloatArray:
        """What the law alone predicts, (N, C), in the history's order; ``known`` is `respond`'s."""
        acting = [(term.effect, term.values) for term in self.terms]
        return respond(data.history, data.channel, self.compliance, acting, known)

    def response(self, data: ChannelData, known: Known = None) -> FloatArray:
        """The law and the covariates, (N, C)."""
        law = result = self.law_response(data, known)
        for term in self.covariates:
            columns = np.stack(term.covariate.columns(data, law))
            result = result + np.tensordot(np.asarray(term.coefficients), columns, axes=1)
        return result


@dataclass(frozen=True)
class Fit:
    """A fitted model, its weighted residual (R,) and Jacobian (R, P), rows as ``reduce`` has.

    The Jacobian is 0 for a parameter that its bound holds. ``prior`` (P, P + 1) are rows of the
    same least squares, the residual last, that hold free amounts near 0.
    """

    model: Model
    residual: FloatArray
    jacobian: FloatArray
    prior: FloatArray

    @property
    def loss(self) -> float:
        """Weighted sum of squares."""
        return float(self.residual @ self.residual)


def references_of(effect: Effect, data: ChannelData) -> dict[str, float]:
    """Reference values of an effect on this log."""
    of_response = {p.name: data.span for p in effect.parameters if p.of_response}
    return effect.references(data.history) | of_response


def start_term(
    effect: Effect, variant: Variant, data: ChannelData, scales: Sequence[float]
) -> Term:
    """A term at the probes' settings times ``scales``, one for each probe, within bounds."""
    values = effect.complete({**references_of(effect, data), **variant.shapes})
    for probe, scale in zip(variant.probes, scales, strict=True):
        for name, value in probe.items():
            parameter = effect.parameter(name)
            scaled = value * scale if variant.scales else value
            values[name] = float(np.clip(scaled, parameter.low, parameter.high))
    return Term(effect, variant, values)


def fit_model(data: ChannelData, start: Model) -> Fit:
    """Least squares from ``start`` by Levenberg-Marquardt within the parameters' bounds."""
    space = _Space(data, start)
    vector = space.start
    residual = space.residual(vector)
    damping = 1e-3
    jacobian = space.jacobian(vector, residual)
    for _ in range(_MAX_STEPS):
        inner = space.inner(vector, jacobian.T @ residual)
        open_jacobian = jacobian[:, inner]
        normal, gradient = open_jacobian.T @ open_jacobian, open_jacobian.T @ residual
        size = np.sqrt(np.diag(normal)) + 1e-12 * np.sqrt(np.trace(normal)) + 1e-150
        normal, gradient = normal / np.outer(size, size), gradient / size
        improved = False
        for _ in range(6):
            trial = vector.copy()
            damped = normal + (damping + 1e-11) * np.eye(size.size)
            step = np.linalg.solve(damped, gradient) / size
            trial[inner] += np.clip(step, -space.reach[inner], space.reach[inner])
            trial = space.clip(trial)
            new = space.residual(trial)
            if new @ new < residual @ residual:
                improved = True
                break
            damping *= 10.0
        if not improved:
            break
        gain = 1.0 - float(new @ new) / max(float(residual @ residual), 1e-300)
        vector, residual = trial, new
        damping = max(damping / 10.0, 1e-9)
        jacobian = space.jacobian(vector, residual)
        if gain < 1e-5:
            break
    inner = space.inner(vector, jacobian.T @ residual)
    acts = np.linalg.norm(jacobian, axis=0) > 1e-3 * np.linalg.norm(residual)
    return space.fit(vector, residual, jacobian * (inner & acts))


def without_noise_bias(data: ChannelData, fit: Fit, steps: int = 2) -> Fit:
    """The fit with the bias removed that noise of the force puts on least squares.

    Each Gauss-Newton step solves the normal equations of products of neighbouring rows, as
    instrumental variables do; a step that leads out of the neighbourhood is not taken.
    """
    space = _Space(data, fit.model)
    vector, best = space.start, fit
    for _ in range(steps):
        open_ = np.flatnonzero(np.abs(best.jacobian).max(axis=0) > 0)
        if not open_.size:
            return best
        a, b = data.neighbours(np.column_stack([best.jacobian[:, open_], best.residual]))
        prior = best.prior[:, [*open_, -1]]
        gram = 0.25 * (a.T @ b + b.T @ a) + 0.5 * prior.T @ prior
        scale = np.sqrt(np.maximum(np.diag(gram)[:-1], 1e-300))
        if np.linalg.eigvalsh(gram[:-1, :-1] / np.outer(scale, scale))[0] < 1e-6:
            return best
        trial = vector.copy()
        trial[open_] += np.linalg.solve(gram[:-1, :-1], gram[:-1, -1])
        trial = space.clip(trial)
        residual = space.residual(trial)
        kept = np.abs(best.jacobian).max(axis=0) > 0
        found = space.fit(trial, residual, space.jacobian(trial, residual) * kept)
        if found.loss > 1.02 * fit.loss:
            return best
        vector, best = trial, found
    return best


def prediction_and_jacobian(data: ChannelData, fit: Fit) -> tuple[FloatArray, FloatArray]:
    """The fitted model's reduced prediction (R,) of ``data`` and its Jacobian (R, P) there.

    The Jacobian is 0 where the fit's is: for a parameter that its bound holds.
    """
    space = _Space(data, fit.model)
    prediction = data.reduce(fit.model.response(data))
    jacobian = space.jacobian(space.start, space.residual(space.start))[: prediction.size]
    return prediction, jacobian * (np.abs(fit.jacobian).max(axis=0) > 0)


@dataclass(frozen=True)
class StandardErrors:
    """Standard errors of the compliance and of each effect's free parameters."""

    compliance: float
    effects: Mapping[str, Mapping[str, float]]


def standard_errors(data: ChannelData, fit: Fit, *, of_presses: bool = False) -> StandardErrors:
    """Errors that hold for samples that are correlated within a trial (or part of one).

    ``of_presses``: by the scatter of whole trials, where there are several; as of presses each with
    a gain of its own. A 1.96th of half a 95 % interval then, whatever their number. Where few
    trials determine a parameter these are too small: then those of independent rows. 0 for what the
    fit left as it was, since a bound holds it or nothing depends on it.
    Source: Angrist & Pischke 2009, Mostly Harmless Econometrics, § 8.1: the larger of both.
    """
    space = _Space(data, fit.model)
    whole = of_presses and data.history.n_trials > 1
    unit = data.history.trial_index if whole else data.row_unit
    rows = np.repeat(unit, data.n_outputs)
    n_units, free = int(rows.max()) + 1, fit.jacobian.shape[1]
    scores, breads = np.zeros((n_units, free)), np.zeros((n_units, free, free))
    order = np.argsort(rows, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(rows[order])) + 1)
    for part in parts:
        own = fit.jacobian[part]
        scores[rows[part[0]]], breads[rows[part[0]]] = own.T @ fit.residual[part], own.T @ own
    prior = fit.prior[:, :-1].T @ fit.prior[:, :-1]
    covariance, dof = clustered(scores, breads, prior)
    information = breads.sum(axis=0) + prior
    size = np.sqrt(np.diag(information))
    is_known, size = size > 0, np.where(size > 0, size, 1.0)
    scale = np.outer(size, size)
    inverse = np.linalg.pinv(information / scale, rcond=1e-12, hermitian=True) / scale
    independent = fit.loss / max(fit.residual.size - free, 1) * inverse
    errors = np.sqrt(np.maximum(np.diag(covariance), 0.0)) * (widened(dof) if whole else 1.0)
    errors = np.maximum(errors, np.sqrt(np.maximum(np.diag(independent), 0.0)))
    spread = errors * is_known * space.natural_scale(space.start)
    effects: dict[str, dict[str, float]] = {term.name: {} for term in fit.model.terms}
    for (index, name, *_), error in zip(space.slots, spread[1:], strict=False):
        effects[fit.model.terms[index].name][name] = float(error)
    return StandardErrors(float(spread[0]), effects)


class _Space:
    """The free numbers of a model as one vector, in units of about their own size."""

    def __init__(self, data: ChannelData, model: Model) -> None:
        self._data, self._template = data, model
        self._known: dict[tuple[str | float, ...], FloatArray] = {}
        # Of each number after the first: term, parameter, size, whether it is a logarithm.
        self.slots: list[tuple[int, str, float, bool]] = []
        self._compliance_scale = abs(model.compliance) or 1.0
        self._target = data.reduce(data.target)
        bounds, reach, precision = [(1.0, 1e-3, np.inf)], [np.inf], [0.0]
        for index, term in enumerate(model.terms):
            for name in term.variant.free:
                parameter = term.effect.parameter(name)
                logarithmic = parameter.is_logarithmic
                # The size at which a parameter is probed is that of a number of its kind.
                probed = (abs(probe[name]) for probe in term.variant.probes if name in probe)
                scale = 1.0 if logarithmic else next(probed, 0.0) or 1.0
                low, high = parameter.bounds_on(data.history, term.values)
                value = float(np.clip(term.values[name], low, high))
                self.slots.append((index, name, scale, logarithmic))
                start = [np.log(v) if logarithmic else v / scale for v in (value, low, high)]
                bounds.append((start[0], start[1], start[2]))
                reach.append(_MAX_LOG_STEP if logarithmic else np.inf)
                prior_sd = term.variant.prior_sd if parameter.is_free else np.inf
                precision.append(data.noise * scale / prior_sd)
        coefficients = [c for term in model.covariates for c in term.coefficients]
        bounds += [(c, -np.inf, np.inf) for c in coefficients]
        self.start, self._low, self._high = np.array(bounds).T
        self.reach = np.array(reach + [np.inf] * len(coefficients))
        self._precision = np.array(precision + [0.0] * len(coefficients))

    def natural_scale(self, vector: FloatArray) -> FloatArray:
        """d(parameter)/d(number) at ``vector``, in the parameters' own units."""
        scale = np.ones(vector.size)
        scale[0] = self._compliance_scale
        for i, (_, _, size, logarithmic) in enumerate(self.slots, start=1):
            scale[i] = np.exp(vector[i]) if logarithmic else size
        return scale

    def clip(self, vector: FloatArray) -> FloatArray:
        """``vector`` within the bounds."""
        return np.clip(vector, self._low, self._high)

    def inner(self, vector: FloatArray, gradient: FloatArray) -> BoolArray:
        """Which numbers no bound holds; ``gradient`` is the direction of descent."""
        held_low = (vector <= self._low) & (gradient <= 0)
        held_high = (vector >= self._high) & (gradient >= 0)
        return np.asarray(~(held_low | held_high))

    def model(self, vector: FloatArray) -> Model:
        """The model that ``vector`` stands for."""
        values = [dict(term.values) for term in self._template.terms]
        for number, (index, name, scale, logarithmic) in zip(vector[1:], self.slots, strict=False):
            values[index][name] = float(np.exp(number) if logarithmic else number * scale)
        terms = tuple(
            replace(term, values=v) for term, v in zip(self._template.terms, values, strict=True)
        )
        numbers = iter(vector[1 + len(self.slots) :])
        covariates = tuple(
            replace(term, coefficients=tuple(float(next(numbers)) for _ in term.coefficients))
            for term in self._template.covariates
        )
        return Model(float(vector[0]) * self._compliance_scale, terms, covariates)

    def residual(self, vector: FloatArray) -> FloatArray:
        """The residual of the model (R,), and below it the rows of the prior (P,)."""
        if len(self._known) > _MAX_KNOWN:
            self._known.clear()
        response = self._data.reduce(self.model(vector).response(self._data, self._known))
        return np.concatenate([self._target - response, -self._precision * vector])

    def fit(self, vector: FloatArray, residual: FloatArray, jacobian: FloatArray) -> Fit:
        """The fit at ``vector`` from both with the rows of the prior."""
        rows = self._target.size
        prior = np.column_stack([np.diag(self._precision), residual[rows:]])
        return Fit(self.model(vector), residual[:rows], jacobian[:rows], prior)

    def jacobian(self, vector: FloatArray, residual: FloatArray) -> FloatArray:
        """−d(residual)/d(vector) by forward differences, inwards at a bound."""
        columns = []
        for i in range(vector.size):
            step = 1e-4 * max(1.0, abs(vector[i])) if i <= len(self.slots) else 1e-3
            moved = vector.copy()
            moved[i] += step if vector[i] + step <= self._high[i] else -step
            columns.append((residual - self.residual(moved)) / (moved[i] - vector[i]))
        return np.stack(columns, axis=1)

"""Candidates against the declared simulation and each other, by the evidence of real labels.

The evidence is the labels' probability under a candidate, averaged over its parameter's prior. Its
logarithm is the sum of the scores of predicting each label from those before it, in any order: a
cross-validation over grasps, averaged over every size of the held-out part (Fong & Holmes 2020, On
the marginal likelihood and cross-validation). A parameter that explains nothing lowers it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np
from scipy.special import expit, logsumexp

from tacgen.core.arrays import BoolArray, FloatArray, IntArray
from tacgen.diagnose.grasps.hypotheses import Candidate
from tacgen.diagnose.grasps.rules import RULES

SUCCESS, FAILED, TURNED, SLID = range(4)
"""What is known of a real grasp: a failure may come with its mode or without."""

_N_WIDTHS = len(RULES.border_widths)
_NUISANCE = [(flip, width) for flip in RULES.flip_rates for width in RULES.border_widths]
_LOG_NUISANCE = np.log(np.repeat(RULES.flip_weights, _N_WIDTHS) / _N_WIDTHS)


@dataclass(frozen=True)
class LabelModel:
    """What would happen to N grasps over M values of a parameter; one value for the declared one.

    ``coordinate`` (M,) and ``log_prior`` (M,) are the parameter's axis and weights; ``margin``
    (M, N) and ``turning`` (M, N) are of ``slip_margin``; ``log_force`` (M,) is the logarithm of
    the delivered over the declared force.
    """

    coordinate: FloatArray
    log_prior: FloatArray
    margin: FloatArray
    turning: FloatArray
    log_force: FloatArray

    def log_probability(self) -> FloatArray:
        """Log-probability (M, S, 4, N) of what can be known, for S flip rates and widths."""
        tables = []
        for flip, width in _NUISANCE:
            success = flip + (1 - 2 * flip) * expit(self.margin / width)
            failure = 1 - success
            tables.append(
                np.stack(
                    [success, failure, failure * self.turning, failure * (1 - self.turning)], axis=1
                )
            )
        return np.asarray(np.log(np.stack(tables, axis=1)))


@dataclass(frozen=True)
class CandidateModel(LabelModel):
    """A candidate's predictions over its parameter; its own weight is in ``log_prior``."""

    candidate: Candidate


def interpolated(
    candidate: Candidate,
    nodes: FloatArray,
    node_margin: FloatArray,
    node_turning: FloatArray,
    log_force: FloatArray | None = None,
) -> CandidateModel:
    """The model of a candidate from what is known at the values ``nodes`` (K,), (K, N).

    ``log_force`` (K,) as in ``LabelModel``; None where the force is as declared.
    """
    parameter = candidate.parameter
    places = parameter.coordinate(nodes)
    axis = np.linspace(places[0], places[-1], RULES.axis_values)
    center = parameter.coordinate(np.array([parameter.declared]))[0]
    log_prior = -0.5 * ((axis - center) / parameter.spread) ** 2
    force = np.zeros(RULES.axis_values) if log_force is None else np.interp(axis, places, log_force)
    return CandidateModel(
        axis,
        log_prior - logsumexp(log_prior) + np.log(candidate.weight),
        _along(axis, places, node_margin),
        _along(axis, places, node_turning),
        force,
        candidate,
    )


def declared_model(margin: FloatArray, turning: FloatArray) -> LabelModel:
    """The model that nothing is wrong, from margin and turning share (N,)."""
    zero = np.zeros(1)
    return LabelModel(zero, zero, margin[None], turning[None], zero)


def combined_with(
    model: CandidateModel, first: LabelModel, at: int, declared: LabelModel
) -> CandidateModel:
    """``model`` where ``first`` holds at its value number ``at``.

    A margin is a sum of logarithms of what each changes, so the changes add.
    """
    shift = first.margin[at] - declared.margin[0]
    turning = np.where(np.abs(shift) > 0, first.turning[at], model.turning)
    return replace(model, margin=model.margin + shift, turning=turning)


def _along(axis: FloatArray, nodes: FloatArray, values: FloatArray) -> FloatArray:
    """Linear interpolation of every column of ``values`` (K, N) at ``axis`` (M,)."""
    upper = np.clip(np.searchsorted(nodes, axis), 1, len(nodes) - 1)
    part = ((axis - nodes[upper - 1]) / (nodes[upper] - nodes[upper - 1]))[:, None]
    return (1 - part) * values[upper - 1] + part * values[upper]


@dataclass(frozen=True, slots=True)
class ForceReading:
    """The delivered force by images: log(delivered/declared) and its standard error."""

    log_scale: float
    stderr: float


NO_READING = ForceReading(0.0, np.inf)


@dataclass(frozen=True, slots=True)
class Labels:
    """Real labels as the models need them: what is known of each grasp, and of the force."""

    known: IntArray
    modes: BoolArray
    reading: ForceReading

    @property
    def success(self) -> BoolArray:
        """Whether each grasp succeeded."""
        return np.asarray(self.known == SUCCESS)


def one_hot(known: IntArray, used: BoolArray | None = None) -> FloatArray:
    """What is known of the grasps (B, N) as (B, 4, N) zeros and ones, unused grasps all zero."""
    table = (known[:, None, :] == np.arange(4)[None, :, None]).astype(np.float64)
    return np.asarray(table if used is None else table * used)


Model = TypeVar("Model", bound=LabelModel)


class Evidence(Generic[Model]):
    """The log-evidence of models for labels; tables of probabilities are made once."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self._table = model.log_probability()
        values, settings = self._table.shape[:2]
        self._log_prior = model.log_prior[:, None] + _LOG_NUISANCE[None, :]
        self._flat = self._table.reshape(values * settings, -1)
        self._shape = values, settings

    def joint(self, known: FloatArray, log_scale: FloatArray, stderr: float) -> FloatArray:
        """Log of prior × likelihood (B, M, S) for one-hot labels (B, 4, N) and readings (B,)."""
        fit = (known.reshape(len(known), -1) @ self._flat.T).reshape(-1, *self._shape)
        total = fit + self._log_prior
        if np.isfinite(stderr):
            apart = (log_scale[:, None] - self.model.log_force) / stderr
            total = total - 0.5 * apart[:, :, None] ** 2
        return total

    def log_evidence(self, known: FloatArray, log_scale: FloatArray, stderr: float) -> FloatArray:
        """Log of the evidence times the candidate's prior weight (B,)."""
        return np.asarray(logsumexp(self.joint(known, log_scale, stderr), axis=(1, 2)))

    def best_fit(self, known: FloatArray, log_scale: FloatArray, stderr: float) -> float:
        """The largest log-likelihood over all values, for one set of labels, without the prior."""
        joint = self.joint(known, log_scale, stderr)[0]
        return float((joint - self.model.log_prior[:, None]).max())

    def posterior(self, known: FloatArray, log_scale: FloatArray, stderr: float) -> FloatArray:
        """Posterior weights (M, S) for one set of labels."""
        joint = self.joint(known, log_scale, stderr)[0]
        return np.asarray(np.exp(joint - logsumexp(joint)))

    def predicted(self, weights: FloatArray) -> FloatArray:
        """Probability (4, N) of what can be known of each grasp, averaged over ``weights``."""
        return np.asarray(np.einsum("ms,mscn->cn", weights, np.exp(self._table)))

    def success_probability(self, labels: Labels, used: BoolArray | None = None) -> FloatArray:
        """Probability (N,) of success, averaged over the posterior from the ``used`` grasps."""
        return np.asarray(self.predicted(self.posterior(*_arguments(labels, used)))[SUCCESS])

    def drawn(
        self, weights: FloatArray, modes: BoolArray, count: int, rng: np.random.Generator
    ) -> IntArray:
        """Labels (count, N) drawn from the posterior prediction; ``modes`` (N,) come with one."""
        values, settings = self._shape
        chosen = rng.choice(values * settings, size=count, p=weights.ravel())
        table = np.exp(self._table.reshape(values * settings, 4, -1)[chosen])
        success = rng.uniform(size=table[:, 0].shape) < table[:, SUCCESS]
        turned = rng.uniform(size=success.shape) * table[:, FAILED] < table[:, TURNED]
        failed = np.where(modes[None, :], np.where(turned, TURNED, SLID), FAILED)
        return np.where(success, SUCCESS, failed)


@dataclass(frozen=True, slots=True)
class CandidateScore:
    """How well one hypothesis explains the labels.

    ``gain`` is the log-evidence over that of the declared simulation; ``fit`` the largest
    log-likelihood of the labels over it; ``model`` that of the hypothesis's best candidate, with
    the posterior ``coordinate`` and its standard deviation; ``second_mode`` the likeliest value
    apart from it, where one has at least ``RULES.second_mode_share`` of the posterior.
    """

    gain: float
    fit: float
    model: CandidateModel
    coordinate: float
    deviation: float
    second_mode: float | None = None

    @property
    def candidate(self) -> Candidate:
        """The best candidate of the hypothesis."""
        return self.model.candidate

    @property
    def name(self) -> str:
        """Name of the hypothesis."""
        return self.candidate.name

    @property
    def value(self) -> float:
        """The posterior value of the parameter."""
        return self.candidate.parameter.value(self.coordinate)

    @property
    def stderr(self) -> float:
        """Its standard error, in the parameter's unit."""
        return self.deviation * (self.value if self.candidate.parameter.is_factor else 1.0)

    @property
    def nearest(self) -> int:
        """Number of the value nearest to the posterior one."""
        return int(np.argmin(np.abs(self.model.coordinate - self.coordinate)))


class ModelComparison:
    """The declared simulation and everything that could be wrong with it, for one set of grasps."""

    def __init__(self, declared: LabelModel, models: Sequence[CandidateModel]) -> None:
        self.declared = Evidence(declared)
        self.others = [Evidence(model) for model in models]
        self.names = tuple(dict.fromkeys(model.candidate.name for model in models))

    def given(self, chosen: CandidateScore) -> "ModelComparison":
        """The comparison where what was chosen holds."""
        at, best, declared = chosen.nearest, chosen.model, self.declared.model
        base = replace(
            declared_model(best.margin[at], best.turning[at]), log_force=best.log_force[at][None]
        )
        rest = [
            combined_with(evidence.model, best, at, declared)
            for evidence in self.others
            if evidence.model.candidate is not best.candidate
        ]
        return ModelComparison(base, rest)

    def gains(self, known: FloatArray, log_scale: FloatArray, stderr: float) -> FloatArray:
        """Log-evidence of every name over the declared one's (names, B), for B sets of labels."""
        base = self.declared.log_evidence(known, log_scale, stderr)
        by_name: dict[str, list[FloatArray]] = {name: [] for name in self.names}
        for evidence in self.others:
            found = evidence.log_evidence(known, log_scale, stderr)
            by_name[evidence.model.candidate.name].append(found)
        return np.stack([logsumexp(by_name[name], axis=0) - base for name in self.names])

    def scores(self, labels: Labels, used: BoolArray | None = None) -> list[CandidateScore]:
        """Every name, the one with most evidence first, from the ``used`` (N,) grasps alone."""
        known, log_scale, stderr = _arguments(labels, used)
        gains = self.gains(known, log_scale, stderr)[:, 0]
        base_fit = self.declared.best_fit(known, log_scale, stderr)
        found = []
        for name, gain in zip(self.names, gains, strict=True):
            own = [one for one in self.others if one.model.candidate.name == name]
            best = max(own, key=lambda one: one.log_evidence(known, log_scale, stderr)[0])
            weights = best.posterior(known, log_scale, stderr).sum(axis=1)
            axis = best.model.coordinate
            mean, deviation, rest = _mean_of_best_mode(axis, weights)
            second_mode = None
            if rest.sum() > RULES.second_mode_share * weights.sum():
                second = _mean_of_best_mode(axis, rest)[0]
                second_mode = best.model.candidate.parameter.value(second)
            fit = max(one.best_fit(known, log_scale, stderr) for one in own) - base_fit
            found.append(CandidateScore(float(gain), fit, best.model, mean, deviation, second_mode))
        return sorted(found, key=lambda score: -score.gain)

    def null_gains(self, labels: Labels, rng: np.random.Generator) -> FloatArray:
        """The largest gain (``RULES.null_draws``,) in labels drawn from the declared model."""
        known, log_scale, stderr = _arguments(labels, None)
        weights = self.declared.posterior(known, log_scale, stderr)
        drawn = one_hot(self.declared.drawn(weights, labels.modes, RULES.null_draws, rng))
        spread = stderr if np.isfinite(stderr) else 0.0
        log_force = self.declared.model.log_force[0]
        readings = log_force + spread * rng.standard_normal(RULES.null_draws)
        return np.asarray(self.gains(drawn, readings, stderr).max(axis=0))


@dataclass(frozen=True, slots=True)
class Choice:
    """One step of the choice: all scores, the p-value of the first, and whether it is accepted."""

    scores: list[CandidateScore]
    p_value: float
    critical_gain: float
    accepted: bool


def choose(comparison: ModelComparison, labels: Labels, rng: np.random.Generator) -> list[Choice]:
    """Accept candidates one by one, while clean labels would hardly ever give as much evidence.

    What is accepted on top of another must also be ``confirmed`` by simulating both together.
    """
    steps: list[Choice] = []
    while len(steps) <= RULES.max_effects and comparison.others:
        scores = comparison.scores(labels)
        null = comparison.null_gains(labels, rng)
        p_value = float((1 + (null >= scores[0].gain).sum()) / (1 + len(null)))
        critical = float(np.quantile(null, 1 - RULES.false_alarm))
        significant = p_value <= RULES.false_alarm and scores[0].gain > 0
        accepted = significant and len(steps) < RULES.max_effects
        steps.append(Choice(scores, p_value, max(critical, 0.0), accepted))
        if not accepted:
            break
        comparison = comparison.given(scores[0])
    return steps


def confirmed(steps: Sequence[Choice], mislabels: Sequence[int]) -> list[Choice]:
    """The steps, ended before the first addition that simulation does not confirm.

    ``mislabels`` (K + 1,) are simulated with none, one, two … of the K choices that were accepted.
    An addition to an effect must correct at least ``RULES.least_corrected``.
    """
    kept: list[Choice] = []
    for number, step in enumerate(steps):
        added = step.accepted and number > 0
        if added and mislabels[number] - mislabels[number + 1] < RULES.least_corrected:
            kept.append(replace(step, accepted=False))
            break
        kept.append(step)
    return kept


def heldout_success(
    comparison: ModelComparison, labels: Labels, steps: Sequence[Choice], folds: IntArray
) -> FloatArray:
    """Probability (N,) of success of each grasp, from a choice and a fit without its fold.

    The whole choice is made anew on the other folds, by the gains that ``steps`` asked for.
    """
    predicted = np.zeros(len(folds))
    for fold in np.unique(folds):
        used, current = folds != fold, comparison
        probability = current.declared.success_probability(labels, used)
        best: CandidateScore | None = None
        for step in steps:
            current = current.given(best) if best is not None else current
            best = current.scores(labels, used)[0]
            if best.gain <= step.critical_gain:
                break
            probability = Evidence(best.model).success_probability(labels, used)
        predicted[~used] = probability[~used]
    return predicted


def confusable(scores: Sequence[CandidateScore]) -> tuple[str, ...]:
    """Names that fit the labels as well as the first: only the prior speaks for it."""
    first = scores[0]
    return tuple(
        other.name
        for other in scores[1:]
        if other.fit > first.fit - RULES.equal_fit
        and other.gain > first.gain - RULES.confusable_gain
    )


def _mean_of_best_mode(axis: FloatArray, weights: FloatArray) -> tuple[float, float, FloatArray]:
    """Mean and deviation about the highest mode, out to its edges, and the remaining weights.

    A shift to either side may explain the same labels; the mean of both would explain none.
    """
    top = int(np.argmax(weights))
    low = weights < RULES.mode_edge * weights[top]
    left = int(np.flatnonzero(low[:top])[-1]) + 1 if low[:top].any() else 0
    right = top + int(np.flatnonzero(low[top:])[0]) if low[top:].any() else len(axis)
    own, part = axis[left:right], weights[left:right] / weights[left:right].sum()
    mean = float(part @ own)
    rest = weights.copy()
    rest[left:right] = 0.0
    return mean, float(np.sqrt(part @ (own - mean) ** 2)), rest


def _arguments(labels: Labels, used: BoolArray | None) -> tuple[FloatArray, FloatArray, float]:
    reading = labels.reading
    return one_hot(labels.known[None], used), np.array([reading.log_scale]), reading.stderr

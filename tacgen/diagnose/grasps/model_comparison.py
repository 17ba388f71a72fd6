"""What real labels say about everything that may be wrong, together: a joint posterior.

An explanation is a set of candidates, each with its parameter; the empty one is the simulation as
declared. Its evidence is the labels' probability averaged over the priors of its parameters. The
logarithm is the sum of the scores of predicting each label from those before it, in any order: a
cross-validation over grasps, averaged over every size of the held-out part (Fong & Holmes 2020, On
the marginal likelihood and cross-validation). A parameter that explains nothing lowers it. Evidence
times prior weight gives the probability of each explanation.
"""

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from scipy.special import expit, logit, logsumexp

from tacgen.core.types import BoolArray, FloatArray, IntArray
from tacgen.diagnose.engine import Problem, grown
from tacgen.diagnose.grasps.hypotheses import HypothesisCandidate, Prediction
from tacgen.diagnose.grasps.slip_margin import gain_by_torsion
from tacgen.diagnose.rules import GRASPS

SUCCESS, FAILED, TURNED, SLID = range(4)
"""What is known of a real grasp: a failure may come with its mode or without."""

_FLIPS = np.array(GRASPS.flip_rates, np.float32)[:, None, None]
_WIDTHS = np.array(GRASPS.border_widths)[:, None]
_LOG_NUISANCE = np.log(np.repeat(GRASPS.flip_weights, len(_WIDTHS)) / len(_WIDTHS))


@dataclass(frozen=True)
class LabelModel:
    """What would happen to N grasps over M values of parameters; one value for the declared one.

    ``log_prior`` (M,) are the values' weights; ``margin`` (M, N) and ``turning`` (M, N) are of
    ``slip_margin``, and so is ``moment`` (M, N), its ``moment_part``; ``log_force`` (M,) is the
    logarithm of the delivered over the declared force.
    """

    log_prior: FloatArray
    margin: FloatArray
    turning: FloatArray
    log_force: FloatArray
    moment: FloatArray

    def log_probability(self, known: IntArray) -> FloatArray:
        """Log-probability (M, S, N) of what is known (N,), for S flip rates and widths."""
        sign = np.where(known == SUCCESS, 1, -1)
        held = expit((sign * self.margin[:, None, :] / _WIDTHS).astype(np.float32))
        right = _FLIPS + (1 - 2 * _FLIPS) * held[:, None]
        found = np.log(right.reshape(len(held), -1, held.shape[-1]))
        if np.isin(known, (TURNED, SLID)).any():
            by_mode = np.where(known == TURNED, self.turning, 1 - self.turning)
            found += np.log(np.where(known >= TURNED, by_mode, 1.0))[:, None, :]
        return np.asarray(found)

    def log_weights(self, log_scale: FloatArray | float, stderr: float) -> FloatArray:
        """Log of prior × probability (..., M, S) of readings (...) of the force."""
        total = self.log_prior[:, None] + _LOG_NUISANCE
        if np.isfinite(stderr):
            apart = (np.asarray(log_scale)[..., None] - self.log_force) / stderr
            total = total - 0.5 * apart[..., None] ** 2
        return total

    def log_joint(self, labels: "Labels") -> FloatArray:
        """Log of prior × probability (M, S) of all labels."""
        weights = self.log_weights(labels.reading.log_scale, labels.reading.stderr)
        fit = self.log_probability(labels.known).sum(axis=-1, dtype=np.float64)
        return np.asarray(weights + fit)


@dataclass(frozen=True)
class CandidateModel(LabelModel):
    """A candidate's predictions over its parameter, at ``coordinate`` (M,).

    The candidate's own weight is in ``log_prior``; ``as_declared`` (N,) is its margin at the
    declared value, which refining may have corrected.
    """

    coordinate: FloatArray
    as_declared: FloatArray
    candidate: HypothesisCandidate

    @property
    def acts(self) -> BoolArray:
        """Whether any value changes the margin of each grasp (N,), by more than rounding."""
        return np.asarray(np.abs(self.margin - self.as_declared).max(axis=0) > 1e-9)

    @property
    def change(self) -> FloatArray:
        """How far each value (M,) is from the declared one."""
        return self.coordinate - self.candidate.parameter.center

    def only(self, part: slice) -> "CandidateModel":
        """Some of the values."""
        return CandidateModel(
            self.log_prior[part],
            self.margin[part],
            self.turning[part],
            self.log_force[part],
            self.moment[part],
            self.coordinate[part],
            self.as_declared,
            self.candidate,
        )

    def thinned(self, step: int) -> "CandidateModel":
        """Every so many-th value."""
        found = self.only(slice(None, None, step))
        return replace(found, log_prior=found.log_prior + np.log(step))


def interpolated(
    candidate: HypothesisCandidate,
    nodes: FloatArray,
    node_margin: FloatArray,
    node_turning: FloatArray,
    log_force: FloatArray | None = None,
    node_moment: FloatArray | None = None,
) -> CandidateModel:
    """The model of a candidate from what is known at the values ``nodes`` (K,), (K, N).

    ``log_force`` (K,) as in ``LabelModel``; None where the force is as declared. ``node_moment``
    None where nothing turns.
    """
    parameter = candidate.parameter
    places = parameter.coordinate(nodes)
    axis = np.linspace(places[0], places[-1], GRASPS.axis_values)
    log_prior = -0.5 * ((axis - parameter.center) / parameter.spread) ** 2
    force = (
        np.zeros(GRASPS.axis_values) if log_force is None else np.interp(axis, places, log_force)
    )
    return CandidateModel(
        log_prior - logsumexp(log_prior) + np.log(candidate.weight),
        _along(axis, places, node_margin),
        _along(axis, places, node_turning),
        force,
        _along(axis, places, 0 * node_margin if node_moment is None else node_moment),
        axis,
        _along(np.array([parameter.center]), places, node_margin)[0],
        candidate,
    )


def declared_model(
    margin: FloatArray, turning: FloatArray, moment: FloatArray | None = None
) -> LabelModel:
    """The model that nothing is wrong, from margin, turning share and moment's part (N,)."""
    zero = np.zeros(1)
    part = 0 * margin if moment is None else moment
    return LabelModel(zero, margin[None], turning[None], zero, part[None])


def _along(axis: FloatArray, nodes: FloatArray, values: FloatArray) -> FloatArray:
    """Linear interpolation of every column of ``values`` (K, N) at ``axis`` (M,)."""
    upper = np.clip(np.searchsorted(nodes, axis), 1, len(nodes) - 1)
    part = ((axis - nodes[upper - 1]) / (nodes[upper] - nodes[upper - 1]))[:, None]
    return (1 - part) * values[upper - 1] + part * values[upper]


@dataclass(frozen=True, slots=True)
class JointOutcome:
    """Margins (N,) of grasps simulated with several causes at once; NaN where one was not."""

    coordinate: Mapping[HypothesisCandidate, float]
    margin: FloatArray


def joint_model(
    declared: LabelModel, parts: Sequence[CandidateModel], known: Sequence[JointOutcome] = ()
) -> LabelModel:
    """Several candidates at once, over the product of their values (the last varies fastest).

    A margin is a sum of logarithms of what each changes, so the changes add. They add to the
    margin as declared. Refinement corrects that margin separately for each force, mass and
    friction; here it is the mean over the candidates that act on the grasp, weighted by how far
    each is changed. A torsion has no such correction, and counts only where nothing else acts. A
    torsion adds by the part that turning has where others are changed. What ``known`` outcomes of
    some or all of them differ by is added in proportion to the product of those changes, up to the
    simulated ones, in that order.
    """
    if not parts:
        return declared

    def spread(values: FloatArray, k: int) -> FloatArray:
        return values.reshape(
            [-1 if j == k else 1 for j in range(len(parts))] + [*values.shape[1:]]
        )

    turning = logit(declared.turning[0])
    margin: FloatArray = np.zeros(())
    log_prior, log_force, base, weight = (np.zeros(()) for _ in range(4))
    for k, part in enumerate(parts):
        margin = margin + spread(part.margin - part.as_declared, k)
        is_torsion = part.candidate.parameter.prediction is Prediction.TORSION
        size = np.abs(part.change)[:, None] / part.candidate.parameter.spread + 1e-6
        size = size * (part.acts & (not is_torsion)) + 1e-15
        base = base + spread(size, k) * part.as_declared
        weight = weight + spread(size, k)
        turning = turning + spread(logit(part.turning) - logit(declared.turning[0]), k)
        log_prior = log_prior + spread(part.log_prior, k)
        log_force = log_force + spread(part.log_force, k)
    margin = margin + base / weight
    for k, torsion in enumerate(parts):
        if torsion.candidate.parameter.prediction is Prediction.TORSION:
            log_factor = spread(torsion.change[:, None] * torsion.acts, k)
            before = gain_by_torsion(declared.moment[0], log_factor)
            for j, part in enumerate(parts):
                if j != k:
                    margin = margin + gain_by_torsion(spread(part.moment, j), log_factor) - before
    for outcome in known:
        share, at = np.ones(()), []
        for k, part in enumerate(parts):
            center = part.candidate.parameter.center
            place = outcome.coordinate.get(part.candidate, center)
            at.append(int(np.argmin(np.abs(part.coordinate - place))))
            if place != center:
                share = share * spread(np.clip(part.change / (place - center), 0, 1), k)
        apart = np.nan_to_num(outcome.margin - margin[tuple(at)])
        margin = margin + share[..., None] * apart
    n = margin.shape[-1]
    return LabelModel(
        log_prior.ravel(),
        margin.reshape(-1, n),
        expit(turning).reshape(-1, n),
        log_force.ravel(),
        np.repeat(declared.moment, log_prior.size, axis=0),
    )


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


@dataclass(frozen=True, slots=True, eq=False)
class Cause:
    """A candidate of an explanation: its posterior ``coordinate`` and that one's deviation.

    ``second_mode`` is the likeliest value apart from it, where one has at least
    ``GRASPS.second_mode_share`` of the posterior.
    """

    model: CandidateModel
    coordinate: float
    deviation: float
    second_mode: float | None = None

    @property
    def candidate(self) -> HypothesisCandidate:
        """What is wrong."""
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


@dataclass(frozen=True, slots=True, eq=False)
class Explanation:
    """A set of causes, and how well it explains the labels.

    ``gain`` is the log of its evidence times prior weight over that of the declared simulation;
    ``fit`` the largest log-likelihood of the labels over that one's; ``covariance`` (k, k) that of
    the causes' coordinates, in their highest modes.
    """

    causes: tuple[Cause, ...]
    gain: float
    fit: float
    covariance: FloatArray

    @property
    def candidates(self) -> frozenset[HypothesisCandidate]:
        """What is wrong."""
        return frozenset(cause.candidate for cause in self.causes)

    @property
    def name(self) -> str:
        """The names of the causes."""
        return " and ".join(cause.name for cause in self.causes)

    @property
    def members(self) -> tuple[CandidateModel, ...]:
        """The models of the causes."""
        return tuple(cause.model for cause in self.causes)

    @property
    def loss(self) -> float:
        """The less evidence, the more."""
        return -self.gain


AS_DECLARED = Explanation((), 0.0, 0.0, np.zeros((0, 0)))


class ModelComparison:
    """The declared simulation and everything that could be wrong with it, for one set of grasps.

    ``joint`` are grasps simulated with several candidates at once.
    """

    def __init__(
        self,
        declared: LabelModel,
        models: Sequence[CandidateModel],
        joint: Mapping[frozenset[HypothesisCandidate], JointOutcome] | None = None,
    ) -> None:
        self.declared = declared
        self.models = tuple(models)
        self.joint = joint or {}

    def model_of(self, parts: Sequence[CandidateModel]) -> LabelModel:
        """Several candidates at once, at fewer values each the more there are."""
        own = {part.candidate for part in parts}
        known = [one for key, one in self.joint.items() if key <= own]
        known.sort(key=lambda one: len(one.coordinate))
        return joint_model(self.declared, _thinned(parts), known)

    def explanation(self, parts: Sequence[CandidateModel], labels: Labels) -> Explanation:
        """What the labels say about this set of candidates."""
        model = self.model_of(parts)
        by_declared, joint = self.declared.log_joint(labels), model.log_joint(labels)
        fit = (joint - model.log_prior[:, None]).max() - by_declared.max()
        gain = logsumexp(joint) - logsumexp(by_declared) + len(parts) * np.log(GRASPS.cause_odds)
        axes = [part.coordinate for part in _thinned(parts)]
        weights = np.exp(logsumexp(joint, axis=1) - logsumexp(joint)).reshape(
            [len(axis) for axis in axes]
        )
        causes, modes = [], []
        for k, (part, axis) in enumerate(zip(parts, axes, strict=True)):
            own = weights.sum(axis=tuple(j for j in range(len(parts)) if j != k))
            mode = _best_mode(axis, own)
            mean, deviation = _mean_and_deviation(axis[mode], own[mode])
            rest, second_mode = own.copy(), None
            rest[mode] = 0.0
            if rest.sum() > GRASPS.second_mode_share:
                other = _best_mode(axis, rest)
                beyond = _mean_and_deviation(axis[other], rest[other])[0]
                second_mode = part.candidate.parameter.value(beyond)
            causes.append(Cause(part, mean, deviation, second_mode))
            modes.append(mode)
        axes = [axis[mode] for axis, mode in zip(axes, modes, strict=True)]
        weights = weights[tuple(modes)] / weights[tuple(modes)].sum()
        places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(parts))
        apart = places - weights.ravel() @ places
        covariance = (weights.ravel() * apart.T) @ apart
        return Explanation(tuple(causes), float(gain), float(fit), covariance)

    def explanations(self, labels: Labels) -> list[Explanation]:
        """The likeliest sets of up to ``max_members``, each extended from a smaller one."""
        problem = _Explanations(self, labels)
        singles = [problem.add(AS_DECLARED, [model]) for model in self.models]
        singles.sort(key=problem.score)
        levels, _ = grown(problem, singles)
        return sorted((one for level in [singles, *levels] for one in level), key=problem.score)

    def null_gains(self, labels: Labels, rng: np.random.Generator) -> FloatArray:
        """The largest gain of a hypothesis (``GRASPS.null_draws``,) in labels drawn as declared."""
        weights = np.exp(self.declared.log_joint(labels))
        count = GRASPS.null_draws
        chosen = rng.choice(weights.size, size=count, p=weights.ravel() / weights.sum())
        success = np.exp(self.declared.log_probability(np.full(labels.known.shape, SUCCESS)))[0]
        held = rng.uniform(size=(count, len(labels.known))) < success[chosen]
        turned = rng.uniform(size=held.shape) < self.declared.turning
        failed = np.where(labels.modes, np.where(turned, TURNED, SLID), FAILED)
        drawn = np.where(held, SUCCESS, failed)
        stderr = labels.reading.stderr
        readings = (stderr if np.isfinite(stderr) else 0.0) * rng.standard_normal(count)
        base = _log_evidence(self.declared, drawn, readings, stderr)
        by_name: dict[str, list[FloatArray]] = {}
        for model in self.models:
            found = _log_evidence(model, drawn, readings, stderr)
            by_name.setdefault(model.candidate.name, []).append(found)
        gains = np.stack([logsumexp(found, axis=0) for found in by_name.values()]) - base
        return np.asarray(gains.max(axis=0) + np.log(GRASPS.cause_odds))

    def success_probability(
        self, labels: Labels, explanations: Sequence[Explanation], folds: IntArray | None = None
    ) -> FloatArray:
        """Probability (N,) of success, averaged over ``explanations`` by their evidence.

        With ``folds`` (N,), each grasp's from the other folds' labels alone, the weights of the
        explanations included. The simulation as declared is one without causes.
        """
        n = len(labels.known)
        used = np.ones((1, n), bool) if folds is None else folds != np.unique(folds)[:, None]
        row = np.zeros(n, int) if folds is None else np.searchsorted(np.unique(folds), folds)
        found, evidence = [], []
        for one in explanations:
            model = self.model_of([cause.model for cause in one.causes])
            prior = model.log_weights(labels.reading.log_scale, labels.reading.stderr)
            by_grasp = model.log_probability(labels.known).reshape(-1, n)
            total = by_grasp @ used.T + prior.reshape(-1, 1)
            whole = logsumexp(total, axis=0)
            weights = np.exp(total - whole)
            success = np.exp(model.log_probability(np.full(n, SUCCESS))).reshape(-1, n)
            found.append((weights[:, row] * success).sum(axis=0))
            evidence.append(whole + len(one.causes) * np.log(GRASPS.cause_odds))
        share = np.exp(evidence - logsumexp(evidence, axis=0))[:, row]
        return np.asarray((share * np.stack(found)).sum(axis=0))


class _Explanations(Problem[CandidateModel, Explanation]):
    """Sets of causes as the search extends them; each is weighed, so none is dropped."""

    rules = GRASPS

    def __init__(self, comparison: ModelComparison, labels: Labels) -> None:
        self._comparison, self._labels = comparison, labels
        self._known: dict[frozenset[HypothesisCandidate], Explanation] = {}

    def pool(self, current: Explanation) -> list[tuple[CandidateModel, float]]:
        """Every other candidate; only its evidence tells."""
        models = self._comparison.models
        return [(one, np.inf) for one in models if one.candidate not in current.candidates]

    def add(self, current: Explanation, more: Sequence[CandidateModel]) -> Explanation:
        """What the labels say about both together, once for each set."""
        key = current.candidates | {one.candidate for one in more}
        if key not in self._known:
            parts = [*current.members, *more]
            self._known[key] = self._comparison.explanation(parts, self._labels)
        return self._known[key]

    def without(self, full: Explanation, member: CandidateModel) -> Explanation:
        """The set without one, which it was extended from."""
        return self._known[full.candidates - {member.candidate}]

    def accepts(self, _full: Explanation, _member: CandidateModel) -> bool:
        """Which are needed is said by the posterior of all."""
        return True


@dataclass(frozen=True, slots=True)
class Shared:
    """A found ``cause`` as it is where an ``other`` one may be wrong as well.

    The labels determine cause + ``exponent`` × other (coordinates, so that of factors it is a
    product of powers) better than either; with an exponent of 0, the cause is another beside it.
    """

    cause: Cause
    other: Cause
    exponent: float

    @property
    def is_product(self) -> bool:
        """Whether both are factors, of which the labels determine a product of powers."""
        both = self.cause.candidate.parameter, self.other.candidate.parameter
        return abs(self.exponent) >= 0.05 and all(parameter.is_factor for parameter in both)


@dataclass(frozen=True)
class Posterior:
    """What the labels say: explanations, the likeliest first, and whether one is needed at all.

    ``p_value`` is the share of labels drawn from the declared simulation in which one hypothesis
    gains as much as the best does here; ``critical_gain`` is what ``false_alarm`` of them reach.
    """

    explanations: tuple[Explanation, ...]
    p_value: float
    critical_gain: float

    @property
    def best(self) -> Explanation:
        """The likeliest explanation."""
        return self.explanations[0]

    @property
    def found(self) -> tuple[Cause, ...]:
        """Its causes; none where clean labels often need an explanation as much."""
        return self.best.causes if self.p_value <= GRASPS.false_alarm else ()

    def by_hypothesis(self) -> list[Explanation]:
        """The best single cause of each name, with the evidence of all of that name."""
        best: dict[str, Explanation] = {}
        for one in self.explanations:
            if len(one.causes) == 1:
                known = best.setdefault(one.name, one)
                if known is not one:
                    gain = float(np.logaddexp(known.gain, one.gain))
                    best[one.name] = replace(known, gain=gain)
        return sorted(best.values(), key=lambda one: -one.gain)

    @cached_property
    def log_total(self) -> float:
        """Log of the sum of all weights, over that of the declared simulation."""
        return float(logsumexp([0.0, *(one.gain for one in self.explanations)]))

    @property
    def with_declared(self) -> list[Explanation]:
        """The explanations and that nothing is wrong, the likeliest first."""
        return sorted([AS_DECLARED, *self.explanations], key=lambda one: -one.gain)

    def share(self, one: Explanation) -> float:
        """Probability that exactly this is wrong."""
        return float(np.exp(one.gain - self.log_total))

    def probability(self, candidates: Set[HypothesisCandidate]) -> float:
        """Probability that all of these are wrong, among whatever else."""
        gains = [one.gain for one in self.explanations if candidates <= one.candidates]
        return float(np.exp(logsumexp(gains) - self.log_total)) if gains else 0.0

    @cached_property
    def same(self) -> tuple[Explanation, ...]:
        """Explanations that say what is reported as found, the likeliest first.

        The best one and, of each product that ``shared`` reports, those by its other factors at
        which it has the value found.
        """
        powers = [
            {
                cause.candidate: 1.0,
                **{
                    one.other.candidate: one.exponent
                    for one in self.shared(cause)
                    if one.is_product
                },
            }
            for cause in self.found
        ]
        reported = frozenset[HypothesisCandidate]().union(*powers)
        return tuple(
            one
            for one in self.explanations
            if one.candidates <= reported and all(map(partial(_has_value, one), self.found, powers))
        )

    @property
    def found_probability(self) -> float:
        """Probability of what is reported as found: that of all that say the ``same``."""
        return sum(map(self.share, self.same))

    @cached_property
    def alternatives(self) -> tuple[Explanation, ...]:
        """Other explanations that the labels do not exclude, the likeliest first.

        They have at least ``GRASPS.least_alternative`` of the best one's probability, that nothing
        is wrong among them. Not listed again is what is the ``same``, what adds a cause to the best
        that ``shared`` reports, and what adds one to a likelier one of these or of those.
        """
        if not self.found:
            return ()
        best, found = self.best, list[Explanation]()
        reported = [one.candidates for one in self.same]
        for cause in self.found:
            reported += [best.candidates | {one.other.candidate} for one in self.shared(cause)]
        for one in self.with_declared:
            if one.gain < best.gain + np.log(GRASPS.least_alternative):
                break
            # A part of the best one says nothing of what else may be beside it.
            likelier = [other for other in (*self.same, *found) if other.gain >= one.gain]
            smaller = [other.candidates for other in likelier]
            adds = any(own < one.candidates for own in smaller if not own <= best.candidates)
            if one.candidates not in reported and not adds:
                found.append(one)
        return tuple(found)

    @cached_property
    def products(self) -> tuple[Cause, ...]:
        """Where nothing is found: factors that the labels determine only in products with others.

        One cause a product, the likeliest, alone; ``shared`` has the others.
        """
        leading, named = list[Cause](), set[str]()
        for one in self.by_hypothesis() if not self.found else ():
            (cause,) = one.causes
            others = {both.other.name for both in self.shared(cause) if both.is_product}
            if others and cause.name not in named:
                leading.append(cause)
                named |= {cause.name, *others}
        return tuple(leading)

    def shared(self, cause: Cause) -> tuple[Shared, ...]:
        """What a ``cause`` that is found, or the likeliest of its name, is confounded with.

        The likeliest first: those by other names that the labels do not exclude, and beside which
        the cause lies ``GRASPS.ridge_widening`` times its error from its estimate or farther, root
        mean square.
        Where both are correlated, the precision matrix less the prior's gives the one combination
        that the labels determine; a shift that may be to either side is taken to that of ``cause``.
        """
        found: dict[str, Shared] = {}
        smaller = next(one for one in self.explanations if cause in one.causes)
        k = smaller.causes.index(cause)
        alone = np.sqrt(smaller.covariance[k, k])
        for one in self.explanations:
            added = [own for own in one.causes if own.candidate not in smaller.candidates]
            if len(added) != 1 or not smaller.candidates < one.candidates:
                continue
            weight = GRASPS.cause_odds * added[0].candidate.weight
            if one.gain - np.log(weight) < smaller.gain - GRASPS.excluding_gain:
                continue
            order = [own.candidate for own in one.causes]
            pair = [order.index(cause.candidate), order.index(added[0].candidate)]
            covariance = one.covariance[np.ix_(pair, pair)]
            precision = np.linalg.inv(covariance + GRASPS.least_variance * np.eye(2))
            by_labels = precision[0, 0] - cause.candidate.parameter.spread**-2
            least = GRASPS.ridge_widening * alone
            if added[0].candidate.objects != cause.candidate.objects:
                least *= np.sqrt(2)  # as where each follows from the grasps of one of two objects
            beside = one.causes[pair[0]]
            is_mirrored = (
                beside.second_mode is not None and beside.coordinate * cause.coordinate < 0
            )
            side = -1.0 if is_mirrored else 1.0
            moved = side * beside.coordinate - cause.coordinate
            is_farther = np.hypot(np.sqrt(covariance[0, 0]), moved) > least
            if is_farther and by_labels > 0 and added[0].name != cause.name:
                exponent = side * float(precision[0, 1] / by_labels)
                both = Shared(beside, added[0], exponent)
                found.setdefault(added[0].candidate.title, both)
        return tuple(found.values())

    def confusable_with(self, cause: Cause) -> tuple[str, ...]:
        """Names of what may be wrong beside a found ``cause`` or instead of it, likeliest first."""
        others = [one.other for one in self.shared(cause)]
        for one in self.alternatives:
            if cause.candidate not in one.candidates or self.best.candidates < one.candidates:
                others += one.causes
        found = {(own.name, own.candidate.objects) for own in self.found}
        names = [one.name for one in others if (one.name, one.candidate.objects) not in found]
        return tuple(name for name in dict.fromkeys(names) if name != cause.name)


def _has_value(one: Explanation, cause: Cause, powers: Mapping[HypothesisCandidate, float]) -> bool:
    """Whether the product of these ``powers`` has, by ``one``, the value of the found ``cause``."""
    power = np.array([powers.get(own.candidate, 0.0) for own in one.causes])
    apart = power @ np.array([own.coordinate for own in one.causes]) - cause.coordinate
    variance = power @ one.covariance @ power + cause.deviation**2
    return bool(power.any() and apart**2 <= GRASPS.same_errors**2 * variance)


def posterior(comparison: ModelComparison, labels: Labels, rng: np.random.Generator) -> Posterior:
    """The joint posterior, and the share of clean labels in which as much would be found."""
    null = comparison.null_gains(labels, rng)
    found = Posterior(tuple(comparison.explanations(labels)), 1.0, 0.0)
    gain = found.by_hypothesis()[0].gain
    p_value = float((1 + (null >= gain).sum()) / (1 + len(null)))
    critical = float(np.quantile(null, 1 - GRASPS.false_alarm))
    return replace(found, p_value=p_value, critical_gain=critical)


def _thinned(parts: Sequence[CandidateModel]) -> list[CandidateModel]:
    """Fewer values each, the more there are, and of the first the most: it explains the most."""
    steps = GRASPS.axis_steps[max(0, len(parts) - 1)]
    return [part.thinned(step) for part, step in zip(parts, steps, strict=False)]


def _log_evidence(
    model: LabelModel, drawn: IntArray, readings: FloatArray, stderr: float
) -> FloatArray:
    """Log of the evidence times the prior weight (B,) for labels (B, N) and readings (B,)."""
    n = drawn.shape[1]
    total = model.log_weights(readings, stderr)
    for kind in np.unique(drawn):
        table = model.log_probability(np.full(n, kind)).reshape(-1, n)
        fit = (drawn == kind).astype(np.float64) @ table.T
        total = total + fit.reshape(-1, *total.shape[-2:])
    return np.asarray(logsumexp(total, axis=(-2, -1)))


def _best_mode(axis: FloatArray, weights: FloatArray) -> slice:
    """The highest mode of weights (M,) on ``axis`` (M,), out to its edges.

    A shift to either side may explain the same labels; the mean of both would explain none. So the
    mode is of one side where the declared value, 0, is less than half as likely as either.
    """
    top = int(np.argmax(weights))
    low = weights < GRASPS.mode_edge * weights[top]
    peaks = [weights[side].max(initial=0.0) for side in (axis < 0, axis > 0)]
    if np.interp(0.0, axis, weights) < 0.5 * min(peaks):
        low |= axis * axis[top] <= 0
    left = int(np.flatnonzero(low[:top])[-1]) + 1 if low[:top].any() else 0
    right = top + int(np.flatnonzero(low[top:])[0]) if low[top:].any() else len(weights)
    return slice(left, right)


def _mean_and_deviation(axis: FloatArray, weights: FloatArray) -> tuple[float, float]:
    part = weights / weights.sum()
    mean = float(part @ axis)
    return mean, float(np.sqrt(part @ (axis - mean) ** 2))

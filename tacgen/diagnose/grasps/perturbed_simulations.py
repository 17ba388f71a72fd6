"""From perturbed simulations of the real grasps to the models that are compared.

Not everything is simulated. An offset of the force is another factor for every grasp. Where a
grasp is far from slipping under a factor on force, mass, friction or torsion, its margin is taken
from the closed form. More is simulated where it matters: about the values that lead (``refined``).
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, reduce
from pathlib import Path

import numpy as np

from tacgen.collection.perturbed import (
    Outcome,
    OutcomeKey,
    Perturbation,
    perturbed_settings,
    recipe_object,
    simulate_perturbed,
)
from tacgen.collection.recipe import Recipe
from tacgen.core.records import GraspConfig
from tacgen.core.types import FloatArray, IntArray
from tacgen.diagnose.grasps.hypotheses import (
    HypothesisCandidate,
    HypothesisParameter,
    Prediction,
    candidates_for,
)
from tacgen.diagnose.grasps.model_comparison import (
    CandidateModel,
    Cause,
    Explanation,
    JointOutcome,
    LabelModel,
    ModelComparison,
    declared_model,
    interpolated,
    joint_model,
)
from tacgen.diagnose.grasps.slip_margin import (
    at_force,
    crossings,
    gain_by_force,
    gain_by_torsion,
    holds_from,
    limited,
    margin_at_force,
    margins_of,
    moment_part,
)
from tacgen.diagnose.rules import GRASPS

DECLARED = Perturbation()
GAINS: dict[Prediction, Callable[[FloatArray, FloatArray], FloatArray]] = {
    Prediction.FRICTION: lambda moment, log_factor: log_factor + 0 * moment,
    Prediction.MASS: lambda moment, log_factor: -log_factor + 0 * moment,
    Prediction.FORCE: gain_by_force,
    Prediction.TORSION: gain_by_torsion,
}
"""What a factor adds to margins, from turning's part in a slip and the factor's logarithm."""
Show = Callable[[int, int], None]
Tables = tuple[FloatArray, FloatArray, FloatArray, FloatArray]


@dataclass
class PerturbedSimulations:
    """Simulates a set of grasps under perturbations; nothing is simulated twice."""

    recipe: Recipe
    configs: tuple[GraspConfig, ...]
    out: Path
    workers: int
    show: Show = lambda done, total: None
    known: dict[OutcomeKey, Outcome] = field(default_factory=dict)
    further: dict[HypothesisCandidate, set[float]] = field(default_factory=dict)
    joint: dict[frozenset[HypothesisCandidate], JointOutcome] = field(default_factory=dict)

    def simulate(self, wanted: Iterable[tuple[GraspConfig, Perturbation]]) -> None:
        """Make the outcomes of these grasps known."""
        self.known |= simulate_perturbed(
            self.recipe, wanted, self.out, workers=self.workers, show=self.show
        )

    def outcomes(self, change: Perturbation) -> list[Outcome]:
        """The outcome of every grasp under a perturbation that was simulated."""
        return [self.known[config.point, change] for config in self.configs]

    def labels(self, changes: Mapping[str, Perturbation]) -> IntArray:
        """Simulated labels (N,), each grasp under the perturbation of its object."""
        self.simulate([(config, changes[config.object]) for config in self.configs])
        found = [self.known[c.point, changes[c.object]].label for c in self.configs]
        return np.array(found, dtype=np.int64)

    def comparison(self) -> ModelComparison:
        """Simulate what cannot be predicted, and compare all candidates."""
        self.simulate([(config, DECLARED) for config in self.configs])
        self.simulate(self._wanted())
        return self._comparison()

    def refined(self, explanations: Sequence[Explanation]) -> ModelComparison:
        """The comparison with the first few of these simulated where their values matter."""
        wanted: list[tuple[GraspConfig, Perturbation]] = []
        together = []
        for one in [one for one in explanations if _changes_enough(one)][: GRASPS.most_refined]:
            if len(one.causes) > 1:
                places, changes = self._at_once(one.causes)
                together.append((places, changes))
                wanted += [(self.configs[n], change) for n, change in changes.items()]
                continue
            own = one.causes[0].candidate
            if own.parameter.prediction is Prediction.EQUIVALENT_FORCE:
                continue
            for config, value in self._informative(one.causes[0]):
                value = _rounded(value)
                self.further.setdefault(own, set()).add(value)
                wanted.append((config, own.parameter.perturb(value)))
        self.simulate(wanted)
        for places, changes in together:
            margin = np.full(len(self.configs), np.nan)
            for n, change in changes.items():
                margin[n] = margins_of([self.known[self.configs[n].point, change]])[0][0]
            self.joint[frozenset(places)] = JointOutcome(places, margin)
        return self._comparison()

    def _at_once(
        self, causes: Sequence[Cause]
    ) -> tuple[dict[HypothesisCandidate, float], dict[int, Perturbation]]:
        """Where several causes are, and their changes to grasps whose label could be another."""
        places: dict[HypothesisCandidate, float] = {}
        acting: list[tuple[tuple[str, ...], Perturbation]] = []
        for cause in causes:
            own, value = cause.candidate.parameter, _rounded(cause.value)
            places[cause.candidate] = float(own.coordinate(np.array([value]))[0])
            acting.append((cause.candidate.objects, own.perturb(value)))
        parts = [_at(cause.model, cause.coordinate) for cause in causes]
        near = np.abs(joint_model(self._declared(), parts).margin[0]) < GRASPS.sure_margin
        found = {}
        for n in np.flatnonzero(near).tolist():
            changes = [one for objects, one in acting if self.configs[n].object in objects]
            if len(changes) > 1:
                found[n] = reduce(Perturbation.and_then, changes)
        return places, found

    def _informative(self, cause: Cause) -> Iterator[tuple[GraspConfig, float]]:
        """Grasps and values at which a simulation would tell most about the cause's value.

        Each grasp whose label changes near the value, at the value where it seems to change.
        """
        candidate, axis = cause.candidate, cause.model.coordinate
        deviation = max(cause.deviation, 0.5 * float(axis[1] - axis[0]))
        near = np.abs(axis - cause.coordinate) <= GRASPS.refining_deviations * deviation
        for n, config in enumerate(self.configs):
            if config.object in candidate.objects:
                for place in crossings(axis[near], cause.model.margin[near, n]):
                    yield config, candidate.parameter.value(float(place))

    @cached_property
    def _candidates(self) -> tuple[HypothesisCandidate, ...]:
        """The candidates for these grasps, values within what their objects allow."""
        objects = tuple(dict.fromkeys(config.object for config in self.configs))
        found = []
        for candidate in candidates_for(objects):
            parameter = candidate.parameter
            if parameter.limits is not None:
                grasped = [recipe_object(self.recipe.entry_of(n)) for n in candidate.objects]
                lows, highs = zip(*map(parameter.limits, grasped), strict=True)
                nodes = tuple(node for node in parameter.nodes if max(lows) <= node <= min(highs))
                if len(nodes) < 2:
                    continue
                candidate = replace(candidate, parameter=replace(parameter, nodes=nodes))
            found.append(candidate)
        return tuple(found)

    def _wanted(self) -> list[tuple[GraspConfig, Perturbation]]:
        """Grasps at the nodes of the candidates that are simulated from the start."""
        wanted = []
        for candidate in self._candidates:
            parameter = candidate.parameter
            if parameter.prediction is Prediction.EQUIVALENT_FORCE:
                continue
            near = np.ones((len(parameter.nodes), len(self.configs)), dtype=bool)
            if parameter.prediction is not Prediction.NONE:
                margin, _ = self._predicted(candidate, np.array(parameter.nodes), None)
                near = np.minimum(np.abs(margin), np.abs(self._declared().margin))
                near = near < GRASPS.sure_margin
            wanted += [
                (self.configs[n], parameter.perturb(parameter.nodes[k]))
                for k, n in np.argwhere(near)
                if self.configs[n].object in candidate.objects
            ]
        return wanted

    def _declared(self) -> LabelModel:
        outcomes = self.outcomes(DECLARED)
        return declared_model(*margins_of(outcomes), moment_part(outcomes))

    @cached_property
    def _force(self) -> HypothesisCandidate:
        """The candidate from whose simulations others follow."""
        force = Prediction.FORCE
        return next(one for one in self._candidates if one.parameter.prediction is force)

    def _comparison(self) -> ModelComparison:
        """The comparison of all candidates from what is known."""
        force = self._tables(self._force)
        models = []
        for candidate in self._candidates:
            tables = force if candidate is self._force else self._tables(candidate, force)
            log_force = None
            if candidate.parameter.changes_force:
                log_force = self._log_force(candidate.parameter, tables[0]).mean(axis=1)
            models.append(interpolated(candidate, *tables[:3], log_force, tables[3]))
        return ModelComparison(self._declared(), models, self.joint)

    def _tables(self, candidate: HypothesisCandidate, force: Tables | None = None) -> Tables:
        """Nodes (K,), margin, turning share and moment's part (K, N), as in ``LabelModel``.

        They are simulated, predicted, or in between. ``force`` are those of the force, from which
        other candidates' may follow.
        """
        parameter = candidate.parameter
        nodes = np.array(sorted({*parameter.nodes, *self.further.get(candidate, set())}))
        margin, turning = self._predicted(candidate, nodes, force)
        moment = np.repeat(self._declared().moment, len(nodes), axis=0)
        if parameter.prediction is Prediction.EQUIVALENT_FORCE:
            return nodes, margin, turning, moment
        known = np.isin(nodes, parameter.nodes)[:, None] | np.zeros(margin.shape, bool)
        acting = [n for n, c in enumerate(self.configs) if c.object in candidate.objects]
        for k, node in enumerate(nodes):
            change = parameter.perturb(float(node))
            keys = {n: (self.configs[n].point, change) for n in acting}
            own = [n for n, key in keys.items() if key in self.known]
            outcomes = [self.known[keys[n]] for n in own]
            margin[k, own], turning[k, own] = margins_of(outcomes)
            if parameter.prediction is Prediction.NONE:
                moment[k, own] = moment_part(outcomes)
            known[k, own] = True
        at = parameter.coordinate(nodes)
        gains = self._gains(parameter, nodes)
        for n, own in enumerate(known.T):
            turning[:, n] = np.interp(at, at[own], turning[own, n])
            moment[:, n] = np.interp(at, at[own], moment[own, n])
            between = np.interp(at, at[own], margin[own, n])
            if gains is not None and parameter.prediction is not Prediction.TORSION:
                order = np.argsort(gains[own, n])
                place = holds_from(gains[own, n][order], margin[own, n][order])
                between = between if place is None else limited(gains[:, n] - place)
            margin[:, n] = between
        return nodes, margin, turning, moment

    def _gains(self, parameter: HypothesisParameter, nodes: FloatArray) -> FloatArray | None:
        """What margins (K, N) gain by a factor with a closed form."""
        gain = GAINS.get(parameter.prediction)
        return None if gain is None else gain(self._declared().moment, np.log(nodes)[:, None])

    def _predicted(
        self, candidate: HypothesisCandidate, nodes: FloatArray, force: Tables | None
    ) -> tuple[FloatArray, FloatArray]:
        """Margin and turning share (K, N) at ``nodes`` as far as they follow from simulations."""
        declared = self._declared()
        margin = np.repeat(declared.margin, len(nodes), axis=0)
        turning = np.repeat(declared.turning, len(nodes), axis=0)
        acts = np.array([config.object in candidate.objects for config in self.configs])
        gains, found = self._gains(candidate.parameter, nodes), margin
        if gains is not None:
            found = margin + gains
        elif candidate.parameter.prediction is Prediction.EQUIVALENT_FORCE and force is not None:
            log_scale, wanted = np.log(force[0]), self._log_force(candidate.parameter, nodes)
            found = margin_at_force(log_scale, force[1], wanted)
            turning = np.where(acts, at_force(log_scale, force[2], wanted), turning)
        return np.where(acts, limited(found), margin), turning

    def _log_force(self, parameter: HypothesisParameter, nodes: FloatArray) -> FloatArray:
        """Log (K, N) of the force over the declared one that each value amounts to."""

        def delivered(change: Perturbation) -> list[float]:
            settings = perturbed_settings(self.recipe.physics_settings, change)
            forces_n = [settings.delivered_force_n(config.force_n) for config in self.configs]
            return [max(force_n, GRASPS.least_force_n) for force_n in forces_n]

        perturbed = np.array([delivered(parameter.perturb(float(node))) for node in nodes])
        return np.asarray(np.log(perturbed / np.array(delivered(DECLARED))))


def combined_perturbation(causes: Sequence[Cause], name: str) -> Perturbation:
    """All changes that were found, for grasps of the object ``name``."""
    found = Perturbation()
    for cause in causes:
        if cause.candidate.acts_on(name):
            found = found.and_then(cause.candidate.parameter.perturb(round(cause.value, 4)))
    return found


def _changes_enough(one: Explanation) -> bool:
    """Whether each of several causes is changed so far that simulating them together says more."""
    least = [GRASPS.least_change * cause.candidate.parameter.spread for cause in one.causes]
    changes = [cause.coordinate - cause.candidate.parameter.center for cause in one.causes]
    return len(one.causes) == 1 or bool((np.abs(changes) >= least).all())


def _rounded(value: float) -> float:
    """Digits that suffice for a simulation, and the same from one run to the next."""
    return float(f"{value:.3g}")


def _at(model: CandidateModel, coordinate: float) -> CandidateModel:
    """The model at the value nearest to ``coordinate`` alone."""
    k = int(np.argmin(np.abs(model.coordinate - coordinate)))
    return model.only(slice(k, k + 1))

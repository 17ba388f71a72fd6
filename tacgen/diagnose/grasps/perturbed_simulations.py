"""From perturbed simulations of the real grasps to the models that are compared.

Not everything is simulated. Grasps of an object whose mass and force grow by one factor move
alike, so a heavier object is a weaker grip, and an offset of the force is another factor for every
grasp. Where a grasp is far from slipping at a force, its margin is taken from the closed form.
Parameters with a closed form of their own start from there too, and are simulated only where it
matters: about the values that lead (``refined``).
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from tacgen.collection.perturbed import (
    Key,
    Outcome,
    Perturbation,
    declared_entry,
    perturbed_settings,
    place_of,
    recipe_object,
    simulate_perturbed,
)
from tacgen.collection.recipe import Recipe
from tacgen.core.arrays import FloatArray, IntArray
from tacgen.core.records import GraspConfig
from tacgen.diagnose.grasps.hypotheses import Candidate, Parameter, Prediction, candidates_for
from tacgen.diagnose.grasps.model_comparison import (
    CandidateScore,
    LabelModel,
    ModelComparison,
    declared_model,
    interpolated,
)
from tacgen.diagnose.grasps.rules import RULES
from tacgen.diagnose.grasps.slip_margin import (
    at_force,
    crossings,
    holds_from,
    is_sure,
    limited,
    margin_at_force,
    margin_at_torsion,
    margins_of,
)

DECLARED = Perturbation()
Show = Callable[[int, int], None]
Tables = tuple[FloatArray, FloatArray, FloatArray]


@dataclass
class PerturbedSimulations:
    """Simulates a set of grasps under perturbations; nothing is simulated twice."""

    recipe: Recipe
    configs: tuple[GraspConfig, ...]
    out: Path
    workers: int
    show: Show = lambda done, total: None
    known: dict[Key, Outcome] = field(default_factory=dict)
    further: dict[Candidate, set[float]] = field(default_factory=dict)

    def simulate(self, wanted: Iterable[tuple[GraspConfig, Perturbation]]) -> None:
        """Make the outcomes of these grasps known."""
        self.known |= simulate_perturbed(
            self.recipe, wanted, self.out, workers=self.workers, show=self.show
        )

    def outcomes(self, change: Perturbation) -> list[Outcome]:
        """The outcome of every grasp under a perturbation that was simulated."""
        return [self.known[place_of(config), change] for config in self.configs]

    def labels(self, changes: Mapping[str, Perturbation]) -> IntArray:
        """Simulated labels (N,), each grasp under the perturbation of its object."""
        self.simulate([(config, changes[config.object]) for config in self.configs])
        found = [self.known[place_of(c), changes[c.object]].label for c in self.configs]
        return np.array(found, dtype=np.int64)

    def comparison(self) -> ModelComparison:
        """Simulate what cannot be predicted, and compare all candidates."""
        self.simulate([(config, DECLARED) for config in self.configs])
        self.simulate(self._wanted())
        return self._comparison()

    def refined(self, scores: Sequence[CandidateScore]) -> ModelComparison:
        """The comparison with these candidates simulated where their values matter."""
        wanted = []
        for score in scores:
            own, parameter = score.candidate, score.candidate.parameter
            equivalent = parameter.prediction is Prediction.EQUIVALENT_FORCE
            if equivalent and not parameter.force_exponent:
                continue
            for config, value in self._informative(score):
                if equivalent:
                    own, value = self._force, parameter.at_force(value)
                value = float(f"{value:.3g}")  # enough, and the same from one run to the next
                self.further.setdefault(own, set()).add(value)
                wanted.append((config, own.parameter.perturb(value)))
        self.simulate(wanted)
        return self._comparison()

    def _informative(self, score: CandidateScore) -> Iterator[tuple[GraspConfig, float]]:
        """Grasps and values at which a simulation would tell most about the score's value.

        Each grasp whose label changes near the value, at the value where it seems to change. What
        was predicted by closed form is simulated at the value and one deviation to each side.
        """
        candidate, axis = score.candidate, score.model.coordinate
        margin, parameter = score.model.margin, candidate.parameter
        closed_form = parameter.prediction in (
            Prediction.CLOSED_FORM_FORCE,
            Prediction.CLOSED_FORM_TORSION,
        )
        deviation = max(score.deviation, 0.5 * float(axis[1] - axis[0]))
        near = np.abs(axis - score.coordinate) <= RULES.refining_deviations * deviation
        about = score.coordinate + deviation * np.array([-1.0, 0.0, 1.0])
        about = np.clip(about, axis[0], axis[-1])
        for n, config in enumerate(self.configs):
            if config.object not in candidate.objects:
                continue
            if closed_form and candidate not in self.further:
                unsure = np.abs(np.interp(about, axis, margin[:, n])) < RULES.sure_margin
                places: FloatArray = about[unsure]
            else:
                places = crossings(axis[near], margin[near, n])
            for place in places:
                yield config, parameter.value(float(place))

    @cached_property
    def _candidates(self) -> tuple[Candidate, ...]:
        """The candidates for these grasps, values within what their objects allow."""
        objects = tuple(dict.fromkeys(config.object for config in self.configs))
        found = []
        for candidate in candidates_for(objects):
            parameter = candidate.parameter
            if parameter.limits is not None:
                grasped = [recipe_object(declared_entry(self.recipe, n)) for n in candidate.objects]
                lows, highs = zip(*map(parameter.limits, grasped), strict=True)
                nodes = tuple(node for node in parameter.nodes if max(lows) <= node <= min(highs))
                if len(nodes) < 2:
                    continue
                candidate = replace(candidate, parameter=replace(parameter, nodes=nodes))
            found.append(candidate)
        return tuple(found)

    def _wanted(self) -> list[tuple[GraspConfig, Perturbation]]:
        """Grasps at the nodes of the candidates that are simulated from the start."""
        margin = dict(zip(self.configs, self._declared().margin[0], strict=True))
        return [
            (config, candidate.parameter.perturb(node))
            for candidate in self._candidates
            if candidate.parameter.is_simulated
            for node in candidate.parameter.nodes
            for config in self.configs
            if config.object in candidate.objects
            and not (candidate is self._force and is_sure(margin[config], node))
        ]

    def _declared(self) -> LabelModel:
        return declared_model(*margins_of(self.outcomes(DECLARED)))

    @cached_property
    def _force(self) -> Candidate:
        """The candidate from whose simulations others follow."""
        force = Prediction.GRIP_FORCE
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
            models.append(interpolated(candidate, *tables, log_force))
        return ModelComparison(self._declared(), models)

    def _tables(self, candidate: Candidate, force: Tables | None = None) -> Tables:
        """Nodes (K,), margin and turning share (K, N): simulated, predicted, or in between.

        ``force`` are those of the force, from which other candidates' may follow.
        """
        parameter = candidate.parameter
        values = {*parameter.nodes, *self.further.get(candidate, set())}
        if parameter.force_exponent and force is not None:
            values |= {parameter.at_force(factor) for factor in force[0]}
        nodes = np.array(sorted(values))
        margin, turning = self._predicted(candidate, nodes, force)
        known = np.isin(nodes, parameter.nodes)[:, None] | np.zeros(margin.shape, bool)
        if not parameter.is_simulated:
            known[:] = True
        acting = [n for n, c in enumerate(self.configs) if c.object in candidate.objects]
        for k, node in enumerate(nodes):
            if not parameter.is_simulated and node == parameter.declared:
                continue
            change = parameter.perturb(float(node))
            keys = {n: (place_of(self.configs[n]), change) for n in acting}
            own = [n for n, key in keys.items() if key in self.known]
            margin[k, own], turning[k, own] = margins_of([self.known[keys[n]] for n in own])
            known[k, own] = True
        at = parameter.coordinate(nodes)
        for n, own in enumerate(known.T):
            turning[:, n] = np.interp(at, at[own], turning[own, n])
            place = holds_from(at[own], margin[own, n]) if candidate is self._force else None
            between = np.interp(at, at[own], margin[own, n])
            margin[:, n] = between if place is None else limited(at - place)
        return nodes, margin, turning

    def _predicted(
        self, candidate: Candidate, nodes: FloatArray, force: Tables | None
    ) -> tuple[FloatArray, FloatArray]:
        """Margin and turning share (K, N) at ``nodes`` as far as they follow from simulations."""
        declared = self._declared()
        margin = np.repeat(declared.margin, len(nodes), axis=0)
        turning = np.repeat(declared.turning, len(nodes), axis=0)
        acts = np.array([config.object in candidate.objects for config in self.configs])
        found = margin
        if candidate is self._force:
            found = margin + np.log(nodes)[:, None]
        elif candidate.parameter.prediction is Prediction.CLOSED_FORM_TORSION:
            outcomes = self.outcomes(DECLARED)
            found = margin_at_torsion(
                declared.margin[0],
                np.array([one.friction_ratio for one in outcomes]),
                np.array([one.torsion_ratio for one in outcomes]),
                np.log(nodes),
            )
        elif not candidate.parameter.is_simulated and force is not None:
            log_scale, wanted = np.log(force[0]), self._log_force(candidate.parameter, nodes)
            found = margin_at_force(log_scale, force[1], wanted)
            turning = np.where(acts, at_force(log_scale, force[2], wanted), turning)
        return np.where(acts, limited(found), margin), turning

    def _log_force(self, parameter: Parameter, nodes: FloatArray) -> FloatArray:
        """Log (K, N) of the force over the declared one that each value amounts to."""
        if parameter.force_exponent:
            column = parameter.force_exponent * np.log(nodes)[:, None]
            return np.repeat(column, len(self.configs), axis=1)

        def delivered(change: Perturbation) -> list[float]:
            settings = perturbed_settings(self.recipe.physics_settings, change)
            forces_n = [settings.delivered_force_n(config.force_n) for config in self.configs]
            return [max(force_n, RULES.least_force_n) for force_n in forces_n]

        perturbed = np.array([delivered(parameter.perturb(float(node))) for node in nodes])
        return np.asarray(np.log(perturbed / np.array(delivered(DECLARED))))


def combined_perturbation(scores: Sequence[CandidateScore], name: str) -> Perturbation:
    """All changes that were found, for grasps of the object ``name``."""
    found = Perturbation()
    for score in scores:
        if score.candidate.acts_on(name):
            found = found.and_then(score.candidate.parameter.perturb(round(score.value, 4)))
    return found

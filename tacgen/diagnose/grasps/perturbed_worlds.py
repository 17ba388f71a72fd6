"""From simulated grasps in altered worlds to the hypotheses that the loop weighs.

Not every world is simulated. Grasps of an object whose mass and force grow by one factor move
alike, so a wrong mass is a wrong force upside down, and an offset of the force is another factor
for every grasp. Where a grasp is far from slipping at a force, its slack is taken from the closed
form. Friction and spinning friction start from there too, and are simulated only where it matters:
about the values that lead (``refined``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tacgen.collection.perturbed import Alteration, Key, Outcome, place_of, simulate_altered
from tacgen.collection.pipeline import recipe_object
from tacgen.collection.recipe import ObjectEntry, Recipe
from tacgen.core.records import GraspConfig
from tacgen.diagnose.grasps.candidates import WHOLE_WORLD, Candidate, candidates_for
from tacgen.diagnose.grasps.hypothesis import Hypothesis, declared_world, interpolated
from tacgen.diagnose.grasps.model_comparison import Contest, Standing
from tacgen.diagnose.grasps.slip_margin import (
    FARTHEST,
    at_force,
    crossings,
    holds_from,
    signed_slack,
    slack_at_force,
    slack_at_torsion,
    turning_share,
)

DECLARED = Alteration()
Show = Callable[[int, int], None]
FloatArray = NDArray[np.float64]
Tables = tuple[FloatArray, FloatArray, FloatArray]

SURE_SLACK = 0.5
"""Grasps that are further than this from their threshold are not simulated at that force."""
AS_FORCE: dict[str, Callable[[float], float]] = {
    "force_scale": lambda scale: scale,
    "mass_factor": lambda factor: 1 / factor,
}
"""The force that a factor amounts to exactly; the other way round it is the same."""
BY_CLOSED_FORM = ("friction_factor", "spinning_friction_factor")
"""Parameters that are simulated only about the values that lead."""
PREDICTED = ("mass_factor", "force_offset_n", *BY_CLOSED_FORM)
WITHIN_DEVIATIONS = 2.5


@dataclass
class GraspWorlds:
    """Simulates a set of grasps in altered worlds; what was simulated before is not repeated."""

    recipe: Recipe
    configs: tuple[GraspConfig, ...]
    out: Path
    workers: int
    show: Callable[[str], Show] = lambda what: lambda done, total: None
    known: dict[Key, Outcome] = field(default_factory=dict)
    further: dict[Candidate, set[float]] = field(default_factory=dict)

    def simulate(self, what: str, wanted: Iterable[tuple[GraspConfig, Alteration]]) -> None:
        """Make the outcomes of these grasps known."""
        self.known |= simulate_altered(
            self.recipe, wanted, self.out, workers=self.workers, show=self.show(what)
        )

    def outcomes(self, world: Alteration) -> list[Outcome]:
        """What every grasp does in a world that was simulated."""
        return [self.known[place_of(config), world] for config in self.configs]

    def labels(self, worlds: Mapping[str, Alteration]) -> NDArray[np.int64]:
        """Simulated labels (N,), each grasp in the world of its object."""
        self.simulate("labels", [(config, worlds[config.object]) for config in self.configs])
        found = [self.known[place_of(c), worlds[c.object]].label for c in self.configs]
        return np.array(found, dtype=np.int64)

    def contest(self) -> Contest:
        """Simulate what cannot be predicted, and set up the contest of all candidates."""
        self.simulate("declared world", [(config, DECLARED) for config in self.configs])
        self.simulate("altered worlds", self._wanted())
        return self._contest()

    def refined(self, standings: Sequence[Standing]) -> Contest:
        """The contest with these standings' hypotheses simulated where their values matter."""
        wanted = []
        for standing in standings:
            candidate = standing.hypothesis.candidate
            if candidate is None or candidate.parameter.key == "force_offset_n":
                continue
            as_force = AS_FORCE.get(candidate.parameter.key)
            for config, value in self._telling(standing):
                own = candidate if as_force is None else self._force
                value = _rounded(value if as_force is None else as_force(value))
                self.further.setdefault(own, set()).add(value)
                wanted.append((config, world_of(own, value)))
        self.simulate("worlds about the best", wanted)
        return self._contest()

    def _telling(self, standing: Standing) -> Iterator[tuple[GraspConfig, float]]:
        """Grasps and values at which a simulation would say most about the standing's value.

        Each grasp whose label changes near the value, at the value where it seems to change. What
        was predicted by closed form is simulated at the value and one deviation to each side.
        """
        candidate, axis = standing.hypothesis.candidate, standing.hypothesis.coordinate
        if candidate is None:
            return
        value, slack = candidate.parameter.value, standing.hypothesis.slack
        deviation = max(standing.deviation, 0.5 * float(axis[1] - axis[0]))
        near = np.abs(axis - standing.coordinate) <= WITHIN_DEVIATIONS * deviation
        about = standing.coordinate + deviation * np.array([-1.0, 0.0, 1.0])
        about = np.clip(about, axis[0], axis[-1])
        for n, config in enumerate(self.configs):
            if config.object not in candidate.objects:
                continue
            if candidate.parameter.key in BY_CLOSED_FORM and candidate not in self.further:
                unsure = np.abs(np.interp(about, axis, slack[:, n])) < SURE_SLACK
                places = about[unsure]
            else:
                places = crossings(axis[near], slack[near, n])
            for place in places:
                yield config, value(float(place))

    @cached_property
    def _candidates(self) -> tuple[Candidate, ...]:
        """The candidates for these grasps, centres of mass kept within the objects."""
        objects = tuple(dict.fromkeys(config.object for config in self.configs))
        found = []
        for candidate in candidates_for(objects):
            parameter = candidate.parameter
            if parameter.name == "center_of_mass":
                low, high = self._room_for_center(candidate)
                nodes = tuple(node for node in parameter.nodes if low <= node <= high)
                if len(nodes) < 2:
                    continue
                candidate = replace(candidate, parameter=replace(parameter, nodes=nodes))
            found.append(candidate)
        return tuple(found)

    def _room_for_center(self, candidate: Candidate) -> tuple[float, float]:
        """How far the centre of mass of the candidate's objects may move along its axis, mm."""
        axis = "xyz".index(candidate.parameter.key.removeprefix("center_of_mass_")[0])
        low, high = -np.inf, np.inf
        for name in candidate.objects:
            grasped = recipe_object(declared_object(self.recipe, name))
            vertices = grasped.surface.vertices_mm[:, axis]
            center = grasped.center_of_mass_mm[axis]
            low, high = max(low, vertices.min() - center), min(high, vertices.max() - center)
        return float(low), float(high)

    def _wanted(self) -> list[tuple[GraspConfig, Alteration]]:
        """Grasps at the nodes of the candidates that are simulated from the start."""
        slack = dict(zip(self.configs, self._declared().slack[0], strict=True))
        found = []
        for candidate in self._candidates:
            parameter = candidate.parameter
            if parameter.key in PREDICTED:
                continue
            for node in parameter.nodes:
                world = world_of(candidate, node)
                for config in self.configs:
                    far = parameter.key == "force_scale" and is_sure(slack[config], node)
                    if config.object in candidate.objects and not far:
                        found.append((config, world))
        return found

    def _declared(self) -> Hypothesis:
        return declared_world(*slack_of(self.outcomes(DECLARED)))

    @property
    def _force(self) -> Candidate:
        return next(c for c in self._candidates if c.parameter.key == "force_scale")

    def _contest(self) -> Contest:
        """The contest of all candidates from what is known."""
        force = self._tables(self._force)
        hypotheses = []
        for candidate in self._candidates:
            tables = force if candidate is self._force else self._tables(candidate, force)
            log_force = None
            if candidate.name == "grip_force":
                log_force = self._log_force(candidate, tables[0]).mean(axis=1)
            hypotheses.append(interpolated(candidate, *tables, log_force))
        return Contest(self._declared(), hypotheses)

    def _tables(self, candidate: Candidate, force: Tables | None = None) -> Tables:
        """Nodes (K,), slack and turning share (K, N): simulated, predicted, or in between.

        ``force`` are those of the force, from which other candidates' may follow.
        """
        key = candidate.parameter.key
        further = self.further.get(candidate, set())
        if key in ("mass_factor", "friction_factor") and force is not None:
            further = further | {1 / f if key == "mass_factor" else f for f in force[0]}
        nodes = np.array(sorted({*candidate.parameter.nodes, *further}))
        slack, turning = self._predicted(candidate, nodes, force)
        known = np.isin(nodes, candidate.parameter.nodes)[:, None] | np.zeros(slack.shape, bool)
        if key in PREDICTED:
            known[:] = True
        acting = [n for n, c in enumerate(self.configs) if c.object in candidate.objects]
        for k, node in enumerate(nodes):
            if key in PREDICTED and node == candidate.parameter.declared:
                continue
            keys = {n: (place_of(self.configs[n]), world_of(candidate, node)) for n in acting}
            own = [n for n, key in keys.items() if key in self.known]
            slack[k, own], turning[k, own] = slack_of([self.known[keys[n]] for n in own])
            known[k, own] = True
        at = candidate.parameter.coordinate(nodes)
        for n, own in enumerate(known.T):
            turning[:, n] = np.interp(at, at[own], turning[own, n])
            place = holds_from(at[own], slack[own, n]) if key == "force_scale" else None
            between = np.interp(at, at[own], slack[own, n])
            slack[:, n] = between if place is None else np.clip(at - place, -FARTHEST, FARTHEST)
        return nodes, slack, turning

    def _predicted(
        self, candidate: Candidate, nodes: FloatArray, force: Tables | None
    ) -> tuple[FloatArray, FloatArray]:
        """Slack and turning share (K, N) at ``nodes`` as far as they follow from other worlds."""
        declared = self._declared()
        slack = np.repeat(declared.slack, len(nodes), axis=0)
        turning = np.repeat(declared.turning, len(nodes), axis=0)
        key = candidate.parameter.key
        acts = np.array([config.object in candidate.objects for config in self.configs])
        if key == "force_scale":
            found = slack + np.log(nodes)[:, None]
        elif key == "spinning_friction_factor":
            outcomes = self.outcomes(DECLARED)
            found = slack_at_torsion(
                declared.slack[0],
                np.array([one.friction_ratio for one in outcomes]),
                np.array([one.torsion_ratio for one in outcomes]),
                np.log(nodes),
            )
        elif key in PREDICTED and force is not None:
            log_scale, wanted = np.log(force[0]), self._log_force(candidate, nodes)
            found = slack_at_force(log_scale, force[1], wanted)
            turning = np.where(acts, at_force(log_scale, force[2], wanted), turning)
        else:
            found = slack
        return np.where(acts, np.clip(found, -FARTHEST, FARTHEST), slack), turning

    def _log_force(self, candidate: Candidate, nodes: FloatArray) -> FloatArray:
        """Log (K, N) of the force over the declared one that each value amounts to."""
        key = candidate.parameter.key
        if key == "mass_factor":
            return np.repeat(-np.log(nodes)[:, None], len(self.configs), axis=1)
        if key in ("force_scale", "friction_factor"):
            return np.repeat(np.log(nodes)[:, None], len(self.configs), axis=1)
        settings = self.recipe.physics_settings
        declared = np.array([settings.delivered_force_n(c.force_n) for c in self.configs])
        delivered = np.maximum(declared + nodes[:, None], 0.01)
        return np.log(delivered / np.maximum(declared, 0.01))


def slack_of(outcomes: Sequence[Outcome]) -> tuple[FloatArray, FloatArray]:
    """Slack and turning share (N,) of simulated grasps."""
    label = np.array([one.label for one in outcomes])
    friction = np.array([one.friction_ratio for one in outcomes])
    torsion = np.array([one.torsion_ratio for one in outcomes])
    turn = np.array([one.turn_rad for one in outcomes])
    turned = np.array([one.failure_mode == "rotational_slip" for one in outcomes])
    return (
        signed_slack(label, friction, torsion, turn),
        turning_share(label, turned, friction, torsion),
    )


def is_sure(slack: float, factor: float) -> bool:
    """Whether a grasp's label at another force is beyond doubt.

    Slack near 0 may be a turn that is allowed: only a clear one is carried to another force.
    """
    there = slack + np.log(factor)
    return bool(abs(slack) > SURE_SLACK and abs(there) > SURE_SLACK)


def _rounded(value: float) -> float:
    """Three digits are enough to simulate about, and repeat from one run to the next."""
    return float(f"{value:.3g}")


def world_of(candidate: Candidate, value: float) -> Alteration:
    """The world in which a candidate's parameter has that value."""
    return Alteration(**{candidate.parameter.key: float(value)})


def combined_world(standings: Sequence[Standing], name: str) -> Alteration:
    """The world of several found effects, as the object ``name`` meets it."""
    changes: dict[str, float] = {}
    for standing in standings:
        candidate = standing.hypothesis.candidate
        if candidate is None:
            continue
        if name not in candidate.objects and candidate.name not in WHOLE_WORLD:
            continue
        key, value = candidate.parameter.key, round(standing.value, 4)
        before = changes.get(key, candidate.parameter.declared)
        changes[key] = before * value if candidate.parameter.is_factor else before + value
    return Alteration(**changes)


def declared_object(recipe: Recipe, name: str) -> ObjectEntry:
    """What the recipe says of an object."""
    for entry in recipe.objects:
        if entry.name == name:
            return entry
    return ObjectEntry(name=name)

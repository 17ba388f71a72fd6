"""From simulated grasps in altered worlds to the hypotheses that the loop weighs.

Not every world is simulated. Grasps of an object whose mass and force grow by one factor move
alike, so a wrong mass is a wrong force upside down, and an offset of the force is another factor
for every grasp. Where a grasp is far from slipping at a force, its slack is taken from the closed
form. Friction and spinning friction start from there too, and are simulated only where it matters:
about the values that lead (``refined``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tacgen.grasp_loop.altered_worlds import Alteration, Key, Outcome, place_of, simulate_altered
from tacgen.grasp_pipeline import recipe_object
from tacgen.loop.grasps.candidates import WHOLE_WORLD, Candidate, candidates_for
from tacgen.loop.grasps.contest import Contest, Standing
from tacgen.loop.grasps.hypothesis import Hypothesis, declared_world, interpolated
from tacgen.loop.grasps.slack import (
    at_force,
    signed_slack,
    slack_at_force,
    slack_at_torsion,
    turning_share,
)
from tacgen.recipe import ObjectEntry, Recipe
from tacgen.records import GraspConfig

DECLARED = Alteration()
Show = Callable[[int, int], None]
FloatArray = NDArray[np.float64]

SURE_SLACK = 0.5
"""Grasps that are further than this from their threshold are not simulated at that force."""
BY_FORCE = ("mass_factor", "force_offset_n")
"""Parameters that amount to another force exactly."""
AS_FORCE: dict[str, Callable[[float], float]] = {
    "force_scale": lambda scale: scale,
    "mass_factor": lambda factor: 1 / factor,
}
"""The force that a factor amounts to; the other way round it is the same."""
PREDICTED = (*BY_FORCE, "friction_factor", "spinning_friction_factor")


@dataclass
class GraspWorlds:
    """Simulates a set of grasps in altered worlds; what was simulated before is not repeated."""

    recipe: Recipe
    configs: tuple[GraspConfig, ...]
    out: Path
    workers: int
    show: Callable[[str], Show] = lambda what: lambda done, total: None
    known: dict[Key, Outcome] = field(default_factory=dict)
    further_forces: set[float] = field(default_factory=set)

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
        candidates = self._candidates()
        self.simulate("altered worlds", self._wanted(candidates))
        return Contest(self._declared(), [self._hypothesis(one) for one in candidates])

    def refined(self, contest: Contest, standings: Sequence[Standing]) -> Contest:
        """The contest with these standings' hypotheses simulated about their own values."""
        wanted = []
        places: dict[int, NDArray[np.float64]] = {}
        for standing in standings:
            candidate, axis = standing.hypothesis.candidate, standing.hypothesis.coordinate
            if candidate is None or candidate.parameter.key == "force_offset_n":
                continue
            values = _around(standing)
            if candidate.parameter.key in AS_FORCE:
                if set(candidate.objects) != {config.object for config in self.configs}:
                    continue
                worlds = [
                    Alteration(force_scale=_rounded(AS_FORCE[candidate.parameter.key](v)))
                    for v in values
                ]
                self.further_forces |= {world.force_scale for world in worlds}
            else:
                places[id(candidate)] = values
                worlds = [world_of(candidate, value) for value in values]
            for value, world in zip(values, worlds, strict=True):
                at = np.argmin(np.abs(axis - candidate.parameter.coordinate(value)))
                near = np.abs(standing.hypothesis.slack[at]) < SURE_SLACK
                wanted += [
                    (config, world)
                    for config, unsure in zip(self.configs, near, strict=True)
                    if unsure and config.object in candidate.objects
                ]
        self.simulate("worlds about the best", wanted)
        return Contest(
            contest.declared.hypothesis,
            [
                self._hypothesis(e.hypothesis.candidate, places.get(id(e.hypothesis.candidate)))
                for e in contest.others
                if e.hypothesis.candidate is not None
            ],
        )

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

    def _wanted(self, candidates: Sequence[Candidate]) -> list[tuple[GraspConfig, Alteration]]:
        """Grasps at the nodes of the candidates that are simulated from the start."""
        slack = dict(zip(self.configs, self._declared().slack[0], strict=True))
        found = []
        for candidate in candidates:
            parameter = candidate.parameter
            if parameter.key in PREDICTED:
                continue
            for node in parameter.nodes:
                world = world_of(candidate, node)
                for config in self.configs:
                    far = parameter.key == "force_scale" and _sure(slack[config], node)
                    if config.object in candidate.objects and not far:
                        found.append((config, world))
        return found

    def _declared(self) -> Hypothesis:
        return declared_world(*slack_of(self.outcomes(DECLARED)))

    def _hypothesis(
        self, candidate: Candidate, further: NDArray[np.float64] | None = None
    ) -> Hypothesis:
        """A candidate's hypothesis from what is known; ``further`` values were simulated too."""
        nodes = np.array(candidate.parameter.nodes)
        if candidate.parameter.key in AS_FORCE:
            as_force = AS_FORCE[candidate.parameter.key]
            further = np.array([as_force(force) for force in sorted(self.further_forces)])
        if further is not None:
            nodes = np.unique(np.concatenate([nodes, further]))
        slack, turning = self._predicted(candidate, nodes)
        for k, node in enumerate(nodes):
            world = world_of(candidate, node)
            for n, config in enumerate(self.configs):
                key = place_of(config), world
                if config.object in candidate.objects and key in self.known:
                    own_slack, own_turning = slack_of([self.known[key]])
                    slack[k, n], turning[k, n] = own_slack[0], own_turning[0]
        log_force = None
        if candidate.name == "grip_force":
            log_force = self._log_force(candidate, nodes).mean(axis=1)
        return interpolated(candidate, nodes, slack, turning, log_force)

    def _predicted(
        self, candidate: Candidate, nodes: NDArray[np.float64]
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
        elif key in PREDICTED:
            by_force, wanted = self._by_force(), self._log_force(candidate, nodes)
            found = slack_at_force(by_force.coordinate, by_force.slack, wanted)
            turning = np.where(
                acts, at_force(by_force.coordinate, by_force.turning, wanted), turning
            )
        else:
            found = slack
        return np.where(acts, np.clip(found, -1.5, 1.5), slack), turning

    def _by_force(self) -> Hypothesis:
        """What grasps do at other forces; its coordinate is the logarithm of the force."""
        scaled = next(c for c in self._candidates() if c.parameter.key == "force_scale")
        return self._hypothesis(scaled)

    def _log_force(self, candidate: Candidate, nodes: NDArray[np.float64]) -> FloatArray:
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


def _sure(slack: float, factor: float) -> bool:
    """Whether a grasp's label at another force is beyond doubt.

    Slack near 0 may be a turn that is allowed: only a clear one is carried to another force.
    """
    there = slack + np.log(factor)
    return bool(abs(slack) > SURE_SLACK and abs(there) > SURE_SLACK)


def _around(standing: Standing) -> NDArray[np.float64]:
    """Values to simulate: the posterior one and one deviation to each side, within the nodes."""
    axis = standing.hypothesis.coordinate
    steps = standing.coordinate + max(standing.deviation, 0.02) * np.array([-1.0, 0.0, 1.0])
    candidate = standing.hypothesis.candidate
    value = candidate.parameter.value if candidate is not None else float
    return np.unique([_rounded(value(float(v))) for v in np.clip(steps, axis[0], axis[-1])])


def _rounded(value: float) -> float:
    """Two digits are enough to simulate about, and repeat from one run to the next."""
    return float(f"{value:.2g}")


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

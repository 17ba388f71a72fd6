"""Which real grasps to make next: those on which the leading explanations disagree most."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit

from tacgen.collection.grid import plan_recipe
from tacgen.collection.perturbed import place_of
from tacgen.core.records import GraspConfig
from tacgen.diagnose.grasps.model_comparison import Standing
from tacgen.diagnose.grasps.perturbed_worlds import GraspWorlds, combined_world, slack_of

N_CONSIDERED, N_PROPOSED, MAX_RIVALS = 24, 5, 3
WITHIN = np.log(100)
"""Explanations whose evidence is further behind are no rivals."""
BORDER = 0.1
LEAST_DISAGREEMENT = 0.2
_SIGN_OF_RATIO = {"force_scale": 1, "friction_factor": 1, "mass_factor": -1}


@dataclass(frozen=True, slots=True)
class Proposal:
    """A grasp to make, and the probability of success that each explanation gives it."""

    config: GraspConfig
    success: dict[str, float]

    @property
    def disagreement(self) -> float:
        """How far the explanations' probabilities lie apart."""
        return max(self.success.values()) - min(self.success.values())


def rivals_of(standings: Sequence[Standing], found: bool) -> dict[str, tuple[Standing, ...]]:
    """The explanations worth telling apart by name; no standing at all is the declared world."""
    best = standings[0]
    rivals: dict[str, tuple[Standing, ...]] = {} if found else {"as declared": ()}
    candidate = best.hypothesis.candidate
    if best.elsewhere is not None and candidate is not None:
        there = float(candidate.parameter.coordinate(np.array([best.elsewhere]))[0])
        rivals[best.name] = (best,)
        rivals[f"{best.name} at {best.elsewhere:.3g}"] = (replace(best, coordinate=there),)
    for standing in standings:
        if len(rivals) < MAX_RIVALS and standing.gain > best.gain - WITHIN:
            rivals[standing.name] = (_at_the_same_ratio(standing, best),)
    if len(rivals) < 2:
        rivals["as declared"] = ()
    return rivals


def _at_the_same_ratio(standing: Standing, best: Standing) -> Standing:
    """``standing`` at the value that changes force over weight as ``best`` does.

    Force, mass and friction act through one ratio. Only what is left where it is the same can
    tell them apart; their own estimates differ by what the prior holds usual.
    """
    candidate, leader = standing.hypothesis.candidate, best.hypothesis.candidate
    if candidate is None or leader is None:
        return standing
    signs = [_SIGN_OF_RATIO.get(one.parameter.key, 0) for one in (candidate, leader)]
    if 0 in signs:
        return standing
    axis = standing.hypothesis.coordinate
    same = np.clip(best.coordinate * signs[0] * signs[1], axis[0], axis[-1])
    return replace(standing, coordinate=float(same))


def propose_grasps(
    worlds: GraspWorlds, rivals: dict[str, tuple[Standing, ...]]
) -> tuple[Proposal, ...]:
    """Grasps of the recipe's grid, none of them made before, that tell ``rivals`` apart.

    A part of the grid is drawn and simulated under each explanation. What belongs to the gripper
    also acts on objects that have not been grasped yet, so they may tell where no further grasp
    of the same object can.
    """
    configs = _considered(worlds)
    wanted = [
        (config, combined_world(standings, config.object))
        for standings in rivals.values()
        for config in configs
    ]
    worlds.simulate("next grasps", wanted)
    proposals = []
    for config in configs:
        success = {}
        for name, standings in rivals.items():
            outcome = worlds.known[place_of(config), combined_world(standings, config.object)]
            slack, _ = slack_of([outcome])
            success[name] = float(expit(slack[0] / BORDER)) if outcome.label >= 0 else 0.5
        proposals.append(Proposal(config, success))
    telling = [one for one in proposals if one.disagreement >= LEAST_DISAGREEMENT]
    return tuple(sorted(telling, key=lambda one: -one.disagreement)[:N_PROPOSED])


def _considered(worlds: GraspWorlds) -> list[GraspConfig]:
    """A part of the recipe's grid, evenly over its objects, drawn with the recipe's seed."""
    made = {place_of(config) for config in worlds.configs}
    open_to = [g.config for g in plan_recipe(worlds.recipe) if place_of(g.config) not in made]
    rng = np.random.default_rng(np.random.SeedSequence(worlds.recipe.seed, spawn_key=(0x6E,)))
    names = dict.fromkeys(config.object for config in open_to)
    chosen: list[GraspConfig] = []
    for name in names:
        own = [config for config in open_to if config.object == name]
        count = min(len(own), -(-N_CONSIDERED // len(names)))
        chosen += [own[k] for k in np.sort(rng.choice(len(own), count, replace=False))]
    return chosen

"""Which real grasps to make next: those on which the leading explanations disagree most."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit

from tacgen.collection.grid import plan_recipe
from tacgen.collection.perturbed import place_of
from tacgen.core.records import GraspConfig
from tacgen.diagnose.grasps.model_comparison import CandidateScore
from tacgen.diagnose.grasps.perturbed_simulations import PerturbedSimulations, combined_perturbation
from tacgen.diagnose.grasps.rules import RULES
from tacgen.diagnose.grasps.slip_margin import margins_of

Rivals = dict[str, tuple[CandidateScore, ...]]


@dataclass(frozen=True, slots=True)
class Proposal:
    """A grasp to make, and the probability of success that each explanation gives it."""

    config: GraspConfig
    success: dict[str, float]

    @property
    def disagreement(self) -> float:
        """How far the explanations' probabilities lie apart."""
        return max(self.success.values()) - min(self.success.values())


def rivals_of(scores: Sequence[CandidateScore], found: bool) -> Rivals:
    """The explanations to separate, by name; no score at all is the declared simulation."""
    best = scores[0]
    rivals: Rivals = {} if found else {"as declared": ()}
    if best.second_mode is not None:
        there = float(best.candidate.parameter.coordinate(np.array([best.second_mode]))[0])
        rivals[best.name] = (best,)
        rivals[f"{best.name} at {best.second_mode:.3g}"] = (replace(best, coordinate=there),)
    for score in scores:
        close = score.gain > best.gain - RULES.confusable_gain
        if len(rivals) < RULES.max_rivals and close:
            rivals[score.name] = (_at_the_same_ratio(score, best),)
    if len(rivals) < 2:
        rivals["as declared"] = ()
    return rivals


def _at_the_same_ratio(score: CandidateScore, best: CandidateScore) -> CandidateScore:
    """``score`` at the value that changes force over weight as ``best`` does.

    Several hypotheses act through that one ratio. Only what differs where it is the same can
    separate them; their own estimates differ by what their priors hold usual.
    """
    sign = score.candidate.parameter.force_exponent * best.candidate.parameter.force_exponent
    if not sign:
        return score
    axis = score.model.coordinate
    return replace(score, coordinate=float(np.clip(best.coordinate * sign, axis[0], axis[-1])))


def propose_grasps(simulations: PerturbedSimulations, rivals: Rivals) -> tuple[Proposal, ...]:
    """Grasps of the recipe's grid, none of them made before, that separate ``rivals``.

    A part of the grid is drawn and simulated under each explanation. What belongs to the gripper
    also acts on objects that have not been grasped yet, so they may tell where no further grasp
    of the same object can.
    """
    configs = _considered(simulations)
    wanted = [
        (config, combined_perturbation(scores, config.object))
        for scores in rivals.values()
        for config in configs
    ]
    simulations.simulate(wanted)
    proposals = []
    for config in configs:
        success = {}
        for name, scores in rivals.items():
            change = combined_perturbation(scores, config.object)
            outcome = simulations.known[place_of(config), change]
            margin, _ = margins_of([outcome])
            expected = float(expit(margin[0] / RULES.proposal_width))
            success[name] = expected if outcome.label >= 0 else 0.5
        proposals.append(Proposal(config, success))
    separating = [one for one in proposals if one.disagreement >= RULES.least_disagreement]
    ranked = sorted(separating, key=lambda one: -one.disagreement)
    return tuple(ranked[: RULES.grasps_proposed])


def _considered(simulations: PerturbedSimulations) -> list[GraspConfig]:
    """A part of the recipe's grid, evenly over its objects, drawn with the recipe's seed."""
    made = {place_of(config) for config in simulations.configs}
    open_to = [g.config for g in plan_recipe(simulations.recipe) if place_of(g.config) not in made]
    rng = np.random.default_rng(np.random.SeedSequence(simulations.recipe.seed, spawn_key=(0x6E,)))
    names = dict.fromkeys(config.object for config in open_to)
    chosen: list[GraspConfig] = []
    for name in names:
        own = [config for config in open_to if config.object == name]
        count = min(len(own), -(-RULES.grasps_considered // len(names)))
        chosen += [own[k] for k in np.sort(rng.choice(len(own), count, replace=False))]
    return chosen

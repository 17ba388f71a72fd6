"""Which real grasps to make next: those on which the leading explanations disagree most."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit

from tacgen.collection.grid import plan_recipe
from tacgen.core.records import GraspConfig
from tacgen.diagnose.grasps.hypotheses import Prediction
from tacgen.diagnose.grasps.model_comparison import Cause, Explanation, Posterior
from tacgen.diagnose.grasps.perturbed_simulations import PerturbedSimulations, combined_perturbation
from tacgen.diagnose.grasps.slip_margin import margins_of
from tacgen.diagnose.rules import GRASPS

Competing = dict[str, tuple[Cause, ...]]
_RATIO_SIGN = {Prediction.FORCE: 1, Prediction.FRICTION: 1, Prediction.MASS: -1}
"""Whether force over weight grows or falls by a factor."""


@dataclass(frozen=True, slots=True)
class Proposal:
    """A grasp to make, and the probability of success that each explanation gives it."""

    config: GraspConfig
    success: dict[str, float]

    @property
    def disagreement(self) -> float:
        """How far the explanations' probabilities lie apart."""
        return max(self.success.values()) - min(self.success.values())


def competing_explanations(posterior: Posterior) -> Competing:
    """The explanations to separate, by name; one without causes is the declared simulation."""
    best = posterior.best
    competing: Competing = {} if posterior.found else {"as declared": ()}
    for cause in best.causes:
        if cause.second_mode is not None:
            there = float(cause.candidate.parameter.coordinate(np.array([cause.second_mode]))[0])
            other = replace(cause, coordinate=there)
            competing[best.name] = best.causes
            competing[f"{best.name}, {cause.name} at {cause.second_mode:.3g}"] = tuple(
                other if one is cause else one for one in best.causes
            )
    for one in posterior.explanations:
        close = one.gain > best.gain - GRASPS.confusable_gain
        if len(competing) < GRASPS.max_competing and close and len(one.causes) == len(best.causes):
            competing.setdefault(one.name, _at_the_same_ratio(one, best))
    if len(competing) < 2:
        competing["as declared"] = ()
    return competing


def _at_the_same_ratio(one: Explanation, best: Explanation) -> tuple[Cause, ...]:
    """The causes of ``one`` at values that change force over weight as ``best`` does.

    Several hypotheses act through that one ratio. Only what differs where it is the same can
    separate them; their own estimates differ by what their priors hold usual.
    """
    new = [cause for cause in one.causes if cause.candidate not in best.candidates]
    left = [cause for cause in best.causes if cause.candidate not in one.candidates]
    if len(new) != 1:
        return one.causes
    signs = [_RATIO_SIGN.get(own.candidate.parameter.prediction, 0) for own in (new[0], left[0])]
    sign = signs[0] * signs[1]
    if not sign:
        return one.causes
    axis = new[0].model.coordinate
    there = float(np.clip(left[0].coordinate * sign, axis[0], axis[-1]))
    kept = [cause for cause in best.causes if cause is not left[0]]
    return (*kept, replace(new[0], coordinate=there))


def propose_grasps(simulations: PerturbedSimulations, competing: Competing) -> tuple[Proposal, ...]:
    """Grasps of the recipe's grid, none of them made before, that separate ``competing``.

    A part of the grid is drawn and simulated under each explanation. What belongs to the gripper
    also acts on objects that have not been grasped yet, so they may tell where no further grasp
    of the same object can.
    """
    configs = _considered(simulations)
    wanted = [
        (config, combined_perturbation(causes, config.object))
        for causes in competing.values()
        for config in configs
    ]
    simulations.simulate(wanted)
    proposals = []
    for config in configs:
        success = {}
        for name, causes in competing.items():
            change = combined_perturbation(causes, config.object)
            outcome = simulations.known[config.point, change]
            margin, _ = margins_of([outcome])
            expected = float(expit(margin[0] / GRASPS.proposal_width))
            success[name] = expected if outcome.label >= 0 else 0.5
        proposals.append(Proposal(config, success))
    separating = [one for one in proposals if one.disagreement >= GRASPS.least_disagreement]
    ranked = sorted(separating, key=lambda one: -one.disagreement)
    return tuple(ranked[: GRASPS.grasps_proposed])


def _considered(simulations: PerturbedSimulations) -> list[GraspConfig]:
    """A part of the recipe's grid, evenly over its objects, drawn with the recipe's seed."""
    made = {config.point for config in simulations.configs}
    open_to = [g.config for g in plan_recipe(simulations.recipe) if g.config.point not in made]
    rng = np.random.default_rng(np.random.SeedSequence(simulations.recipe.seed, spawn_key=(0x6E,)))
    names = dict.fromkeys(config.object for config in open_to)
    chosen: list[GraspConfig] = []
    for name in names:
        own = [config for config in open_to if config.object == name]
        count = min(len(own), -(-GRASPS.grasps_considered // len(names)))
        chosen += [own[k] for k in np.sort(rng.choice(len(own), count, replace=False))]
    return chosen

"""How many labels of far grasps change when PyBullet halves its time step, and from twice the step.

Every shipped object is grasped as by ``compare_engines.py`` with ``grid: {sample: 20}``; *far*
is meant as there. Run it with ``python -m validation.physics.time_step [SEED ...]``.
"""

import sys
from itertools import pairwise

from tacgen.collection.grid import plan_recipe
from tacgen.collection.pipeline import GraspPipeline
from tacgen.collection.recipe import Recipe
from tacgen.core.records import GraspTrace
from tacgen.core.resources import object_folders
from tacgen.physics import PhysicsSettings
from validation.physics.compare_engines import NEAR_MARGIN


def traces(seed: int, time_step_s: float) -> list[GraspTrace]:
    """The traces of the grasps that a seed samples, at a time step."""
    recipe = Recipe.model_validate(
        {
            "name": "time_step",
            "seed": seed,
            "objects": list(object_folders()),
            "grid": {"sample": 20},
            "physics": {"time_step_s": time_step_s},
        }
    )
    with GraspPipeline(recipe) as pipeline:
        return [pipeline.simulate(planned).trace for planned in plan_recipe(recipe)]


def is_near(trace: GraspTrace) -> bool:
    """Whether what friction or torsion can hold is within 5 % of what is asked of it."""
    margin = trace.margin
    if margin is None:
        return False
    return abs(min(margin.friction_ratio, margin.torsion_ratio) - 1) <= NEAR_MARGIN


def main() -> None:
    """Print a line for each seed, at twice the default step and at the step itself."""
    default_s = PhysicsSettings().time_step_s
    for seed in map(int, sys.argv[1:] or ["8"]):
        found = [traces(seed, factor * default_s) for factor in (2, 1, 0.5)]
        for factor, (whole, half) in zip((2, 1), pairwise(found), strict=True):
            far = [pair for pair in zip(whole, half, strict=True) if not is_near(pair[0])]
            same = sum(one.label == other.label for one, other in far)
            step = f"{1e3 * factor * default_s:.2f} ms"
            sys.stdout.write(f"seed {seed}, {step} and half: {same} of {len(far)} labels equal\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()

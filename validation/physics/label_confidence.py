"""The `label_confidence` of grasps near their border, against repetitions that are simulated.

A place of each object is drawn, and a force within 12 % of where its closed form has the border;
the grasp is then repeated with force, friction and place drawn by the recipe's uncertainty.
Run it with ``python -m validation.physics.label_confidence [SEED] [ROUNDS]``; about 2 CPU seconds
a grasp.
"""

import sys
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np

from tacgen.collection.confidence import label_confidence
from tacgen.collection.gel import gel_patch
from tacgen.collection.recipe import Recipe
from tacgen.contact.indenter import Indenter
from tacgen.contact.law import ContactLaw
from tacgen.core.records import GraspConfig, GraspObject, GraspTrace
from tacgen.core.sensors import load_sensor
from tacgen.diagnose.grasps.slip_margin import closed_form_margin
from tacgen.objects import load_object
from tacgen.physics import FrameRequest, GelModel, GraspSimulator, run_grasp

OBJECTS = (
    *("tomato_soup_can", "potted_meat_can", "sugar_box", "rubiks_cube"),
    *("mustard_bottle", "wood_block", "flat_screwdriver", "cup"),
)
REPETITIONS = 12
NEAR_LOG = 0.12  # of the force, about the border
RECIPE = Recipe.model_validate({"name": "near_the_border", "objects": OBJECTS})
UNCERTAINTY, SETTINGS = RECIPE.uncertainty, RECIPE.physics_settings
BINS = (0.0, 0.5, 0.7, 0.9, 1.01)


class Study:
    """One simulator and gel for all grasps."""

    def __init__(self, simulator: GraspSimulator, rng: np.random.Generator) -> None:
        self.simulator, self.rng = simulator, rng
        self.indenter, self.law = Indenter(load_sensor("gelsight")), ContactLaw.default()

    def grasp(self, obj: GraspObject, config: GraspConfig) -> GraspTrace:
        """Simulate one grasp on the shipped sensor's gel."""
        patch_of = partial(gel_patch, self.indenter, self.law, obj.surface)
        frames = FrameRequest()
        return run_grasp(
            self.simulator, obj, config, SETTINGS, frames=frames, gel=GelModel(patch_of)
        )

    def near_border(self, obj: GraspObject) -> GraspConfig | None:
        """A grasp within ``NEAR_LOG`` of its closed form's border; None if it has none."""
        ranges = obj.grasp_ranges
        y_mm, z_mm = (float(self.rng.choice(ranges[axis])) for axis in ("y_mm", "z_mm"))
        force_n = float(np.median(ranges["force_n"]))
        for step in range(3):
            margin = self.grasp(obj, GraspConfig(0, obj.name, force_n, 0.0, y_mm, z_mm)).margin
            if margin is None:
                return None
            at = closed_form_margin(np.array(margin.friction_ratio), np.array(margin.torsion_ratio))
            change = -float(at) if step < 2 else self.rng.uniform(-NEAR_LOG, NEAR_LOG)
            force_n = float(np.clip(force_n * np.exp(change), 0.5, 38.0))
        return GraspConfig(0, obj.name, force_n, 0.0, y_mm, z_mm)

    def repeated(self, obj: GraspObject, config: GraspConfig) -> int:
        """The label of a repetition."""
        force, friction, x, y, z = self.rng.standard_normal(5).tolist()
        drawn = replace(
            config,
            force_n=config.force_n * np.exp(UNCERTAINTY.force_relative * force),
            x_mm=config.x_mm + UNCERTAINTY.position_mm * x,
            y_mm=config.y_mm + UNCERTAINTY.position_mm * y,
            z_mm=config.z_mm + UNCERTAINTY.position_mm * z,
        )
        factor = np.exp(UNCERTAINTY.friction_relative * friction)
        return self.grasp(replace(obj, friction=obj.friction * factor), drawn).label


def main() -> None:
    """Print a line for each grasp, then the confidence and the share of repetitions by bin."""
    seed, rounds = ([int(text) for text in sys.argv[1:]] + [0, 6][len(sys.argv) - 1 :])[:2]
    stated, same = [], []
    with GraspSimulator() as simulator:
        study = Study(simulator, np.random.default_rng(seed))
        for name in OBJECTS * rounds:
            obj = load_object(name)
            config = study.near_border(obj)
            trace = study.grasp(obj, config) if config else None
            if config is None or trace is None or trace.margin is None:
                continue
            confidence = label_confidence(trace, obj, RECIPE)
            labels = [study.repeated(obj, config) for _ in range(REPETITIONS)]
            stated.append(confidence)
            same.append(np.mean([label == trace.label for label in labels]))
            sys.stdout.write(f"{name:18} {trace.label}  {confidence:.2f}  {same[-1]:.2f}\n")
            sys.stdout.flush()
    found, shares = np.array(stated), np.array(same)
    for low, high in pairwise(BINS):
        within = (found >= low) & (found < high)
        if within.any():
            means = f"{found[within].mean():.3f}  {shares[within].mean():.3f}"
            sys.stdout.write(
                f"{low:.1f} … {min(high, 1.0):.1f}  {within.sum():3d} grasps  {means}\n"
            )
    error = np.sqrt((found * (1 - found)).sum() / REPETITIONS) / len(found)
    means = f"{found.mean():.3f} ± {error:.3f}  {shares.mean():.3f}"
    sys.stdout.write(f"all        {len(found):3d} grasps  {means}\n")


if __name__ == "__main__":
    main()

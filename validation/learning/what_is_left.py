"""What knowing all that was drawn would be worth: the most that touch could tell.

``python -m validation.learning.what_is_left DATA…`` takes datasets whose recipe draws what the
robot does not know (``randomize``), and prints of the test grasps of each the accuracy of trees
that see what was commanded, and of trees that see the place that the gripper came to, the friction
and the centre of mass. No network is trained.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tacgen.collection.perturbed import draw_variation
from tacgen.collection.recipe import Randomize
from tacgen.core.records import LABEL_NOT_EXECUTED, rng_of
from tacgen.dataset.folder import DatasetFolder
from tacgen.learning.grasps import SimulatedGrasps
from tacgen.learning.parameter_baseline import forest
from tacgen.learning.scores import score


def drawn(source: SimulatedGrasps) -> NDArray[np.float64]:
    """Of each grasp the shifts of place and yaw, the friction's factor and the centre's shift."""
    spread = Randomize.model_validate(DatasetFolder(source.root).recipe()["randomize"])
    columns = source.dataset.columns()
    seeds = columns["seed"][columns["label"] != LABEL_NOT_EXECUTED]
    found = [draw_variation(spread, rng_of(int(seed), 0)) for seed in seeds]
    place = [[*one.position_mm, one.yaw_rad] for one in found]
    changes = [one.perturbation for one in found]
    held_by = [[one.friction_factor, *one.center_of_mass_mm] for one in changes]
    return np.concatenate([place, held_by], axis=1)


def by_trees(source: SimulatedGrasps, known: NDArray[np.float64]) -> dict[str, float]:
    """The scores, on the test grasps, of trees that see ``known`` (N, n), one forest an object."""
    table = source.table
    tests, probabilities = table.split == "test", np.zeros(len(table))
    for name in table.object_names():
        own = table.objects == name
        trees = forest().fit(known[own & ~tests], table.label[own & ~tests])
        chances = trees.predict_proba(known[own & tests])
        probabilities[own & tests] = chances @ trees.classes_
    return score(table.label[tests], probabilities[tests])


def main() -> None:
    """Print a line for each dataset."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, nargs="+")
    for data in parser.parse_args().data:
        source = SimulatedGrasps(data)
        commanded, draws = source.table.commanded(), drawn(source)
        there = commanded.copy()
        there[:, 1:] += draws[:, :4]
        for name, known in (
            ("commanded", commanded),
            ("all that was drawn", np.concatenate([there, draws[:, 4:]], axis=1)),
        ):
            found = by_trees(source, known)
            accuracy, auroc, n = found["accuracy"], found["auroc"], found["n"]
            print(f"{data}: {name}: accuracy {accuracy:.3f}, AUROC {auroc:.3f}, n = {n}")  # noqa: T201


if __name__ == "__main__":
    main()

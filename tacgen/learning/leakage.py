"""Which grasps a run may be tested on: those that no part of its training has seen."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.core.errors import LearningError
from tacgen.learning.grasps import GraspSource, SimulatedGrasps


def unseen_tests(
    plan: Mapping[str, Any], source: GraspSource, where: str
) -> tuple[NDArray[np.bool_], list[str]]:
    """Which of a source's grasps are to be tested on, (N,), and what is to be said of it.

    Grasps of another dataset that ask for the same as one that was trained on are left out. Those
    of a robot, or of another world that stands in for one, are not: there the same grasp has
    another image and may have another outcome.

    Parameters
    ----------
    plan : mapping
        The run's ``run.json``.

    Raises
    ------
    LearningError
        If grasps made with the very recipe of the training data were trained on.
    """
    table = source.table
    tests = table.split == "test"
    trained = {text for model in plan["models"].values() for text in model["configurations"]}
    seen = tests & np.array([text in trained for text in table.configurations()], bool)
    same_world = source.made_with is not None and (
        source.made_with == plan["dataset"].get("recipe_sha256")
    )
    if same_world and seen.any():
        first = min(table.take(np.flatnonzero(seen)).configurations())
        msg = (
            f"{where}: {int(seen.sum())} test configurations were trained on, such as {first}; "
            "test on grasps that this run has not seen"
        )
        raise LearningError(msg)
    if not isinstance(source, SimulatedGrasps) or not seen.any():
        return tests, []
    return tests & ~seen, [
        f"{int(seen.sum())} of {int(tests.sum())} test grasps of {where} are left out: they ask "
        "for the same as grasps of another dataset that were trained on"
    ]

"""How well a grasp's outcome follows from force and place: what a network can hope for.

Images tell the force by the patch's size and the place by its shape. Trees that are told both
instead of the image show whether the recipe's grid can be learnt at all from as many grasps; where
they lose what only one axis tells and images do not show, no network makes up for it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from tacgen.learning.grasps import GraspTable

AXES = ("force_n", "x_mm", "y_mm", "z_mm", "yaw_rad")
FOLDS = 5
N_TREES = 300


def told_scores(table: GraspTable, seed: int = 0) -> dict[str, Any]:
    """Accuracy of trees that are told the axes which vary, all of them and without each.

    Parameters
    ----------
    table : GraspTable
        Only its training side is used, by cross-validation over five folds.
    seed : int
        Of the folds and of the trees.

    Returns
    -------
    dict
        For each object ``n``, ``successes``, ``always`` (the accuracy of always saying the more
        common outcome) and ``told`` (accuracy by the names of the axes that are told, None where
        a class has fewer grasps than there are folds).
    """
    return {
        name: _of_object(table.take(table.rows(objects=(name,), split="train")), seed)
        for name in table.object_names()
    }


def told_lines(scores: Mapping[str, Any]) -> Iterator[str]:
    """The scores as lines for a terminal."""
    for name, one in scores.items():
        yield (
            f"{name}: {one['n']} training grasps, {one['successes']} successes; "
            f"always the more common outcome {one['always']:.3f}"
        )
        if not one["told"]:
            yield f"  fewer than {FOLDS} grasps of one outcome: nothing to learn from"
        for axes, accuracy in one["told"].items():
            yield f"  trees told {axes}: {accuracy:.3f}"


def _of_object(table: GraspTable, seed: int) -> dict[str, Any]:
    counts = np.bincount(table.label, minlength=2)
    varying = [axis for axis in AXES if len(np.unique(getattr(table, axis))) > 1]
    told: dict[str, float] = {}
    if counts.min() >= FOLDS and varying:
        told[", ".join(varying)] = _accuracy(table, varying, seed)
        for axis in varying if len(varying) > 1 else ():
            rest = [name for name in varying if name != axis]
            told[f"all but {axis}"] = _accuracy(table, rest, seed)
    n = len(table)
    return {
        "n": n,
        "successes": int(counts[1]),
        "always": float(counts.max() / max(n, 1)),
        "told": told,
    }


def _accuracy(table: GraspTable, axes: list[str], seed: int) -> float:
    from sklearn.ensemble import ExtraTreesClassifier
    from sklearn.model_selection import StratifiedKFold, cross_val_score

    trees = ExtraTreesClassifier(N_TREES, random_state=seed)
    folds = StratifiedKFold(FOLDS, shuffle=True, random_state=seed)
    known = np.stack([getattr(table, axis) for axis in axes], axis=1)
    return float(cross_val_score(trees, known, table.label, cv=folds).mean())

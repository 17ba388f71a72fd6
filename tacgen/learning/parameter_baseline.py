"""The parameter baseline: how well a grasp's outcome follows from force and place alone.

They show whether the outcome can be learnt at all; what images do not show limits networks.
"""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tacgen.core.records import AXES
from tacgen.learning.grasps import EqualRanges, GraspTable

if TYPE_CHECKING:
    from sklearn.ensemble import ExtraTreesClassifier

FOLDS = 5  # the usual number; four fifths of 150 grasps are 120, about what a network learns from
SEED = 0  # of the folds and of the trees: any, so that the scores repeat
N_TREES = 300  # enough that the vote of the trees no longer depends on their seed


def baseline_scores(table: GraspTable, equal: EqualRanges | None = None) -> dict[str, Any]:
    """Accuracy of decision trees that see all axes which vary, and all but each one.

    Only training grasps are used, by cross-validation over five folds, in which grasps that are
    the same by their ``equal`` ranges (see ``twins.py``) stay together. For each object ``n``,
    ``successes``, ``majority_accuracy`` (of always predicting the more common outcome) and
    ``tree_accuracy`` by the names of the axes that the trees see (empty where an outcome has fewer
    different grasps than there are folds).
    """
    rows = {name: table.rows(objects=(name,), split="train") for name in table.object_names()}
    return {name: _of_object(table.take(own), equal or {}) for name, own in rows.items()}


def baseline_lines(scores: Mapping[str, Any]) -> Iterator[str]:
    """The scores as lines for a terminal."""
    for name, one in scores.items():
        yield (
            f"{name}: {one['n']} training grasps, {one['successes']} successes; accuracy of the "
            f"more common outcome {one['majority_accuracy']:.3f}"
        )
        if not one["tree_accuracy"]:
            yield f"  fewer than {FOLDS} grasps of one outcome: nothing to learn from"
        for axes, accuracy in one["tree_accuracy"].items():
            yield f"  accuracy of trees that see {axes}: {accuracy:.3f}"


def _of_object(table: GraspTable, equal: EqualRanges) -> dict[str, Any]:
    counts = np.bincount(table.label, minlength=2)
    groups = np.array(table.configurations(equal))
    different = [len(np.unique(groups[table.label == label])) for label in (0, 1)]
    varying = [axis for axis in AXES if len(np.unique(getattr(table, axis))) > 1]
    accuracy: dict[str, float] = {}
    if min(different) >= FOLDS and varying:
        accuracy[", ".join(varying)] = _accuracy(table, varying, groups)
        for axis in varying if len(varying) > 1 else ():
            rest = [name for name in varying if name != axis]
            accuracy[f"all but {axis}"] = _accuracy(table, rest, groups)
    return {
        "n": len(table),
        "successes": int(counts[1]),
        "majority_accuracy": float(counts.max() / max(len(table), 1)),
        "tree_accuracy": accuracy,
    }


def _accuracy(table: GraspTable, axes: list[str], groups: NDArray[np.str_]) -> float:
    from sklearn.model_selection import StratifiedGroupKFold, cross_val_score

    folds = StratifiedGroupKFold(FOLDS, shuffle=True, random_state=SEED)
    known = np.stack([getattr(table, axis) for axis in axes], axis=1)
    found = cross_val_score(forest(), known, table.label, groups=groups, cv=folds)
    return float(found.mean())


def predicted_by_trees(model: Mapping[str, Any], table: GraspTable) -> NDArray[np.float64]:
    """Probability of success (N,) by trees that see what was commanded: force, place and yaw.

    ``model`` is one of ``run.json``: they learn from its training grasps, of each object by itself;
    of a new object from all of them.
    """
    trained = [text.rsplit(" ", len(AXES)) for text in model["configurations"]]
    objects = np.array([name for name, *_ in trained])
    known, labels = np.array([row[1:] for row in trained], float), np.array(model["labels"])
    commanded, found = table.commanded(), np.zeros(len(table))
    for name in table.object_names():
        asked = table.objects == name
        own = objects == name if name in objects else np.full(len(objects), fill_value=True)
        trees = forest().fit(known[own], labels[own])
        found[asked] = trees.predict_proba(commanded[asked]) @ trees.classes_
    return found


def forest() -> "ExtraTreesClassifier":
    """The trees that learn from figures."""
    from sklearn.ensemble import ExtraTreesClassifier

    return ExtraTreesClassifier(N_TREES, random_state=SEED)

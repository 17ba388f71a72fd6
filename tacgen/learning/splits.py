"""Which grasps are for fitting, validation and tests: by configuration, never by image."""

import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.core.errors import LearningError
from tacgen.learning.grasps import EqualRanges, GraspSource, GraspTable, configuration_key
from tacgen.learning.training_recipe import POOLED, TrainRecipe

MIN_OF_A_CLASS = 2  # grasps of each outcome to fit to; fewer teach a network nothing about it
FEW_OF_A_CLASS = 20
"""Fewer grasps of an outcome to fit to than this are warned of. The paper's smallest training set,
50 grasps of an object, has some 25 of each."""
_STREAM_SUBSET, _STREAM_VALIDATION = 0, 1  # keep the random numbers of one seed apart


@dataclass(frozen=True, slots=True)
class ModelPlan:
    """One model to train: the rows it is fitted to, and those that choose its best epoch."""

    name: str
    objects: tuple[str, ...]
    fit_rows: NDArray[np.int64]
    validation_rows: NDArray[np.int64]


def plan_models(
    recipe: TrainRecipe,
    table: GraspTable,
    where: str,
    equal: EqualRanges | None = None,
) -> list[ModelPlan]:
    """The models of a recipe, each with its grasps for fitting and validation.

    ``where`` is the dataset, for messages, ``equal`` the ranges in which an axis changes nothing.
    Raises ``LearningError``, which lists every object that is unknown, or has too few grasps of one
    class.
    """
    objects = _chosen_objects(recipe, table, where)
    groups = [(name, (name,)) for name in objects] if recipe.per_object else [(POOLED, objects)]
    plans, problems = [], []
    for name, members in groups:
        try:
            plans.append(_plan_model(recipe, table, name, tuple(members), equal or {}))
        except LearningError as error:
            problems.append(f"{where}: {error}")
    LearningError.raise_if(problems)
    return plans


def few_grasps_warning(plan: ModelPlan, table: GraspTable) -> str:
    """What a model has too little of to learn from; empty if it has enough."""
    failures, successes = np.bincount(table.label[plan.fit_rows], minlength=2).tolist()
    if min(failures, successes) >= FEW_OF_A_CLASS:
        return ""
    return (
        f"{plan.name}: {successes} successes and {failures} failures to train on; a network seldom "
        f"learns from fewer than {FEW_OF_A_CLASS} of each. Collect more grasps (`sample`), or a "
        "wider range of forces"
    )


def unseen_tests(
    plan: Mapping[str, Any], source: GraspSource, where: str
) -> tuple[NDArray[np.bool_], list[str]]:
    """Which of a source's grasps to test on, (N,), and notes about those left out.

    Simulated grasps, in whichever format and made with whichever recipe, are left out where one of
    the same object, force and place was trained on; a robot's are kept, whose images differ.
    ``plan`` is the run's ``run.json``. Raises ``LearningError`` if all were trained on.
    """
    table = source.table
    tests = table.split == "test"
    if not source.is_simulated:
        return tests, []
    equal = plan.get("equal_ranges", {})
    trained = {
        configuration_key(text, equal)
        for model in plan["models"].values()
        for text in model["configurations"]
    }
    keys = table.configurations(equal)
    tests |= np.isin(keys, plan.get("test_groups", []))
    seen = tests & np.isin(keys, list(trained))
    if not seen.any():
        return tests, []
    first = min(np.array(keys)[seen])
    if (seen == tests).all():
        msg = (
            f"{where}: all {int(seen.sum())} test configurations were trained on, such as {first}; "
            "test on grasps that this run has not seen"
        )
        raise LearningError(msg)
    return tests & ~seen, [
        f"{int(seen.sum())} of {int(tests.sum())} test grasps of {where} are not used: a simulated "
        f"grasp of the same object, force and place was trained on, such as {first}"
    ]


def class_weights(labels: NDArray[np.int64]) -> NDArray[np.float64]:
    """(2,) weights that make both classes count the same: N / (2 × count of the class)."""
    return len(labels) / (2 * np.bincount(labels, minlength=2))


def _chosen_objects(recipe: TrainRecipe, table: GraspTable, where: str) -> tuple[str, ...]:
    known = table.object_names()
    chosen = tuple(known) if recipe.objects is None else recipe.objects
    unknown = [name for name in chosen if name not in known]
    if unknown:
        msg = (
            f"{where}: has no executed grasps of {', '.join(unknown)}; let `objects` in the "
            f"training recipe name only {', '.join(known)}"
        )
        raise LearningError(msg)
    return chosen


def _plan_model(
    recipe: TrainRecipe,
    table: GraspTable,
    name: str,
    objects: tuple[str, ...],
    equal: EqualRanges,
) -> ModelPlan:
    fit, validation = [], []
    for member in objects:
        rows = table.rows(objects=(member,), split="train")
        if recipe.training.grasps is not None:
            rows = _subset(rows, recipe.training.grasps, recipe.seed, member)
        chosen = _validation_rows(table, rows, recipe, member, equal)
        validation.append(chosen)
        fit.append(np.setdiff1d(rows, chosen))
    plan = ModelPlan(name, objects, np.concatenate(fit), np.concatenate(validation))
    counts = np.bincount(table.label[plan.fit_rows], minlength=2)
    kept = np.bincount(table.label[plan.validation_rows], minlength=2)
    if counts.min() < MIN_OF_A_CLASS or kept.min() < 1:
        total = counts + kept
        pool = ", or set per_object: false" if recipe.per_object else ""
        msg = (
            f"{name}: of its {total.sum()} training grasps {total[1]} succeeded and {total[0]} "
            f"failed, and each class needs {MIN_OF_A_CLASS + 1} or more; collect a wider range "
            f"of forces or positions{pool}"
        )
        raise LearningError(msg)
    return plan


def _subset(rows: NDArray[np.int64], wanted: int, seed: int, name: str) -> NDArray[np.int64]:
    """The first ``wanted`` of a fixed order, so that a smaller set is part of a larger one."""
    if wanted > len(rows):
        msg = (
            f"{name}: training.grasps asks for {wanted}, the dataset has {len(rows)} to train on; "
            "lower it or collect more"
        )
        raise LearningError(msg)
    return np.sort(_rng(seed, name, _STREAM_SUBSET).permutation(rows)[:wanted])


def _validation_rows(
    table: GraspTable,
    rows: NDArray[np.int64],
    recipe: TrainRecipe,
    name: str,
    equal: EqualRanges,
) -> NDArray[np.int64]:
    """A part of each class; grasps of one configuration stay together."""
    mine = table.take(rows)
    configurations = np.array(mine.configurations(equal))
    rng = _rng(recipe.seed, name, _STREAM_VALIDATION)
    chosen: list[str] = []
    for label in (0, 1):
        groups = np.unique(configurations[mine.label == label])
        groups = groups[~np.isin(groups, chosen)]
        count = math.ceil(recipe.training.validation_fraction * len(groups))
        count = min(count, max(len(groups) - MIN_OF_A_CLASS, 0))
        chosen += list(rng.permutation(groups)[:count])
    return rows[np.isin(configurations, chosen)]


def _rng(seed: int, name: str, stream: int) -> np.random.Generator:
    """Random numbers of one object: the same whichever other objects there are."""
    return np.random.default_rng(_sequence(seed, name, stream))


def seed_of(seed: int, name: str, parts: Sequence[int]) -> int:
    """A 63-bit seed for torch, from the recipe's seed, the model and further numbers."""
    return int(_sequence(seed, name, *parts).generate_state(1, np.uint64)[0] >> 1)


def _sequence(seed: int, name: str, *parts: int) -> np.random.SeedSequence:
    return np.random.SeedSequence(seed, spawn_key=(zlib.crc32(name.encode()), *parts))

"""The test set is never seen, and validation is a part of the training grasps."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tacgen.core.errors import LearningError
from tacgen.learning.grasps import GraspTable, SimulatedGrasps, configuration_key
from tacgen.learning.splits import class_weights, plan_models
from tacgen.learning.twins import one_sided
from tests.learning.conftest import recipe_of
from tests.messages import refused


def table_of(n: int, seed: int = 0, repeats: int = 1, **given) -> GraspTable:
    """n configurations of two objects, each asked for ``repeats`` times; a third is for testing."""
    rng = np.random.default_rng(seed)
    once = {
        "objects": np.where(np.arange(n) % 2, "can", "cup"),
        "label": rng.integers(0, 2, n),
        "split": np.where(rng.random(n) < 0.3, "test", "train"),
        "force_n": rng.integers(1, 8, n).astype(float),
        "x_mm": rng.random(n),
        "y_mm": np.zeros(n),
        "z_mm": rng.random(n),
        "yaw_rad": np.zeros(n),
        "grasp_frame": np.zeros(n, int),
    } | given
    columns = {name: np.repeat(values, repeats) for name, values in once.items()}
    return GraspTable(ids=np.arange(n * repeats).astype(str), **columns)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    n=st.integers(160, 300),  # of fewer, chance may leave too few of a class to train on
    repeats=st.integers(1, 3),
    per_object=st.booleans(),
    fraction=st.floats(0.05, 0.5),
)
def test_no_grasp_or_configuration_is_on_two_sides(seed, n, repeats, per_object, fraction):
    table = table_of(n, seed, repeats)
    recipe = recipe_of(per_object=per_object, seed=seed, training={"validation_fraction": fraction})
    tested = np.flatnonzero(table.split == "test")
    used: list[int] = []
    for plan in plan_models(recipe, table, "data"):
        sides = [plan.fit_rows, plan.validation_rows, tested]
        for i, one in enumerate(sides):
            for other in sides[i + 1 :]:
                assert not set(one) & set(other)
                shared = set(table.take(one).configurations())
                assert not shared & set(table.take(other).configurations())
        used += [*plan.fit_rows, *plan.validation_rows]
    assert sorted(used) == sorted(np.flatnonzero(table.split == "train"))


def test_grasps_of_one_configuration_come_to_one_side():
    table = table_of(80, repeats=2)
    split = table.split.copy()
    row = int(np.flatnonzero(split == "test")[0])
    split[row] = "train"
    given = replace(table, split=split)
    kept, (note,) = one_sided(given, {})
    keys = np.array(kept.configurations())
    sides = [set(keys[kept.split == side]) for side in ("train", "test")]
    assert not sides[0] & sides[1]
    assert note.startswith("1 grasps change sides")


def test_a_yaw_and_a_full_turn_more_are_one_grasp():
    turns = np.array([-np.pi, np.pi, 3 * np.pi, -1e-7, 0.0, 2 * np.pi, 0.3])
    table = table_of(7, objects=["can"] * 7, yaw_rad=turns, force_n=np.ones(7), x_mm=np.zeros(7))
    texts = table.take(np.arange(7)).configurations()
    where = [text.rpartition(" ")[2] for text in texts]
    assert where == ["3.1416"] * 3 + ["0"] * 3 + ["0.3"]
    # As earlier versions wrote it.
    wrote = ["can 5 0 0 40 -3.14159", "can 5 0 0 40 3.14159"]
    assert [configuration_key(text, {}) for text in wrote] == ["can 5 0 0 40 3.1416"] * 2


def test_validation_takes_its_share_of_each_class():
    table = table_of(400, seed=3)
    recipe = recipe_of(training={"validation_fraction": 0.2})
    (plan,) = plan_models(recipe, table, "data")
    for label in (0, 1):
        kept = (table.label[plan.validation_rows] == label).sum()
        learnt = (table.label[plan.fit_rows] == label).sum()
        assert kept / (kept + learnt) == pytest.approx(0.2, abs=0.03)


def test_the_split_follows_from_the_seed_and_the_object_alone():
    table = table_of(120)
    first = plan_models(recipe_of(per_object=True), table, "data")
    alone = plan_models(recipe_of(per_object=True, objects=["cup"]), table, "data")
    assert [plan.name for plan in first] == ["can", "cup"]
    np.testing.assert_array_equal(first[1].validation_rows, alone[0].validation_rows)
    other = plan_models(recipe_of(per_object=True, seed=5), table, "data")
    assert list(first[1].validation_rows) != list(other[1].validation_rows)


def test_a_smaller_training_set_is_part_of_a_larger_one():
    table = table_of(200)

    def rows(n: int) -> set[int]:
        recipe = recipe_of(per_object=True, objects=["can"], training={"grasps": n})
        (plan,) = plan_models(recipe, table, "data")
        assert len(plan.fit_rows) + len(plan.validation_rows) == n
        return {*plan.fit_rows, *plan.validation_rows}

    assert rows(20) < rows(40)
    with refused(LearningError):
        rows(500)


def test_one_class_only_is_told_for_every_object_at_once():
    table = table_of(80, label=np.ones(80, int))
    with refused(LearningError):
        plan_models(recipe_of(per_object=True), table, "data")


def test_objects_that_are_not_there_are_named(toy):
    table = SimulatedGrasps(toy).table
    with refused(LearningError):
        plan_models(recipe_of(objects=["can", "mug"]), table, "data")


def test_class_weights_make_both_classes_count_the_same():
    labels = np.array([0] * 30 + [1] * 10)
    weights = class_weights(labels)
    assert weights[0] * 30 == pytest.approx(weights[1] * 10)
    assert np.sum(weights[labels]) == pytest.approx(len(labels))


def test_grasps_that_were_not_executed_are_left_out(toy):
    table = SimulatedGrasps(toy).table
    assert len(table) == 40 - len(range(8, 40, 9))
    assert set(table.label) == {0, 1}

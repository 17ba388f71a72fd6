"""What force and place tell of the outcome, on tables whose rule is known."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from tacgen import cli
from tacgen.learning.grasps import GraspTable
from tacgen.learning.parameter_baseline import baseline_lines, baseline_scores, predicted_by_trees

AXES_SEEN = ("force_n", "y_mm", "z_mm")


@pytest.fixture(autouse=True)
def fewer_trees(monkeypatch):
    """A tenth of them: the rules of these tables are plain enough for a vote of 30."""
    monkeypatch.setattr("tacgen.learning.parameter_baseline.N_TREES", 30)


def table_of(label_of, n: int = 150, split: str = "train") -> GraspTable:
    rng = np.random.default_rng(0)
    force_n, y_mm, z_mm = rng.uniform(1, 20, n), rng.uniform(-10, 10, n), rng.uniform(20, 60, n)
    return GraspTable(
        ids=np.arange(n).astype(str),
        objects=np.full(n, "can"),
        label=label_of(force_n, y_mm, z_mm, rng).astype(np.int64),
        split=np.full(n, split),
        force_n=force_n,
        x_mm=np.zeros(n),
        y_mm=y_mm,
        z_mm=z_mm,
        yaw_rad=np.zeros(n),
        grasp_frame=np.ones(n, np.int64),
    )


@pytest.mark.slow
def test_an_outcome_that_force_decides_is_found_from_force():
    scores = baseline_scores(table_of(lambda f, y, z, rng: f > 10))["can"]
    assert list(scores["tree_accuracy"]) == [
        "force_n, y_mm, z_mm",
        *(f"all but {a}" for a in AXES_SEEN),
    ]
    assert scores["tree_accuracy"]["force_n, y_mm, z_mm"] > 0.95
    # Without the force nothing is left; three standard deviations of a guess on 150 are 0.12.
    assert scores["tree_accuracy"]["all but force_n"] < 0.5 + 0.13


@pytest.mark.slow
def test_a_height_that_decides_and_is_not_seen_costs_accuracy():
    accuracy = baseline_scores(table_of(lambda f, y, z, rng: f > 10 * (z > 40)))["can"][
        "tree_accuracy"
    ]
    assert accuracy["force_n, y_mm, z_mm"] > 0.93
    assert accuracy["all but z_mm"] < accuracy["force_n, y_mm, z_mm"] - 0.1


@pytest.mark.slow
def test_grasps_that_are_the_same_are_in_one_fold():
    """Each grasp twice, at two x that change nothing: trees would know an outcome by its twin."""
    once = table_of(lambda f, y, z, rng: rng.random(len(f)) < 0.5, n=75)
    table = once.take(np.tile(np.arange(75), 2))
    table = replace(table, x_mm=np.repeat([-2.0, 2.0], 75))
    known = baseline_scores(table)["can"]["tree_accuracy"]["all but x_mm"]
    found = baseline_scores(table, {"can": {"x_mm": [(-2.0, 2.0)]}})["can"]["tree_accuracy"]
    assert known > 0.9
    # Three standard deviations of a guess on 75 are 0.17.
    assert abs(found["all but x_mm"] - 0.5) < 0.18


def test_one_outcome_alone_is_said_to_teach_nothing():
    scores = baseline_scores(table_of(lambda f, y, z, rng: f > 0))
    assert scores["can"]["majority_accuracy"] == 1.0
    assert "nothing to learn from" in "\n".join(baseline_lines(scores))


@pytest.mark.slow
def test_the_command_reports_each_object(toy, capsys, monkeypatch):
    monkeypatch.setattr(
        sys, "argv", ["tacgen", "eval", "--baseline", "parameters", "--data", str(toy), "--json"]
    )
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 0
    scores = json.loads(capsys.readouterr().out)
    assert sorted(scores) == ["can", "cup"]
    assert all(one["n"] >= one["successes"] > 0 for one in scores.values())


def model_of(*tables: GraspTable) -> dict[str, list]:
    """What ``run.json`` keeps of the training grasps."""
    return {
        "configurations": [text for table in tables for text in table.configurations()],
        "labels": [int(label) for table in tables for label in table.label],
    }


def test_trees_know_each_object_of_the_training_and_of_a_new_one_what_all_have_in_common():
    """The can slips below 10 N, the cup above 10 N: together force tells nothing of a mug."""
    can = table_of(lambda f, y, z, rng: f > 10)
    cup = replace(can, objects=np.full(150, "cup"), label=1 - can.label)
    model = model_of(can, cup)
    for table in (can, cup):
        found = predicted_by_trees(model, table)
        assert ((found >= 0.5) == (table.label == 1)).all()
    mug = predicted_by_trees(model, replace(can, objects=np.full(150, "mug")))
    assert mug == pytest.approx(np.full(150, 0.5), abs=0.3)
    alone = predicted_by_trees(model_of(can), replace(can, objects=np.full(150, "mug")))
    assert ((alone >= 0.5) == (can.label == 1)).all()


def test_of_an_object_that_always_held_trees_say_that_it_will():
    table = table_of(lambda f, y, z, rng: np.ones_like(f))
    assert predicted_by_trees(model_of(table), table) == pytest.approx(np.ones(150))

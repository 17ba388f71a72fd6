"""Training grasps chosen near the border: the same ones however they are collected."""

import hashlib
import itertools
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from tacgen.collection.border import choose_near_border
from tacgen.collection.grid import grown_plan
from tacgen.collection.recipe import Recipe, load_recipe
from tacgen.collection.run import collect, describe, prepare
from tacgen.core.errors import DatasetError, RecipeError
from tacgen.dataset import Dataset, DatasetFolder
from tacgen.dataset.summary import summarize, summary_text
from tacgen.dataset.verify import verify
from tests.small_world import write_world

GRID = {
    "force_n": {"geomspace": [2, 25, 20]},
    "y_mm": {"linspace": [-15, 15, 20]},
    "z_mm": [60, 90],
    "sample": 100,
    "adaptive": {"first": 20, "batch": 20},
}


def recipe_of(size=7, seed=3, **grid):
    sections = {"name": "r", "objects": ["sugar_box", "cup"], "seed": seed}
    return Recipe.model_validate(sections | {"grid": GRID | grid, "dataset": {"shard_size": size}})


def holds(config):
    """A border that force and place share."""
    return int(config.force_n > 5 + 0.05 * config.y_mm**2)


def collected(recipe, label=holds):
    """The plan after its last batch, and those before it, where ``label`` is the simulation."""
    plans = [grown_plan(recipe, ())]
    while plans[-1].n_to_choose:
        before = plans[-1]
        labels = np.array([label(one.config) for one in before.grasps])
        known = json.loads(json.dumps(before.grids))
        plans.append(grown_plan(recipe, known, lambda n, labels=labels: labels[:n]))
    return plans


def test_batches_are_parts_of_the_plan_and_keep_what_was_before():
    plans = collected(recipe_of())
    assert plans[0].parts == (80, 40, 40, 40)
    assert [plan.n_to_choose for plan in plans] == [120, 80, 40, 0]
    for before, plan in itertools.pairwise(plans):
        assert plan.parts == before.parts
        assert plan.grasps[: len(before.grasps)] == before.grasps
        assert plan.grasps[len(before.grasps)].shard == before.grasps[-1].shard + 1
    points = {replace(g.config, index=0) for g in plans[-1].grasps}
    assert len(points) == 200


def test_test_grasps_are_drawn_at_random_before_anything_is_known():
    """They are the same whatever the outcomes, and none is added by a choice."""
    by_force, by_place = (
        collected(recipe_of(), label)[-1] for label in (holds, lambda c: int(c.y_mm > 3))
    )
    tests = [[g for g in plan.grasps if g.split == "test"] for plan in (by_force, by_place)]
    assert tests[0] == tests[1]
    for name in ("sugar_box", "cup"):
        own = [g for g in by_force.grasps if g.config.object == name]
        assert sum(g.split == "test" for g in own) == 20
        assert {g.split for g in own if g.config.index >= 80} == {"train"}
    assert by_force.grasps[80:] != by_place.grasps[80:]


def test_what_test_grasps_come_to_has_no_part_in_the_choice():
    recipe = recipe_of()
    first = grown_plan(recipe, ())
    labels = np.array([holds(one.config) for one in first.grasps])
    is_test = np.array([one.split == "test" for one in first.grasps])
    plans = [
        grown_plan(recipe, json.loads(json.dumps(first.grids)), lambda n, given=given: given[:n])
        for given in (labels, np.where(is_test, 1 - labels, labels), np.where(is_test, -1, labels))
    ]
    assert plans[0] == plans[1] == plans[2]
    assert len(plans[0].grasps) == 120


def test_test_grasps_fall_evenly_on_the_grid():
    """Over many seeds each quarter of the forces has a quarter of them, as binomial draws do."""
    forces = sorted({g.config.force_n for g in grown_plan(recipe_of(), ()).grasps})
    counts = np.zeros(4)
    for seed in range(20):
        tests = [g for g in grown_plan(recipe_of(seed=seed), ()).grasps if g.split == "test"]
        np.add.at(counts, [forces.index(g.config.force_n) // 5 for g in tests], 1)
    assert counts.sum() == 20 * 40
    assert np.abs(counts - 200).max() < 4 * np.sqrt(800 * 0.25 * 0.75)


def test_choices_lie_nearer_to_the_border_than_random_grasps():
    plan = collected(recipe_of())[-1]

    def far(grasps):
        border = [5 + 0.05 * g.config.y_mm**2 for g in grasps]
        return np.median(
            [abs(np.log(g.config.force_n / b)) for g, b in zip(grasps, border, strict=True)]
        )

    assert far(plan.grasps[120:]) < far(plan.grasps[:80]) / 3


def test_grasps_that_cannot_be_executed_are_left_aside():
    """A third of the grid is out of reach: after the first batches nothing is drawn there."""
    plan = collected(recipe_of(), lambda c: -1 if c.y_mm > 5 else holds(c))[-1]
    beyond = [g.config.y_mm > 5 for g in plan.grasps]
    assert np.mean(beyond[:80]) > 0.2
    assert np.mean(beyond[80:]) < 0.05
    # Where nothing can be executed the batches are random ones.
    assert len(collected(recipe_of(), lambda _: -1)[-1].grasps) == 200


def test_of_equal_candidates_the_first_is_chosen():
    made = np.array([[0.0], [1.0]])
    twice = np.array([[0.5], [0.5], [0.25], [0.75]])
    assert choose_near_border(made, np.array([0, 1]), twice, 1) == [0]
    assert choose_near_border(made, np.array([-1, -1]), twice, 2) == [0, 1]
    assert sorted(choose_near_border(made, np.array([1, 1]), twice, 9)) == [0, 1, 2, 3]


def test_a_choice_halves_the_open_interval():
    """On one axis with a step the point half-way is the least certain one."""
    made, open_to = np.array([[0.2], [0.6]]), np.linspace(0, 1, 41)[:, None]
    (chosen,) = choose_near_border(made, np.array([0, 1]), open_to, 1)
    assert open_to[chosen, 0] == pytest.approx(0.4)


def test_a_recipe_without_it_is_written_as_before():
    plain = Recipe.model_validate({"name": "r", "objects": ["cup"], "grid": {"sample": 9}})
    assert "adaptive" not in plain.resolved()["grid"]
    recipe = recipe_of()
    assert Recipe.model_validate(recipe.resolved()) == recipe
    assert recipe.sha256() != recipe_of(adaptive=None).sha256()


@pytest.mark.parametrize(
    ("grid", "words"),
    [
        ({"adaptive": {}}, r"grid.adaptive needs grid.sample"),
        ({"sample": 30, "adaptive": {"first": 24}}, r"first = 24 is to be less than the 24 train"),
    ],
)
def test_what_leaves_nothing_to_choose_is_refused(tmp_path, grid, words):
    path = tmp_path / "r.yaml"
    path.write_text(yaml.safe_dump({"name": "r", "objects": ["cup"], "grid": grid}))
    with pytest.raises(RecipeError, match=words):
        load_recipe(path)


# With the simulation: 20 grasps of a block in parts of 12, 4 and 4.

SECTIONS = {
    "grid": "{force_n: [3, 5, 8, 12, 25], y_mm: [0, 6, 12], z_mm: [60, 90], sample: 20, "
    "adaptive: {first: 8, batch: 4}}",
    "dataset": "{shard_size: 2, scene_pictures: false}",
}


@pytest.fixture
def world(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return write_world(tmp_path, **SECTIONS)


def hashes(folder):
    return {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(Path(folder).glob("shards/*.h5"))
    }


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    folder, before = tmp_path_factory.mktemp("reference"), Path.cwd()
    os.chdir(folder)
    try:
        collect(load_recipe(write_world(folder, **SECTIONS)), folder / "out", progress=False)
    finally:
        os.chdir(before)
    return folder / "out"


@pytest.mark.slow
def test_a_dataset_says_how_its_grasps_were_chosen(reference):
    plan = DatasetFolder(reference).plan()
    assert plan["parts"] == [12, 4, 4]
    assert [len(record.get("chosen", ())) for (record,) in plan["grids"]] == [0, 4, 4]
    lines = DatasetFolder(reference).manifest()
    assert [line.chosen for line in lines.values()] == [False] * 6 + [True] * 4
    assert not verify(reference).problems
    text = summary_text(summarize(reference))
    assert "sampling  8 training grasps were chosen near the border" in text
    assert "Sampling: 8 training grasps were chosen" in (reference / "README.md").read_text()
    # The points of the plan are those that were made.
    columns = Dataset(reference).columns()
    rows = [[columns[axis][k] for axis in ("force_n", "y_mm", "z_mm")] for k in range(12, 20)]
    chosen = [[p[0], p[2], p[3]] for (record,) in plan["grids"][1:] for p in record["chosen"]]
    assert rows == chosen
    assert list(columns["split"][12:]) == ["train"] * 8


@pytest.mark.slow
def test_neither_workers_nor_shares_change_a_byte(reference, world, tmp_path):
    collect(load_recipe(world), tmp_path / "two", workers=2, progress=False)
    assert hashes(tmp_path / "two") == hashes(reference)
    # A job whose share is the last shards alone makes what these follow from.
    made = collect(load_recipe(world), tmp_path / "last", shards=[9], progress=False).made
    assert made == [*range(8), 9]
    assert describe(load_recipe(world), tmp_path / "last")["shards_done"] == 9
    collect(load_recipe(world), tmp_path / "last", progress=False)
    assert hashes(tmp_path / "last") == hashes(reference)


@pytest.mark.slow
def test_jobs_side_by_side_that_are_killed_and_go_on_make_the_same(reference, world, tmp_path):
    command = [sys.executable, "-m", "tacgen", "-q", "collect", str(world), "--out", "out"]
    shares = [[*command, "--workers", "1", "--shard", f"{k}/2"] for k in range(2)]
    jobs = [subprocess.Popen(share, start_new_session=True) for share in shares]
    folder, until_s = DatasetFolder(tmp_path / "out"), time.monotonic() + 240
    while len(folder.grids()) < 2 and time.monotonic() < until_s:
        time.sleep(0.05)
    for job in jobs:  # amid the second batch, or between two
        os.killpg(job.pid, signal.SIGKILL)
        job.wait()
    assert len(folder.manifest()) < 10
    jobs = [subprocess.Popen(share) for share in shares]
    assert [job.wait(timeout=300) for job in jobs] == [0, 0]
    assert hashes(tmp_path / "out") == hashes(reference)
    assert not verify(tmp_path / "out").problems


@pytest.mark.slow
def test_a_lost_plan_is_found_again_and_another_batch_size_refused(reference, world, tmp_path):
    recipe = load_recipe(world)
    collect(recipe, tmp_path / "out", progress=False)
    folder = DatasetFolder(tmp_path / "out")
    plan = folder.plan_path.read_bytes()
    folder.plan_path.unlink()
    assert collect(recipe, tmp_path / "out", progress=False).made == []
    assert folder.plan_path.read_bytes() == plan
    # Begun with another size of the batches.
    prepare(recipe, tmp_path / "begun")
    other = world.read_text().replace("batch: 4", "batch: 3")
    world.write_text(other)
    with pytest.raises(DatasetError, match=r"grid.adaptive.batch: 4 there, 3 now"):
        prepare(load_recipe(world), tmp_path / "begun")
    # Also where all are made, or nothing of the plan's sizes shows it.
    with pytest.raises(DatasetError, match=r"grid.adaptive.batch: 4 there, 3 now"):
        prepare(load_recipe(world), tmp_path / "out")
    world.write_text(other.replace("batch: 3", "batch: 4").replace("first: 8", "first: 9"))
    with pytest.raises(DatasetError, match=r"grid.adaptive.first: 8 there, 9 now"):
        prepare(load_recipe(world), tmp_path / "out")
    # More grasps: what is there stays.
    world.write_text(other.replace("sample: 20", "sample: 26"))
    grasps, spec = prepare(load_recipe(world), tmp_path / "out", grow=True)
    assert spec.parts == (12, 4, 4, 3, 3)
    assert [g.split for g in grasps].count("test") == 4

"""Grasps of a list, and those that are chosen near the border between success and failure."""

import numpy as np
import pandas as pd
import pytest
import yaml

from tacgen.collection import border
from tacgen.collection.border import choose_near_border, next_grasps
from tacgen.collection.grid import grown_plan, plan_recipe
from tacgen.collection.recipe import load_recipe
from tacgen.collection.run import collect
from tacgen.core.errors import RecipeError
from tacgen.core.records import AXES
from tacgen.dataset import Dataset, DatasetFolder
from tacgen.dataset.summary import summarize, summary_text
from tacgen.dataset.verify import verify
from tests.messages import refused
from tests.small_world import write_world

GRID = {
    "force_n": {"geomspace": [2, 25, 20]},
    "y_mm": {"linspace": [-15, 15, 20]},
    "z_mm": [60, 90],
    "sample": 40,
}


def recipe_of(folder, **grid):
    path = folder / "r.yaml"
    content = {"name": "r", "objects": ["sugar_box", "cup"], "seed": 3, "grid": GRID | grid}
    path.write_text(yaml.safe_dump(content))
    return load_recipe(path)


def holds(table):
    """A border that force and place share."""
    return (table["force_n"] > 5 + 0.05 * table["y_mm"] ** 2).astype(int)


class Made:
    """A dataset whose simulation is ``label``."""

    def __init__(self, recipe, label):
        plan = plan_recipe(recipe)
        rows = [{a: getattr(g.config, a) for a in ("object", *AXES)} for g in plan]
        self.table = pd.DataFrame(rows).assign(split=[g.split for g in plan])
        self.table["label"] = label(self.table)

    def columns(self):
        return {name: self.table[name].to_numpy() for name in self.table}

    def close(self):
        pass


def grown(tmp_path, monkeypatch, label=holds, steps=3):
    """The table of grasps after some steps of 20 more of each object."""
    recipe = recipe_of(tmp_path)
    for _ in range(steps):
        monkeypatch.setattr(border, "Dataset", lambda _, recipe=recipe: Made(recipe, label))
        table = next_grasps(recipe, "data", 20)
        table.to_csv(tmp_path / "next.csv", index=False)
        recipe = recipe_of(tmp_path, file="next.csv")
    return recipe, table


def test_a_list_keeps_what_was_there_and_its_sides(tmp_path, monkeypatch):
    before = grown_plan(recipe_of(tmp_path), ())
    recipe, table = grown(tmp_path, monkeypatch)
    plan = grown_plan(recipe, before.grids)
    assert plan.parts == (80, 120)
    assert plan.grasps[:80] == before.grasps
    assert plan.grasps[80].shard == before.grasps[-1].shard + 1
    assert [g.split for g in plan.grasps].count("test") == 16
    assert {g.split for g in plan.grasps[80:]} == {"train"}
    assert len(table.drop_duplicates(["object", *AXES])) == 200


def test_choices_lie_nearer_to_the_border_than_random_grasps(tmp_path, monkeypatch):
    _, table = grown(tmp_path, monkeypatch)
    far = np.abs(np.log(table["force_n"] / (5 + 0.05 * table["y_mm"] ** 2)))
    assert far[120:].median() < far[:80].median() / 3


def test_what_test_grasps_come_to_has_no_part_in_the_choice(tmp_path, monkeypatch):
    flipped = lambda table: holds(table).where(table["split"] == "train", 1 - holds(table))  # noqa: E731
    pd.testing.assert_frame_equal(
        grown(tmp_path, monkeypatch)[1], grown(tmp_path, monkeypatch, flipped)[1]
    )


def test_grasps_that_cannot_be_executed_are_avoided(tmp_path, monkeypatch):
    _, table = grown(tmp_path, monkeypatch, lambda t: holds(t).where(t["y_mm"] <= 5, -1))
    # Of the grid 7 in 20 cannot be executed: choices at random would be there as often.
    assert (table["y_mm"][80:] > 5).mean() < 0.35 / 2


def test_a_choice_halves_the_open_interval():
    """On one axis with a step the point half-way is the least certain one."""
    made, open_to = np.array([[0.2], [0.6]]), np.linspace(0, 1, 41)[:, None]
    (chosen,) = choose_near_border(made, np.array([0, 1]), open_to, 1)
    assert open_to[chosen, 0] == pytest.approx(0.4)


def test_the_list_alone_says_which_grasps_there_are(tmp_path):
    """Other columns, the order of columns and a repeated row change nothing."""
    (tmp_path / "own.csv").write_text(
        "note,z_mm,y_mm,force_n,object\na,60,1,5,cup\nb,60,0,4,sugar_box\nc,60,0,4,sugar_box\n"
    )
    plan = plan_recipe(recipe_of(tmp_path, file="own.csv"))
    found = [(g.config.object, g.config.force_n, g.config.y_mm, g.config.yaw_rad) for g in plan]
    assert found == [("sugar_box", 4.0, 0.0, 0.0), ("cup", 5.0, 1.0, 0.0)]


@pytest.mark.parametrize(
    "text",
    [
        "object,force_n,y_mm\ncup,3,1\n",
        "force_n,y_mm,z_mm\n3,1,50\n",
        "object,force_n,y_mm,z_mm\ncup,x,1,50\n",
        "object,force_n,y_mm,z_mm\nball,3,1,50\n",
        "object,force_n,y_mm,z_mm\ncup,3,1,50\n",
        "object,force_n,y_mm,z_mm\nsugar_box,3,1,50\ncup,3,1,50\ncup,99,1,50\n",
        "",
    ],
)
def test_a_list_that_cannot_be_used_is_refused(tmp_path, text):
    (tmp_path / "own.csv").write_text(text)
    with refused(RecipeError):
        plan_recipe(recipe_of(tmp_path, file="own.csv"))


def test_a_list_stands_in_the_section_of_all_objects(tmp_path):
    path = tmp_path / "r.yaml"
    objects = [{"name": "cup", "grid": {"file": "own.csv"}}]
    path.write_text(yaml.safe_dump({"name": "r", "objects": objects}))
    with refused(RecipeError):
        load_recipe(path)


@pytest.mark.slow
def test_a_dataset_grows_by_a_list(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    grid = "{force_n: [3, 5, 8, 12, 25], y_mm: [0, 6, 12], z_mm: [60, 90], sample: 8%s}"
    sections = {"dataset": "{shard_size: 4, scene_pictures: false}"}
    recipe = write_world(tmp_path, **sections, grid=grid % "")
    collect(load_recipe(recipe), "out", progress=False)
    before = (tmp_path / "out/shards/shard-00000.h5").read_bytes()
    next_grasps(load_recipe(recipe), "out", 4).to_csv("next.csv", index=False)
    recipe = write_world(tmp_path, **sections, grid=grid % ", file: next.csv")
    assert collect(load_recipe(recipe), "out", grow=True, progress=False).made == [2]
    assert (tmp_path / "out/shards/shard-00000.h5").read_bytes() == before
    assert not verify("out").problems
    assert DatasetFolder("out").plan()["parts"] == [8, 4]
    assert list(Dataset("out").columns()["split"][8:]) == ["train"] * 4
    assert "8 grasps at first, then 4 more; grasps of a list" in summary_text(summarize("out"))
    # Collected at once, the list gives the same pictures.
    collect(load_recipe(recipe), "again", progress=False)
    one, other = Dataset("out"), Dataset("again")
    key = ["force_n", "y_mm", "z_mm"]
    rows = {tuple(one[k][name] for name in key): k for k in range(12)}
    for k in range(12):
        same = one[rows[tuple(other[k][name] for name in key)]]
        assert np.array_equal(same["rgb"], other[k]["rgb"])

"""Studies: rows become recipes, run once, and the table says what it is."""

import itertools
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tacgen.collection.perturbed import recipe_object
from tacgen.collection.recipe import Grid, load_recipe
from tacgen.contact import ContactLaw, save_law
from tacgen.core.errors import LearningError, RecipeError, TacgenError
from tacgen.core.records import GraspConfig
from tacgen.core.resources import packaged
from tacgen.dataset.export import export_dataset
from tacgen.learning.scores import evaluation_lines, wilson_interval
from tacgen.objects import load_object
from tacgen.physics import FrameRequest, GraspSimulator, run_grasp
from tacgen.physics.rest import topples_deg
from tacgen.study.real_data import RealData
from tacgen.study.run import check_finished, run_study
from tacgen.study.study_recipe import load_study, reductions, run_folder_name, with_rows
from tests.learning.conftest import collect, make_spec, write_real
from tests.messages import refused
from tests.small_world import SHORT_LIFT
from tests.study.conftest import small_study

SHIPPED = [
    *sorted(packaged("recipes").glob("paper*.yaml")),
    packaged("recipes/what_touch_adds.yaml"),
]


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_every_shipped_study_loads_and_its_objects_stand(path):
    study = load_study(path.stem)
    assert study.name == path.stem
    entries = {str(e): e for row in study.rows for e in study.data_recipe(row, quick=False).objects}
    for entry in entries.values():
        assert topples_deg(recipe_object(entry)) == 0.0, entry


def test_the_paper_table_is_twelve_objects_by_four_ways_with_the_papers_figures():
    study = load_study("paper_table")
    recipes = [study.data_recipe(row, quick=False) for row in study.rows]
    assert [len(recipe.objects) for recipe in recipes] == [12] * 4
    assert [recipe.contact.law for recipe in recipes] == [
        "linear_depth",
        *["volume_linear"] * 3,
    ]
    trained = [study.train_recipe(row, quick=False) for row in study.rows]
    assert [one.model.kind for one in trained] == ["single", "single", "sequence", "sequence"]
    assert [one.input.until for one in trained[2:]] == ["lift", "outcome"]
    assert [row.published.sim for row in study.rows[1:]] == [0.968, None, 1.0]
    assert [row.published.real for row in study.rows[1:]] == [0.864, None, 0.907]


@pytest.mark.exhaustive
@pytest.mark.slow
def test_of_every_object_in_the_table_the_weakest_grasps_slip_and_some_strong_one_holds():
    """A grid whose grasps nearly all hold teaches nothing, and its row would be refused."""
    study = load_study("paper_table")
    recipe = study.data_recipe(study.rows[1], quick=False)
    with GraspSimulator(recipe.robot.name) as simulator:
        for entry in recipe.objects:
            places = list(itertools.product(entry.grid.y_mm, entry.grid.z_mm))[::5]
            weakest, strongest = min(entry.grid.force_n), max(entry.grid.force_n)
            held = list(_held(simulator, recipe, entry.name, weakest, places))
            assert sum(held) <= len(places) - 3, (entry.name, held)
            assert any(_held(simulator, recipe, entry.name, strongest, places)), entry.name


def _held(simulator, recipe, name, force_n, places) -> Iterator[bool]:
    grasped, settings = load_object(name), replace(recipe.physics_settings, **SHORT_LIFT)
    for y_mm, z_mm in places:
        config = GraspConfig(0, name, force_n, 0.0, y_mm, z_mm, 0.0)
        trace = run_grasp(simulator, grasped, config, settings, frames=FrameRequest())
        yield trace.label == 1


@pytest.mark.parametrize(
    ("name", "world"),
    [("paper_transfer", "perturbed/other"), ("paper_ablation", "perturbed/ablation")],
)
def test_the_second_world_grasps_the_same_objects_over_the_same_ranges_elsewhere(name, world):
    study, other = load_study(name), load_recipe(world)
    grids: dict[str, Grid] = {}
    for row in study.rows:
        recipe = study.data_recipe(row, quick=False)
        grids |= {entry.name: entry.grid or recipe.grid for entry in recipe.objects}
    assert {entry.name for entry in other.objects} == set(grids)
    for entry in other.objects:
        shared = 1
        for axis in ("force_n", "y_mm", "z_mm"):
            ours, theirs = getattr(grids[entry.name], axis), getattr(entry.grid, axis)
            assert (min(ours), max(ours)) == (min(theirs), max(theirs)), (entry.name, axis)
            shared *= len(set(ours) & set(theirs))
        assert shared <= 4  # the corners
    assert other.randomize.position_mm > 0


def test_a_row_is_trained_with_three_seeds_unless_the_study_says_otherwise(tmp_path):
    study = load_study("paper_table")
    recipe = study.train_recipe(study.rows[0], quick=True)
    assert [one.seed for one in study.seeded(recipe, quick=False)] == [0, 1, 2]
    assert len(load_study(small_study(tmp_path)).seeded(recipe, quick=True)) == 1


def test_every_mistake_of_a_study_is_told(tmp_path):
    path = tmp_path / "s.yaml"
    path.write_text(
        "name: s\nobjects: [tomato_soup_can]\ndata: {objects: [cup]}\nrows:\n"
        "  - {name: one, train: {training: {epochs: 0}}}\n  - {name: one}\n"
    )
    with refused(RecipeError):
        load_study(path)


def test_a_misspelt_key_of_a_row_s_recipes_is_told_with_those_there_are(tmp_path):
    path = tmp_path / "s.yaml"
    path.write_text(
        "name: s\nobjects: [cup]\ndata: {grid: {smple: 16}}\n"
        "train: {inptu: {}}\nrows: [{name: one}]\n"
    )
    with refused(RecipeError):
        load_study(path)


def test_a_row_with_a_gripper_that_is_not_there_is_told_before_anything_is_collected(tmp_path):
    path = small_study(tmp_path, ", data: {robot: {name: nosuch}}")
    with refused(RecipeError):
        load_study(path)


def test_rows_whose_runs_would_share_a_folder_are_told(tmp_path):
    path = tmp_path / "s.yaml"
    path.write_text("name: s\nobjects: [cup]\nrows:\n- name: one, two\n- name: One (two)\n")
    with refused(RecipeError):
        load_study(path)


def test_signs_stay_in_the_names_of_folders():
    assert run_folder_name("centre of mass at −30 mm") == "centre_of_mass_at_minus_30_mm"
    assert run_folder_name("centre of mass at +30 mm") == "centre_of_mass_at_plus_30_mm"
    assert run_folder_name("TACTO's law, single image") == "tacto_s_law_single_image"


def test_rows_are_chosen_by_name():
    study = load_study("paper_table")
    assert [row.name for row in with_rows(study, ["sequence"]).rows] == ["sequence"]
    assert with_rows(study, []) == study
    with refused(RecipeError):
        with_rows(study, ["sequences"])


@pytest.fixture
def toy(tmp_path) -> Path:
    return collect(tmp_path / "toy", make_spec())


@pytest.mark.slow
def test_a_study_collects_once_trains_each_row_and_says_what_it_is(
    tmp_path, toy_collect, small_backbone
):
    path, real = small_study(tmp_path), write_real(tmp_path / "real")
    path.write_text(path.read_text().replace("seeds: 1", "seeds: 2"))
    result = run_study(load_study(path), tmp_path / "out", RealData(test=real), quick=True)
    assert len(toy_collect) == 1
    for row in result["rows"]:
        sim, seeds = row["sim"], row["sim"]["seeds"]
        assert len(seeds) == len(row["real"]["seeds"]) == row["seeds"] == 2
        assert sim["accuracy"] == pytest.approx(np.mean(seeds))
        low, high = wilson_interval(sim["accuracy"] * sim["n"], sim["n"])
        assert sim["accuracy_interval"][0] <= low
        assert sim["accuracy_interval"][1] >= high
    assert [row["sim"]["source"] for row in result["rows"]] == ["sim", "sim"]
    assert all("sim_to_real_gap" in row["real"] for row in result["rows"])
    assert all(isinstance(row["training_grasps"], dict) for row in result["rows"])
    text = (tmp_path / "out" / "table.md").read_text()
    assert "REDUCED VERSION" in text
    assert "NONE, trained from scratch" in text
    assert "| 0.900 |" in text
    assert "| single image | single | grasp | " in text
    assert "means over 2 seeds; their intervals hold for other test grasps and seeds" in text
    assert "sim-to-real" in text
    assert "NOT real" not in text
    assert json.loads((tmp_path / "out" / "table.json").read_text())["quick"] is True
    assert "Accuracy" in (tmp_path / "out" / "index.html").read_text()


@pytest.mark.slow
def test_a_row_that_cannot_be_trained_keeps_its_reason_and_the_others_go_on(
    tmp_path, toy_collect, small_backbone
):
    study = load_study(small_study(tmp_path, ", train: {training: {grasps: 500}}"))
    result = run_study(study, tmp_path / "out", RealData())
    assert "training.grasps asks for 500" in result["rows"][0]["problem"]
    assert result["rows"][1]["sim"]["n"] > 0
    text = (tmp_path / "out" / "table.md").read_text()
    assert "| single image | single | – | – | – | – |" in text
    assert "single image: NOT trained. " in text


def test_a_study_of_which_nothing_can_be_trained_says_so_in_its_table(tmp_path, toy_collect):
    path = small_study(tmp_path)
    path.write_text(path.read_text().replace("weights: none", "weights: missing.pth"))
    result = run_study(load_study(path), tmp_path / "out", RealData())
    assert "one model for all: NOT trained. " in (tmp_path / "out" / "table.md").read_text()
    with refused(LearningError):
        check_finished(result)


@pytest.mark.slow
def test_another_simulation_is_not_called_reality(tmp_path, toy, toy_collect, small_backbone):
    """The folder says that it is simulated: no table and no line may call it real."""
    study = load_study(small_study(tmp_path))
    export_dataset(toy, tmp_path / "world", "real-grasps", split="test")
    result = run_study(study, tmp_path / "out", RealData(test=tmp_path / "world"))
    assert result["real_is_simulated"] is True
    for name in ("table.md", "index.html"):
        text = (tmp_path / "out" / name).read_text()
        assert "sim-to-real" not in text
        assert "other simulation" in text
        assert "NOT real" in text
    lines = "\n".join(evaluation_lines(result["rows"][0]["real"]))
    assert "another simulation, NOT real: accuracy" in lines
    assert "gap to the other simulation" in lines
    assert "sim-to-real" not in lines


def test_friction_is_calibrated_on_other_grasps_than_those_tested_on(tmp_path, toy_collect):
    study = load_study(small_study(tmp_path, ", calibrate_friction: true"))
    real = write_real(tmp_path / "real")
    with refused(TacgenError):
        run_study(study, tmp_path / "out", RealData(test=real))
    with refused(TacgenError):
        run_study(study, tmp_path / "out", RealData(test=real, calibration=real))
    with refused(TacgenError):
        run_study(study, tmp_path / "out", RealData(calibration=tmp_path / "nosuch"))
    assert not toy_collect


@pytest.mark.slow
def test_friction_is_fitted_to_the_objects_of_the_study_alone(
    tmp_path, toy_collect, monkeypatch, no_networks
):
    study = load_study(small_study(tmp_path, ", calibrate_friction: true"))
    asked: list[list[str]] = []

    def fake(recipe, grasps, *_, **__):
        asked.append(sorted(grasps.by_object()))
        return {}, {}

    monkeypatch.setattr("tacgen.study.run.sweep_friction", fake)
    real = write_real(tmp_path / "labels")
    table = pd.read_csv(real / "grasps.csv")
    table.loc[0, "object"] = "a_thing_of_no_study"
    table.to_csv(real / "grasps.csv", index=False)
    run_study(study, tmp_path / "out", RealData(calibration=real))
    assert asked == [["can", "cup"]]
    table[table.object == "can"].to_csv(real / "grasps.csv", index=False)
    toy_collect.clear()
    with refused(TacgenError):
        run_study(study, tmp_path / "new", RealData(calibration=real))
    assert not toy_collect


@pytest.mark.slow
def test_a_calibrated_contact_law_must_be_given(tmp_path, toy_collect, no_networks):
    study = load_study(small_study(tmp_path, ", calibrate_contact: true"))
    with refused(TacgenError):
        run_study(study, tmp_path / "out", RealData())
    given = RealData(contact=tmp_path / "contact.yaml")
    with refused(TacgenError):
        run_study(study, tmp_path / "out", given)
    assert not toy_collect
    save_law(ContactLaw.linear(5.0, 1.0), given.contact)
    result = run_study(study, tmp_path / "out", given)
    assert [row["contact_file"] for row in result["rows"]] == [str(given.contact), None]
    assert f"contact law from {given.contact}" in (tmp_path / "out" / "table.md").read_text()


def test_a_row_may_be_tested_on_other_grasps_than_it_is_trained_on(
    tmp_path, monkeypatch, no_networks
):
    path = small_study(tmp_path, ", test: {objects: [mug], data: {grid: {sample: 7}}}")
    study, seen = load_study(path), []
    row, other = study.rows
    recipe = study.test_recipe(row, quick=False)
    assert ([one.name for one in recipe.objects], recipe.grid.sample) == (["mug"], 7)
    assert study.test_recipe(other, quick=False) == study.data_recipe(other, quick=False)

    def evaluate(run, data):
        seen.append(data)
        scores = {"accuracy": 0.9, "accuracy_interval": [0.8, 0.95], "n": 12}
        baseline = {"accuracy": 0.8, "auroc": 0.85, "ece": 0.1, "n": 12}
        gain = {"gain": 0.1, "gain_interval": [-0.1, 0.3]}
        full = {**scores, "auroc": 0.95, "ece": 0.05, "without_touch": baseline | gain}
        notes = ["x: NEW to the network: the object mug"]
        data = str(data)
        return {
            **full,
            "data": data,
            "notes": notes,
            "real_is_simulated": False,
            "by_object": {"mug": scores},
        }

    monkeypatch.setattr("tacgen.study.run.evaluate", evaluate)
    result = run_study(study, tmp_path / "out", RealData())
    trained_on = tmp_path / "out/data" / study.data_recipe(row, quick=False).sha256()[:12]
    assert seen == [tmp_path / "out/data" / recipe.sha256()[:12], trained_on]
    assert len({one["settings_sha256"] for one in result["rows"]}) == 2
    text = (tmp_path / "out/table.md").read_text()
    figures = "0.900 / 0.950 / 0.050 | 0.800 / 0.850 / 0.100 | +0.100 [-0.100, +0.300] | 0.50"
    assert f"| single image | {figures} |" in text
    assert "* single image: x: NEW to the network: the object mug" in text
    assert "| variant | tested on | can | cup | mug |" in text


def test_rows_that_differ_in_what_they_are_tested_on_share_their_networks(tmp_path, no_networks):
    path = small_study(tmp_path)
    test = "{objects: [mug]}"
    path.write_text(
        path.read_text().replace(
            "rows:\n", f"rows:\n  - {{name: first}}\n  - {{name: elsewhere, test: {test}}}\n"
        )
    )
    run_study(load_study(path), tmp_path / "out", RealData(), rows=["first", "elsewhere"])
    assert no_networks == ["first", "first"]
    assert "* elsewhere: the networks of first." in (tmp_path / "out/table.md").read_text()


def test_a_study_finds_the_grasps_that_collect_made_of_the_same_recipe(tmp_path):
    path = small_study(tmp_path)
    path.write_text(path.read_text().replace("[can, cup]", "[cup]"))
    study = load_study(path)
    recipe = study.data_recipe(study.rows[0], quick=False)
    (tmp_path / "r.yaml").write_text("name: s\nobjects: [cup]\n")
    assert load_recipe(tmp_path / "r.yaml").sha256() == recipe.sha256()
    assert recipe.resolved()["robot"]["max_force_n"] == 40.0  # the gripper's own


def test_a_reduced_study_may_have_fewer_seeds(tmp_path):
    path = small_study(tmp_path, quick="{seeds: 1}")
    path.write_text(path.read_text().replace("seeds: 1\ntrain", "seeds: 4\ntrain"))
    study = load_study(path)
    assert [study.n_seeds(quick=quick) for quick in (False, True)] == [4, 1]
    assert "seeds: 1 instead of 4" in reductions(study, study.rows)


def test_what_touch_adds_is_asked_of_four_worlds_with_all_else_the_same():
    study = load_study("what_touch_adds")
    rows, lift, elsewhere = study.rows[:16], study.rows[16], study.rows[17:]
    recipes = [study.data_recipe(row, quick=False) for row in rows]
    spreads = [recipe.randomize.model_dump(exclude_defaults=True) for recipe in recipes[::4]]
    pose = {"position_mm": (8.0, 8.0, 0.0), "yaw_rad": 0.262}
    assert spreads == [{}, {}, pose, {"friction_relative": 0.4, "center_of_mass_mm": 10.0}]
    assert len({recipe.sha256() for recipe in recipes}) == 3
    for row in rows:
        tested, trained = study.test_recipe(row, quick=False), study.data_recipe(row, quick=False)
        new = {one.name for one in tested.objects} - {one.name for one in trained.objects}
        assert len(new) == (6 if row.name.startswith("object unknown") else 0)
    trained = [study.train_recipe(row, quick=False).input.channels for row in rows]
    assert trained[3::4] == [
        ("image", "commanded", "object"),
        ("image", "commanded"),
        *[("image", "commanded", "object")] * 2,
    ]
    lifted, shown = study.test_recipe(lift, quick=False), study.data_recipe(lift, quick=False)
    assert study.train_recipe(lift, quick=False) == study.train_recipe(rows[14], quick=False)
    assert shown == recipes[14]
    assert not {one.name for one in lifted.objects} & {one.name for one in shown.objects}
    assert len(lifted.objects) == 6
    assert not lifted.randomize.friction_relative
    # Networks of the unknown pose, tested in other worlds with the same objects.
    for row, kind in zip(elsewhere, itertools.cycle((rows[9], rows[11])), strict=False):
        there = study.test_recipe(row, quick=False)
        assert study.train_recipe(row, quick=False) == study.train_recipe(kind, quick=False)
        assert study.data_recipe(row, quick=False) == recipes[8]
        assert [one.name for one in there.objects] == [one.name for one in recipes[8].objects]
        assert there.randomize.position_mm == (8.0, 8.0, 0.0)
    assert len({study.test_recipe(row, quick=False).sha256() for row in elsewhere}) == 4

"""The plan: every grasp once, the same for the same seed, train and test apart."""

from types import SimpleNamespace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tacgen.collection.grid import plan_recipe
from tacgen.collection.recipe import ObjectEntry, Recipe
from tacgen.core.errors import RecipeError
from tests.messages import refused

RANGES = {
    "can": {"force_n": (5.0, 10.0, 20.0), "x_mm": (0.0,), "y_mm": (-5.0, 5.0), "z_mm": (40.0,)},
    "box": {"force_n": (2.0,), "x_mm": (0.0,), "y_mm": (0.0,), "z_mm": (10.0, 20.0, 30.0)},
}


@pytest.fixture(scope="module", autouse=True)
def _objects():
    """Two objects of which nothing but their grasp ranges is known."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ObjectEntry, "object_folder", lambda entry: entry.name)
        patch.setattr(
            "tacgen.collection.grid.read_description",
            lambda name: SimpleNamespace(grasp_ranges=SimpleNamespace(**RANGES[name])),
        )
        yield


def recipe(**sections):
    return Recipe.model_validate({"name": "r", "objects": ["can", "box"], **sections})


def plan(**sections):
    return plan_recipe(recipe(**sections))


def points(planned):
    return [(g.config.object, g.config.force_n, g.config.y_mm, g.config.z_mm) for g in planned]


def test_an_axis_left_out_comes_from_the_object():
    assert points(plan()) == [
        ("can", force, y, 40.0) for force in (5.0, 10.0, 20.0) for y in (-5.0, 5.0)
    ] + [("box", 2.0, 0.0, z) for z in (10.0, 20.0, 30.0)]


def test_one_object_is_grasped_under_several_names():
    heavy = {"name": "can", "dataset_name": "heavy_can", "added_mass_kg": 0.5}
    planned = plan(objects=["can", heavy], grid={"y_mm": 0.0})
    assert [(grasp.config.object, grasp.entry) for grasp in planned] == [
        *[("can", 0)] * 3,
        *[("heavy_can", 1)] * 3,
    ]
    assert len({grasp.seed for grasp in planned}) == 6


def test_the_recipes_own_axis_goes_before_the_objects_and_the_entrys_before_both():
    planned = plan(
        objects=["can", {"name": "box", "grid": {"force_n": 7}}], grid={"force_n": [1, 2]}
    )
    assert {g.config.force_n for g in planned if g.config.object == "can"} == {1.0, 2.0}
    assert {g.config.force_n for g in planned if g.config.object == "box"} == {7.0}


def test_an_objects_own_ranges_are_scaled_with_it():
    """Its mass stays, and so do its forces; pads that clear the table do so still."""
    planned = plan(objects=[{"name": "can", "scale": 0.5}, {"name": "box", "scale": 0.5}])
    assert points(planned)[:2] == [("can", 5.0, -2.5, 20.0), ("can", 5.0, 2.5, 20.0)]
    assert [g.config.z_mm for g in planned if g.config.object == "box"] == [10.0, 10.5, 15.0]
    asked = plan(objects=[{"name": "can", "scale": 2.0, "grid": {"z_mm": 30}}])
    assert {g.config.z_mm for g in asked} == {30.0}
    assert {g.config.y_mm for g in asked} == {-10.0, 10.0}


def test_a_force_that_presses_soft_pads_through_is_refused():
    with refused(RecipeError):
        plan(physics={"pad_stiffness_n_mm": 2.0})


def test_an_objects_own_force_beyond_the_gripper_is_refused():
    with refused(RecipeError):
        plan(robot={"max_force_n": 15})


def test_a_sample_beyond_the_grid_is_said(capsys):
    assert len(plan(grid={"sample": 91})) == 9
    assert "grid.sample = 91: the grid of 'can' has 6 grasps, all taken" in capsys.readouterr().err


def test_a_sample_is_drawn_without_repeats_and_by_the_seed():
    wide = {"force_n": {"linspace": [1, 10, 20]}, "z_mm": {"linspace": [1, 5, 20]}}
    draws = [plan(grid=wide | {"sample": 50}, seed=seed) for seed in (1, 1, 2)]
    assert points(draws[0]) == points(draws[1]) != points(draws[2])
    assert len(set(points(draws[0]))) == len(draws[0]) == 100


def test_adding_an_object_leaves_the_others_grasps_as_they_are():
    grid = {"force_n": {"linspace": [1, 10, 20]}, "sample": 7}
    both = plan(grid=grid)
    alone = plan(grid=grid, objects=["can"])
    assert alone == both[: len(alone)]


@settings(max_examples=50, deadline=None)
@given(
    fraction=st.floats(0, 0.9),
    seed=st.integers(0, 1000),
    forces=st.lists(st.integers(1, 30), min_size=1, max_size=12),
)
def test_no_configuration_is_on_both_sides_of_the_split(fraction, seed, forces):
    planned = plan(grid={"force_n": forces}, split={"test_fraction": fraction}, seed=seed)
    sides = {"train": set(), "test": set()}
    for grasp in planned:
        config = grasp.config
        sides[grasp.split].add((config.object, config.force_n, config.y_mm, config.z_mm))
    assert not sides["train"] & sides["test"]
    assert len(sides["train"]) + len(sides["test"]) == len(planned)
    for name in RANGES:
        own = [g for g in planned if g.config.object == name]
        assert sum(g.split == "test" for g in own) == round(fraction * len(own))

"""The world that environments act on: grasps as `collect` makes them, and regrasps."""

from dataclasses import replace

import numpy as np
import pytest

from tacgen.collection.grid import plan_recipe
from tacgen.collection.pipeline import GraspPipeline
from tacgen.collection.recipe import Recipe
from tacgen.core.errors import RecipeError
from tacgen.core.records import AXES
from tacgen.envs.grasp_world import GraspWorld, grasp_values
from tests.messages import refused

RANDOM = {
    "friction_relative": 0.2,
    "mass_relative": 0.1,
    "center_of_mass_mm": 5.0,
    "k_n_relative": 0.1,
    "sensor_gain_relative": 0.05,
    "position_mm": 1.0,
    "yaw_rad": 0.02,
}


def small_recipe(**sections) -> Recipe:
    given = {
        "name": "envs",
        "objects": ["rubiks_cube", "tomato_soup_can"],
        "grid": {"force_n": [1.0, 4.0, 12.0], "y_mm": [-8.0, 0.0, 8.0], "z_mm": [20.0, 40.0]},
        "sensor": "digit",
        "dataset": {"scene_pictures": False, "markers": True, "force_field": [3, 4]},
        "randomize": RANDOM,
    }
    return Recipe.model_validate(given | sections)


@pytest.fixture(params=["pybullet", "mujoco"])
def engine(request) -> str:
    pytest.importorskip(request.param)
    return request.param


@pytest.mark.parametrize("frames", [{}, {"mode": "sequence", "count": 3, "until": "lift"}])
def test_the_first_grasp_is_that_of_collect(engine, frames):
    recipe = small_recipe(physics={"engine": engine}, frames=frames)
    world = GraspWorld(recipe)
    with GraspPipeline(recipe) as pipeline:
        for planned in plan_recipe(recipe)[3:30:13]:
            expected = pipeline.sample(planned)
            world.place(planned)
            touch = world.grasp(grasp_values(planned))
            trace = world.lift()
            assert (trace.label, trace.failure_mode) == (expected.label, expected.failure_mode)
            assert trace.rise_mm == expected.rise_mm
            assert touch.trace.label == -1  # the outcome does not show before the lift
            np.testing.assert_array_equal(touch.pads["left"].rgb, expected.pads["left"].rgb)
            for name in ("markers_mm", "force_field_n", "force_normal_n"):
                shown, kept = (getattr(p["left"], name) for p in (touch.pads, expected.pads))
                np.testing.assert_array_equal(shown, kept)
    world.close()


def test_frames_of_the_lift_are_there_after_it_alone():
    recipe = small_recipe(frames={"mode": "sequence", "count": 4, "span_s": 3.0})
    planned = plan_recipe(recipe)[4]
    world = GraspWorld(recipe)
    world.place(planned)
    whole = world.grasp_and_lift(grasp_values(planned)).pads["left"].rgb
    world.place(planned)
    before = world.grasp(grasp_values(planned)).pads["left"].rgb
    with GraspPipeline(recipe) as pipeline:
        kept = pipeline.sample(planned).pads["left"].rgb
    world.close()
    np.testing.assert_array_equal(whole, kept)
    assert before.shape == whole.shape
    assert not np.array_equal(before[-1], whole[-1])


def test_an_object_keeps_its_draw_over_regrasps_and_the_gripper_does_not():
    world = GraspWorld(small_recipe())
    world.place(world.draw(np.random.default_rng(5), "rubiks_cube"))
    values = np.array([4.0, 0.0, 0.0, 28.0, 0.0])
    first, again = (world.grasp(values).grasp for _ in range(2))
    assert first.grasped.mass_kg == again.grasped.mass_kg != 0.094
    assert first.variation.perturbation == again.variation.perturbation
    assert first.variation.gain_factor == again.variation.gain_factor
    assert first.variation.position_mm != again.variation.position_mm
    assert first.config.yaw_rad != again.config.yaw_rad
    world.close()


def test_a_regrasp_is_the_grasp_that_it_would_be_by_itself():
    world = GraspWorld(small_recipe(randomize={"friction_relative": 0.3}))
    planned = world.draw(np.random.default_rng(1), "tomato_soup_can")
    values = np.array([12.0, 0.0, 8.0, 40.0, 0.0])
    outcomes = []
    for before in ([], [np.array([1.0, 0.0, -8.0, 20.0, 0.0])]):
        world.place(planned)
        for one in before:
            world.grasp(one)
        world.grasp(values)
        outcomes.append(world.lift())
    world.close()
    assert outcomes[0].rise_mm == outcomes[1].rise_mm
    assert outcomes[0].turn_rad == outcomes[1].turn_rad


def test_draws_come_from_the_generator_alone():
    world = GraspWorld(small_recipe())
    drawn = [world.draw(np.random.default_rng(seed)) for seed in (3, 3, *range(20))]
    assert drawn[0] == drawn[1]
    assert {one.config.object for one in drawn} == {"rubiks_cube", "tomato_soup_can"}
    assert len({one.seed for one in drawn}) == 20
    plan = {replace(one, seed=0) for one in world.plan}
    assert all(replace(one, seed=0) in plan for one in drawn)
    assert world.low.tolist() == [1.0, 0.0, -8.0, 20.0, 0.0]
    assert world.high.tolist() == [12.0, 0.0, 8.0, 40.0, 0.0]
    assert len(AXES) == 5


def test_a_grasp_that_cannot_be_carried_out_shows_gels_at_rest():
    world = GraspWorld(small_recipe(optics={"noise": False}, randomize={}))
    world.place(world.plan[0])
    rest = world.untouched().pads["left"].rgb
    touch = world.grasp(np.array([4.0, 0.0, 0.0, 5.0, 0.0]))  # the pads would be in the table
    assert touch.trace.status == "unreachable"
    np.testing.assert_array_equal(touch.pads["left"].rgb, rest)
    assert not touch.pads["left"].force_field_n.any()
    assert world.lift().label == -1
    world.close()


def test_images_are_drawn_on_the_recipes_device(monkeypatch):
    """As those of `collect`, which differ by up to a grey level from those drawn without it."""
    pytest.importorskip("warp")
    from tacgen.batch import pad_images

    class Grey:
        def __init__(self, pad, n, device):
            assert device == "cuda"
            self.shape = *pad.sensor.shape_px, 3

        def images(self, imprints, rng=None):
            return np.full((len(imprints), *self.shape), 77, np.uint8)

    monkeypatch.setattr(pad_images, "PadImages", Grey)
    world = GraspWorld(small_recipe(optics={"device": "cuda"}, randomize={}))
    world.place(world.plan[10])
    touch = world.grasp_and_lift(grasp_values(world.plan[10]))
    world.close()
    assert touch.trace.status == "executed"
    assert (touch.pads["left"].rgb == 77).all()


def test_what_is_no_recipe_or_object_is_refused():
    with refused(RecipeError):
        GraspWorld({"name": "x"})
    world = GraspWorld(small_recipe())
    with refused(RecipeError):
        world.draw(np.random.default_rng(0), "rubik_cube")

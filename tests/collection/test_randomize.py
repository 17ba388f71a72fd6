"""Domain randomisation: by the grasp's seed, and none where none is asked for."""

import numpy as np
import pytest

from tacgen.collection.grid import plan_recipe
from tacgen.collection.perturbed import Variation, draw_variation
from tacgen.collection.pipeline import GraspPipeline
from tacgen.collection.recipe import Randomize, load_recipe
from tacgen.core.errors import RecipeError
from tacgen.core.records import AXES, rng_of
from tests.messages import refused


def draws(count=4000, **spread):
    rng = np.random.default_rng(3)
    return [draw_variation(Randomize(**spread), rng) for _ in range(count)]


def test_nothing_varies_unless_asked_for():
    assert draw_variation(Randomize(), np.random.default_rng(0)) == Variation()


def test_the_spread_is_the_one_asked_for():
    # 4000 draws estimate a standard deviation to 1.1 %; clipping at 3 sigma takes 1.3 % off.
    varied = draws(friction_relative=0.2, center_of_mass_mm=5.0)
    assert np.std(np.log([v.perturbation.friction_factor for v in varied])) == pytest.approx(
        0.2, rel=0.05
    )
    assert np.std([v.perturbation.center_of_mass_mm for v in varied]) == pytest.approx(
        5.0, rel=0.05
    )
    assert max(abs(np.log(v.perturbation.friction_factor)) for v in varied) <= 0.6 + 1e-9


def test_switching_one_figure_on_leaves_the_draws_of_the_others():
    alone = draws(5, friction_relative=0.2)
    both = draws(5, friction_relative=0.2, mass_relative=0.1)
    assert [v.perturbation.friction_factor for v in alone] == [
        v.perturbation.friction_factor for v in both
    ]


def test_the_place_may_vary_along_each_axis_by_its_own():
    """The draws of the axes stay those of one figure for all."""
    every = np.array([one.position_mm for one in draws(50, position_mm=4.0)])
    own = np.array([one.position_mm for one in draws(50, position_mm=(4.0, 8.0, 0.0))])
    np.testing.assert_allclose(own, every * (1.0, 2.0, 0.0))


def test_two_figures_for_three_axes_are_refused(tmp_path):
    path = tmp_path / "r.yaml"
    path.write_text("name: r\nobjects: [cup]\nrandomize: {position_mm: [1, 2]}\n")
    with refused(RecipeError):
        load_recipe(path)


def test_what_was_commanded_is_kept_not_where_the_gripper_came_to():
    recipe = load_recipe("quickstart")
    spread = Randomize(position_mm=(8.0, 8.0, 0.0), yaw_rad=0.2)
    recipe = recipe.model_copy(update={"randomize": spread})
    planned = plan_recipe(recipe)[0]
    with GraspPipeline(recipe) as pipeline:
        went = pipeline.at_rest(planned).config
        sample = pipeline.sample(planned)
    assert sample.config == planned.config
    moved = [getattr(went, axis) - getattr(planned.config, axis) for axis in AXES]
    variation = draw_variation(spread, rng_of(planned.seed, 0))
    assert moved == pytest.approx([0.0, *variation.position_mm, variation.yaw_rad])

"""One grasp as an animation."""

import pytest
from PIL import Image

from tacgen.collection.grasp_gif import write_gif
from tacgen.collection.recipe import load_recipe
from tacgen.core.errors import RecipeError
from tacgen.sensor.tactile_pad import TactilePad
from tests.messages import refused

from ..small_world import write_world


@pytest.mark.slow
def test_a_grasp_becomes_an_animation(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    recipe = load_recipe(write_world(tmp_path, frames="{mode: sequence, count: 3}"))
    outcome = write_gif(recipe, 1, tmp_path / "grasp.gif")
    assert outcome in ("success", "translational_slip", "rotational_slip")
    with Image.open(tmp_path / "grasp.gif") as gif:
        assert gif.height == 48
        assert gif.n_frames == 3


@pytest.mark.slow
def test_a_grasp_that_shows_nothing_says_so_and_what_to_change(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(TactilePad, "visible_share", lambda *_: 0.0)
    outcome = write_gif(load_recipe(write_world(tmp_path)), 1, tmp_path / "grasp.gif")
    assert "pad: nothing to see" in outcome
    for fix in ("grid.force_n", "grid.x_mm", "a sensor with"):
        assert fix in outcome


def test_a_grasp_that_is_not_in_the_recipe(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    recipe = load_recipe(write_world(tmp_path))
    with refused(RecipeError):
        write_gif(recipe, 6, tmp_path / "grasp.gif")

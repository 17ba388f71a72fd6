"""Recipes, sensors, grippers and laws by name: a recipe that has the name of what it uses."""

from pathlib import Path

import pytest

from tacgen.core.errors import RecipeError
from tacgen.core.resources import (
    contact_law_path,
    find_recipe,
    gripper_path,
    packaged,
    sensor_path,
)
from tests.messages import refused

SENSORS, GRIPPERS = packaged("recipes") / "sensors", packaged("recipes") / "grippers"
RECIPES = ["name: own\nobjects: [golf_ball]\n", '{"sensor": digit}\n', "\ufeffextends: rig\n"]


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("text", RECIPES)
@pytest.mark.parametrize("beside", [None, Path("lab")])
def test_a_recipe_named_like_its_sensor_or_gripper_uses_the_shipped_one(text, beside):
    Path("lab").mkdir()
    for folder in (Path(), Path("lab")):
        for name in ("digit", "wsg50"):
            (folder / f"{name}.yaml").write_text(text, encoding="utf-8")
    assert sensor_path("digit", beside=beside) == SENSORS / "digit.yaml"
    assert sensor_path("digit.yaml", beside=beside) == SENSORS / "digit.yaml"
    assert gripper_path("wsg50", beside=beside) == GRIPPERS / "wsg50.yaml"


def test_an_own_sensor_of_that_name_comes_first():
    own = Path("digit.yaml")
    own.write_text((SENSORS / "digit.yaml").read_text(encoding="utf-8"), encoding="utf-8")
    assert sensor_path("digit") == own


def test_where_there_is_no_other_it_says_that_a_recipe_was_found():
    Path("mine.yaml").write_text("objects: [golf_ball]\n", encoding="utf-8")
    with refused(RecipeError):
        sensor_path("mine")
    with refused(RecipeError):
        contact_law_path("mine.yaml")
    with refused(RecipeError):
        find_recipe("mine", extended_by=Path("mine.yaml"))

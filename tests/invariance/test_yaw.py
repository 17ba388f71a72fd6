"""A whole turn of the gripper is no other grasp."""

import numpy as np
import pytest

from tacgen.collection.grid import plan_recipe
from tacgen.collection.recipe import Recipe


def yaws(axis, **entry):
    grid = {"force_n": 5.0, "x_mm": 0.0, "y_mm": 0.0, "z_mm": 87.0}
    where = {"grid": grid | {"yaw_rad": axis}}
    objects = [{"name": "sugar_box", **(where if entry else {})}]
    recipe = {"name": "turns", "objects": objects, "grid": grid} | ({} if entry else where)
    return [one.config.yaw_rad for one in plan_recipe(Recipe.model_validate(recipe))]


@pytest.mark.parametrize("pi", [np.pi, 3.14159, 3.1416, 3.14])
@pytest.mark.parametrize("entry", [{}, {"own": True}])
def test_the_last_angle_of_a_whole_turn_is_the_first(pi, entry):
    found = yaws({"linspace": [-pi, pi, 5]}, **entry)
    np.testing.assert_allclose(found, np.linspace(-pi, pi, 5)[:-1], atol=1e-12)


def test_a_list_is_treated_alike():
    assert yaws([0.0, 1.0, 6.28319, 7.28318]) == [0.0, 1.0]


@pytest.mark.parametrize("axis", [[-1.57, 0.0, 1.57], [0.0, 0.001], [-3.1, 3.1], [0.0, 3.14159]])
def test_other_angles_stay(axis):
    assert yaws(axis) == axis

"""Domain randomisation: by the grasp's seed, and none where none is asked for."""

import numpy as np
import pytest

from tacgen.collection.perturbed import (
    Perturbation,
    Variation,
    draw_variation,
    perturbed_object,
    vary_config,
)
from tacgen.collection.recipe import Randomize
from tacgen.core.records import GraspConfig, GraspObject, Mesh, frozen_array

MESH = Mesh(frozen_array(np.eye(3)), frozen_array([[0, 1, 2]], np.int32))
BLOCK = GraspObject(
    name="block",
    surface=MESH,
    collision=(MESH,),
    mass_kg=0.2,
    center_of_mass_mm=frozen_array([0, 0, 30]),
    inertia_kg_mm2=frozen_array(np.eye(3)),
    friction=0.5,
    spinning_friction_mm=1.0,
    grasp_ranges={},
)


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


def test_the_objects_inertia_follows_its_mass_and_the_original_is_untouched():
    change = Perturbation(mass_factor=1.4, friction_factor=0.5, center_of_mass_x_mm=1)
    varied = perturbed_object(BLOCK, change)
    assert varied.mass_kg == pytest.approx(0.28)
    assert varied.friction == pytest.approx(0.25)
    assert varied.spinning_friction_mm == pytest.approx(0.5)
    np.testing.assert_allclose(varied.inertia_kg_mm2, 1.4 * np.eye(3))
    np.testing.assert_allclose(varied.center_of_mass_mm, [1, 0, 30])
    assert BLOCK.mass_kg == 0.2


def test_the_configuration_carried_out_is_off_by_the_draw():
    config = GraspConfig(3, "block", 5.0, 1.0, 2.0, 3.0)
    moved = vary_config(config, Variation(position_mm=(0.5, -0.5, 1.0), yaw_rad=0.1))
    assert moved == GraspConfig(3, "block", 5.0, 1.5, 1.5, 4.0, 0.1)

"""Perturbed simulations: perturbations that are equivalent, and what is kept on disk."""

from dataclasses import replace

import numpy as np
import pytest

from tacgen.collection.perturbed import (
    Outcome,
    Perturbation,
    perturbed_entry,
    perturbed_object,
    recipe_object,
    simulate_perturbed,
)
from tacgen.collection.recipe import ObjectEntry, Recipe
from tacgen.core.records import GraspConfig, GraspTrace, SlipMargin
from tacgen.core.types import STANDARD_GRAVITY_M_S2
from tests.small_world import SHORT_LIFT

BOX = "sugar_box"
RECIPE = Recipe.model_validate({"name": "perturbed", "objects": [BOX], "physics": SHORT_LIFT})
HEIGHT_MM = 87.5


def config(force_n, y_mm=0.0):
    return GraspConfig(0, BOX, force_n, 0.0, y_mm, HEIGHT_MM)


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    """One run for all tests: grasps on either side of the threshold, under a few perturbations."""
    box = recipe_object(ObjectEntry(name=BOX))
    threshold_n = box.mass_kg * STANDARD_GRAVITY_M_S2 / (2 * box.friction)
    perturbations = {
        "declared": Perturbation(),
        "heavy": Perturbation(mass_factor=1.4),
        "weak": Perturbation(force_scale=1 / 1.4),
        "slippery": Perturbation(friction_factor=1 / 1.4),
        "offset": Perturbation(force_offset_n=0.3 * threshold_n),
        "shifted": Perturbation(center_of_mass_y_mm=20.0),
    }
    places = {
        "below": config(0.85 * threshold_n),
        "above": config(1.2 * threshold_n),
        "aside": config(3.0 * threshold_n, 15.0),
    }
    out = tmp_path_factory.mktemp("perturbations")
    wanted = [(place, change) for place in places.values() for change in perturbations.values()]
    found = simulate_perturbed(RECIPE, wanted, out, workers=1)
    by_name = {
        (where, what): found[place.point, change]
        for where, place in places.items()
        for what, change in perturbations.items()
    }
    return out, wanted, by_name


WEIGHTED = ObjectEntry(
    name=BOX,
    scale=1.1,
    mass_kg=0.4,
    center_of_mass_offset_mm=(1.0, 2.0, 0.0),
    added_mass_kg=0.3,
    added_mass_at_mm=(20.0, -5.0, 40.0),
)


def about_the_origin(mass_kg, center_mm, inertia=0.0):
    """Moments of inertia about the origin of the frame, in which those of two bodies add."""
    return inertia + mass_kg * (center_mm @ center_mm * np.eye(3) - np.outer(center_mm, center_mm))


def test_a_fixed_weight_adds_its_mass_its_moment_and_its_inertia():
    alone = recipe_object(WEIGHTED.model_copy(update={"added_mass_kg": 0.0}))
    both = recipe_object(WEIGHTED)
    at_mm = np.array(WEIGHTED.added_mass_at_mm)
    assert both.mass_kg == pytest.approx(0.7)
    moment = 0.4 * alone.center_of_mass_mm + 0.3 * at_mm
    np.testing.assert_allclose(both.mass_kg * both.center_of_mass_mm, moment)
    np.testing.assert_allclose(
        about_the_origin(0.7, both.center_of_mass_mm, both.inertia_kg_mm2),
        about_the_origin(0.4, alone.center_of_mass_mm, alone.inertia_kg_mm2)
        + about_the_origin(0.3, at_mm),
    )


@pytest.mark.parametrize("entry", [WEIGHTED, ObjectEntry(name=BOX, added_mass_kg=0.2)])
def test_a_perturbed_entry_is_of_the_perturbed_object(entry):
    change = Perturbation(mass_factor=0.6, object_scale=0.9, center_of_mass_x_mm=4.0)
    expected = perturbed_object(recipe_object(entry), change)
    found = recipe_object(perturbed_entry(entry, change))
    assert found.mass_kg == pytest.approx(expected.mass_kg)
    np.testing.assert_allclose(found.center_of_mass_mm, expected.center_of_mass_mm, rtol=1e-3)
    np.testing.assert_allclose(found.inertia_kg_mm2, expected.inertia_kg_mm2, atol=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("added_kg", [0.1, 0.5])
def test_an_object_held_in_its_middle_needs_half_its_load_over_mu(tmp_path, added_kg):
    """2 μ F ≥ m (g + a), the added mass with it, from below and from above."""
    entry = ObjectEntry(name=BOX, dataset_name="heavy", added_mass_kg=added_kg)
    recipe = RECIPE.model_copy(update={"objects": (entry,)})
    box = recipe_object(ObjectEntry(name=BOX))
    lift_m_s2 = recipe.physics.lift_acceleration_mm_s2 / 1000
    load_n = (box.mass_kg + added_kg) * (STANDARD_GRAVITY_M_S2 + lift_m_s2)
    least_n = load_n / (2 * box.friction)
    places = [
        GraspConfig(0, "heavy", share * least_n, 0.0, 0.0, HEIGHT_MM) for share in (0.97, 1.03)
    ]
    found = simulate_perturbed(
        recipe, [(place, Perturbation()) for place in places], tmp_path, workers=1
    )
    assert [found[place.point, Perturbation()].label for place in places] == [0, 1]


@pytest.mark.slow
def test_mass_force_and_friction_are_one_ratio_for_a_block(simulated):
    *_, found = simulated
    assert found["above", "declared"].label == 1
    for change in ("heavy", "weak", "slippery"):
        assert found["above", change].label == 0
        ratio = found["above", change].friction_ratio
        assert ratio == pytest.approx(found["above", "declared"].friction_ratio / 1.4, rel=0.01)


@pytest.mark.slow
def test_a_centre_of_mass_moved_under_the_pads_takes_the_moment_away(simulated):
    *_, found = simulated
    declared, shifted = found["aside", "declared"], found["aside", "shifted"]
    # The box's faces bulge by 8.3 mrad there, so that domes of 30 mm touch 0.25 mm nearer the
    # middle: the lever goes from 14.75 mm to 5.25 mm.
    expected = 14.75 / 5.25 * declared.swing_ratio
    assert shifted.swing_ratio == pytest.approx(expected, rel=0.01)


@pytest.mark.slow
def test_what_was_simulated_is_not_simulated_again(simulated):
    out, wanted, found = simulated
    seen = []
    again = simulate_perturbed(
        RECIPE, wanted, out, workers=1, show=lambda done, total: seen.append((done, total))
    )
    assert seen == [(3, 3)]
    assert list(again.values()) == list(found.values())
    other = replace(wanted[0][0], index=7)
    assert simulate_perturbed(RECIPE, [(other, Perturbation())], out, workers=1)


def test_changes_on_top_of_each_other_multiply_and_add():
    both = Perturbation(mass_factor=1.5, center_of_mass_y_mm=10.0, friction=0.3).and_then(
        Perturbation(mass_factor=2.0, center_of_mass_y_mm=-4.0, friction=0.5)
    )
    assert both == Perturbation(mass_factor=3.0, center_of_mass_y_mm=6.0, friction=0.5)
    # A figure that is replaced is the one given, whatever factor was on the one before.
    replaced = Perturbation(mass_factor=1.5, friction_factor=2.0).and_then(
        Perturbation(mass_kg=0.4, friction=0.3, friction_factor=0.5)
    )
    assert replaced == Perturbation(mass_kg=0.4, friction=0.3, friction_factor=0.5)
    box = recipe_object(ObjectEntry(name=BOX))
    assert perturbed_object(box, replaced).mass_kg == 0.4
    table = Perturbation(settings_factors=(("table_friction", 0.5),))
    assert table.and_then(table).settings_factors == (("table_friction", 0.25),)


@pytest.mark.parametrize(
    ("share", "swing", "whole"), [(0.5, 2.4, 3.0), (1.0, 1.2, 1.5), (0.0, np.inf, np.inf)]
)
def test_torsion_is_asked_to_hold_the_moment_of_the_largest_turn(share, swing, whole):
    margin = SlipMargin(1.0, 0.1, np.nan, np.zeros(2), 3.0, 1.2, 1.5, share)
    config = GraspConfig(0, "sugar_box", 8.0, 0.0, 0.0, 50.0, 0.0)
    trace = GraspTrace(
        config=config, status="executed", label=1, frames={}, object_pose=np.zeros((0, 7)),
        rise_mm=180.0, turn_rad=0.02, margin=margin,
    )  # fmt: skip
    outcome = Outcome.of(trace, RECIPE.physics_settings)
    assert (outcome.friction_ratio, outcome.turn_ratio) == pytest.approx((3.0, 0.2))
    assert (outcome.swing_ratio, outcome.whole_swing_ratio) == pytest.approx((swing, whole))

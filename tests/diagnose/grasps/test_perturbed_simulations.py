"""Perturbed simulations as the diagnosis uses them, and the recipe extended by what it found."""

from dataclasses import replace

import numpy as np
import pytest

from tacgen.collection.perturbed import (
    Outcome,
    Perturbation,
    perturbed_object,
    recipe_object,
)
from tacgen.collection.recipe import Recipe
from tacgen.core.records import GraspConfig
from tacgen.diagnose.grasps.command import extended_recipe
from tacgen.diagnose.grasps.hypotheses import candidates_for
from tacgen.diagnose.grasps.model_comparison import (
    Cause,
    Explanation,
    Posterior,
    interpolated,
)
from tacgen.diagnose.grasps.next_grasps import competing_explanations
from tacgen.diagnose.grasps.perturbed_simulations import (
    PerturbedSimulations,
    combined_perturbation,
)
from tacgen.diagnose.grasps.result import describe
from tacgen.diagnose.grasps.slip_margin import crossings, margins_of
from tests.small_world import SHORT_LIFT

BOX = "sugar_box"
RECIPE = Recipe.model_validate({"name": "perturbed", "objects": [BOX], "physics": SHORT_LIFT})
CANDIDATES = {one.parameter.key: one for one in candidates_for((BOX,))}


def config(force_n, y_mm=0.0):
    return GraspConfig(0, BOX, force_n, 0.0, y_mm, 87.5)


def cause(key, value):
    candidate = CANDIDATES[key]
    nodes = np.array(candidate.parameter.nodes)
    table = np.zeros((len(nodes), 1))
    coordinate = float(candidate.parameter.coordinate(np.array([value]))[0])
    return Cause(interpolated(candidate, nodes, table, table + 0.5), coordinate, 0.01)


def test_an_extended_recipe_holds_what_was_found():
    found = [
        cause("mass_factor", 1.4),
        cause("center_of_mass_y_mm", 12.0),
        cause("spinning_friction_factor", 0.7),
        cause("object_scale", 1.02),
        cause("force_scale", 0.8),
        cause("height_offset_mm", 2.0),
    ]
    read = Recipe.model_validate(extended_recipe(RECIPE, found, [BOX]).resolved())
    assert read.physics_settings.delivered_force_scale == pytest.approx(0.8)
    assert read.physics_settings.height_offset_mm == pytest.approx(2.0)
    expected = perturbed_object(
        recipe_object(RECIPE.objects[0]),
        Perturbation(
            mass_factor=1.4,
            center_of_mass_y_mm=12.0,
            spinning_friction_factor=0.7,
            object_scale=1.02,
        ),
    )
    made = recipe_object(read.objects[0])
    assert made.mass_kg == pytest.approx(expected.mass_kg, rel=1e-4)
    assert made.center_of_mass_mm == pytest.approx(expected.center_of_mass_mm, abs=0.01)
    assert made.spinning_friction_factor == pytest.approx(0.7)
    assert made.spinning_friction_mm is expected.spinning_friction_mm is None
    assert np.ptp(made.surface.vertices_mm, axis=0) == pytest.approx(
        np.ptp(expected.surface.vertices_mm, axis=0), rel=1e-6
    )


def test_a_finding_is_reported_with_its_object_and_as_many_digits_as_its_error():
    assert (
        describe(cause("mass_factor", 1.4)) == f"mass of {BOX} at 1.400 ± 0.014 times the declared"
    )
    shifted = replace(cause("center_of_mass_y_mm", -21.34), deviation=4.41)
    assert describe(shifted) == f"center_of_mass of {BOX} along y off by -21.3 ± 4.4 mm"


def test_grasps_to_make_next_separate_the_two_sides_of_a_shift():
    shifted = replace(cause("center_of_mass_y_mm", -21.0), second_mode=22.0)
    competing = competing_explanations(
        Posterior((Explanation((shifted,), 5.0, 5.0, np.eye(1)),), 0.0, 0.0)
    )
    sides = [combined_perturbation(found, BOX).center_of_mass_y_mm for found in competing.values()]
    assert sides == [-21.0, 22.0]


@pytest.mark.exhaustive
@pytest.mark.slow
def test_a_mass_predicts_what_the_inverse_force_does_where_nothing_turns(tmp_path):
    """Failure modes included: they would speak for whichever of the two was simulated."""
    configs = (config(6.0), config(7.0), config(14.0))
    simulations = PerturbedSimulations(RECIPE, configs, tmp_path, 1)
    comparison = simulations.comparison()
    by_key = {model.candidate.parameter.key: model for model in comparison.models}
    force, mass = by_key["force_scale"], by_key["mass_factor"]
    assert mass.coordinate == pytest.approx(-force.coordinate[::-1])
    # Thresholds are reproduced to the narrower of the diagnosis's widths.
    assert mass.margin == pytest.approx(force.margin[::-1], abs=0.02)
    assert mass.turning == pytest.approx(force.turning[::-1], abs=0.02)


@pytest.mark.exhaustive
@pytest.mark.slow
def test_only_a_force_presses_the_patches_under_the_pads_larger(tmp_path):
    """So a mass is not quite another force: on a dome V = π a⁴ / 4R, and V grows with the force.

    The moment that the pads hold then grows with the force to the power of 5/4; where the box ends
    under the pads, by a few per cent more or less.
    """
    simulations = PerturbedSimulations(RECIPE, (config(9.0, 6.0), config(14.0, 6.0)), tmp_path, 1)
    changes = {
        "declared": Perturbation(),
        "force": Perturbation(force_scale=1.6),
        "friction": Perturbation(friction_factor=1.6),
        "mass": Perturbation(mass_factor=1 / 1.6),
    }
    simulations.simulate(
        (one, change) for one in simulations.configs for change in changes.values()
    )
    held = {
        name: np.array([one.whole_swing_ratio for one in simulations.outcomes(change)])
        for name, change in changes.items()
    }
    power = {name: np.log(one / held["declared"]) / np.log(1.6) for name, one in held.items()}
    assert power["force"] == pytest.approx(1.25, abs=0.05)
    assert power["friction"] == pytest.approx(1.0, abs=0.01)
    assert power["mass"] == pytest.approx(1.0, abs=0.01)


class RimmedSimulations(PerturbedSimulations):
    """No simulator: an object that a rim holds at 0.86 of the force that friction would need."""

    def simulate(self, wanted):
        for place, change in wanted:
            ratio = 1.1 * change.force_scale * change.friction_factor / change.mass_factor
            outcome = Outcome(int(ratio > 0.86), "", ratio, np.inf, turn_ratio=0.0)
            self.known[place.point, change] = outcome


@pytest.mark.parametrize(
    ("key", "sign"),
    [
        ("force_scale", 1),
        pytest.param("friction_factor", 1, marks=pytest.mark.exhaustive),
        ("mass_factor", -1),
    ],
)
def test_refining_finds_where_a_grasp_slips_that_the_closed_form_puts_elsewhere(
    tmp_path, key, sign
):
    simulations = RimmedSimulations(RECIPE, (config(7.0),), tmp_path, 1)
    comparison = simulations.comparison()
    places = []
    for _ in range(4):
        model = {one.candidate.parameter.key: one for one in comparison.models}[key]
        places.append(sign * crossings(model.coordinate, model.margin[:, 0])[0])
        # Margins lie as far apart as the factor's logarithms.
        expected = np.clip(sign * model.coordinate - places[-1], -1.5, 1.5)
        assert model.margin[:, 0] == pytest.approx(expected, abs=0.02)
        weaker = Explanation((Cause(model, sign * np.log(0.8), 0.1),), 1.0, 1.0, np.eye(1))
        comparison = simulations.refined([weaker])
    truth = np.log(0.86 / 1.1)
    # The threshold lies between 0.7 and 0.8 of the force at first; each round halves that.
    assert all(
        abs(place - truth) <= np.log(0.8 / 0.7) / 2 ** (k + 1) for k, place in enumerate(places)
    )
    assert abs(places[-1] - truth) < 0.01


def test_two_causes_are_simulated_at_once_and_kept(tmp_path):
    simulations = RimmedSimulations(RECIPE, (config(7.0),), tmp_path, 1)
    comparison = simulations.comparison()
    by_key = {model.candidate.parameter.key: model for model in comparison.models}
    mass, friction = by_key["mass_factor"], by_key["friction_factor"]
    causes = (Cause(mass, np.log(1.25), 0.1), Cause(friction, np.log(0.9), 0.1))
    simulations.refined([Explanation(causes, 1.0, 1.0, np.eye(2))])
    change = Perturbation(mass_factor=1.25, friction_factor=0.9)
    outcome = simulations.known[config(7.0).point, change]
    assert outcome.friction_ratio == pytest.approx(1.1 * 0.9 / 1.25)
    kept = simulations.joint[frozenset({mass.candidate, friction.candidate})]
    assert kept.coordinate[mass.candidate] == pytest.approx(np.log(1.25))
    assert kept.margin == pytest.approx(margins_of([outcome])[0])
    # A simulation with a mass as declared would tell of the friction alone.
    idle = (Cause(mass, np.log(1.01), 0.1), Cause(friction, np.log(0.8), 0.1))
    known = dict(simulations.known)
    simulations.refined([Explanation(idle, 1.0, 1.0, np.eye(2))])
    assert simulations.known == known

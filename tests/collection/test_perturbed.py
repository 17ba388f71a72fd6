"""Altered worlds with the simulator in them: what amounts to the same, and what is kept on disk."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
import yaml

from tacgen.collection.perturbed import (
    Alteration,
    Outcome,
    altered_object,
    place_of,
    simulate_altered,
)
from tacgen.collection.pipeline import recipe_object
from tacgen.collection.recipe import ObjectEntry, Recipe, load_recipe
from tacgen.core.records import GraspConfig
from tacgen.core.resources import find_object_folder
from tacgen.core.units import STANDARD_GRAVITY_M_S2
from tacgen.diagnose.grasps.candidates import PARAMETERS, Candidate
from tacgen.diagnose.grasps.extended_recipe import extended_recipe, write_extended_recipe
from tacgen.diagnose.grasps.hypothesis import interpolated
from tacgen.diagnose.grasps.model_comparison import Standing
from tacgen.diagnose.grasps.next_grasps import rivals_of
from tacgen.diagnose.grasps.perturbed_worlds import GraspWorlds, combined_world
from tacgen.diagnose.grasps.result import describe
from tacgen.diagnose.grasps.slip_margin import crossings

BOX = "sugar_box"
RECIPE = Recipe.model_validate({"name": "worlds", "objects": [BOX]})
HEIGHT_MM = 87.5
BY_KEY = {parameter.key: parameter for parameter in PARAMETERS}


def config(force_n, y_mm=0.0):
    return GraspConfig(0, BOX, force_n, 0.0, y_mm, HEIGHT_MM)


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    """One run for all tests: grasps on either side of the threshold, in a few worlds."""
    box = recipe_object(ObjectEntry(name=BOX))
    threshold_n = box.mass_kg * STANDARD_GRAVITY_M_S2 / (2 * box.friction)
    worlds = {
        "declared": Alteration(),
        "heavy": Alteration(mass_factor=1.4),
        "weak": Alteration(force_scale=1 / 1.4),
        "slippery": Alteration(friction_factor=1 / 1.4),
        "offset": Alteration(force_offset_n=0.3 * threshold_n),
        "shifted": Alteration(center_of_mass_y_mm=20.0),
    }
    places = {
        "below": config(0.85 * threshold_n),
        "above": config(1.2 * threshold_n),
        "aside": config(3.0 * threshold_n, 15.0),
    }
    out = tmp_path_factory.mktemp("worlds")
    wanted = [(place, world) for place in places.values() for world in worlds.values()]
    found = simulate_altered(RECIPE, wanted, out, workers=1)
    by_name = {
        (where, what): found[place_of(place), world]
        for where, place in places.items()
        for what, world in worlds.items()
    }
    return out, wanted, by_name


def test_mass_force_and_friction_are_one_ratio_for_a_block(simulated):
    *_, found = simulated
    assert found["above", "declared"].label == 1
    for world in ("heavy", "weak", "slippery"):
        assert found["above", world].label == 0
        ratio = found["above", world].friction_ratio
        assert ratio == pytest.approx(found["above", "declared"].friction_ratio / 1.4, rel=0.01)


def test_force_that_is_delivered_on_top_holds_what_slipped(simulated):
    *_, found = simulated
    assert found["below", "declared"].label == 0
    assert found["below", "declared"].failure_mode == "translational_slip"
    assert found["below", "offset"].label == 1


def test_a_centre_of_mass_moved_under_the_pads_takes_the_moment_away(simulated):
    *_, found = simulated
    declared, shifted = found["aside", "declared"], found["aside", "shifted"]
    # The lever goes from 15 mm to 5 mm, so the ratio grows threefold.
    assert shifted.torsion_ratio == pytest.approx(3 * declared.torsion_ratio, rel=0.03)


def test_what_was_simulated_is_not_simulated_again(simulated):
    out, wanted, found = simulated
    seen = []
    again = simulate_altered(
        RECIPE, wanted, out, workers=1, show=lambda done, total: seen.append((done, total))
    )
    assert seen == [(3, 3)]
    assert list(again.values()) == list(found.values())
    other = replace(wanted[0][0], index=7)
    assert simulate_altered(RECIPE, [(other, Alteration())], out, workers=1)


def standing(key, value, objects=(BOX,)):
    parameter = BY_KEY[key]
    nodes = np.array(parameter.nodes)
    table = np.zeros((len(nodes), 1))
    hypothesis = interpolated(Candidate(parameter, objects, 1.0), nodes, table, table)
    coordinate = float(parameter.coordinate(np.array([value]))[0])
    return Standing(parameter.name, 1.0, 1.0, hypothesis, coordinate, 0.01)


def test_an_extended_recipe_holds_the_world_that_was_found(tmp_path):
    found = [
        standing("mass_factor", 1.4),
        standing("center_of_mass_y_mm", 12.0),
        standing("spinning_friction_factor", 0.7),
        standing("object_scale", 1.02),
        standing("force_scale", 0.8),
        standing("height_offset_mm", 2.0),
    ]
    write_extended_recipe(extended_recipe(RECIPE, found, [BOX]), tmp_path / "recipe.yaml")
    read = load_recipe(tmp_path / "recipe.yaml")
    assert read.physics_settings.delivered_force_scale == pytest.approx(0.8)
    assert read.physics_settings.height_offset_mm == pytest.approx(2.0)
    expected = altered_object(
        recipe_object(RECIPE.objects[0]),
        Alteration(
            mass_factor=1.4,
            center_of_mass_y_mm=12.0,
            spinning_friction_factor=0.7,
            object_scale=1.02,
        ),
    )
    made = recipe_object(read.objects[0])
    assert made.mass_kg == pytest.approx(expected.mass_kg, rel=1e-4)
    assert made.center_of_mass_mm == pytest.approx(expected.center_of_mass_mm, abs=0.01)
    assert made.spinning_friction_mm == pytest.approx(expected.spinning_friction_mm, rel=1e-4)
    assert np.ptp(made.surface.vertices_mm, axis=0) == pytest.approx(
        np.ptp(expected.surface.vertices_mm, axis=0), rel=1e-6
    )


def test_what_was_found_is_told_with_its_object_and_as_many_digits_as_its_error():
    assert (
        describe(standing("mass_factor", 1.4))
        == f"mass of {BOX} at 1.400 ± 0.014 times the declared"
    )
    shifted = replace(standing("center_of_mass_y_mm", -21.34), deviation=4.41)
    assert describe(shifted) == f"center_of_mass of {BOX} along y off by -21.3 ± 4.4 mm"


def test_grasps_to_make_next_tell_the_two_sides_of_a_shift():
    shifted = replace(standing("center_of_mass_y_mm", -21.0), elsewhere=22.0)
    rivals = rivals_of([shifted], True)
    sides = [combined_world(found, BOX).center_of_mass_y_mm for found in rivals.values()]
    assert sides == [-21.0, 22.0]


def test_nothing_found_leaves_the_recipe_as_it_is():
    assert extended_recipe(RECIPE, [], [BOX]) is RECIPE


def test_figures_of_an_entry_that_came_later_leave_older_hashes_alone():
    plain = RECIPE.resolved()["objects"][0]
    assert "scale" not in plain
    assert "spinning_friction_mm" not in plain
    scaled = Recipe.model_validate({"name": "worlds", "objects": [{"name": BOX, "scale": 1.1}]})
    assert scaled.resolved()["objects"][0]["scale"] == 1.1
    assert scaled.sha256() != RECIPE.sha256()


def test_a_mass_predicts_what_the_force_does_upside_down_failure_modes_included(tmp_path):
    """Else given failure modes would speak for whichever of the two was simulated."""
    configs = (config(6.0), config(7.0, 8.0), config(14.0, 6.0))
    worlds = GraspWorlds(RECIPE, configs, tmp_path, 1)
    contest = worlds.contest()
    by_key = {
        evidence.hypothesis.candidate.parameter.key: evidence.hypothesis
        for evidence in contest.others
    }
    force, mass = by_key["force_scale"], by_key["mass_factor"]
    assert mass.coordinate == pytest.approx(-force.coordinate[::-1])
    # Both are drawn through the same simulated values.
    assert mass.slack == pytest.approx(force.slack[::-1], abs=1e-6)
    assert mass.turning == pytest.approx(force.turning[::-1], abs=1e-6)


class RimmedWorlds(GraspWorlds):
    """No simulator: an object that a rim holds at 0.86 of the force that friction would need."""

    def simulate(self, what, wanted):
        for place, world in wanted:
            ratio = 1.1 * world.force_scale * world.friction_factor / world.mass_factor
            outcome = Outcome(int(ratio > 0.86), "", 0.0, 0.0, ratio, np.inf, turn_rad=0.0)
            self.known[place_of(place), world] = outcome


def test_refining_finds_where_a_grasp_slips_that_the_closed_form_puts_elsewhere(tmp_path):
    worlds = RimmedWorlds(RECIPE, (config(7.0),), tmp_path, 1)
    contest = worlds.contest()
    places = []
    for _ in range(4):
        by_key = {e.hypothesis.candidate.parameter.key: e.hypothesis for e in contest.others}
        force, mass = by_key["force_scale"], by_key["mass_factor"]
        places.append(crossings(force.coordinate, force.slack[:, 0])[0])
        assert crossings(mass.coordinate, mass.slack[:, 0]) == pytest.approx([-places[-1]])
        contest = worlds.refined([Standing("mass", 1.0, 1.0, mass, -np.log(0.8), 0.1)])
    truth = np.log(0.86 / 1.1)
    # The threshold lies between 0.7 and 0.8 of the force at first; each round halves that.
    assert all(
        abs(place - truth) <= np.log(0.8 / 0.7) / 2 ** (k + 1) for k, place in enumerate(places)
    )
    assert abs(places[-1] - truth) < 0.01


def test_crossings_lie_where_the_line_between_values_is_zero():
    axis = np.array([0.0, 1.0, 2.0, 3.0])
    assert crossings(axis, np.array([-1.0, 1.0, 3.0, -1.0])) == pytest.approx([0.5, 2.75])
    assert crossings(axis, np.ones(4)).size == 0


def test_an_object_that_was_changed_is_simulated_again(tmp_path, monkeypatch):
    """Its recipe's hash stays the same: it names the object alone."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(find_object_folder(BOX), tmp_path / "objects" / BOX)
    wanted = [(config(30.0), Alteration())]
    (first,) = simulate_altered(RECIPE, wanted, tmp_path / "out", workers=1).values()
    path = tmp_path / "objects" / BOX / "object.yaml"
    content = yaml.safe_load(path.read_text())
    content["friction"]["value"] = 0.02
    path.write_text(yaml.safe_dump(content))
    (second,) = simulate_altered(RECIPE, wanted, tmp_path / "out", workers=1).values()
    assert (first.label, second.label) == (1, 0)

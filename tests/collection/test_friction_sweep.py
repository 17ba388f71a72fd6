"""The sweep over μ with the simulator in it, against a block whose threshold is known."""

import json

import numpy as np
import pytest
import yaml

from tacgen.collection.friction import (
    FrictionFit,
    mu_range,
    sweep_friction,
    write_object_copies,
)
from tacgen.collection.friction_report import write_friction_report
from tacgen.collection.perturbed import Outcome, recipe_object
from tacgen.collection.recipe import ObjectEntry, Recipe
from tacgen.core.errors import RecipeError
from tacgen.core.records import GraspConfig
from tacgen.core.types import STANDARD_GRAVITY_M_S2
from tacgen.dataset.real_grasps import RealGrasp, RealGrasps, read_real_grasps
from tests.messages import refused
from tests.small_world import SHORT_LIFT

BOX = "sugar_box"
MU_STAR = 0.4


@pytest.fixture(scope="module")
def real_folder(tmp_path_factory):
    """Six grasps through the centre of mass, labelled by 2 μ F ≥ m g."""
    box = recipe_object(ObjectEntry(name=BOX))
    height = box.center_of_mass_mm[2]
    threshold_n = box.mass_kg * STANDARD_GRAVITY_M_S2 / (2 * MU_STAR)
    forces = threshold_n * np.array([0.6, 0.75, 0.9, 1.1, 1.3, 1.6])
    lines = [
        f"g{k},{BOX},{f:.4f},0,0,{height:g},{int(f > threshold_n)}" for k, f in enumerate(forces)
    ]
    folder = tmp_path_factory.mktemp("real")
    header = "grasp_id,object,force_n,x_mm,y_mm,z_mm,label"
    (folder / "grasps.csv").write_text("\n".join([header, *lines]) + "\n")
    return folder


@pytest.fixture(scope="module")
def swept(real_folder, tmp_path_factory):
    out = tmp_path_factory.mktemp("sweep")
    recipe = Recipe.model_validate({"name": "sweep", "objects": [BOX], "physics": SHORT_LIFT})
    real = read_real_grasps(real_folder)
    mus = mu_range("0.2:0.6:0.1")
    return out, recipe, real, mus, sweep_friction(recipe, real, mus, out, workers=1)


@pytest.mark.slow
def test_the_sweep_finds_the_friction_of_the_closed_form(swept):
    out, _, _, _, (fits, _) = swept
    assert fits[BOX].mislabels.min() == 0
    assert abs(fits[BOX].mu - MU_STAR) <= 0.05
    written = json.loads((out / "friction.json").read_text())[BOX]
    assert written["mu"] == fits[BOX].mu
    assert [mu for mu, _ in written["mislabels"]] == [0.2, 0.3, 0.4, 0.5, 0.6]
    assert written["n_grasps"] == 6


@pytest.mark.slow
def test_a_sweep_goes_on_from_what_is_there(swept):
    out, recipe, real, mus, (fits, outcomes) = swept
    store = out / "outcomes.jsonl"
    lines = store.read_text().splitlines()
    store.write_text("\n".join(lines[:-3]) + "\n" + lines[-3][:20])
    seen = []
    again, same = sweep_friction(
        recipe, real, mus, out, workers=1, show=lambda done, total: seen.append((done, total))
    )
    assert seen[0] == (5, 6)
    assert same == outcomes
    assert again[BOX].mu == fits[BOX].mu


@pytest.mark.slow
def test_the_result_is_written_into_a_copy_of_the_object(swept, tmp_path):
    *_, (fits, _) = swept
    write_object_copies(fits, tmp_path)
    written = yaml.safe_load((tmp_path / BOX / "object.yaml").read_text())["friction"]
    assert written["value"] == fits[BOX].mu
    assert "6 real grasps" in written["source"]
    assert recipe_object(ObjectEntry(name=str(tmp_path / BOX))).friction == fits[BOX].mu


def test_simulated_grasps_are_not_called_real(tmp_path):
    """In the page, and in the object's file that cites them."""
    config = GraspConfig(0, BOX, 5.0, 0.0, 0.0, 87.0)
    grasps = (RealGrasp("g0", config, 1, "", ()), RealGrasp("g1", config, 0, "slip", ()))
    outcomes = {(g.grasp_id, 0.5): Outcome(g.label, "") for g in grasps}
    fits = {BOX: FrictionFit(0.5, (0.4, 0.6), np.array([0.5]), np.array([0]), 2, "both")}
    for is_simulated, kind in ((True, "exported simulated"), (False, "real")):
        found = RealGrasps(tmp_path, grasps, (), is_simulated=is_simulated)
        assert found.kind == kind
        write_friction_report(tmp_path / "report.html", found, outcomes, fits)
        page = (tmp_path / "report.html").read_text()
        assert f"Friction from {kind} grasps" in page
        for words in ("real grasps", "real outcomes"):
            assert (words in page) is not is_simulated
        write_object_copies(fits, tmp_path, kind=found.kind)
        text = (tmp_path / BOX / "object.yaml").read_text()
        assert f"2 {kind} grasps" in text


@pytest.mark.slow
def test_the_report_stands_alone(swept, tmp_path):
    _, _, real, _, (fits, outcomes) = swept
    write_friction_report(tmp_path / "report.html", real, outcomes, fits)
    text = (tmp_path / "report.html").read_text()
    assert "0 of 6 grasps mislabelled" in text
    assert "://" not in text.replace("http://www.w3.org", "")


@pytest.mark.parametrize("text", ["0:1", "a:b:c", "0:1:0", "1:0:0.1", "-1:1:0.1", "0:3:0.1"])
def test_values_of_mu_that_mean_nothing_are_refused(text):
    with refused(RecipeError):
        mu_range(text)

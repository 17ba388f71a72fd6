"""Hypotheses are plug-ins: one registered here is weighed, simulated, written and reported."""

import json

import numpy as np
import pytest

from tacgen.collection.perturbed import Outcome, Perturbation, perturbed_settings
from tacgen.collection.recipe import Recipe
from tacgen.dataset.real_grasps import read_real_grasps
from tacgen.diagnose.grasps import perturbed_simulations
from tacgen.diagnose.grasps.command import diagnose_grasps, record_of
from tacgen.diagnose.grasps.hypotheses import (
    Hypothesis,
    HypothesisParameter,
    register,
    registry,
)
from tacgen.diagnose.grasps.report import write_grasp_report

BOX = "sugar_box"
RECIPE = Recipe.model_validate({"name": "declared", "objects": [BOX], "grid": {"sample": 8}})
STICKY = HypothesisParameter(
    key="pad_friction_factor",
    unit="1",
    declared=1.0,
    nodes=(0.3, 0.5, 0.7, 1.0, 1.5),
    spread=0.7,
    perturb=lambda factor: Perturbation(settings_factors=(("pad_friction", factor),)),
)


@pytest.fixture
def worn_pads():
    yield register(Hypothesis("worn_pads", 2.0, True, (STICKY,), {"friction": "put on new pads"}))
    del registry._REGISTRY["worn_pads"]


def simulated(recipe, wanted, out, **_):
    """No simulator: a grasp at y_mm of a pad friction against the one that it needs."""
    found = {}
    for config, change in wanted:
        settings = perturbed_settings(recipe.physics_settings, change)
        # Heavier objects and weaker grips fail elsewhere than pads that hold less.
        turn = 1.0 if change.settings_factors else 0.05 * config.y_mm
        held = settings.pad_friction * np.exp(0.05 * config.y_mm)
        held *= (change.friction_factor * change.force_scale / change.mass_factor) ** turn
        label = int(held > 0.9)
        place = config.object, config.force_n, config.x_mm, config.y_mm, config.z_mm
        found[(*place, config.yaw_rad), change] = Outcome(
            label, "" if label else "translational_slip", held / 0.9, np.inf, 1.0, 0.0
        )
    return found


@pytest.mark.slow
def test_a_hypothesis_of_ones_own_is_found_simulated_written_and_reported(
    worn_pads, tmp_path, monkeypatch
):
    monkeypatch.setattr(perturbed_simulations, "simulate_perturbed", simulated)
    rows = ["grasp_id,object,force_n,x_mm,y_mm,z_mm,label"]
    for k, y_mm in enumerate(np.linspace(-5, 30, 36)):
        rows.append(f"g{k},{BOX},10,0,{y_mm:.3f},87.5,{int(0.5 * np.exp(0.05 * y_mm) > 0.9)}")
    (tmp_path / "grasps.csv").write_text("\n".join(rows) + "\n")
    real = read_real_grasps(tmp_path)
    findings = diagnose_grasps(RECIPE, real, tmp_path / "out", workers=1)
    channel = json.loads((tmp_path / "out/diagnosis.json").read_text())["channels"]["grasp"]
    assert channel["effects"][0]["name"] == "worn_pads"
    value = channel["effects"][0]["parameters"]["pad_friction_factor"]["value"]
    assert value == pytest.approx(0.5, rel=0.15)
    assert channel["effects"][0]["description"].startswith("worn_pads at 0.")
    assert findings.recipe.physics.pad_friction == pytest.approx(value, abs=1e-4)
    assert channel["simulated_again"]["mislabels"] <= 2
    record = record_of(findings, RECIPE, [BOX])
    before, after = findings.diagnosis.simulated_before, findings.simulated_after
    write_grasp_report(tmp_path / "report.html", record, real, before, after)
    assert "worn_pads" in (tmp_path / "report.html").read_text()

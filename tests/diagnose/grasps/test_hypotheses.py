"""Hypotheses are plug-ins: one registered here is weighed, simulated, written and reported."""

import ast
import json
from pathlib import Path

import numpy as np
import pytest

import tacgen.diagnose.grasps
from tacgen.collection.perturbed import Outcome, Perturbation, perturbed_settings
from tacgen.collection.recipe import Recipe
from tacgen.core.errors import TacgenError
from tacgen.dataset.real_grasps import read_real_grasps
from tacgen.diagnose.grasps import perturbed_simulations
from tacgen.diagnose.grasps.command import diagnose_grasps, record_of
from tacgen.diagnose.grasps.hypotheses import (
    Hypothesis,
    HypothesisParameter,
    advice,
    candidates_for,
    register,
    registered,
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


def test_it_goes_as_it_came(worn_pads):
    assert worn_pads in registered()
    assert worn_pads.name in {candidate.name for candidate in candidates_for((BOX,))}
    assert advice("friction", "worn_pads") == "friction or worn_pads: put on new pads"
    with pytest.raises(TacgenError, match="'worn_pads' is registered twice"):
        register(worn_pads)


def test_no_other_module_names_a_hypothesis():
    names = {one.name for one in registered()}
    names |= {parameter.key for one in registered() for parameter in one.parameters}
    folder = Path(tacgen.diagnose.grasps.__file__).parent
    found = []
    for path in sorted(folder.glob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            said = node.value if isinstance(node, ast.Constant) else getattr(node, "attr", None)
            if isinstance(node, ast.keyword):
                said = node.arg
            if isinstance(said, str) and said in names:
                found.append(f"{path.name}:{getattr(node, 'lineno', 0)}: {said}")
    assert not found

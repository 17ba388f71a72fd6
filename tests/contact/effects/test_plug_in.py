"""An effect is one module: nothing else names it, and registering it is all that it takes."""

import ast
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import tacgen
from tacgen.calibrate.contact.command import LogSource
from tacgen.contact.effects import all_effects, base, register
from tacgen.contact.law import load_law
from tacgen.diagnose.contact.command import diagnose_log
from tacgen.rig import RigRecipe, load_rig_recipe, simulate_session
from tacgen.rig.rig_recipe import RigEffect
from tests.messages import refused

PACKAGE = Path(tacgen.__file__).parent
EFFECTS = PACKAGE / "contact" / "effects"


ORDINARY = {"position", "geometry", "temperature"}
"""Words that a variable may have for a name all the same."""


def named_in(path):
    """Every string of a module, and its identifiers but for ordinary words."""
    tree = ast.parse(path.read_text())
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value
        elif isinstance(node, ast.Name) and node.id not in ORDINARY:
            yield node.id
        elif isinstance(node, ast.Attribute) and node.attr not in ORDINARY:
            yield node.attr


def test_the_registry_finds_its_modules_itself():
    modules = {path.stem for path in EFFECTS.glob("*.py")}
    own = {effect.name for effect in all_effects()}
    assert own <= modules
    shared = {"__init__", "base", "history", "kernels", "where"}
    assert modules - own == shared
    for name in shared - {"__init__"}:
        assert not own & set(named_in(EFFECTS / f"{name}.py"))


def fatigue(load, history, p):
    """Every third press gives more: no shipped effect does that."""
    return base.with_gain(load, p["share"] * (history.trial % 3 == 0))


@pytest.fixture
def new_effect():
    effect = register(
        base.Effect(
            name="every_third_press",
            channel="normal",
            stage="gain",
            about="every third press gives more",
            parameters=(base.amount("share", -0.9, 5.0),),
            apply=fatigue,
            variants=lambda history, references: (base.variant("third", [{"share": 0.05}]),),
            shown_against="trial",
            separated_by={"position": "press one place in every press"},
        )
    )
    yield effect
    base._REGISTRY.pop((effect.channel, effect.name), None)


@pytest.mark.slow
def test_an_effect_registered_here_is_pressed_diagnosed_reported_and_simulated(
    new_effect, tmp_path
):
    recipe = load_rig_recipe("rig").model_copy(
        update={"effects": (RigEffect(name=new_effect.name, strength=3.0),)}
    )
    assert isinstance(recipe, RigRecipe)
    session = simulate_session(recipe)
    (put_in,) = session.truth.law.effects
    session.log.to_csv(tmp_path / "log.csv", index=False)
    diagnosis = diagnose_log(LogSource(tmp_path / "log.csv"), tmp_path)
    record = json.loads((tmp_path / "diagnosis.json").read_text())["channels"]["normal"]
    assert [effect["name"] for effect in record["effects"]] == [new_effect.name]
    share = record["effects"][0]["parameters"]["share"]
    assert share["value"] == pytest.approx(put_in.values["share"], abs=4 * share["stderr"])
    assert "every third press" in diagnosis.channels["normal"].sentence
    assert new_effect.name in (tmp_path / "report.html").read_text()
    law = load_law(tmp_path / "contact.yaml")
    grasps = pd.DataFrame({"trial": [3, 4], "time_s": [0.0, 10.0], "force_normal_n": [5.0, 5.0]})
    volume, _ = law.predict(grasps, simulate=True)
    assert volume[0] / volume[1] == pytest.approx(1.0 + share["value"], rel=1e-9)
    assert np.isfinite(volume).all()
    del base._REGISTRY[new_effect.channel, new_effect.name]
    with refused(Exception):
        load_law(tmp_path / "contact.yaml")
    register(new_effect)

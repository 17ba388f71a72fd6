"""The thresholds of the diagnosis: all in one record, explained and used."""

import re
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

import tacgen.diagnose.contact as package
from tacgen.diagnose.contact.channel import ChannelSamples
from tacgen.diagnose.contact.rules import DEFAULT_RULES, SelectionRules
from tacgen.diagnose.contact.search import Selection
from tacgen.rig import load_rig_recipe, simulate_session
from tacgen.rig.rig_recipe import RigEffect

FOLDER = Path(next(iter(package.__path__)))
SOURCES = {path.name: path.read_text() for path in FOLDER.glob("*.py")}
REASONS = dict(re.findall(r"^    (\w+): .* = .*  # (.+)$", SOURCES.pop("rules.py"), re.MULTILINE))


@pytest.mark.parametrize("rule", fields(SelectionRules), ids=lambda rule: rule.name)
def test_a_rule_has_a_reason_and_is_used(rule):
    assert REASONS[rule.name]
    assert any(f"rules.{rule.name}" in text for text in SOURCES.values())


@pytest.mark.slow
def test_rules_are_an_argument():
    effects = (RigEffect(name="temperature", strength=3.0),)
    session = simulate_session(load_rig_recipe("rig").model_copy(update={"effects": effects}))
    columns = {name: session.log[name].to_numpy() for name in session.log}

    def members(rules):
        data = ChannelSamples(columns, "normal", rules).thinned()
        found = Selection(data, np.random.default_rng(0)).run()
        return [chosen.candidate.name for chosen in found.chosen]

    assert members(DEFAULT_RULES) == ["temperature"]
    assert members(replace(DEFAULT_RULES, min_gain=20.0)) == []

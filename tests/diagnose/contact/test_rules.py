"""The thresholds of the diagnosis: all in one record, explained, used and documented."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

import tacgen.diagnose.contact as package
from tacgen.diagnose.contact.channel import ChannelSamples
from tacgen.diagnose.contact.rules import DEFAULT_RULES, SelectionRules, rules_table
from tacgen.diagnose.contact.selection import Selection
from tacgen.rig import load_rig_recipe, simulate_session
from tacgen.rig.rig_recipe import RigEffect

METHOD = Path(__file__).parents[3] / "docs" / "method.md"
SOURCES = {
    path.name: path.read_text()
    for path in Path(next(iter(package.__path__))).glob("*.py")
    if path.name != "rules.py"
}


@pytest.mark.parametrize("rule", fields(SelectionRules), ids=lambda rule: rule.name)
def test_a_rule_has_a_reason_and_is_used(rule):
    assert rule.metadata["reason"]
    assert rule.metadata["set_by"]
    assert any(f"rules.{rule.name}" in text for text in SOURCES.values())


def test_the_table_in_the_docs_is_that_of_the_rules():
    assert rules_table(DEFAULT_RULES) in METHOD.read_text()


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

"""The thresholds of the diagnosis: all in one record, explained and used."""

import re
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

import tacgen.diagnose as package
from tacgen.diagnose.contact.channel import ChannelSamples
from tacgen.diagnose.contact.search import ContactProblem
from tacgen.diagnose.rules import CONTACT, GRASPS, MARKERS, OPTICS
from tacgen.rig import load_rig_recipe, simulate_session
from tacgen.rig.rig_recipe import RigEffect

FOLDER = Path(next(iter(package.__path__)))
SOURCES = [path.read_text() for path in FOLDER.rglob("*.py") if path.name != "rules.py"]
EVERY = {rule.name for one in (CONTACT, MARKERS, OPTICS, GRASPS) for rule in fields(one)}


def test_every_rule_is_used():
    used = {name for text in SOURCES for _, name in re.findall(r"(rules|GRASPS)\.(\w+)", text)}
    assert used >= EVERY


@pytest.mark.slow
def test_rules_are_an_argument():
    effects = (RigEffect(name="temperature", strength=3.0),)
    session = simulate_session(load_rig_recipe("rig").model_copy(update={"effects": effects}))
    columns = {name: session.log[name].to_numpy() for name in session.log}

    def members(rules):
        data = ChannelSamples(columns, "normal", rules).thinned()
        found = ContactProblem(data, np.random.default_rng(0)).run()
        return [chosen.candidate.name for chosen in found.chosen]

    assert members(CONTACT) == ["temperature"]
    assert members(replace(CONTACT, min_gain=20.0)) == []

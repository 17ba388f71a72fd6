"""The search for effects: which forms are fitted, which members are needed."""

from dataclasses import replace

import numpy as np

from tacgen.diagnose.contact.channel import ChannelSamples
from tacgen.diagnose.contact.rules import DEFAULT_RULES
from tacgen.diagnose.contact.selection import Selection
from tests.diagnose.contact.test_free_forms import presses, prony


def selection_of_creep_and_offset(**rules):
    creeping = prony([0.15], [1.5])
    columns = presses(lambda *press: 0.2 + creeping(*press), 0.05, 9)
    data = ChannelSamples(columns, "normal", replace(DEFAULT_RULES, **rules)).thinned()
    return Selection(data, np.random.default_rng(0))


def test_of_a_name_with_a_significant_form_the_best_forms_are_fitted():
    """Which form is significant depends on its shape as it is first drawn, before any fit."""
    selection = selection_of_creep_and_offset(max_members=1)
    base = selection.sets.fitted((), selection.sets.linear)
    pool = selection.sets.pool(base)
    creeps = [number for number, (one, _) in enumerate(pool) if one.name == "creep"]
    p_values = np.ones(len(pool))
    p_values[creeps[-1]] = 0.0
    extended = selection._extended(base, pool, p_values, np.ones(len(pool), dtype=bool))
    assert extended.members[0].label in {pool[k][0].label for k in creeps[:2]}


def test_an_effect_is_needed_beside_one_without_which_cross_validation_goes_astray(monkeypatch):
    """All that is there to explain bounds what the other explains; 2 % of it is asked for."""
    sets = selection_of_creep_and_offset().sets
    base = sets.fitted((), sets.linear)
    best = {one.name: one for one, _ in reversed(sets.pool(base))}
    full = sets.add(base, [best["creep"], best["zero_offset"]])
    offset = full.members[1]
    without = {one.name: sets.without(full, one) for one in full.members}
    assert sets.is_needed(full, offset)
    astray = without["creep"].unit_losses + 1e4 * base.loss
    without["creep"] = replace(without["creep"], unit_losses=astray)
    monkeypatch.setattr(sets, "without", lambda _, member: without[member.name])
    assert sets.is_needed(full, offset)

"""The search for effects: which forms are fitted, which members are needed."""

from dataclasses import replace

import numpy as np
import pytest

from tacgen.diagnose.contact.channel import ChannelSamples
from tacgen.diagnose.contact.search import ContactProblem
from tacgen.diagnose.engine import step, worth_a_fit
from tacgen.diagnose.rules import CONTACT
from tests.diagnose.contact.test_free_forms import K_N, N_TRIALS, presses, prony


def selection_of_creep_and_offset(**rules):
    creeping = prony([0.15], [1.5])
    columns = presses(lambda *press: 0.2 + creeping(*press), 0.05, 9)
    data = ChannelSamples(columns, "normal", replace(CONTACT, **rules)).thinned()
    return ContactProblem(data, np.random.default_rng(0))


def test_each_form_is_fitted_from_its_best_start_alone():
    """Two starts of one form end in one fit, in the place of another form."""
    sets = selection_of_creep_and_offset()
    pool = sets.pool(sets.fitted((), sets.linear))
    creeps = [(one, gain) for one, gain in pool if one.name == "creep"]
    best = worth_a_fit(sets, creeps, -np.inf)
    assert len(best) < len(creeps)
    assert {one.form for one in best} == {one.form for one, _ in creeps}
    for one in best:
        starts = [(gain, other.label) for other, gain in creeps if other.form == one.form]
        assert max(starts)[1] == one.label


def test_what_promises_far_less_than_the_best_is_not_fitted():
    sets = selection_of_creep_and_offset()
    best, near = (pool := sets.pool(sets.fitted((), sets.linear)))[0][0], pool[-1][0]
    for gain, fitted in ((0.86, [best, near]), (0.84, [best])):
        assert worth_a_fit(sets, [(best, 1.0), (near, gain)], share=0.85) == fitted


def test_every_rival_of_an_effect_is_looked_at_however_few_are_fitted_in_the_search():
    """One that promises less than another may predict as well as the member, once it is fitted."""

    def chosen_with(share):
        # Every explanation counts as confusable.
        rules = {"fitted_share": share, "confusable_in_se": np.inf}
        return selection_of_creep_and_offset(**rules).run().chosen

    def by_name(chosen):
        return {one.candidate.name: set(one.confusable) for one in chosen}

    best, few, many = chosen_with(1.0), chosen_with(0.9), chosen_with(0.5)
    assert [one.candidate.label for one in few] == [one.candidate.label for one in many]
    assert [one.confusable for one in few] == [one.confusable for one in many]
    assert all(len(one.confusable) > 3 for one in few)
    # With the best start alone the search comes to another form of creep, of the same explanations.
    assert by_name(best) == by_name(many)


def test_an_effect_is_needed_beside_one_without_which_cross_validation_goes_astray(monkeypatch):
    """2 % of what both explain is asked for, whatever a set without one of them seems to leave."""
    sets = selection_of_creep_and_offset()
    base = sets.fitted((), sets.linear)
    best = {one.name: one for one, _ in reversed(sets.pool(base))}
    full = sets.add(base, [best["creep"], best["zero_offset"]])
    offset = full.members[1]
    without = {one.name: sets.without(full, one) for one in full.members}
    assert sets.accepts(full, offset)
    astray = without["creep"].unit_losses + 1e4 * base.loss
    without["creep"] = replace(without["creep"], unit_losses=astray)
    monkeypatch.setattr(sets, "without", lambda _, member: without[member.name])
    assert sets.accepts(full, offset)


@pytest.mark.parametrize(
    ("delay_s", "form", "other"), [(0.02, "delay", "lead"), (-0.02, "lead", "delay")]
)
def test_a_delay_and_a_lead_are_told_before_they_are_fitted(delay_s, form, other):
    """A force with a period of 7 samples: its slopes before and after a sample are 51° apart, so
    that one explains cos² 51° = 0.39 of what the other does.
    """
    columns = presses(lambda force, *_: force, 0.0, 12)
    rng = np.random.default_rng(12)
    for rows in np.split(np.arange(columns["trial"].size), N_TRIALS):
        time = columns["time_s"][rows]
        force = 4.0 - 2.0 * np.cos(2 * np.pi * np.arange(time.size) / 7) * rng.uniform(0.5, 1.0)
        columns["force_normal_n"][rows] = force
        columns["volume_mm3"][rows] = K_N * np.interp(time - delay_s, time, force)
    columns["volume_mm3"] += 0.2 * rng.normal(size=columns["trial"].size)
    data = ChannelSamples(columns, "normal").thinned()
    assert data.history.sample_period_s > 3 * abs(delay_s)
    sets = ContactProblem(data, np.random.default_rng(0))
    base = sets.fitted((), sets.linear)
    gains = {one.label: gain for one, gain in sets.pool(base)}
    assert gains[f"latency: {form}"] > 0.9 * base.loss
    assert gains.get(f"latency: {other}", 0.0) < 0.6 * base.loss


@pytest.mark.exhaustive
def test_causes_that_hide_each_other_in_few_trials_are_found_together():
    """Gains by temperature, place and radius, equally strong: one or two explain too little."""
    rng = np.random.default_rng(4)
    columns = presses(lambda force, *_: force, 0.05, 9)
    columns = {name: values[columns["trial"] < 13] for name, values in columns.items()}
    warmth, place, size = (np.linspace(-1.0, 1.0, 13)[rng.permutation(13)] for _ in range(3))
    trial = columns["trial"].astype(int)
    columns |= {"temperature_c": 25.0 + 5.0 * warmth[trial], "x_mm": 6.0 * place[trial]}
    columns |= {"y_mm": np.zeros(trial.size), "radius_mm": 4.0 * np.exp(0.5 * size[trial])}
    columns["volume_mm3"] *= 1.0 + 0.1 * (warmth + place + size)[trial]
    data = ChannelSamples(columns, "normal").thinned()

    def names():
        return ContactProblem(data, np.random.default_rng(0)).choose().accepted.names

    assert names() == {"temperature", "position", "geometry"}


def test_a_form_that_would_be_dropped_again_hides_no_other(monkeypatch):
    sets = selection_of_creep_and_offset(max_members=1)
    base = sets.fitted((), sets.linear)
    found = step(sets, base).found
    assert found.members[0].name == "creep"
    monkeypatch.setattr(sets, "accepts", lambda _, member: member.name != "creep")
    other = step(sets, base).found
    assert other is None or other.members[0].name != "creep"
    monkeypatch.setattr(sets, "accepts", lambda *_: False)
    assert step(sets, base).found is None

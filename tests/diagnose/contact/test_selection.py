"""The search for effects: which forms are fitted, which members are needed."""

from dataclasses import replace

import numpy as np
import pytest

from tacgen.diagnose.contact.channel import ChannelSamples
from tacgen.diagnose.contact.command import diagnose
from tacgen.diagnose.contact.model import as_it_is
from tacgen.diagnose.contact.rules import DEFAULT_RULES
from tacgen.diagnose.contact.selection import Selection, _worth_a_fit
from tests.diagnose.contact.test_free_forms import K_N, N_TRIALS, presses, prony
from validation.blind.evaluate import split
from validation.blind.generator import draw_case


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
    extended = selection._extended(base, pool, [], p_values)
    assert extended.members[0].label in {pool[k][0].label for k in creeps[:2]}


def test_each_form_is_fitted_from_its_best_start_alone():
    """Two starts of one form end in one fit, in the place of another form."""
    sets = selection_of_creep_and_offset().sets
    pool = sets.pool(sets.fitted((), sets.linear))
    creeps = [(one, gain) for one, gain in pool if one.name == "creep"]
    best = _worth_a_fit(creeps, -np.inf)
    assert len(best) < len(creeps)
    assert {one.form for one in best} == {one.form for one, _ in creeps}
    for one in best:
        starts = [(gain, other.label) for other, gain in creeps if other.form == one.form]
        assert max(starts)[1] == one.label


def test_what_promises_far_less_than_the_best_is_not_fitted():
    sets = selection_of_creep_and_offset().sets
    best, near = (pool := sets.pool(sets.fitted((), sets.linear)))[0][0], pool[-1][0]
    for gain, fitted in ((0.86, [best, near]), (0.84, [best])):
        assert _worth_a_fit([(best, 1.0), (near, gain)], share=0.85) == fitted


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
    sets = selection_of_creep_and_offset().sets
    base = sets.fitted((), sets.linear)
    best = {one.name: one for one, _ in reversed(sets.pool(base))}
    full = sets.add(base, [best["creep"], best["zero_offset"]])
    offset = full.members[1]
    without = {one.name: sets.without(full, one) for one in full.members}
    assert sets.is_accepted(full, offset)
    astray = without["creep"].unit_losses + 1e4 * base.loss
    without["creep"] = replace(without["creep"], unit_losses=astray)
    monkeypatch.setattr(sets, "without", lambda _, member: without[member.name])
    assert sets.is_accepted(full, offset)


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
    sets = Selection(data, np.random.default_rng(0)).sets
    base = sets.fitted((), sets.linear)
    gains = {one.label: gain for one, gain in sets.pool(base)}
    assert gains[f"latency: {form}"] > 0.9 * base.loss
    assert gains.get(f"latency: {other}", 0.0) < 0.6 * base.loss


def test_no_form_explains_more_than_there_is(monkeypatch):
    """Products of neighbours may leave less than nothing of what only noise tells apart."""
    sets = selection_of_creep_and_offset().sets
    base = sets.fitted((), sets.linear)
    losses_of = sets._cv_losses
    monkeypatch.setattr(sets, "_cv_losses", lambda *args: losses_of(*args) - 0.2 * base.loss)
    gains = [gain for _, gain in sets.pool(base)]
    assert gains[:2] == [base.loss, base.loss]
    assert gains == sorted(gains, reverse=True)


def with_losses(sets, monkeypatch, full, **without):
    """``sets`` in which the sets without each member, by name, have these losses of units."""
    rests = {name: replace(full, unit_losses=losses) for name, losses in without.items()}
    monkeypatch.setattr(sets, "without", lambda _, member: rests[member.name])


def creep_and_offset(sets):
    base = sets.fitted((), sets.linear)
    best = {one.name: one for one, _ in reversed(sets.pool(base))}
    return sets.add(base, [best["creep"], best["zero_offset"]])


@pytest.mark.parametrize("n_gaining", [1, 2, 4])
def test_the_p_of_gains_in_so_many_trials_is_that_of_all_signs_alike(monkeypatch, n_gaining):
    """2⁻ⁿ; by 999 flips, to four standard deviations."""
    sets = selection_of_creep_and_offset().sets
    full = creep_and_offset(sets)
    gains = np.zeros(N_TRIALS)
    gains[3 : 3 + n_gaining] = 1.0
    rest = replace(full, unit_losses=full.unit_losses + gains)
    expected = 0.5**n_gaining
    error = np.sqrt(expected * (1 - expected) / sets.rules.n_shuffles)
    assert sets.p_of_gains(rest, full) == pytest.approx(expected, abs=4.0 * error + 0.001)


@pytest.mark.parametrize(
    ("share", "n_gaining", "worth"),
    [(0.55, 1, True), (0.45, 6, False), (0.45, 7, True), (0.45, N_TRIALS, True)],
)
def test_in_few_trials_an_effect_explains_most_or_gains_in_seven(share, n_gaining, worth):
    """2⁻⁶ is above ``alpha``, 2⁻⁷ below; signs are of whole trials, whatever their parts are."""
    sets = selection_of_creep_and_offset(min_trials_as_units=99).sets
    assert sets.data.few_trials
    assert sets.data.n_units > sets.data.unit_trial.max() + 1
    left = 10.0 * sets.data.noise_loss
    gains = (sets.data.unit_trial < n_gaining).astype(float)
    losses = np.full(sets.data.n_units, left / sets.data.n_units)
    full = replace(creep_and_offset(sets), unit_losses=losses * (1.0 - share))
    rest = replace(full, unit_losses=full.unit_losses + share * left * gains / gains.sum())
    assert sets.is_worth(rest, full) is worth


def peaked_presses(n_trials, rng, does):
    """Presses to 3 to 8 N: a ramp up, a hold and a ramp down each; V = 5 F of force ``does``."""
    ramp = np.interp(np.linspace(0.0, 3.0, 60), [0.0, 1.0, 2.0, 3.0], [0, 1, 1, 0])
    force = rng.uniform(3.0, 8.0, n_trials)[:, None] * ramp
    volume = 5.0 * np.stack([does(press) for press in force])
    return {
        "trial": np.repeat(np.arange(n_trials), 60),
        "time_s": (4.0 * np.arange(n_trials)[:, None] + np.linspace(0.0, 3.0, 60)).ravel(),
        "force_normal_n": force.ravel(),
        "volume_mm3": (volume + rng.normal(0.0, 0.3, volume.shape)).ravel(),
    }


@pytest.mark.parametrize("strength", [0.2, 0.0])
def test_what_other_trials_gain_by_is_accepted_however_wrong_the_worst_are(strength):
    """Three presses are off by a third: their gains explain more than an offset of 0.2 N does."""
    columns = presses(lambda force, *_: force + strength, 0.05, 9)
    columns["volume_mm3"][np.isin(columns["trial"], [3, 9, 17])] *= 1.3
    sets = Selection(ChannelSamples(columns, "normal").thinned(), np.random.default_rng(0)).sets
    base = sets.fitted((), sets.linear)
    best = {one.name: one for one, _ in reversed(sets.pool(base))}
    full = sets.add(base, [best["zero_offset"]])
    assert set(sets.worst_trials(base)) == {3, 9, 17}
    assert not sets.is_more_than_gains(base, full)
    assert sets.others_gain(base, full) is (strength > 0.0)


def test_beside_others_as_they_are_the_residual_is_what_a_member_does_and_what_all_leave():
    sets = selection_of_creep_and_offset().sets
    base = sets.fitted((), sets.linear)
    best = {one.name: one for one, _ in reversed(sets.pool(base))}
    full = sets.add(base, [best["creep"], best["zero_offset"]]).fit
    same = as_it_is(sets.data, full.model)
    np.testing.assert_allclose(same.residual, full.residual, atol=1e-12)
    less = full.model.without("creep", None)
    does = sets.data.reduce(full.model.response(sets.data) - less.response(sets.data))
    left = as_it_is(sets.data, less)
    np.testing.assert_allclose(left.residual, full.residual + does, atol=1e-9)
    assert left.jacobian.shape[1] == full.jacobian.shape[1] - len(best["creep"].variant.free)


def test_a_form_that_would_be_dropped_again_hides_no_other(monkeypatch):
    selection = selection_of_creep_and_offset(max_members=1)
    sets = selection.sets
    base = sets.fitted((), sets.linear)
    pool = sets.pool(base)
    args = base, pool, [], np.zeros(len(pool))
    assert selection._extended(*args).members[0].name == "creep"
    monkeypatch.setattr(sets, "is_accepted", lambda _, member, *__: member.name != "creep")
    other = selection._extended(*args)
    assert other is not None
    assert other.members[0].name != "creep"
    monkeypatch.setattr(sets, "is_accepted", lambda *_: False)
    assert selection._extended(*args) is None


def test_an_effect_that_was_fitted_to_nothing_has_no_form_to_correct():
    """As a creep beside which another effect explains all; fits end at bounds such as 0."""
    sets = selection_of_creep_and_offset().sets
    base = sets.fitted((), sets.linear)
    creep = next(one for one, _ in sets.pool(base) if one.name == "creep")
    full = sets.add(base, [creep])
    (term,) = full.fit.model.terms
    assert sets.corrected(full, creep.effect).fit is not full.fit
    nothing = replace(term, values={**term.values, "amount": 0.0, "amount_2": 0.0})
    model = replace(full.fit.model, terms=(nothing,))
    full = replace(full, fit=replace(full.fit, model=model))
    assert sets.corrected(full, creep.effect) is full


def test_causes_that_hide_each_other_in_few_trials_are_found_together(monkeypatch):
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
        return Selection(data, np.random.default_rng(0)).choose().accepted.names

    assert names() == {"temperature", "position", "geometry"}
    monkeypatch.setattr(Selection, "_deeper", lambda *_: None)
    assert not names()


def test_a_form_that_explains_less_than_it_promised_hides_no_better_one(monkeypatch):
    selection = selection_of_creep_and_offset(max_members=1)
    sets = selection.sets
    base = sets.fitted((), sets.linear)
    best = {one.name: one for one, _ in reversed(sets.pool(base))}
    creep, offset = (sets.add(base, [best[name]]) for name in ("creep", "zero_offset"))
    worse, better = sorted((creep, offset), key=lambda one: base.loss - one.loss)
    monkeypatch.setattr(sets, "is_accepted", lambda *_: True)
    explained = base.loss - better.loss
    others = {one.name: one for one, _ in sets.pool(base)}
    less = next(one for name, one in others.items() if name not in ("creep", "zero_offset"))
    pool = [(worse.members[0], 9.0 * explained), (better.members[0], 1.01 * explained)]
    pool.append((less, 0.5 * explained))
    fitted = []
    add = sets.add
    monkeypatch.setattr(sets, "add", lambda *of: fitted.append(of[1][0].name) or add(*of))
    extended = selection._extended(base, pool, [], np.zeros(3))
    assert [one.label for one in extended.members] == [better.members[0].label]
    assert less.name not in fitted


def test_a_form_that_promises_most_and_then_fails_hides_no_weaker_one(monkeypatch):
    """A lead promises, when it is linear, what creep with an amount below 0 would do."""
    selection = selection_of_creep_and_offset(max_members=1)
    sets = selection.sets
    base = sets.fitted((), sets.linear)
    creep = next(one for one, _ in sets.pool(base) if one.name == "creep")
    other = next(one for one, _ in sets.pool(base) if one.name == "zero_offset")
    monkeypatch.setattr(sets, "is_accepted", lambda full, member, n=1: member.name == "zero_offset")
    most = sets.total(base)
    pool = [(creep, most), (other, 0.3 * most * selection.rules.fitted_share)]
    extended = selection._extended(base, pool, [], np.zeros(2))
    assert [one.label for one in extended.members] == [other.label]
    assert selection._extended(base, [(creep, -1.0)], [], np.zeros(1)) is None
    # Neither does it where the search goes by the score alone.
    score = sets.score
    fails = sets.add(base, [creep]).members
    monkeypatch.setattr(sets, "score", lambda one: score(one) + 9 * most * (one.members == fails))
    assert [one.label for one in selection._grown(base, pool, [])[0].members] == [other.label]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "channel", "wanted"),
    [
        # Creep and a lag promise most where the volume is ahead of the force, and cannot be fitted.
        (11253007, "normal", {"stiffening": 2.0, "latency": 2.0, "temperature": 1.0}),
        # The same, and plays fit the lead better than itself while noise blurs the force.
        (11253058, "normal", {"position": 2.0, "latency": 1.0, "geometry": 1.0}),
        # Without the temperature the limit of a saturation that is sharp would be far away.
        (11211036, "normal", {"temperature": 1.0, "saturation": 1.0}),
        # Scores beside the two others are too unequal for signs, however much each one gains.
        (13070013, "shear", {"anisotropy": 2.0, "normal_coupling": 2.0, "slip": 2.0}),
        # Of ten presses all gain, though by less than what is left.
        (14000041, "shear", {"anisotropy": 0.5}),
        # A few presses reach the limit, in the order of their loads.
        (14240018, "normal", {"saturation": 2.0}),
        # What a few-parameter form of hysteresis leaves looks like stiffening and an offset.
        (13060052, "normal", {"hysteresis": 1.0, "saturation": 1.0}),
        # What corrections of hysteresis explain less well than stiffening without any.
        (14070016, "normal", {"hysteresis": 2.0, "stiffening": 1.0, "zero_offset": 2.0}),
    ],
)
def test_blind_logs_whose_causes_hid_each_other(seed, channel, wanted):
    case = draw_case(seed, **{channel: list(wanted.items())})
    given, _ = split(case.frame, seed)
    named = ["trial", "time_s", "force_normal_n", "force_shear_x_n", "force_shear_y_n"]
    named += ["volume_mm3", "shear_x_mm", "shear_y_mm", "indenter", "radius_mm"]
    named += ["x_mm", "y_mm", "temperature_c"]
    columns = {name: given[name].to_numpy() for name in named if name in given}
    found = diagnose(columns).channels[channel]
    assert set(found.effect_names) == set(wanted)

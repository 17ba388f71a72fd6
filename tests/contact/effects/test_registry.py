"""What every effect of the registry must do."""

import pickle

import numpy as np
import pytest

from tacgen.contact.effects import LoadHistory, Where, all_effects, find_effect, register
from tacgen.contact.law import respond
from tacgen.core.errors import ContactError
from tests.messages import refused

EFFECTS = [pytest.param(effect, id=f"{effect.channel}-{effect.name}") for effect in all_effects()]
K = 5.0


def press_columns(n_trials=24, n_samples=60, seed=0):
    """Load, hold, unload, with shear during the hold, several balls, places and temperatures."""
    rng = np.random.default_rng(seed)
    phase = np.linspace(0.0, 1.0, n_samples)
    ramp = np.interp(phase, [0.0, 0.3, 0.7, 1.0], [0.0, 1.0, 1.0, 0.0])
    pull = np.interp(phase, [0.0, 0.3, 0.5, 0.7, 1.0], [0.0, 0.0, 1.0, 0.0, 0.0])
    peak = rng.uniform(3.0, 10.0, n_trials)
    angle = rng.uniform(0.0, 2 * np.pi, n_trials)
    columns = {
        "trial": np.repeat(np.arange(n_trials), n_samples),
        "time_s": (np.arange(n_trials)[:, None] * 20.0 + phase * 6.0).ravel(),
        "force_normal_n": (peak[:, None] * ramp).ravel(),
    }
    pulled = rng.uniform(0.1, 0.5, n_trials) * peak
    columns["force_shear_x_n"] = ((pulled * np.cos(angle))[:, None] * pull).ravel()
    columns["force_shear_y_n"] = ((pulled * np.sin(angle))[:, None] * pull).ravel()
    each = {
        "x_mm": rng.uniform(-6, 6, n_trials),
        "y_mm": rng.uniform(-5, 5, n_trials),
        "radius_mm": rng.choice([2.0, 3.0, 5.0, np.nan], n_trials),
        "temperature_c": rng.uniform(18.0, 30.0, n_trials),
        "tilt_x": rng.normal(0.0, 5.0, n_trials),
        "tilt_y": rng.normal(0.0, 5.0, n_trials),
    }
    columns |= {name: np.repeat(values, n_samples) for name, values in each.items()}
    ball = np.where(np.isnan(columns["radius_mm"]), "flat", "ball")
    return columns | {"indenter": ball}


def first_variant(effect, history):
    references = effect.references(history) | {"span_mm3": 0.9 * K * history.normal_span_n}
    return effect.variants(history, references)[0], references


def switched_on(effect, history):
    """Parameters of the effect's first variant, every probe on."""
    variant, references = first_variant(effect, history)
    parameters = effect.complete({**references, **variant.shapes})
    for probe in variant.probes:
        parameters |= probe
    return parameters


@pytest.mark.slow
@pytest.mark.parametrize("effect", EFFECTS)
def test_shape_and_values_are_kept_finite_and_input_untouched(effect):
    columns = press_columns()
    before = {name: values.copy() for name, values in columns.items()}
    history = LoadHistory(columns)
    result = respond(history, effect.channel, K, [(effect, switched_on(effect, history))])
    assert result.shape == (columns["trial"].size, 1 if effect.channel == "normal" else 2)
    assert np.isfinite(result).all()
    for name, values in columns.items():
        np.testing.assert_array_equal(values, before[name])


@pytest.mark.parametrize("effect", EFFECTS)
def test_zero_strength_changes_nothing(effect):
    history = LoadHistory(press_columns())
    _, references = first_variant(effect, history)
    for variant in effect.variants(history, references):
        idle = effect.complete({**references, **variant.shapes})
        plain = respond(history, effect.channel, K, [])
        np.testing.assert_allclose(
            respond(history, effect.channel, K, [(effect, idle)]), plain, rtol=0, atol=1e-12
        )


@pytest.mark.parametrize("effect", EFFECTS)
def test_every_variant_changes_the_response(effect):
    history = LoadHistory(press_columns())
    _, references = first_variant(effect, history)
    plain = respond(history, effect.channel, K, [])
    variants = effect.variants(history, references)
    assert variants
    for variant in variants:
        for probe in variant.probes:
            assert set(variant.free) >= set(probe)
            parameters = effect.complete({**references, **variant.shapes, **probe})
            changed = respond(history, effect.channel, K, [(effect, parameters)])
            assert np.abs(changed - plain).max() > 1e-4 * np.abs(plain).max(), variant.label


@pytest.mark.parametrize("effect", [one for one in EFFECTS if one.values[0].free_amounts])
def test_free_amounts_change_nothing_at_0_and_the_response_elsewhere(effect):
    history = LoadHistory(press_columns())
    references = effect.references(history)
    plain = respond(history, effect.channel, K, [])
    for size in (0.0, 0.05):
        parameters = effect.complete(references | dict.fromkeys(effect.free_amounts, size))
        change = respond(history, effect.channel, K, [(effect, parameters)]) - plain
        assert (np.abs(change).max() > 0.01 * np.abs(plain).max()) == bool(size)


@pytest.mark.parametrize("effect", EFFECTS)
def test_rows_may_stand_in_any_order(effect):
    columns = press_columns()
    shuffled = np.random.default_rng(1).permutation(columns["trial"].size)
    history = LoadHistory(columns)
    parameters = switched_on(effect, history)
    straight = history.unsorted(respond(history, effect.channel, K, [(effect, parameters)]))
    mixed = LoadHistory({name: values[shuffled] for name, values in columns.items()})
    again = mixed.unsorted(respond(mixed, effect.channel, K, [(effect, parameters)]))
    np.testing.assert_allclose(again, straight[shuffled], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("effect", EFFECTS)
def test_parameters_have_units_bounds_and_an_identity_within_them(effect):
    for parameter in effect.parameters:
        assert parameter.unit
        assert parameter.low <= parameter.identity <= parameter.high


def test_a_name_is_registered_once():
    with refused(ContactError):
        register(find_effect("normal", "creep"))


def test_an_unknown_name_lists_the_known_ones():
    with refused(ContactError):
        find_effect("normal", "crep")


def test_an_effect_reaches_another_process_by_its_name_with_the_part_it_acts_in():
    creep = find_effect("shear", "creep")
    assert pickle.loads(pickle.dumps(creep)) is creep
    part = Where("indenter", equals="ball")
    local = pickle.loads(pickle.dumps(creep.only(part)))
    assert (local.name, local.where, local.needs) == ("creep", part, (*creep.needs, "indenter"))

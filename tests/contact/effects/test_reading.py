"""Reading by reading an effect gives what it gives for the whole log, and remembers no more."""

from types import MappingProxyType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tacgen.contact.effects import LoadHistory, all_effects
from tacgen.contact.law import ContactLaw, FittedEffect
from tacgen.core.records import Estimate
from tests.contact.effects.test_registry import K, first_variant, press_columns

SIMULATED = [
    pytest.param(one, id=f"{one.channel}-{one.name}") for one in all_effects() if one.in_simulation
]
COLUMNS = press_columns(n_trials=3, n_samples=50)


def law_of(effect, parameters):
    """A law with one effect."""
    estimates = MappingProxyType({name: Estimate(one) for name, one in parameters.items()})
    fitted = FittedEffect(effect.name, effect.channel, estimates)
    return ContactLaw("volume_linear", Estimate(K), Estimate(0.8), effects=(fitted,))


def read_one_by_one(law, columns):
    """Volume (N,) and shear (N, 2) of rows in the order of time, and the last memory."""
    memory, volume, shear = {}, [], []
    for k in range(len(columns["trial"])):
        row = {name: values[k] for name, values in columns.items()}
        normal, tangential, memory = law.advance(row, memory)
        volume.append(normal)
        shear.append(tangential)
    return np.array(volume), np.array(shear), memory


def forms_of(effect):
    """Parameters of every variant of an effect, and of its free amounts."""
    history = LoadHistory(COLUMNS)
    _, known = first_variant(effect, history)
    references = effect.references(history) | (
        {"span_mm3": 35.0} if effect.name == "saturation" else {}
    )
    for variant in effect.variants(history, known):
        form = {**references, **variant.shapes}
        for probe in variant.probes:
            form |= probe
        yield variant.label, effect.complete(form)
    if effect.free_amounts:
        free = dict.fromkeys(effect.free_amounts, 0.03)
        yield "free amounts", effect.complete(references | free)


@pytest.mark.parametrize("effect", SIMULATED)
def test_readings_give_what_the_whole_log_gives(effect):
    if effect.is_local:
        pytest.skip("acts in a part of a log only")
    for label, parameters in forms_of(effect):
        law = law_of(effect, parameters)
        volume, shear, _ = read_one_by_one(law, COLUMNS)
        for simulate in (True, False):
            whole, motion = law.predict(COLUMNS, simulate=simulate)
            whole = np.maximum(whole, 0.0)  # of a log, noise about no volume shows
            np.testing.assert_allclose(volume, whole, rtol=1e-9, atol=1e-9, err_msg=label)
            np.testing.assert_allclose(shear, motion, rtol=1e-9, atol=1e-9, err_msg=label)


@pytest.mark.parametrize("effect", SIMULATED)
def test_a_memory_does_not_grow_and_is_not_changed(effect):
    if effect.is_local:
        pytest.skip("acts in a part of a log only")
    _, parameters = list(forms_of(effect))[-1]
    law = law_of(effect, parameters)
    ten = {name: values[:10] for name, values in COLUMNS.items()}
    few, many = (read_one_by_one(law, rows)[2] for rows in (ten, COLUMNS))
    assert few.keys() == many.keys()
    row = {name: values[10] for name, values in COLUMNS.items()}
    first, again = law.advance(row, few), law.advance(row, few)
    assert first[0] == again[0]
    np.testing.assert_array_equal(first[1], again[1])


def fitted(name, channel, **parameters):
    """An effect with given parameters."""
    return FittedEffect(name, channel, {k: Estimate(v) for k, v in parameters.items()})


TOGETHER = ContactLaw(
    "volume_linear",
    Estimate(K),
    Estimate(0.8),
    effects=(
        fitted("creep", "normal", amount=0.4, amount_2=0.2, tau_s=0.5, tau_2_s=6.0, carried=1.0),
        fitted("hysteresis", "normal", residual=0.1, loop=0.2, play=-0.3, width_n=0.7, span_n=8.0),
        fitted("stiffening", "normal", amount=0.1, reference_n=5.0),
        fitted("shear_coupling", "normal", ratio=0.1, ratio_reference=0.3),
        fitted("conditioning", "normal", amount=0.2, trials=2.0),
        fitted("creep", "shear", amount=0.3, tau_s=2.0, recovery=0.4, since_press=1.0),
        fitted("hysteresis", "shear", rubbing=0.3, width_n=0.4, isotropic=1.0, return_2=0.1),
        fitted("slip", "shear", mindlin=0.8, mu=0.7),
        fitted("anisotropy", "shear", along_x=0.2, rotation_rad=0.1),
    ),
)


@settings(max_examples=40, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.booleans(),
            st.floats(0.0, 3.0),
            st.floats(0.0, 20.0),
            st.floats(-5.0, 5.0),
            st.floats(-5.0, 5.0),
        ),
        min_size=1,
        max_size=30,
    )
)
def test_many_effects_at_once_on_any_course(rows):
    """New presses, steps of time of any length or none, loads of any kind."""
    is_new, steps_s, force_n, x_n, y_n = (np.array(one, float) for one in zip(*rows, strict=True))
    columns = {
        "trial": np.cumsum(is_new),
        "time_s": np.cumsum(steps_s),
        "force_normal_n": force_n,
        "force_shear_x_n": x_n,
        "force_shear_y_n": y_n,
    }
    volume, shear, _ = read_one_by_one(TOGETHER, columns)
    whole, motion = TOGETHER.predict(columns, simulate=True)
    np.testing.assert_allclose(volume, whole, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(shear, motion, rtol=1e-9, atol=1e-9)

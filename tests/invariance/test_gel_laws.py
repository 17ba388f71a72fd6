"""What must not matter to a contact law, whatever effect it has."""

import numpy as np
import pytest

from tacgen.contact.effects import all_effects
from tests.contact.effects.test_reading import forms_of, law_of, read_one_by_one
from tests.contact.effects.test_registry import press_columns

FORMS = [
    pytest.param(law_of(effect, parameters), id=f"{effect.channel}-{effect.name}-{label}")
    for effect in all_effects()
    if effect.in_simulation and not effect.is_local
    for label, parameters in forms_of(effect)
]
PRESS = press_columns(n_trials=2, n_samples=50)


def simulated(law, columns):
    """Volume and shear motion of a simulated log, as one array (N, 3)."""
    volume, shear = law.predict(columns, simulate=True)
    return np.column_stack([volume, shear])


@pytest.mark.parametrize("law", FORMS)
def test_a_clocks_zero_does_not_matter(law):
    later = {**PRESS, "time_s": PRESS["time_s"] + 1000.0}
    np.testing.assert_allclose(simulated(law, later), simulated(law, PRESS), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("law", FORMS)
def test_a_pause_before_the_press_does_not_matter(law):
    """A gel that nothing touches stays at rest, however long one looks at it before."""
    first = {name: values[:50] for name, values in PRESS.items()}
    waited = {name: np.concatenate([values[:1], values]) for name, values in first.items()}
    waited["time_s"] = waited["time_s"] - np.array([7.0, *np.zeros(50)])
    np.testing.assert_allclose(
        simulated(law, waited)[1:], simulated(law, first), rtol=1e-9, atol=1e-9
    )


@pytest.mark.parametrize("law", FORMS)
@pytest.mark.parametrize("turn_rad", [np.pi, 0.7])
def test_a_turn_of_the_gel_about_its_normal_turns_the_motion(law, turn_rad):
    """Half a turn, of every effect but one that names a direction; any turn, of one of vectors."""
    fitted = law.effects[0]
    amounts = {
        k for k, v in fitted.values.items() if v and fitted.effect.parameter(k).role == "amount"
    }
    along_axes = fitted.name == "hysteresis" and fitted.values["isotropic"] != 1.0
    if fitted.name in ("position",) or amounts & {"leak_x", "leak_y"}:
        pytest.skip("names a direction")
    if turn_rad != np.pi and (
        fitted.name == "anisotropy" or (along_axes and fitted.channel == "shear")
    ):
        pytest.skip("acts along the axes")
    cos, sin = np.cos(turn_rad), np.sin(turn_rad)
    x, y = PRESS["force_shear_x_n"], PRESS["force_shear_y_n"]
    turned = {**PRESS, "force_shear_x_n": cos * x - sin * y, "force_shear_y_n": sin * x + cos * y}
    volume, shear = law.predict(PRESS, simulate=True)
    volume_of_turned, shear_of_turned = law.predict(turned, simulate=True)
    np.testing.assert_allclose(volume_of_turned, volume, rtol=1e-9, atol=1e-9)
    expected = shear @ np.array([[cos, sin], [-sin, cos]])
    np.testing.assert_allclose(shear_of_turned, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("law", FORMS)
def test_presses_before_matter_only_to_what_remembers_them(law):
    """The second of two presses is as it would be alone, but for conditioning and carried creep."""
    if law.effects[0].name == "conditioning" or law.effects[0].values.get("carried"):
        pytest.skip("remembers the presses before")
    second = {name: values[50:] for name, values in PRESS.items()}
    np.testing.assert_array_equal(simulated(law, PRESS)[50:], simulated(law, second))
    volume, shear, _ = read_one_by_one(law, PRESS)
    again, moved, _ = read_one_by_one(law, second)
    np.testing.assert_array_equal(volume[50:], again)
    np.testing.assert_array_equal(shear[50:], moved)

"""Tracing what a table leaves over to optical effects, on the virtual sensor."""

import json

import pytest

from tacgen.errors import PressError
from tacgen.loop.optics_diagnosis import diagnose_optics
from tests.virtual_presses import virtual_presses


def names(diagnosis):
    return [effect.name for effect in diagnosis.effects]


def test_clean_presses_need_no_effect():
    diagnosis = diagnose_optics(virtual_presses(0))
    assert diagnosis.verdict == "sufficient"
    assert names(diagnosis) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "injected"),
    [
        ("press_center", {"center_scatter_px": 1.0}),
        ("background_gain", {"gain_scatter": 0.04}),
    ],
)
def test_an_injected_effect_is_named_and_lowers_the_heldout_error(name, injected):
    diagnosis = diagnose_optics(virtual_presses(1, **injected))
    assert names(diagnosis) == [name]
    assert diagnosis.rmse_after < 0.75 * diagnosis.rmse_before


def test_the_json_has_the_contracts_fields():
    content = json.loads(json.dumps(diagnose_optics(virtual_presses(2, count=12)).as_dict()))
    channel = content["channels"]["rgb"]
    assert content["schema"] == 1
    assert channel["error_before"]["unit"] == "grey"
    assert channel["trials"] == {"fit": 9, "test": 3}
    assert {"verdict", "effects", "unexplained", "error_after", "noise_floor"} <= set(channel)


def test_too_few_presses():
    with pytest.raises(PressError, match="5 usable presses are too few to hold any out"):
        diagnose_optics(virtual_presses(3, count=5))

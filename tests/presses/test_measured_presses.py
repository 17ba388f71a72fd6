"""Presses of real sensors: none is refused, in whole or in part; altered ones are."""

from dataclasses import replace

import numpy as np
import pytest

from tacgen.core.errors import PressError
from tacgen.presses.press_folder import read_presses
from tacgen.presses.screening import usable_presses

SETS = {
    "taxim": "taxim_ball_presses/dataPack_small_37.npz",
    "digit_a": "press_sets/digit_a",
    "fots_gelsight": "press_sets/fots_gelsight",
    "gelsight_mini": "press_sets/gelsight_mini",
    "known_depth": "press_sets/known_depth/presses",
}


SETS_TO_READ = [
    pytest.param(name, marks=() if name in ("taxim", "gelsight_mini") else pytest.mark.exhaustive)
    for name in SETS
]


@pytest.fixture(scope="module", params=SETS_TO_READ)
def presses(request, measured_data):
    return read_presses(measured_data / SETS[request.param])


@pytest.mark.slow
def test_no_part_of_a_real_set_is_refused(presses):
    """As ten held-out presses beside the background of all are."""
    rng = np.random.default_rng(0)
    for count in (len(presses), 10, 10, 10, 5):
        chosen = np.sort(rng.choice(len(presses), count, replace=False))
        used = usable_presses(presses.select(chosen), every=True)
        assert len(used) == count


ALTERED = {
    "red and blue are swapped": lambda image: image[..., ::-1],
    "it is turned by 180°": lambda image: image[::-1, ::-1],
    "it is mirrored left to right": lambda image: image[:, ::-1],
}


@pytest.mark.slow
@pytest.mark.parametrize("name", ALTERED)
def test_another_view_is_refused(presses, name):
    background = np.ascontiguousarray(ALTERED[name](presses.background))
    with pytest.raises(PressError, match=f"does not match the presses: {name}"):
        usable_presses(replace(presses, background=background))

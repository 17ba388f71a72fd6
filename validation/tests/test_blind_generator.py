"""The blind generator says the truth about what it makes."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import validation.blind.blind_effects as forms
from validation.blind.blind_forms import hysteresis_bouc_wen
from validation.blind.generator import draw_case


def left_over(response, load):
    k = (load * response).sum() / (load**2).sum()
    return np.sqrt(((response - k * load) ** 2).mean())


def test_the_same_seed_gives_the_same_log():
    first = draw_case(3, normal=[("creep", 1.5)], n_trials=12)
    second = draw_case(3, normal=[("creep", 1.5)], n_trials=12)
    assert first.frame.equals(second.frame)
    assert not first.frame.equals(draw_case(4, normal=[("creep", 1.5)], n_trials=12).frame)


@pytest.mark.parametrize("name", sorted(forms.NORMAL))
def test_normal_effects_have_the_strength_they_were_asked_for(name):
    case = draw_case(7, normal=[(name, 2.0)], n_trials=16, noise_share=0.01, force_noise_share=0.0)
    force = case.frame["force_normal_n"].to_numpy()
    assert left_over(case.volume_mm3, force) / case.noise_mm3 == pytest.approx(2.0, rel=0.05)
    assert case.normal == (name,)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(forms.SHEAR))
def test_shear_effects_have_the_strength_they_were_asked_for(name):
    case = draw_case(9, shear=[(name, 2.0)], n_trials=16, noise_share=0.01, force_noise_share=0.0)
    force = case.frame[["force_shear_x_n", "force_shear_y_n"]].to_numpy()
    assert left_over(case.shear_mm, force) / case.noise_mm == pytest.approx(2.0, rel=0.05)


@pytest.mark.parametrize("kind", ["region", "stretch", "indenter"])
def test_a_local_effect_acts_in_its_trials_only(kind):
    case = draw_case(5, normal=[("zero_offset", 2.0)], local={"zero_offset": kind}, n_trials=40)
    inside = case.frame["trial"].isin(case.inside["zero_offset"]).to_numpy()
    still = draw_case(5, normal=[("zero_offset", 0.0)], local={"zero_offset": kind}, n_trials=40)
    assert 8 <= len(case.inside["zero_offset"]) <= 27
    changed = np.abs(case.volume_mm3 - still.volume_mm3) > 1e-9
    np.testing.assert_array_equal(changed, inside)
    assert case.reached["normal", "zero_offset"] == pytest.approx(2.0, rel=0.01)


@pytest.mark.parametrize("n_samples", [2, 400])
def test_a_bouc_wen_loop_closes_alike_however_quickly_the_load_is_let_go(n_samples):
    """z' = s (1 - z sign F') F': with all load let go, z = exp(-s F) (2 - exp(-s F)) - 1."""
    peak_n, width = 4.0, 0.9
    up = np.linspace(0.0, peak_n, n_samples)
    load = np.concatenate([up, up[-2::-1]])[:, None]
    trial = SimpleNamespace(peak_n=peak_n)
    result = hysteresis_bouc_wen(load, trial, 0.2, {"width": width})
    decay = np.exp(-6.0 / width)
    expected = -0.2 * peak_n * (decay * (2.0 - decay) - 1.0)
    assert result[-1, 0] == pytest.approx(expected, rel=1e-9)

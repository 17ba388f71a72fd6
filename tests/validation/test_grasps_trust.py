"""What the trust study counts, against closed forms; the study itself takes an hour."""

from dataclasses import replace

import numpy as np
import pytest

from tacgen.collection.perturbed import Perturbation
from validation.grasps.trust import Trial, as_force, least_fresh_wrong, summary_of

TRIAL = Trial("box", "mass", 0.05, 40, 5, ("mass",), (1.4,), ("grip_force",), 0.2, 0.05, 0.05, 0.02)


@pytest.mark.parametrize("count", [20, 40])
def test_the_least_error_is_half_a_grasp_of_all_and_one_more(count):
    """A fresh grasp lies beside the truth in 2 of count + 1 orders, and on the wrong side in 1/4.

    Its deviation over draws is about its mean, so 4000 draws give it to 5 % at three deviations.
    """
    found = least_fresh_wrong(count, 0.0, np.random.default_rng(0))
    assert found == pytest.approx(1 / (2 * (count + 1)), rel=0.05)


@pytest.mark.slow
def test_flipped_labels_cost_more_and_more_grasps_less():
    few, many = (least_fresh_wrong(n, 0.05, np.random.default_rng(0)) for n in (40, 100))
    assert 1 / 82 < few < 2 / 82
    assert many < few


def test_fresh_mislabels_count_flips_once():
    assert replace(TRIAL, fresh_wrong=0.0).rate_fresh == pytest.approx(0.05)
    assert replace(TRIAL, fresh_wrong=1.0).rate_fresh == pytest.approx(0.95)
    assert TRIAL.rate_fresh == pytest.approx(0.02 * 0.95 + 0.98 * 0.05)


def test_trials_that_change_too_few_labels_are_counted_apart():
    text = summary_of([TRIAL, replace(TRIAL, n_changed=1, named=())])
    assert "| mass | 5 % | 2 | 1 | 1 of 1 | 1 of 1 |" in text


def test_a_mass_is_a_force_upside_down():
    assert as_force(Perturbation(mass_factor=1.25)) == Perturbation(force_scale=0.8)

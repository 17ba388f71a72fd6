"""Domain randomisation: by the grasp's seed, and none where none is asked for."""

import numpy as np
import pytest

from tacgen.collection.perturbed import Variation, draw_variation
from tacgen.collection.recipe import Randomize


def draws(count=4000, **spread):
    rng = np.random.default_rng(3)
    return [draw_variation(Randomize(**spread), rng) for _ in range(count)]


def test_nothing_varies_unless_asked_for():
    assert draw_variation(Randomize(), np.random.default_rng(0)) == Variation()


def test_the_spread_is_the_one_asked_for():
    # 4000 draws estimate a standard deviation to 1.1 %; clipping at 3 sigma takes 1.3 % off.
    varied = draws(friction_relative=0.2, center_of_mass_mm=5.0)
    assert np.std(np.log([v.perturbation.friction_factor for v in varied])) == pytest.approx(
        0.2, rel=0.05
    )
    assert np.std([v.perturbation.center_of_mass_mm for v in varied]) == pytest.approx(
        5.0, rel=0.05
    )
    assert max(abs(np.log(v.perturbation.friction_factor)) for v in varied) <= 0.6 + 1e-9


def test_switching_one_figure_on_leaves_the_draws_of_the_others():
    alone = draws(5, friction_relative=0.2)
    both = draws(5, friction_relative=0.2, mass_relative=0.1)
    assert [v.perturbation.friction_factor for v in alone] == [
        v.perturbation.friction_factor for v in both
    ]

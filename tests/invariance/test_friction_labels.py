"""What the friction sweep's answer may depend on: distinct labels, and nothing else."""

import numpy as np
import pytest

from tacgen.collection.friction import data_warnings, fit_friction, mu_range
from tacgen.collection.perturbed import Outcome
from tacgen.core.records import GraspConfig
from tacgen.dataset.real_grasps import RealGrasp, RealGrasps

MU = np.array(mu_range("0:1:0.05"))
HALF_STEP = 0.025


def labels(seed, count=20, wrong=2, mu=0.45):
    """Simulated (M, N) and real (N,) labels of thresholds from 0.1 to 1, a few of them wrong."""
    rng = np.random.default_rng(seed)
    threshold = rng.uniform(0.1, 1.0, count)
    real = (mu >= threshold).astype(np.int64)
    real[rng.choice(count, wrong, replace=False)] ^= 1
    return (MU[:, None] >= threshold).astype(np.int64), real


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("wrong", [0, 2])
def test_repeated_or_reordered_labels_change_nothing(seed, wrong):
    simulated, real = labels(seed, wrong=wrong)
    fit = fit_friction(MU, simulated, real)
    order = np.random.default_rng(seed).permutation(np.tile(np.arange(20), 3))
    again = fit_friction(MU, simulated[:, order], real[order])
    assert (again.mu, again.interval) == (fit.mu, fit.interval)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("wrong", [0, 1, 3])
def test_the_interval_holds_every_best_value_and_half_a_step(seed, wrong):
    fit = fit_friction(MU, *labels(seed, wrong=wrong))
    best = MU[fit.mislabels == fit.mislabels.min()]
    assert fit.interval[0] <= max(best.min() - HALF_STEP, 0.0) + 1e-12
    assert fit.interval[1] >= best.max() + HALF_STEP - 1e-12


def test_grasps_written_twice_are_said(tmp_path):
    config = GraspConfig(0, "box", 5.0, 0.0, 0.0, 87.0)
    grasps = tuple(RealGrasp(f"g{k}", config, int(k < 2), "", ()) for k in range(3))
    outcomes = {(one.grasp_id, 0.5): Outcome(1, "") for one in grasps}
    (warning,) = data_warnings(RealGrasps(tmp_path, grasps, ()), outcomes, (0.5,))
    assert warning == "1 grasp(s) repeat another's place, force and label: left out"

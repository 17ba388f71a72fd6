"""The Gaussian process beside the law: what it makes of numbers that a log lacks."""

import numpy as np
import pytest

from tacgen.diagnose.contact.channel import ChannelSamples
from tacgen.diagnose.contact.heldout import gp_rmse, select
from tests.contact.effects.test_registry import press_columns


def gp_residual_rmse(radius_mm=None, **others):
    """RMS left on the last trials where the residual follows x, and the log has these columns."""
    columns = press_columns(n_trials=16, n_samples=20)
    columns["volume_mm3"] = columns["force_normal_n"] * 2.0
    columns.pop("radius_mm")
    trial = columns["trial"]
    if radius_mm is not None:
        columns["radius_mm"] = radius_mm(trial)
    columns |= {name: of_trial(trial) for name, of_trial in others.items()}
    parts = [
        ChannelSamples(select(columns, rows), "normal").thinned(10)
        for rows in (trial < 12, trial >= 12)
    ]
    fitted, test = ((part, np.sin(part.history.column("x_mm"))[:, None]) for part in parts)
    return gp_rmse(*fitted, *test, np.random.default_rng(0))


def test_a_column_without_a_number_changes_nothing():
    without = gp_residual_rmse()
    assert gp_residual_rmse(lambda trial: np.full(trial.size, np.nan)) == without
    # Flat indenters in all that is fitted, balls in the test: the process cannot have learned them.
    assert gp_residual_rmse(lambda trial: np.where(trial < 12, np.nan, 3.0)) == without


def test_an_unknown_number_is_at_the_mean_of_the_fit():
    def radius(trial):
        return np.where(trial % 2, 2.0, 4.0)

    gaps = gp_residual_rmse(lambda trial: np.where(trial < 12, radius(trial), np.nan))
    filled = gp_residual_rmse(lambda trial: np.where(trial < 12, radius(trial), 3.0))
    assert gaps == pytest.approx(filled, rel=1e-9)

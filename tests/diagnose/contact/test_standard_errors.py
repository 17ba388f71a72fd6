"""Errors of an extended law are those of presses: each may have a gain of its own."""

import numpy as np
import pytest

from tacgen.calibrate.contact.slope_fit import clustered
from tacgen.contact.effects import find_effect, kernels
from tacgen.diagnose.contact.channel import ChannelSamples
from tacgen.diagnose.contact.model import (
    Model,
    fit_model,
    references_of,
    standard_errors,
    start_term,
)

K_N, AMOUNT, TAU_S = 5.0, 0.4, 3.0
ROWS = 60


def creeping_presses(count, rng, gain=0.08):
    """Columns of presses of a creeping gel whose gains scatter by ``gain``."""
    time_s, parts = np.linspace(0.0, 12.0, ROWS), []
    for trial in range(count):
        course = np.interp(time_s, [0, 1, 2, 8, 10, 12], [0, 0, 1, 1, 0, 0])
        force = rng.uniform(1.0, 4.0) * course
        crept = force + AMOUNT * kernels.low_pass(force, time_s, np.array([0, ROWS]), TAU_S, True)
        volume = K_N * (1.0 + gain * rng.standard_normal()) * crept
        volume = volume + 0.05 * rng.standard_normal(ROWS)
        parts.append((np.full(ROWS, trial), time_s + 60.0 * trial, force, volume))
    names = ("trial", "time_s", "force_normal_n", "volume_mm3")
    return dict(zip(names, map(np.concatenate, zip(*parts, strict=True)), strict=True))


def fitted(columns):
    data = ChannelSamples(columns, "normal").thinned(ROWS)
    creep = find_effect("normal", "creep")
    forms = creep.variants(data.history, references_of(creep, data))
    form = [one for one in forms if one.label.startswith("recovering, tau")][2]
    return data, fit_model(data, Model(K_N, (start_term(creep, form, data, [1.0]),)))


@pytest.mark.slow
@pytest.mark.parametrize("count", [4, 8, 16])
def test_the_interval_of_a_law_with_an_effect_covers_the_truth(count):
    inside, values = 0, []
    for seed in range(60):
        data, fit = fitted(creeping_presses(count, np.random.default_rng([seed, count])))
        error = standard_errors(data, fit, of_presses=True).compliance
        inside += abs(fit.model.compliance - K_N) < 1.96 * error
        values.append(error)
    assert inside >= 53  # of 60 at 95 %: fewer by chance in one of 100
    # Gains of 8 % give k an error of 8 % over the root of the presses, wider by Student's t.
    assert np.median(values) < 2.5 * 0.08 * K_N / np.sqrt(count)


@pytest.mark.slow
def test_the_error_is_that_of_a_bootstrap_over_presses():
    columns, rng = creeping_presses(12, np.random.default_rng(5)), np.random.default_rng(6)
    data, fit = fitted(columns)
    drawn = []
    for _ in range(60):
        rows = (rng.integers(0, 12, 12)[:, None] * ROWS + np.arange(ROWS)).ravel()
        again = {name: values[rows] for name, values in columns.items()}
        again["trial"] = np.repeat(np.arange(12), ROWS)
        again["time_s"] = again["time_s"] % 60.0 + 60.0 * again["trial"]
        drawn.append(fitted(again)[1].model.compliance)
    # Student's t and the fit's share of each residual make it 1.2 times as wide.
    error = standard_errors(data, fit, of_presses=True).compliance
    assert error == pytest.approx(1.2 * np.std(drawn), rel=0.25)


def test_the_scatter_of_equal_presses_is_that_of_their_means():
    """One number, presses that say as much of it: s²/G, of G − 1 degrees of freedom."""
    means = np.random.default_rng(1).standard_normal(9)
    covariance, freedom = clustered((means - means.mean())[:, None], np.ones((9, 1, 1)))
    assert covariance[0, 0] == pytest.approx(means.var(ddof=1) / 9)
    assert freedom[0] == pytest.approx(8.0, rel=0.02)

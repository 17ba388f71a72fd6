"""Plain ways of choosing terms, on a linear model whose terms are known."""

from types import SimpleNamespace

import numpy as np
import pytest

from validation.contact import others


def problem(weights, rng, n=600):
    """Ten single-column forms beside a linear law, noise of a tenth; the interface of Problem."""
    made = others.Problem.__new__(others.Problem)
    made.load = np.abs(rng.normal(size=(n, 1)))
    made.columns = [rng.normal(size=(n, 1)) for _ in weights]
    made.forms = [SimpleNamespace() for _ in weights]
    made.trial = np.repeat(np.arange(n // 20), 20)
    design = np.hstack([made.load, *made.columns])
    made.target = design @ np.array([5.0, *weights]) + 0.1 * rng.normal(size=n)
    return made


@pytest.mark.parametrize("way", ["stepwise", "LASSO, BIC", "STLSQ"])
def test_the_terms_that_act_are_chosen(way):
    weights = [0.0, 1.0, 0.0, 0.0, -0.7, 0.0, 0.0, 0.5, 0.0, 0.0]
    made = problem(weights, np.random.default_rng(3))
    chosen = others.OTHERS[way](made)
    if way == "LASSO, BIC":  # keeps small terms beside the true ones (Zou 2006)
        assert set(chosen) >= {1, 4, 7}
    else:
        assert set(chosen) == {1, 4, 7}
    coefficients, left = made.fitted([1, 4, 7])
    assert coefficients == pytest.approx([5.0, 1.0, -0.7, 0.5], abs=0.03)  # some 6 standard errors
    assert left == pytest.approx(600 * 0.01, rel=0.3)

"""Which effects are added to a table, on residuals made of the effects' own columns."""

from dataclasses import replace

import numpy as np
import pytest

from tacgen.diagnose.engine import reached, search
from tacgen.diagnose.optics.fit import Known, Model
from tacgen.diagnose.optics.selection import PressProblem
from tacgen.diagnose.rules import OPTICS
from tacgen.optics.effects import PressScene

N_PRESSES, N_PIXELS = 24, 200
SCENE = PressScene(1.5, np.full(N_PRESSES, 2.5), 0.1, has_table=False, grey=np.zeros((1, 3)))


class LinearFit:
    """Presses in which each effect is a column: what a fit leaves is what is orthogonal to them."""

    def __init__(self, rules, columns, residual):
        self.rules, self._columns, self._residual = rules, columns, residual

    def residuals(self, model, _known):
        flat = self._residual.ravel()
        columns = [self._columns[candidate.effect].ravel() for candidate in model.candidates]
        basis = np.stack(columns, axis=1) if columns else np.zeros((flat.size, 1))
        left = flat - basis @ np.linalg.lstsq(basis, flat, rcond=None)[0]
        return list(left.reshape(N_PRESSES, N_PIXELS, 3))

    def squares(self, model, known):
        return self.mean_squares(self.residuals(model, known))

    def mean_squares(self, residuals):
        return np.array([(residual**2).mean() for residual in residuals])

    def by_press(self, values):
        return values

    def fitted(self, model, _known):
        return model

    def placed(self, model):
        return model


def found(rules, hiding, sizes=(6.0, 6.0)):
    """What is found of a skirt and a shadow whose columns have a cosine of −``hiding``."""
    rng = np.random.default_rng(4)
    first, other, noise = rng.normal(size=(3, N_PRESSES, N_PIXELS, 3))
    columns = {
        "skirt": first,
        "shadow": -hiding * first + np.sqrt(1 - hiding**2) * other,
    }
    residual = 2 * noise + sizes[0] * columns["skirt"] + sizes[1] * columns["shadow"]
    fit = LinearFit(rules, columns, residual)
    problem = PressProblem(fit, SCENE, (Known.NOTHING, False, False), set())
    problem.listed = [one for one in problem.listed if one.rigid]
    steps = search(problem, problem.unchanged(Model((), {}, {}, np.zeros((N_PRESSES, 3)))))
    return steps, [one.effect for one in reached(steps).members]


def test_effects_that_hide_each_other_are_found_together():
    """Alone each explains the part (1 − 0.98) / 2 of what both explain, which is too little."""
    steps, members = found(OPTICS, hiding=0.98)
    assert all(one.gain < OPTICS.least_gain_of_rigid for one in steps[0].tried)
    assert sorted(members) == ["shadow", "skirt"]
    assert found(replace(OPTICS, max_growth=1), hiding=0.98)[1] == []


@pytest.mark.parametrize("sizes", [(6.0, 0.0), (0.0, 6.0)])
def test_an_effect_alone_brings_no_other_along(sizes):
    expected = "skirt" if sizes[0] else "shadow"
    assert found(OPTICS, hiding=0.5, sizes=sizes)[1] == [expected]

"""The probability of a label against closed forms and against drawing the uncertain quantities."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm

from tacgen.collection.confidence import label_confidence
from tacgen.collection.recipe import Recipe, Uncertainty
from tacgen.core.records import SlipMargin

EXACT_PLACE = Uncertainty(force_relative=0.04, friction_relative=0.03, position_mm=0.0)
ARM_MM = 3.5


def trace(share, lever_mm, label=None):
    """A grasp whose weight takes up ``share`` of the friction, its centre ``lever_mm`` aside."""
    limit_mm = ARM_MM / share * np.sqrt(max(0.0, 1 - share**2))
    ratio = limit_mm / lever_mm if lever_mm else np.inf
    margin = SlipMargin(1 / share - 1, limit_mm - lever_mm, np.nan, np.zeros(2), 1 / share, ratio)
    held = int(share < 1 and lever_mm < limit_mm) if label is None else label
    return SimpleNamespace(margin=margin, label=held, config=SimpleNamespace(z_mm=60.0))


def confidence(grasp, uncertainty, hang_mm=0.0):
    recipe = Recipe(name="r", objects=["cup"], uncertainty=uncertainty)
    held = SimpleNamespace(center_of_mass_mm=np.array([0.0, 0.0, 60.0 - hang_mm]))
    return label_confidence(grasp, held, recipe)


@pytest.mark.parametrize("share", [0.8, 0.97, 1.0, 1.03, 1.2])
def test_without_a_moment_it_is_the_normal_distribution_of_the_friction(share):
    expected = norm.cdf(abs(np.log(share)) / 0.05)
    assert confidence(trace(share, 0.0), EXACT_PLACE) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize(
    ("share", "lever_mm", "hang_mm"),
    [(0.3, 8.0, 0.0), (0.3, 11.0, 0.0), (0.3, 14.0, 0.0), (0.6, 3.0, 20.0), (0.85, 1.5, -20.0)],
)
def test_it_is_the_share_of_draws_with_the_same_label(share, lever_mm, hang_mm):
    uncertainty = Uncertainty(force_relative=0.06, friction_relative=0.08, position_mm=0.7)
    rng = np.random.default_rng(3)
    force, friction = np.exp([[0.06], [0.08]] * rng.standard_normal((2, 200_000)))
    y_mm = 0.7 * rng.standard_normal(200_000)
    shares = share / (force * friction)
    allowed_mm = ARM_MM / shares * np.sqrt(np.maximum(0, 1 - shares**2))
    held = (shares < 1) & (np.abs(lever_mm + y_mm) < allowed_mm + max(0, hang_mm) * 0.05)
    grasp = trace(share, lever_mm)
    expected = np.mean(held == (grasp.label == 1))
    if expected < 0.5:  # a label that the closed form contradicts
        expected = 0.5
    # 2 %: what the swing adds to the lever is taken to grow with the force as the limit does.
    assert confidence(grasp, uncertainty, hang_mm) == pytest.approx(expected, abs=0.02)


def test_an_object_that_hangs_may_swing_to_the_turn_of_a_success():
    """Twice the balance angle: a lever too long by 30 mm · 0.1/2 is just held."""
    limit_mm = ARM_MM / 0.4 * np.sqrt(1 - 0.4**2)
    on_border = trace(0.4, limit_mm + 1.5, label=1)
    assert confidence(on_border, EXACT_PLACE, 30.0) == pytest.approx(0.5, abs=0.01)
    assert confidence(trace(0.4, limit_mm, label=1), EXACT_PLACE, 30.0) > 0.95


def test_a_label_that_the_closed_form_contradicts_is_on_the_border():
    assert confidence(trace(0.7, 0.0, label=0), EXACT_PLACE) == pytest.approx(0.5)
    assert confidence(trace(1.3, 0.0, label=1), EXACT_PLACE) == pytest.approx(0.5)


@pytest.mark.parametrize("limit_mm", [0.3, 0.95, 1.6, 4.0])
@pytest.mark.parametrize("lever_mm", [0.0, 1.0])
def test_a_narrow_patch_holds_only_where_the_place_is_right(limit_mm, lever_mm):
    """An object that hardly takes up friction: the place decides, and it is integrated here."""
    grasp = trace(0.1, lever_mm, label=int(lever_mm < limit_mm))
    ratio = limit_mm / lever_mm if lever_mm else np.inf
    grasp.margin = SlipMargin(9.0, limit_mm - lever_mm, np.nan, np.zeros(2), 10.0, ratio)
    y_mm = np.linspace(-6, 6, 20_001)
    square = 0.1**2 + (1 - 0.1**2) * ((lever_mm + y_mm) / limit_mm) ** 2
    held = norm.cdf(-0.5 * np.log(square) / np.hypot(0.05, 0.05))
    expected = np.average(held, weights=norm.pdf(y_mm))
    if grasp.label == 0:
        expected = 1 - expected
    given = Uncertainty(force_relative=0.05, friction_relative=0.05, position_mm=1.0)
    assert confidence(grasp, given) == pytest.approx(expected, abs=0.01)


def test_pads_that_hold_no_moment_lose_an_object_that_needs_one():
    lost, held = trace(1 / 3, 5.0, label=0), trace(1 / 3, 5.0, label=1)
    lost.margin = held.margin = SlipMargin(2.0, -5.0, np.nan, np.zeros(2), 3.0, 0.0)
    assert confidence(lost, EXACT_PLACE) > 0.99
    assert confidence(held, EXACT_PLACE) == pytest.approx(0.5)


def test_an_object_held_without_friction_is_on_the_border():
    grasp = trace(2.0, 0.0, label=1)
    grasp.margin = SlipMargin(-1.0, 0.0, np.nan, np.zeros(2), 0.0, np.inf)
    assert confidence(grasp, EXACT_PLACE) == pytest.approx(0.5)

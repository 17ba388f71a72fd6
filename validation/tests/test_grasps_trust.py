"""What the trust study counts; the study itself takes hours."""

import numpy as np
import pytest

from tacgen.diagnose.grasps.hypotheses import candidates_for
from tacgen.diagnose.grasps.model_comparison import Cause, Explanation, Posterior, interpolated
from validation.grasps.trust import CASES, Trial, judged, judged_undecided, summary_of, wrong_values

CANDIDATES = {one.parameter.key: one for one in candidates_for(("cup",))}


def cause(key, coordinate, deviation=0.03):
    nodes = np.array(CANDIDATES[key].parameter.nodes)
    table = np.zeros((len(nodes), 1))
    model = interpolated(CANDIDATES[key], nodes, table, table + 0.5)
    return Cause(model, coordinate, deviation)


def on_a_ridge(p_value=0.002):
    """A force of 0.56, of which a mass may be a part: what data tell is to 0.03, of log F/m."""
    data = np.array([[1.0, -1.0], [-1.0, 1.0]]) / 0.03**2
    covariance = np.linalg.inv(data + np.diag([1 / 0.2**2, 1 / 0.4**2]))
    force = np.log(0.56)
    both = (cause("force_scale", 0.3 * force, 0.18), cause("mass_factor", -0.7 * force, 0.18))
    return Posterior(
        (
            Explanation((cause("force_scale", force),), 20.0, 20.0, np.diag([0.03**2])),
            Explanation(both, 17.0, 20.0, covariance),
        ),
        p_value,
        2.0,
    )


@pytest.mark.parametrize(
    ("truth", "expected"),
    [
        ({"grip_force": 0.56}, "right"),
        ({"mass": 1 / 0.56}, "confounded"),
        ({"grip_force": 0.8, "mass": 0.8 / 0.56}, "confounded"),
        # The product is said to be another.
        ({"grip_force": 0.8, "mass": 1.1}, "false"),
        ({"grip_force": 0.56, "center_of_mass": 18.0}, "missed"),
        ({"center_of_mass": 18.0}, "false"),
        ({}, "false"),
    ],
)
def test_a_product_must_hold_all_causes_and_be_the_true_one(truth, expected):
    assert judged(on_a_ridge(), truth, ("cup",)) == expected


@pytest.mark.parametrize(
    ("truth", "expected"),
    [
        ({"grip_force": 0.8, "mass": 0.8 / 0.56}, "confounded"),
        ({"grip_force": 0.8, "mass": 1.1}, "undecided"),
        ({"mass": 1 / 0.56}, "undecided"),  # alone it compensates nothing
        ({"grip_force": 0.8, "center_of_mass": 18.0}, "undecided"),
    ],
)
def test_where_nothing_is_named_a_product_of_all_causes_must_be_stated(truth, expected):
    assert judged_undecided(on_a_ridge(p_value=0.5), truth, ("cup",)) == expected


def test_every_pair_is_a_case_and_half_of_the_values_are_the_other_way_round():
    assert sum(len(one) == 2 for one in CASES) == 10
    forces = {wrong_values(seed)["grip_force"] for seed in range(10)}
    assert forces == {0.8, 1.25}


def test_trials_that_change_too_few_labels_are_counted_apart():
    named = ("mass",), (1.4,), (("friction",),)
    trial = Trial("cup", ("mass",), 0.05, True, *named, "right", 0.2, 0.05, False, 0.6)
    few = Trial("cup", ("mass",), 0.05, False, (), (), (), "missed", 0.02, 0.02, True, 0.1)
    row = "| 1 | 5 % | 2 | 1 | 1 (0) | 0 | 0 | 0 | 0 | 0 | 2.0 | 60 % | 20.0 → 5.0 % |"
    assert row in summary_of([trial, few])


def also_possible(*causes):
    """A force is named; these, each known to 0.03, are half as probable."""
    known = np.diag([0.03**2] * len(causes))
    named = Explanation((cause("force_scale", 0.5),), 20.0, 20.0, np.diag([0.03**2]))
    return Posterior((named, Explanation(causes, 19.3, 20.0, known)), 0.002, 2.0)


@pytest.mark.parametrize(
    ("causes", "objects", "expected"),
    [
        ((("friction_factor", -0.35), ("center_of_mass_y_mm", 18.05)), ("cup",), "alternative"),
        # One value is off by four standard deviations.
        ((("friction_factor", -0.35), ("center_of_mass_y_mm", 18.12)), ("cup",), "false"),
        # Along another axis, of another object, one cause too few.
        ((("friction_factor", -0.35), ("center_of_mass_x_mm", 18.0)), ("cup",), "false"),
        ((("friction_factor", -0.35), ("center_of_mass_y_mm", 18.0)), ("jug", "cup"), "false"),
        ((("friction_factor", -0.35),), ("cup",), "false"),
    ],
)
def test_only_the_whole_truth_counts_as_an_alternative(causes, objects, expected):
    found = also_possible(*(cause(key, coordinate) for key, coordinate in causes))
    truth = {"friction": np.exp(-0.35), "center_of_mass": 18.0}
    assert judged(found, truth, objects) == expected
    assert judged(found, {}, objects) == "false"

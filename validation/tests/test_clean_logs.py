"""The clean logs of the study of false names: what spoils them is what their kind says."""

import numpy as np
import pytest

from validation.blind.generator import draw_case
from validation.contact import clean_logs


def spoiled(kind, seed=3):
    """A spoiled log, its case, and the error (n,) of its volume over the noise."""
    case = draw_case(seed, n_trials=40, with_shear=True)
    frame = clean_logs.KINDS[kind][0](case.frame, case, np.random.default_rng(seed))
    truth = case.volume_mm3[frame.index]
    return frame, (frame["volume_mm3"].to_numpy() - truth) / case.noise_mm3


@pytest.mark.parametrize("kind", clean_logs.KINDS)
def test_every_kind_has_the_columns_of_a_log_and_no_effect(kind):
    frame, error = spoiled(kind)
    assert {"trial", "time_s", "force_normal_n", "volume_mm3"} <= set(frame)
    force = frame["force_normal_n"].to_numpy()
    error = error[np.isfinite(error)]
    # A gain of 2 % a trial adds up to 4 noises here; other kinds' errors are about the noise.
    assert 0.3 < np.median(np.abs(error)) / 0.67 < 4.0
    assert len(force) > 1000


def test_trials_that_bend_have_a_curvature_each():
    case = draw_case(3, n_trials=40, with_shear=True)
    bent = clean_logs.KINDS["trials that bend by 3 %"][0]
    frame = bent(case.frame, case, np.random.default_rng(3))
    volume = case.frame["volume_mm3"]
    share = volume.abs() / volume.abs().max()
    bends = ((frame["volume_mm3"] / volume - 1) / share).groupby(frame["trial"])
    assert bends.std().max() < 1e-9
    # The standard deviation of 40 normal numbers is known to 11 %.
    assert bends.mean().std() == pytest.approx(0.03, rel=0.4)


def test_the_table_counts_logs_with_a_false_name_once():
    said = {"effects": [], "unexplained": []}
    wrong = {"effects": ["creep"], "unexplained": []}
    kind = next(iter(clean_logs.KINDS))
    results = [
        {"kind": kind, "said": {"normal": wrong, "shear": wrong}},
        {"kind": kind, "said": {"normal": said, "shear": {**said, "unexplained": ["lamp"]}}},
    ]
    rows = clean_logs.table(results).splitlines()[2:]
    # Clopper and Pearson's interval of 1 in 2 is 1.3 to 98.7 %.
    assert rows == [f"| {name} | 2 | 1 | 1.3 to 98.7 % | 1 |" for name in (kind, "all")]

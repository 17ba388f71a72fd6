"""What gauge and gel read at rest is no part of the law."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tacgen.calibrate.contact.align import without_zero
from tacgen.calibrate.contact.law_fit import fit_contact
from tacgen.presses.press_log import read_press_log

K_N, K_S = 5.135, 0.8
N_TRIALS, N_ROWS = 24, 40


def session(seed: int = 0, first: tuple[int, float] = (6, 0.0)) -> pd.DataFrame:
    """Presses from rest and back, noise of 0.01 N, 0.1 mm³ and 0.02 mm.

    Until row ``first[0]`` the force rises to that share of its largest.
    """
    rng = np.random.default_rng(seed)
    course = np.interp(
        np.arange(N_ROWS), [0, first[0], 16, 24, 34, N_ROWS], [0, first[1], 1, 1, 0, 0]
    )
    parts = []
    for trial in range(N_TRIALS):
        force = rng.uniform(3, 8) * course
        shear = 0.3 * force * course
        noise = rng.standard_normal((4, N_ROWS))
        parts.append(
            pd.DataFrame(
                {
                    "trial": trial,
                    "time_s": 0.05 * np.arange(N_ROWS) + 5.0 * trial,
                    "force_normal_n": force + 0.01 * noise[0],
                    "volume_mm3": K_N * force + 0.1 * noise[1],
                    "force_shear_x_n": shear + 0.01 * noise[2],
                    "force_shear_y_n": 0.0,
                    "shear_x_mm": K_S * shear + 0.02 * noise[3],
                    "shear_y_mm": 0.0,
                }
            )
        )
    return pd.concat(parts, ignore_index=True)


def read(frame: pd.DataFrame, folder: Path):
    path = folder / "log.csv"
    frame.to_csv(path, index=False)
    return read_press_log(path)


def zeros_said(fit) -> list[str]:
    return [text for text in fit.warnings if "rest" in text]


def test_nothing_is_subtracted_where_all_is_zero_at_rest(tmp_path):
    log = read(session(), tmp_path)
    assert without_zero(log) is not None
    assert without_zero(log).columns == dict(log.columns)
    assert zeros_said(fit_contact(log)) == []


@pytest.mark.parametrize("offset_n", [-1.3, 0.1])
def test_a_gauge_that_was_not_tared(tmp_path, offset_n):
    """The interval holds the truth as often as it says: ≥ 4 of 5 in 98 of 100 such tests."""
    covered = 0
    for seed in range(5):
        frame = session(seed)
        frame["force_normal_n"] += offset_n
        fit = fit_contact(read(frame, tmp_path))
        low, high = fit.normal.pooled.interval
        covered += low < K_N < high
        assert fit.normal.pooled.value == pytest.approx(K_N, rel=0.001)
        (said,) = zeros_said(fit)
        stated = float(said.split("force_normal_n is ")[1].split(" N")[0])
        assert stated == pytest.approx(offset_n, abs=0.01)  # of three digits
    assert covered >= 4


@pytest.mark.parametrize(
    ("name", "offset"), [("volume_mm3", 2.0), ("force_shear_x_n", 0.4), ("shear_x_mm", -0.3)]
)
def test_a_volume_or_a_shear_that_is_not_zero_at_rest(tmp_path, name, offset):
    frame = session()
    frame[name] += offset
    fit = fit_contact(read(frame, tmp_path))
    assert fit.normal.pooled.value == pytest.approx(K_N, rel=0.005)
    assert fit.shear is not None
    assert fit.shear.pooled.value == pytest.approx(K_S, rel=0.01)
    (said,) = zeros_said(fit)
    assert name in said


def test_a_zero_that_wanders_between_presses(tmp_path):
    frame = session()
    zero_n = 0.5 * np.cumsum(np.random.default_rng(1).standard_normal(N_TRIALS))
    frame["force_normal_n"] += zero_n[frame["trial"]]
    log = read(frame[frame.groupby("trial")["force_normal_n"].transform("max") > 0], tmp_path)
    fit = fit_contact(log)
    assert fit.normal.pooled.value == pytest.approx(K_N, rel=0.005)
    (said,) = zeros_said(fit)
    assert "differs from press to press" in said


def test_presses_that_do_not_begin_at_rest_state_no_zero(tmp_path):
    """All begin on their way down: the lowest rows are not the first."""
    frame = session()
    frame["force_normal_n"] += 1.0
    later = frame[frame.groupby("trial").cumcount() >= 20]
    log = read(later, tmp_path)
    assert without_zero(log) is log


def test_a_noise_free_log_states_its_zero_exactly(tmp_path):
    frame = session()
    course = frame["force_normal_n"].round(0)
    frame["force_normal_n"], frame["volume_mm3"] = course - 1.0, K_N * course
    frame = frame.drop(columns=[name for name in frame if "shear" in name])
    log = without_zero(read(frame, tmp_path))
    np.testing.assert_allclose(K_N * log["force_normal_n"], log["volume_mm3"], atol=1e-9)

"""Rows that are no readings of their own are found and reduced; logs as measured are left alone."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

from tacgen.calibrate.contact.law_fit import fit_contact
from tacgen.presses.independent_rows import independent_rows
from tacgen.presses.press_log import read_press_log
from validation.contact.recordings import RESPONSES, doubled, held, resampled, smoothed

K_N = 5.0
N_TRIALS, N_ROWS = 24, 80
NOISE_N, NOISE_MM3 = 0.01, 0.3


def measured(seed: int = 0, *, memory: float = 0.0, slow_share: float = 0.0) -> pd.DataFrame:
    """Trapezoids with a rest before and after, one independent reading a row.

    A part of the noise of the volume is an AR(1) of that memory.
    """
    rng = np.random.default_rng(seed)
    parts = []
    for trial in range(N_TRIALS):
        shape = np.interp(np.arange(N_ROWS), [0, 8, 28, 50, 68, N_ROWS], [0, 0, 1, 1, 0, 0])
        force = rng.uniform(3, 9) * shape
        white, slow = rng.standard_normal((2, N_ROWS))
        slow = np.sqrt(1 - memory**2) * lfilter([1.0], [1.0, -memory], slow)
        noise = np.sqrt(1 - slow_share) * white + np.sqrt(slow_share) * slow
        parts.append(
            pd.DataFrame(
                {
                    "trial": trial,
                    "time_s": 0.05 * np.arange(N_ROWS) + 6.0 * trial,
                    "force_normal_n": force + NOISE_N * rng.standard_normal(N_ROWS),
                    "volume_mm3": K_N * force + NOISE_MM3 * noise,
                }
            )
        )
    return pd.concat(parts, ignore_index=True)


def reduced(frame: pd.DataFrame) -> tuple[pd.DataFrame, list[str]]:
    keep, notes = independent_rows({name: frame[name].to_numpy() for name in frame})
    return frame[keep].reset_index(drop=True), notes


def test_rows_that_are_independent_are_all_kept() -> None:
    kept, notes = reduced(measured())
    assert len(kept) == N_TRIALS * N_ROWS
    assert notes == []


@pytest.mark.parametrize(("memory", "share"), [(0.6, 0.5), (0.9, 0.5), (0.3, 1.0)])
def test_noise_with_a_white_part_is_left_as_it_is(memory: float, share: float) -> None:
    """The diagnosis stands brief correlation, and what lasts is not mended by taking fewer rows."""
    _, notes = reduced(measured(memory=memory, slow_share=share))
    assert notes == []


def test_an_exact_value_at_rest_is_no_reading_that_stands() -> None:
    frame = measured()
    at_rest = frame["force_normal_n"].abs() < 0.1
    frame.loc[at_rest, ["force_normal_n", "volume_mm3"]] = 0.0
    _, notes = reduced(frame)
    assert notes == []


@pytest.mark.parametrize("step_n", [0.05, 0.2, 1.0])
def test_a_coarse_gauge_is_not_a_slow_one(step_n: float) -> None:
    frame = measured()
    frame["force_normal_n"] = step_n * np.round(frame["force_normal_n"] / step_n)
    _, notes = reduced(frame)
    assert notes == []


def test_a_commanded_force_that_is_held_is_no_reading_that_stands() -> None:
    """While the force stands the volume does, too: it does not go on as if the force had."""
    frame = measured()
    steps = frame.groupby("trial").cumcount() // 6
    true_n = (steps % 11) * 0.7
    noise = frame["volume_mm3"] - K_N * frame["force_normal_n"]
    frame["force_normal_n"] = true_n
    frame["volume_mm3"] = K_N * true_n + noise
    _, notes = reduced(frame)
    assert notes == []


@pytest.mark.parametrize("rows", [2, 3, 4, 8])
@pytest.mark.parametrize("names", [("force_normal_n",), RESPONSES])
def test_the_first_row_of_a_reading_that_stands_is_kept(rows: int, names: tuple[str, ...]) -> None:
    frame = measured()
    kept, (note,) = reduced(held(frame, rows, names))
    fresh = frame[frame.groupby("trial").cumcount() % rows == 0].reset_index(drop=True)
    pd.testing.assert_frame_equal(kept, fresh)
    present = next(name for name in names if name in frame)
    assert f"each reading of {present} stands in {rows} rows" in note
    assert f"({20 / rows:.3g} Hz)" in note
    assert f"({len(fresh)} of {len(frame)} rows)" in note


def test_a_gauge_whose_rate_is_no_part_of_the_logs() -> None:
    """Its readings stand in two rows or in three; each is kept once."""
    frame = measured()
    place = frame.groupby("trial").cumcount().to_numpy()
    first = np.ceil(np.floor(place / 2.5) * 2.5).astype(int)
    slow = frame.copy()
    slow["force_normal_n"] = frame["force_normal_n"].to_numpy()[
        np.arange(len(frame)) - place + first
    ]
    kept, (note,) = reduced(slow)
    assert "stands in 2.5 rows" in note
    pd.testing.assert_frame_equal(kept, frame[place == first].reset_index(drop=True))


@pytest.mark.parametrize("clock_runs", [False, True])
def test_doubled_rows_are_used_once(clock_runs: bool) -> None:
    frame = measured()
    kept, (note,) = reduced(doubled(frame, clock_runs=clock_runs))
    pd.testing.assert_frame_equal(kept, frame)
    assert "repeat the row before them" in note or "every row stands in 2 rows" in note


@pytest.mark.parametrize("spoilt", [lambda f: resampled(f, 3), lambda f: smoothed(f, 5)])
def test_smoothed_rows_are_left_and_the_compliance_is_as_sure(spoilt, tmp_path: Path) -> None:
    """Errors are of presses, however many rows are made of each."""
    laws = []
    for name, frame in (("measured", measured()), ("spoilt", spoilt(measured()))):
        frame.to_csv(tmp_path / f"{name}.csv", index=False)
        log = read_press_log(tmp_path / f"{name}.csv")
        assert len(log.columns["trial"]) == len(frame)
        laws.append(fit_contact(log).law.k_n_mm3_per_n)
    assert laws[1].value == pytest.approx(laws[0].value, abs=laws[0].stderr)
    # 24 presses tell a standard error to 15 %; smoothing takes noise away.
    assert laws[1].stderr == pytest.approx(laws[0].stderr, rel=0.5)


def test_a_log_written_twice_a_row_says_so_and_is_as_good_as_once(tmp_path: Path) -> None:
    laws = []
    for name, frame in (("once", measured()), ("twice", doubled(measured(), clock_runs=True))):
        frame.to_csv(tmp_path / f"{name}.csv", index=False)
        log = read_press_log(tmp_path / f"{name}.csv")
        laws.append(fit_contact(log).law)
    assert any("every row stands in 2 rows" in warning for warning in log.warnings)
    assert laws[0].k_n_mm3_per_n == laws[1].k_n_mm3_per_n

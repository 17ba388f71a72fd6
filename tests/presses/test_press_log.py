"""Press logs: what is read, what is refused, what is left out and said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tacgen.core.errors import PressError
from tacgen.presses.lab_table import LogFormat
from tacgen.presses.press_log import read_press_log

N_SAMPLES = 40


def log_frame(n_trials: int = 5) -> pd.DataFrame:
    """A clean log: triangles of 6 N at 5 mm³/N, one clock, two balls, shear in every trial."""
    rng = np.random.default_rng(1)
    ramp = 6.0 * (1.0 - np.abs(np.linspace(-1.0, 1.0, N_SAMPLES)))
    trials = []
    for trial in range(n_trials):
        force = ramp + 0.01 * rng.standard_normal(N_SAMPLES)
        trials.append(
            pd.DataFrame(
                {
                    "trial": trial,
                    "time_s": 10.0 * trial + 0.1 * np.arange(N_SAMPLES),
                    "indenter": f"ball_{trial % 2}",
                    "radius_mm": 2.0 + trial % 2,
                    "force_normal_n": force,
                    "volume_mm3": 5.0 * ramp + 0.02 * rng.standard_normal(N_SAMPLES),
                    "force_shear_x_n": 0.2 * force,
                    "force_shear_y_n": 0.0,
                    "shear_x_mm": 0.3 * force,
                    "shear_y_mm": 0.0,
                    "temperature_c": 20.0 + trial,
                    "operator": "ann" if trial < 3 else "bob",
                }
            )
        )
    return pd.concat(trials, ignore_index=True)


def write(frame: pd.DataFrame, folder: Path, name: str = "log.csv") -> Path:
    path = folder / name
    frame.to_csv(path, index=False)
    return path


def refusal(frame: pd.DataFrame, folder: Path) -> str:
    path = write(frame, folder)
    with pytest.raises(PressError) as error:
        read_press_log(path)
    assert str(path) in str(error.value)
    return str(error.value)


def test_a_clean_log_is_kept_whole(tmp_path):
    frame = log_frame()
    log = read_press_log(write(frame, tmp_path))
    assert (len(log), log.dropped, log.warnings, log.session_clock) == (len(frame), (), (), True)
    np.testing.assert_allclose(log["volume_mm3"], frame["volume_mm3"])
    assert log.covariates == ("temperature_c", "operator")
    assert log["operator"][0] == "ann"
    assert log.has_shear
    assert list(log.trials) == [0, 1, 2, 3, 4]
    assert log.rows[0] == 2, "the header is row 1, as in a spreadsheet"


def test_parquet_reads_as_csv_does(tmp_path):
    frame = log_frame()
    frame.to_parquet(tmp_path / "log.parquet")
    by_parquet = read_press_log(tmp_path / "log.parquet")
    by_csv = read_press_log(write(frame, tmp_path))
    for name in frame.columns:
        if by_csv[name].dtype.kind == "U":
            assert (by_parquet[name] == by_csv[name]).all()
        else:
            np.testing.assert_allclose(by_parquet[name], by_csv[name], rtol=1e-14)


def test_only_the_required_columns_are_needed(tmp_path):
    frame = log_frame()[["trial", "time_s", "force_normal_n", "volume_mm3"]]
    log = read_press_log(write(frame, tmp_path))
    assert not log.has_shear
    assert log.covariates == ()


def test_every_missing_column_is_named_at_once_with_a_guess(tmp_path):
    frame = log_frame().rename(columns={"force_normal_n": "force_norm"}).drop(columns="volume_mm3")
    message = refusal(frame, tmp_path)
    assert "'force_normal_n' is missing" in message
    assert "rename 'force_norm' if it is that" in message
    assert "'volume_mm3' or 'depth_mm' is missing" in message
    assert "found trial, time_s" in message
    assert "not read: 'force_norm', 'temperature_c'" in message


def test_cells_that_are_not_numbers_are_named_by_row(tmp_path):
    frame = log_frame().astype({"force_normal_n": object, "time_s": object})
    frame.loc[3, "force_normal_n"] = "heavy"
    frame.loc[7, "time_s"] = "0,7"
    message = refusal(frame, tmp_path)
    assert "row 5: force_normal_n = 'heavy'" in message
    assert "row 9: time_s = '0,7' is not a number; use a decimal point" in message


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "cannot be read"),
        ("trial,time_s,force_normal_n,volume_mm3\n", "holds no samples"),
        ("trial,trial,time_s\n1,1,0\n", "appear twice: trial"),
        ("trial,time_s,force_normal_n,volume_mm3\n1.5,0,1,5\n,0,1,5\n", "row 3: trial is empty"),
        ("trial,time_s,force_normal_n,volume_mm3\n1,0,1,5,6\n", "line 2 has 5 cells, the header 4"),
        ("trial,time_s,force_normal_n,volume_mm3\n1,0,1_0,5\n", "force_normal_n = '1_0' is not a"),
        ("trial,time_s,force_normal_n,volume_mm3\n1,0,١,5\n", "force_normal_n = '١' is not a"),
        (
            'trial,time_s,force_normal_n,volume_mm3\n1,0,"1,5\n2,0,1,5\n',
            "line 2 opens a quote that is not closed; close",
        ),
    ],
)
def test_files_that_are_no_log(tmp_path, text, words):
    path = tmp_path / "log.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(PressError, match=words.replace("(", r"\(")):
        read_press_log(path)


def test_marks_spaces_and_quotes_change_no_cell(tmp_path):
    """As spreadsheets and other programs write the same table."""
    frame = log_frame()
    plain = read_press_log(write(frame, tmp_path))
    header, *rows = frame.to_csv(index=False).splitlines()
    lines = ["\ufeff" + header.replace(",", " , ")]
    lines += [",".join(f'" {cell} "' for cell in row.split(",")) for row in rows]
    path = tmp_path / "other.csv"
    path.write_bytes("\r\n".join(lines).encode())
    other = read_press_log(path)
    assert list(other.columns) == list(plain.columns)
    for name in plain.columns:
        np.testing.assert_array_equal(other[name], plain[name])


def test_a_stiff_sample_pressed_by_a_gripper_is_not_grams(tmp_path):
    frame = log_frame()
    frame["force_normal_n"] *= 10.0
    assert read_press_log(write(frame, tmp_path)).dropped == ()


def test_one_empty_cell_costs_one_sample_and_is_said(tmp_path):
    frame = log_frame()
    frame.loc[50, "volume_mm3"] = np.nan
    log = read_press_log(write(frame, tmp_path))
    assert len(log) == len(frame) - 1
    assert 52 not in log.rows
    assert any("row 52" in text and "volume_mm3" in text for text in log.warnings)


def test_many_empty_cells_cost_the_press(tmp_path):
    frame = log_frame()
    frame.loc[45:70, "force_normal_n"] = np.nan
    log = read_press_log(write(frame, tmp_path))
    assert [trial.trial for trial in log.dropped] == [1]
    assert "row 47" in str(log.dropped[0])
    assert 1 not in log.trials


def test_infinity_counts_as_empty(tmp_path):
    frame = log_frame()
    frame.loc[3, "force_normal_n"] = np.inf
    log = read_press_log(write(frame, tmp_path))
    assert np.isfinite(log["force_normal_n"]).all()
    assert len(log) == len(frame) - 1


def test_time_going_backwards_leaves_the_press_out(tmp_path):
    frame = log_frame()
    frame.loc[90, "time_s"] -= 5.0
    log = read_press_log(write(frame, tmp_path))
    assert [trial.trial for trial in log.dropped] == [2]
    assert "time_s goes backwards at row 92" in str(log.dropped[0])


def test_a_clock_that_starts_again_is_said_and_kept(tmp_path):
    frame = log_frame()
    frame["time_s"] -= 10.0 * frame["trial"]
    log = read_press_log(write(frame, tmp_path))
    assert not log.session_clock
    assert log.dropped == ()
    assert any("drift" in text for text in log.warnings)


def test_a_gap_is_said(tmp_path):
    frame = log_frame()
    frame.loc[frame.index >= 100, "time_s"] += 30.0
    log = read_press_log(write(frame, tmp_path))
    assert log.dropped == ()
    assert any("row 102" in text and "jumps" in text for text in log.warnings)


def test_a_press_copied_under_another_number_is_left_out(tmp_path):
    frame = log_frame()
    copied = frame[frame["trial"] == 2].assign(trial=9, time_s=lambda data: data["time_s"] + 99.0)
    log = read_press_log(write(pd.concat([frame, copied]), tmp_path))
    assert [(trial.trial, trial.rows) for trial in log.dropped] == [(9, (202, 241))]
    assert "copy of trial 2 (from row 82)" in str(log.dropped[0])


def test_a_number_used_twice_keeps_the_first_press(tmp_path):
    frame = log_frame()
    frame.loc[frame["trial"] == 4, "trial"] = 1
    log = read_press_log(write(frame, tmp_path))
    assert [(trial.trial, trial.rows) for trial in log.dropped] == [(1, (162, 201))]
    assert (log["trial"] == 1).sum() == N_SAMPLES


def test_one_press_in_grams_is_left_out(tmp_path):
    frame = log_frame()
    frame.loc[frame["trial"] == 3, "force_normal_n"] *= 101.97
    log = read_press_log(write(frame, tmp_path))
    assert [trial.trial for trial in log.dropped] == [3]
    assert "grams" in log.dropped[0].reason


def test_a_press_without_contact_is_left_out(tmp_path):
    frame = log_frame()
    frame.loc[frame["trial"] == 0, "volume_mm3"] = 0.0
    frame.loc[frame["trial"] == 1, "force_normal_n"] = 2.0
    log = read_press_log(write(frame, tmp_path))
    assert [trial.trial for trial in log.dropped] == [0, 1]


def test_nothing_left_is_an_error_that_says_why(tmp_path):
    frame = log_frame(3)
    frame["force_normal_n"] = 2.0
    message = refusal(frame, tmp_path)
    assert "no usable press remains" in message
    assert message.count("the force never changes") == 3


def test_shear_known_in_some_presses_only(tmp_path):
    frame = log_frame()
    frame.loc[frame["trial"] == 0, ["shear_x_mm", "shear_y_mm"]] = np.nan
    log = read_press_log(write(frame, tmp_path))
    assert log.dropped == ()
    assert list(log.trials) == [0, 1, 2, 3, 4]
    assert list(log.with_shear().trials) == [1, 2, 3, 4]


def test_measured_logs_are_read(measured_data):
    asmi = read_press_log(measured_data / "asmi_ball_indentation" / "press_log.csv")
    assert (len(asmi.trials), asmi.dropped, asmi.session_clock) == (3, (), False)
    assert "sample" in asmi.covariates
    wedge = read_press_log(measured_data / "wedge_press_log" / "press_log.csv")
    assert (len(wedge.trials), wedge.dropped) == (4, ())
    assert not wedge.has_shear


def test_holes_in_every_press_cost_only_their_samples(tmp_path):
    frame = log_frame(9)
    holes = np.random.default_rng(3).random(len(frame)) < 0.25
    frame.loc[holes, "volume_mm3"] = np.nan
    path = tmp_path / "log.csv"
    frame.to_csv(path, index=False)
    log = read_press_log(path)
    assert log.dropped == ()
    assert len(log.rows) == int((~holes).sum())
    assert len(log.warnings) == 6, "five presses are spelled out, the others counted"
    assert "more presses have empty cells" in log.warnings[-1]


def test_a_column_is_one_quantity(tmp_path):
    path = write(log_frame(), tmp_path)
    twice = LogFormat.of_options(["time_s=temperature_c", "x_mm=temperature_c"], [])
    with pytest.raises(PressError, match="another --column names it too"):
        read_press_log(path, twice)

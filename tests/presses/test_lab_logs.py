"""Logs as laboratories write them: read as the same log in the contract's own form, or refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tacgen.core.errors import PressError
from tacgen.presses.geometry import ball_volume_mm3
from tacgen.presses.lab_table import LogFormat
from tacgen.presses.press_log import read_press_log

K_N, RADIUS_MM, N_SAMPLES = 5.0, 4.0, 40


def presses(n_trials: int = 6) -> pd.DataFrame:
    """Presses of a ball on a gel of ``K_N``: depths and their volumes, on one clock."""
    rng = np.random.default_rng(7)
    depth = 1.2 * (1.0 - np.abs(np.linspace(-1.0, 1.0, N_SAMPLES)))
    volume = ball_volume_mm3(depth, RADIUS_MM)
    return pd.concat(
        [
            pd.DataFrame(
                {
                    "trial": trial,
                    "time_s": np.round(20.0 * trial + 0.1 * np.arange(N_SAMPLES), 3),
                    "force_normal_n": volume / K_N + 0.003 * rng.standard_normal(N_SAMPLES),
                    "depth_mm": depth,
                    "volume_mm3": volume,
                }
            )
            for trial in range(n_trials)
        ],
        ignore_index=True,
    )


def plain(folder: Path, frame: pd.DataFrame):
    path = folder / "plain.csv"
    frame.to_csv(path, index=False)
    return read_press_log(path)


def same(log, expected, names=("trial", "time_s", "force_normal_n", "volume_mm3")):
    for name in names:
        np.testing.assert_allclose(log[name], expected[name], rtol=1e-9, atol=1e-12)


RENAMED = {"trial": "Press #", "time_s": "Timestamp", "force_normal_n": "Fz [N]"}


@pytest.mark.parametrize(
    "before",
    [
        "# GelLab 3.1\n# operator: ann; gel 7\n",
        "Rig: A;Gel: 12\n\nOperator: ann\n\n",
        "% exported\n\n",
        "// exported; by rig\n",
    ],
)
def test_lines_above_the_header_and_comments_between_rows(tmp_path, before):
    frame = presses().drop(columns="depth_mm")
    lines = frame.rename(columns=RENAMED).to_csv(sep=";", index=False).splitlines()
    lines = [*lines[:20], "# paused", "", *lines[20:], ";;;", ""]
    path = tmp_path / "lab.csv"
    path.write_text(before + "\n".join(lines))
    log = read_press_log(path)
    same(log, plain(tmp_path, frame))
    assert log.rows[0] == before.count("\n") + 2, "rows are counted as an editor counts lines"


@pytest.mark.parametrize(
    ("name", "header", "per_unit"),
    [
        ("force_normal_n", "Fz [mN]", 1e3),
        ("force_normal_n", "Normal force (kN)", 1e-3),
        ("force_normal_n", "Load [g]", 1 / 9.80665e-3),
        ("force_normal_n", "force_mN", 1e3),
        ("time_s", "Time [ms]", 1e3),
        ("time_s", "t_us", 1e6),
        ("time_s", "Timestamp (ns)", 1e9),
        ("volume_mm3", "Volume [µl]", 1.0),
        ("volume_mm3", "Indented volume [cm^3]", 1e-3),
        ("volume_mm3", "V_mm^3", 1.0),
        ("volume_mm3", "Volume [in3]", None),
        ("force_normal_n", "Fn_kgf", 1 / 9.80665),
        ("force_normal_n", "Load (lbf)", 1 / 4.4482216152605),
        ("time_s", "timestampSec", 1.0),
        ("depth_mm", "depthMm", 1.0),
        ("depth_mm", "Depth [µm]", 1e3),
        ("depth_mm", "Indentation depth (m)", 1e-3),
        ("depth_mm", "depth_cm", 0.1),
    ],
)
def test_units_in_headers_are_converted(tmp_path, name, header, per_unit):
    frame = presses()
    expected = plain(tmp_path, frame.assign(radius_mm=RADIUS_MM))
    frame = frame.drop(columns="volume_mm3" if name == "depth_mm" else "depth_mm")
    frame[name] = frame[name] * (per_unit or 1.0)
    path = tmp_path / "lab.csv"
    frame.rename(columns={name: header}).to_csv(path, index=False)
    if per_unit is None:
        with pytest.raises(PressError, match="'in3' is none of mm3"):
            read_press_log(path)
    else:
        same(read_press_log(path, radius_mm=RADIUS_MM), expected)


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"force_normal_n": "Fz [V]"}, "'V' is none of N, Newton"),
        ({"force_normal_n": "Fz [counts]"}, "'counts' is none of"),
        ({"volume_mm3": "Volume [px3]"}, "'px3' is none of mm3"),
        ({"time_s": "Frame"}, "column 'time_s' is missing"),
    ],
)
def test_what_is_unclear_is_asked_in_one_message(tmp_path, columns, words):
    path = tmp_path / "lab.csv"
    presses().drop(columns="depth_mm").rename(columns=columns).to_csv(path, index=False)
    with pytest.raises(PressError) as caught:
        read_press_log(path)
    assert words in str(caught.value)
    assert "--column" in str(caught.value)
    assert "found " in str(caught.value)


def test_two_columns_for_one_quantity_are_asked_about(tmp_path):
    path = tmp_path / "lab.csv"
    frame = presses().rename(columns={"force_normal_n": "Fz [N]"}).assign(**{"Force [N]": 1.0})
    frame.to_csv(path, index=False)
    with pytest.raises(PressError, match=r"'Fz \[N\]' and 'Force \[N\]' may both be force_normal"):
        read_press_log(path)
    chosen = LogFormat.of_options(["force_normal_n=Fz [N]"], [])
    same(read_press_log(path, chosen), plain(tmp_path, presses()))


def test_columns_by_option_with_the_unit_that_the_header_lacks(tmp_path):
    frame = presses().drop(columns="depth_mm")
    path = tmp_path / "lab.csv"
    lab = frame.assign(force_normal_n=1e3 * frame["force_normal_n"])
    lab.rename(columns={"force_normal_n": "gauge A", "trial": "No"}).to_csv(path, index=False)
    chosen = LogFormat.of_options(["force_normal_n=gauge A [mN]", "trial=No"], [])
    same(read_press_log(path, chosen), plain(tmp_path, frame))


@pytest.mark.parametrize(
    ("columns", "flip", "words"),
    [
        (["force_normal_n=Gauge"], [], "no column 'Gauge'"),
        (["force_normal_n"], [], "write it as"),
        (["force_normal=Fz"], [], "--column 'force_normal' is not known"),
        ([], ["forces"], "--flip 'forces' is not known"),
        (["force_normal_n=force_normal_n [V]"], [], "'V' is not a unit"),
        ([], ["force_shear_x_n"], "there is no such column"),
    ],
)
def test_options_that_do_not_fit_the_file(tmp_path, columns, flip, words):
    path = tmp_path / "log.csv"
    presses().to_csv(path, index=False)
    with pytest.raises(PressError, match=words):
        read_press_log(path, LogFormat.of_options(columns, flip))


@pytest.mark.parametrize("quantity", ["force_normal_n", "volume_mm3", "depth_mm"])
def test_negative_readings_say_which_sign_to_flip(tmp_path, quantity):
    other = {"depth_mm": "volume_mm3"}.get(quantity, "depth_mm")
    frame = presses().drop(columns=other)
    expected = read_press_log(_written(tmp_path, frame), radius_mm=RADIUS_MM)
    path = _written(tmp_path, frame.assign(**{quantity: -frame[quantity]}))
    word = quantity.partition("_")[0]
    with pytest.raises(PressError, match=f"flip the sign: --flip {word}"):
        read_press_log(path, radius_mm=RADIUS_MM)
    same(read_press_log(path, LogFormat.of_options([], [word]), radius_mm=RADIUS_MM), expected)


def _written(folder: Path, frame: pd.DataFrame) -> Path:
    path = folder / "log.csv"
    frame.to_csv(path, index=False)
    return path


def test_an_untared_gauge_is_no_wrong_sign(tmp_path):
    frame = presses()
    frame["force_normal_n"] -= 20.0
    with pytest.raises(PressError, match="zero the gauge"):
        read_press_log(_written(tmp_path, frame))


def test_rows_of_presses_that_alternate_are_joined(tmp_path):
    frame = presses().assign(time_s=lambda f: f["time_s"] - 20.0 * f["trial"])
    log = read_press_log(_written(tmp_path, frame.sort_values(["time_s", "trial"])))
    same(log, plain(tmp_path, frame))


def test_a_log_of_which_most_is_dropped_is_an_error(tmp_path):
    frame = presses()
    frame.loc[frame["trial"] > 1, "volume_mm3"] = np.nan
    with pytest.raises(PressError, match="only 80 of 240 samples can be used") as caught:
        read_press_log(_written(tmp_path, frame))
    assert "volume_mm3 is empty" in str(caught.value)


@pytest.mark.parametrize(
    "style",
    ["%Y-%m-%d %H:%M:%S.%f", "%d.%m.%Y %H:%M:%S,%f", "%H:%M:%S.%f", "%Y-%m-%dT%H:%M:%S.%fZ"],
)
def test_dates_and_times_are_a_clock(tmp_path, style):
    frame = presses()
    stamps = pd.Timestamp("2024-03-05 10:00:00") + pd.to_timedelta(frame["time_s"], unit="s")
    log = read_press_log(_written(tmp_path, frame.assign(time_s=stamps.dt.strftime(style))))
    np.testing.assert_allclose(log["time_s"], frame["time_s"], atol=1e-6)


def test_a_covariate_is_not_taken_for_what_its_letter_may_mean(tmp_path):
    frame = presses().assign(**{"T [°C]": 21.5, "f [Hz]": 50.0, "x": 1.0})
    log = read_press_log(_written(tmp_path, frame))
    assert {"T [°C]", "f [Hz]", "x"} <= set(log.covariates)

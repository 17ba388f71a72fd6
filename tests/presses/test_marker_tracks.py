"""Marker tracks: read and joined with their log; what is wrong with them is said with the frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from tacgen.contact.gel import mm_to_px, px_to_mm
from tacgen.contact.shear import marker_grid_mm, turned
from tacgen.core.errors import PressError
from tacgen.core.sensors import load_sensor
from tacgen.presses.marker_tracks import read_marker_tracks, rigid_fit, tracks_in_pictures
from tacgen.presses.press_folder import WITH_FORCES, read_press_folder
from tacgen.presses.press_log import read_press_log
from tacgen.rig import load_rig_recipe, run_rig
from tests.marker_sessions import SENSOR, make_session, read_session


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return make_session(tmp_path_factory.mktemp("tracks"), presses=4, noise_mm=0.002)


@pytest.fixture
def table(folder):
    return pd.read_csv(folder / "markers.csv")


def read(table, folder, tmp_path, sensor=SENSOR):
    path = tmp_path / "markers.csv"
    table.to_csv(path, index=False)
    return read_marker_tracks(path, sensor, read_press_log(folder / "press_log.csv"))


def test_tracks_have_the_sensors_dots_at_the_logs_times(folder):
    log, tracks = read_session(folder)
    assert tracks.places_mm.shape[1:] == (108, 2)
    assert np.abs(tracks.rest_mm - marker_grid_mm(SENSOR)).max() < 0.01
    assert not tracks.warnings
    first = tracks.press == tracks.press[0]
    rows = log["trial"] == tracks.press[0]
    np.testing.assert_allclose(tracks.time_s[first][:3], log["time_s"][rows][:21:7][:3], atol=1e-9)
    # A frame's force is that of its sample.
    at = np.searchsorted(log["time_s"][rows], tracks.time_s[first])
    np.testing.assert_allclose(
        tracks.load["force_normal_n"][first], log["force_normal_n"][rows][at], atol=1e-9
    )


def test_mm_and_times_are_read_as_px_and_frames(folder, table, tmp_path):
    by_px = read(table, folder, tmp_path)
    log = pd.read_csv(folder / "press_log.csv")
    first = log.groupby("trial")["time_s"].first()
    xy = px_to_mm(table[["x_px", "y_px"]].to_numpy(), SENSOR.shape_px, SENSOR.mm_per_px)
    other = pd.DataFrame(
        {
            "press": table["press"],
            "time_s": first[table["press"]].to_numpy() + table["frame"] / 20.0,
            "marker": 500 - table["marker"],  # numbers are names: any will do
            "x_mm": xy[:, 0],
            "y_mm": xy[:, 1],
        }
    )
    by_mm = read(other, folder, tmp_path)
    np.testing.assert_allclose(by_mm.places_mm, by_px.places_mm, atol=1e-9)
    np.testing.assert_allclose(by_mm.time_s, by_px.time_s, atol=1e-6)


def test_a_turn_and_a_shift_are_found_as_they_were_made():
    grid = marker_grid_mm(SENSOR)
    turn, shift = rigid_fit(turned(grid, 0.03) - [-0.2, 0.1], grid)
    assert turn == pytest.approx(0.03, abs=1e-12)
    np.testing.assert_allclose(shift, [0.2, -0.1], atol=1e-12)


def test_a_grid_that_is_turned_and_shifted_keeps_its_dots_in_order(folder, table, tmp_path):
    xy = px_to_mm(table[["x_px", "y_px"]].to_numpy(), SENSOR.shape_px, SENSOR.mm_per_px)
    table[["x_px", "y_px"]] = mm_to_px(
        turned(xy, np.radians(4.0)) - [-0.4, 0.3], SENSOR.shape_px, SENSOR.mm_per_px
    )
    tracks = read(table, folder, tmp_path)
    turn, shift = rigid_fit(tracks.rest_mm, tracks.grid_mm)
    assert np.degrees(turn) == pytest.approx(4.0, abs=0.02)
    np.testing.assert_allclose(shift, [0.4, -0.3], atol=0.01)


def test_lost_dots_are_left_out_and_named_with_their_frame(folder, table, tmp_path):
    lost = (table["press"] == 2) & (table["frame"] == 28) & table["marker"].isin([5, 6])
    tracks = read(table[~lost], folder, tmp_path)
    (line,) = tracks.warnings
    assert "press 2, frame 28" in line
    assert "marker 5, 6" in line
    assert np.isnan(tracks.places_mm).any(axis=2).sum() == 2


def test_no_dots_at_all_are_refused(folder, table, tmp_path):
    table[["x_px", "y_px"]] = np.nan
    with pytest.raises(PressError, match="no dots in any frame"):
        read(table, folder, tmp_path)


def test_swapped_dots_are_left_out_and_named_with_their_frame(folder, table, tmp_path):
    at = (table["press"] == 3) & (table["frame"] == 35)
    names = table.loc[at, "marker"].to_numpy().copy()
    names[[40, 41]] = names[[41, 40]]
    table.loc[at, "marker"] = names
    tracks = read(table, folder, tmp_path)
    (line,) = tracks.warnings
    assert "swapped" in line
    assert "press 3, frame 35" in line
    assert "marker 40, 41" in line


def test_another_number_of_dots_is_refused_with_the_frame(folder, table, tmp_path):
    few = table[table["marker"] < 60]
    with pytest.raises(PressError, match=r"press 0, frame 0: 60 dots.*has 108 \(9 × 12\)"):
        read(few, folder, tmp_path)
    more = pd.concat([table, table[table["marker"] < 3].assign(marker=lambda t: t["marker"] + 200)])
    with pytest.raises(PressError, match="111 dots"):
        read(more, folder, tmp_path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.assign(frame=t["frame"] + 9000), "press 0, frame 9000: the log has no such"),
        (lambda t: t.assign(press=t["press"] + 70), "press 70, frame 0: the log has no trial 70"),
        (lambda t: pd.concat([t, t.iloc[[7]]]), "press 0, frame 0: marker 7 is given 2 times"),
        (lambda t: t.drop(columns="marker"), "column marker is missing"),
        (lambda t: t.assign(x_px=t["x_px"] * 2.0), "not on the sensor's grid"),
        (lambda t: t[t["frame"] > 20], "no frame is of a gel at rest"),
    ],
)
def test_tracks_that_cannot_be_used_are_refused(folder, table, tmp_path, change, message):
    with pytest.raises(PressError, match=message):
        read(change(table), folder, tmp_path)


def test_a_log_without_a_ball_or_a_sensor_without_dots_is_refused(folder, table, tmp_path):
    log = read_press_log(folder / "press_log.csv")
    columns = {name: values for name, values in log.columns.items() if name != "radius_mm"}
    with pytest.raises(PressError, match="lacks radius_mm"):
        read_marker_tracks(folder / "markers.csv", SENSOR, replace(log, columns=columns))
    with pytest.raises(PressError, match="has no markers"):
        read(table, folder, tmp_path, replace(SENSOR, markers=None))


@pytest.mark.slow
def test_dots_are_followed_in_pictures(tmp_path):
    given = load_rig_recipe("rig_images_with_forces")
    schedule = given.schedule.model_copy(update={"presses": 3, "shear_ratio": (0.2, 0.4)})
    run_rig(given.model_copy(update={"schedule": schedule}), tmp_path)
    sensor = load_sensor(given.sensor, needs_table=False)
    log = read_press_log(tmp_path / "press_log.csv")
    pictures = read_press_folder(tmp_path / "presses", WITH_FORCES)
    tracks = tracks_in_pictures(pictures, sensor, log)
    assert tracks.places_mm.shape == (9, 63, 2)
    # Dots at rest are found to a tenth of a pixel, their sum is the log's.
    assert np.abs(tracks.rest_mm - tracks.grid_mm).max() < 0.1 * sensor.mm_per_px
    for press in np.unique(tracks.press):
        rows = np.flatnonzero(tracks.press == press)
        at = np.argmin(np.abs(log["time_s"] - tracks.time_s[rows[-1]]))
        motion = np.nansum(tracks.places_mm[rows[-1]] - tracks.rest_mm, axis=0)
        expected = [log["shear_x_mm"][at], log["shear_y_mm"][at]]
        np.testing.assert_allclose(motion, expected, atol=0.15)
    with pytest.raises(PressError, match=r"background.png: 63 dots, but virtual_gelsight has 108"):
        tracks_in_pictures(pictures, SENSOR, log)

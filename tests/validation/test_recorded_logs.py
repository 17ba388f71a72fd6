"""The study of logs that were smoothed, resampled, doubled or joined to a slower device."""

import numpy as np
import pytest

from validation.blind.generator import draw_case
from validation.contact import recorded_logs
from validation.contact.recordings import RECORDINGS, held, resampled, smoothed


@pytest.mark.parametrize("name", RECORDINGS)
def test_a_recording_keeps_the_columns_and_the_trials(name):
    frame = draw_case(3, n_trials=12).frame
    recorded = RECORDINGS[name](frame)
    assert list(recorded) == list(frame)
    assert recorded["trial"].nunique() == 12
    assert len(recorded) >= len(frame)


def test_every_other_row_of_twice_the_rate_is_a_measured_one():
    frame = draw_case(3, n_trials=12).frame
    recorded = resampled(frame)
    counts = frame.groupby("trial").size()
    assert len(recorded) == int((2 * counts - 1).sum())
    place = recorded.groupby("trial").cumcount()
    np.testing.assert_array_equal(recorded["volume_mm3"][place % 2 == 0], frame["volume_mm3"])


def test_means_and_held_readings_are_those_of_their_rows():
    frame = draw_case(3, n_trials=12).frame
    force = frame["force_normal_n"].to_numpy()
    assert smoothed(frame)["force_normal_n"].to_numpy()[7] == pytest.approx(force[5:10].mean())
    np.testing.assert_array_equal(held(frame, 4)["force_normal_n"].to_numpy()[4:8], force[4])


@pytest.mark.slow
def test_a_clean_log_that_was_doubled_is_used_once_and_names_nothing():
    found = recorded_logs.one_log("every row twice", "clean", 8)
    assert found is not None
    assert found["used"] == found["rows"] / 2
    assert found["wrong"] == {}
    assert "clean | every row twice | 1 of 1" in recorded_logs.table([found])

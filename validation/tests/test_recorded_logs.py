"""The study of logs that were smoothed, resampled, doubled or joined to a slower device."""

import numpy as np
import pytest

from validation.blind.generator import draw_case
from validation.contact import recorded_logs
from validation.contact.recordings import RECORDINGS, resampled


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


@pytest.mark.slow
def test_a_clean_log_that_was_doubled_is_used_once_and_names_nothing():
    found = recorded_logs.one_log("every row twice", "clean", 8)
    assert found is not None
    assert found["used"] == found["rows"] / 2
    assert found["wrong"] == {}
    assert "clean | every row twice | 1 of 1" in recorded_logs.table([found])

"""In how many columns a log's clock stands, and how its header is marked, must not matter."""

import numpy as np
import pandas as pd
import pytest

from tacgen.presses.lab_table import LogFormat
from tacgen.presses.press_log import read_press_log

START_NS = 1_700_000_000 * 10**9


def session(presses=4, samples=40):
    """A log's columns with a clock of 20 Hz in ns since 1970."""
    rng = np.random.default_rng(3)
    number = np.arange(presses * samples)
    press, place = number // samples, number % samples
    force = (2.0 + press) * np.minimum(1.0, place / 20) + rng.normal(0, 0.01, len(number))
    stamp_ns = START_NS + 50_000_000 * number + 3 * 10**9 * press
    log = {"trial": press, "force_normal_n": force, "volume_mm3": 5.135 * force, "radius_mm": 4.0}
    return pd.DataFrame(log), stamp_ns


PARTS = [
    ("header.stamp.secs", "header.stamp.nsecs", 1),
    ("field.header.stamp.sec", "field.header.stamp.nanosec", 1),
    ("stamp_sec", "stamp_usec", 1000),
    ("secs", "nsecs", 1),
]


@pytest.mark.parametrize(("whole", "part", "in_ns"), PARTS)
@pytest.mark.parametrize("is_named", [False, True])
def test_two_columns_of_a_stamp_are_one_clock(tmp_path, whole, part, in_ns, is_named):
    log, stamp_ns = session()
    path = tmp_path / "log.csv"
    log.assign(**{whole: stamp_ns // 10**9, part: stamp_ns % 10**9 // in_ns}).to_csv(
        path, index=False
    )
    read = read_press_log(path, LogFormat({"time_s": whole} if is_named else {}))
    np.testing.assert_allclose(read["time_s"] - 1.7e9, (stamp_ns - START_NS) * 1e-9, atol=1e-6)
    assert part not in read
    assert f"{path}: {whole!r} and {part!r} are one clock: added" in read.warnings
    assert not any("share their time" in warning for warning in read.warnings)


@pytest.mark.parametrize(("step_s", "is_said"), [(0.05, False), (0.2, True), (1.0, True)])
def test_a_clock_too_coarse_for_its_samples_is_said(tmp_path, step_s, is_said):
    log, stamp_ns = session()
    path = tmp_path / "log.csv"
    time_s = np.floor((stamp_ns - START_NS) * 1e-9 / step_s + 1e-6) * step_s
    log.assign(time_s=time_s).to_csv(path, index=False)
    said = [one for one in read_press_log(path).warnings if "samples of 4 presses share" in one]
    assert bool(said) is is_said


@pytest.mark.parametrize("text", [{}, {"field.header.frame_id": "ft_link"}])
@pytest.mark.parametrize("remark", ["", "# a remark\n"])
def test_a_header_marked_as_a_remark_is_read_beside_text(tmp_path, text, remark):
    """As ``rostopic echo -p`` writes it."""
    log, stamp_ns = session()
    log = pd.DataFrame({"%time": stamp_ns, **text}).join(log)
    path = tmp_path / "log.csv"
    renamed = log.rename(columns={"force_normal_n": "field.wrench.force.z"})
    path.write_text(remark + renamed.to_csv(index=False))
    read = read_press_log(path, LogFormat({"time_s": "time [ns]"}))
    assert len(read) == len(log)
    np.testing.assert_allclose(read["force_normal_n"], log["force_normal_n"])
    assert set(text) <= set(read.columns)

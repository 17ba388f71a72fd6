"""Bags that another library writes, and what a camera's recording holds."""

import os
import signal
from dataclasses import replace

import cv2
import h5py
import numpy as np
import pandas as pd
import pytest
import trimesh
from typer.testing import CliRunner

import tacgen
from tacgen.calibrate.contact.command import LogSource, calibrate_contact
from tacgen.cli import app
from tacgen.core import errors
from tacgen.core.errors import PressError, SensorError
from tacgen.sensor import recordings
from tacgen.sensor.bags import BACKGROUND, kept
from tacgen.sensor.read_image import ImageReader
from tacgen.sensor.recorded import Wrench
from tacgen.sensor.recordings import open_camera, open_recording, read_recording

rosbag2 = pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")
pytest.importorskip("mcap")

STORE = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
WRENCH = "geometry_msgs/msg/WrenchStamped"
EPOCH_S, FPS = 1_700_000_000.0, 12.5


def stamped(kind, time_s, **values):
    whole, part = divmod(round(time_s * 1e9), 10**9)
    stamp = STORE.types["builtin_interfaces/msg/Time"](sec=whole, nanosec=part)
    header = STORE.types["std_msgs/msg/Header"](stamp=stamp, frame_id="a frame")
    return STORE.types[kind](header=header, **values)


def image(rgb, time_s=0.0, encoding="bgr8", padding=0):
    channels = {"bgr8": [2, 1, 0], "rgb8": [0, 1, 2], "bgra8": [2, 1, 0, 0]}.get(encoding, [0])
    rows = rgb[..., channels].reshape(len(rgb), -1)
    rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=77)
    return stamped(
        IMAGE, time_s, height=len(rgb), width=rgb.shape[1], encoding=encoding, is_bigendian=0,
        step=rows.shape[1], data=rows.reshape(-1),
    )  # fmt: skip


def packed(rgb, time_s=0.0, form="png", suffix=".png"):
    data = cv2.imencode(suffix, np.ascontiguousarray(rgb[..., ::-1]))[1]
    return stamped(COMPRESSED, time_s, format=form, data=data.reshape(-1))


def wrench(force_n, time_s=0.0):
    vector = STORE.types["geometry_msgs/msg/Vector3"]
    force, torque = vector(*map(float, force_n)), vector(0.0, 0.0, 0.0)
    return stamped(WRENCH, time_s, wrench=STORE.types["geometry_msgs/msg/Wrench"](force, torque))


def write_bag(path, messages, *, storage="MCAP", packing=None, serialize=STORE.serialize_cdr):
    """A bag of ``messages``, (topic, log time in s, message); the path of its one file."""
    plugin = rosbag2.StoragePlugin[storage]
    writer = rosbag2.Writer(path, version=9, storage_plugin=plugin)
    if packing is not None:
        writer.set_compression(rosbag2.CompressionMode[packing], rosbag2.CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for topic, log_s, message in sorted(messages, key=lambda one: one[1]):
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], round(log_s * 1e9), serialize(message, kind))
    return next(file for file in path.iterdir() if file.suffix in (".mcap", ".db3", ".zstd"))


@pytest.fixture(scope="module")
def sensor():
    return tacgen.Sensor("gelsight_mini")


@pytest.fixture(scope="module")
def reader(sensor):
    return ImageReader(sensor)


@pytest.fixture(scope="module")
def press(sensor):
    """Pictures of a ball by the force that presses it in, in steps of 0.25 N."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=4.0)
    loads_n = np.arange(0.25, 2.1, 0.25)
    found = {f: sensor.render(ball, np.eye(4), force_n=f).rgb for f in loads_n.tolist()}
    return {0.0: sensor.at_rest_rgb(), **found}


def nothing(done, total, note):
    pass


def times_s(count):
    return EPOCH_S + np.arange(count) / FPS


def course_n(time_s):
    """Force of presses that take 0.8 s, one every 1.6 s, to 1, 1.5 and 2 N; 0 before and after."""
    since = np.asarray(time_s) - EPOCH_S
    number, within = np.divmod(since, 1.6)
    peak = np.array([1.0, 1.5, 2.0])[number.astype(int) % 3]
    shape = np.interp(within, [0.4, 0.7, 0.9, 1.2], [0.0, 1.0, 1.0, 0.0])
    return np.where((since >= 0) & (since < 4.8), peak * shape, 0.0)


def recorded(path, press, *, lag_s=0.0, gauge=lambda force: (0.0, 0.0, force), rate_hz=200):
    """A bag of presses of the ball by ``course_n`` and a gauge whose clock is late by ``lag_s``."""
    at = times_s(60)
    seen = [press[round(4 * force) / 4] for force in course_n(at)]
    felt_at = np.arange(at[0] - 1.0, at[-1] + 1.0, 1 / rate_hz)
    messages = [("/cam", t, image(rgb, t)) for t, rgb in zip(at, seen, strict=True)]
    shown_n = np.round(4 * course_n(at)) / 4  # the gauge measures what the pictures show
    messages += [
        ("/ft", t + lag_s, wrench(gauge(force), t + lag_s))
        for t, force in zip(felt_at, np.interp(felt_at, at, shown_n), strict=True)
    ]
    return write_bag(path, messages)


@pytest.mark.parametrize("storage", ["MCAP", "SQLITE3"])
@pytest.mark.parametrize("packing", [None, "MESSAGE"])
def test_pictures_come_out_of_a_bag_as_they_went_in(storage, packing, press, tmp_path):
    ways = {
        "bgr": lambda rgb, t: image(rgb, t),
        "padded": lambda rgb, t: image(rgb, t, "rgb8", padding=5),
        "alpha": lambda rgb, t: image(rgb, t, "bgra8"),
        "png": packed,
    }
    for name, make in ways.items():
        shown = [press[0.0], press[1.0], press[2.0]]
        messages = [("/cam", t + 1, make(rgb, t)) for t, rgb in zip(times_s(3), shown, strict=True)]
        file = write_bag(tmp_path / name, messages, storage=storage, packing=packing)
        for path in (file, file.parent):
            recording = open_recording(path)
            found = list(recording.pictures)
            assert recording.stated == 3
            assert all(np.array_equal(f.rgb, rgb) for f, rgb in zip(found, shown, strict=True))
            np.testing.assert_allclose([f.time_s for f in found], times_s(3), atol=1e-6)


def test_messages_of_either_order_of_bytes_are_read(press, tmp_path):
    def reversed_order(message, kind):
        return STORE.serialize_cdr(message, kind, little_endian=False)

    message = image(press[1.0], EPOCH_S)
    file = write_bag(tmp_path / "bag", [("/cam", EPOCH_S, message)], serialize=reversed_order)
    (found,) = open_recording(file).pictures
    assert np.array_equal(found.rgb, press[1.0])
    assert found.time_s == EPOCH_S


@pytest.mark.slow
def test_a_bag_gives_a_row_a_picture_with_the_gauge_beside_it(reader, press, tmp_path):
    file = recorded(tmp_path / "bag", press, lag_s=0.12, gauge=lambda f: (0.3, 0.0, -f))
    found = read_recording(reader, file, tmp_path / "out", nothing)
    assert (found["pictures"], found["wrench"]) == (60, "/ft")
    assert found["wrench_lag_s"] == pytest.approx(0.12, abs=0.02)
    rows = pd.read_csv(tmp_path / "out/readings.csv")
    np.testing.assert_allclose(rows["time_s"], times_s(60), atol=1e-6)
    np.testing.assert_allclose(rows["wrench_x_n"], 0.3)
    # By its own stamps the gauge is late.
    late = np.interp(times_s(60) - 0.12, times_s(60), rows["force_normal_n"])
    assert np.corrcoef(late, rows["wrench_z_n"])[0, 1] < -0.99
    with h5py.File(tmp_path / "out/depth.h5") as depths:
        np.testing.assert_allclose(depths["time_s"], times_s(60), atol=1e-6)
        assert depths["depth_mm"].shape == (60, 240, 320)


def test_a_force_is_read_between_two_and_not_across_a_gap():
    at = np.array([0.0, 0.1, 0.2, 5.0, 5.1])
    gauge = Wrench("/ft", at, np.outer(at, [1.0, 2.0, -3.0]), most_gap_s=0.5)
    np.testing.assert_allclose(gauge.at(np.array([0.05, 5.05])), np.outer([0.05, 5.05], [1, 2, -3]))
    assert np.isnan(gauge.at(np.array([-0.1, 1.0, 5.2]))).all()


def test_a_lag_that_does_not_show_is_not_stated():
    at = np.arange(0.0, 10.0, 0.01)
    rng = np.random.default_rng(1)
    gauge = Wrench("/ft", at, rng.normal(size=(1000, 3)), most_gap_s=0.05)
    seen_at = np.arange(1.0, 9.0, 0.04)
    assert np.isnan(gauge.lag_s(seen_at, np.sin(seen_at)))
    assert np.isnan(gauge.lag_s(seen_at, np.zeros(len(seen_at))))
    gauge = replace(gauge, force_n=np.outer(np.sin(at - 0.2), [0.0, 1.0, -2.0]))
    assert gauge.lag_s(seen_at, np.sin(seen_at)) == pytest.approx(0.2, abs=0.005)


@pytest.mark.parametrize("storage", ["MCAP", "SQLITE3"])
def test_of_a_cut_bag_what_was_read_is_kept(storage, reader, press, tmp_path):
    messages = [("/cam", t, image(press[1.0], t)) for t in times_s(30)]
    file = write_bag(tmp_path / "whole", messages, storage=storage)
    cut = tmp_path / f"cut{file.suffix}"
    cut.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    with pytest.raises(SensorError, match=r"cut.*broken or cut.*\d+ pictures are kept in") as error:
        read_recording(reader, cut, tmp_path / "out", nothing)
    kept_rows = len(pd.read_csv(tmp_path / "out/readings.csv"))
    assert 10 < kept_rows < 20
    assert f"readings of {kept_rows} pictures" in str(error.value)


def test_of_several_topics_one_is_chosen(press, tmp_path):
    messages = [("/left", t, image(press[0.0], t)) for t in times_s(3)]
    messages += [("/right", t, image(press[2.0], t)) for t in times_s(3)]
    file = write_bag(tmp_path / "two", messages)
    with pytest.raises(SensorError, match=r"choose one with --topic; it has /left \(.*/right \("):
        open_recording(file)
    with pytest.raises(SensorError, match=r"--topic /rihgt holds neither.*/right"):
        open_recording(file, ["/rihgt"])
    assert np.array_equal(next(open_recording(file, ["/right"]).pictures).rgb, press[2.0])
    only = write_bag(tmp_path / "none", [("/ft", EPOCH_S, wrench((0, 0, 1), EPOCH_S))])
    with pytest.raises(SensorError, match=r"no sensor_msgs/msg/Image.*it has /ft \(geometry_msgs"):
        open_recording(only)


def test_without_stamps_the_times_are_the_logs(press, tmp_path):
    at = times_s(3)
    file = write_bag(tmp_path / "zero", [("/cam", t, image(press[0.0])) for t in at])
    recording = open_recording(file)
    assert "the headers of /cam hold no common time" in recording.notes[0]
    np.testing.assert_allclose([p.time_s for p in recording.pictures], at, atol=1e-6)
    # Two clocks: that of the gauge counts from when it was switched on.
    messages = [("/cam", t, image(press[0.0], t)) for t in at]
    messages += [("/ft", t, wrench((0, 0, 1), t - EPOCH_S + 5)) for t in at]
    recording = open_recording(write_bag(tmp_path / "two", messages))
    assert "/cam and /ft hold no common time" in recording.notes[0]
    np.testing.assert_allclose(recording.wrench.time_s, at, atol=1e-6)


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (lambda rgb: image(rgb, EPOCH_S, "mono8"), "encoding 'mono8' is not read; record one of"),
        (lambda rgb: image(rgb, EPOCH_S, "bayer_rggb8"), "encoding 'bayer_rggb8' is not read"),
        (lambda rgb: packed(rgb, EPOCH_S, "16UC1; compressedDepth png"), "are distances"),
        (lambda rgb: replace(image(rgb, EPOCH_S), step=9), "9 a row, are no 320 × 240 bgr8"),
        (lambda rgb: image(rgb[::2, ::2], EPOCH_S), r"shape \(120, 160, 3\)"),
        (lambda rgb: image(rgb[..., ::-1], EPOCH_S), "red and blue are swapped"),
    ],
)
def test_a_picture_that_is_none_of_the_sensors_says_so(message, words, reader, press, tmp_path):
    file = write_bag(tmp_path / "bag", [("/cam", EPOCH_S, message(press[2.0]))])
    with pytest.raises(SensorError, match=words):
        read_recording(reader, file, tmp_path / "out", nothing)


def test_what_is_no_bag_that_is_read_says_what_to_do(press, tmp_path, monkeypatch):
    (tmp_path / "one.bag").write_bytes(b"#ROSBAG V2.0\n")
    with pytest.raises(
        SensorError, match=r"one.bag: a bag of ROS 1; convert it: .*rosbags-convert"
    ):
        open_recording(tmp_path / "one.bag")
    messages = [("/cam", EPOCH_S, image(press[0.0], EPOCH_S))]
    packed_whole = write_bag(tmp_path / "packed", messages, packing="FILE")
    with pytest.raises(SensorError, match=r"a bag packed as a whole; convert it"):
        open_recording(packed_whole.parent)
    (tmp_path / "no.mcap").write_bytes(b"no bag")
    with pytest.raises(SensorError, match=r"no.mcap: .*broken or cut"):
        open_recording(tmp_path / "no.mcap")
    file = write_bag(tmp_path / "bag", messages)
    monkeypatch.setitem(errors.EXTRAS, "mcap", ("a_package_that_is_missing",))
    with pytest.raises(SensorError, match=r"pip install 'tacgen\[mcap\]'"):
        open_recording(file)


@pytest.mark.slow
def test_a_contact_law_is_fitted_to_a_bag_as_to_its_readings(press, tmp_path):
    plain = recorded(tmp_path / "plain", press)
    source = LogSource(plain, sensor="gelsight_mini")
    law = calibrate_contact(source, tmp_path / "plain.yaml").law
    # The rendering's own k_n, within what the reading of the pictures is off by.
    assert law.k_n_mm3_per_n.value == pytest.approx(5.135, rel=0.08)
    log = pd.read_csv(tmp_path / "plain.csv")
    assert log.groupby("trial")["force_normal_n"].max().tolist() == [1.0, 1.5, 2.0]
    # A gauge that is late, not tared and the other way round gives the same, and says so.
    late = recorded(tmp_path / "late", press, lag_s=0.2, gauge=lambda f: (0.1, 0.0, 0.5 - f))
    with pytest.raises(PressError, match="--flip force"):
        calibrate_contact(replace(source, path=late), tmp_path / "late.yaml")
    arguments = [
        "calibrate",
        "contact",
        str(late),
        "--sensor",
        "gelsight_mini",
        "--flip",
        "force",
        "--force",
    ]
    result = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path / "late.yaml")])
    assert result.exit_code == 0, result.output
    assert "the lag of /ft behind the pictures is 0.2" in result.output
    assert "without contact the gauge reads 0.1, 0, 0.5 N: subtracted" in result.output
    found = tacgen.contact.law.load_law(tmp_path / "late.yaml").k_n_mm3_per_n.value
    assert found == pytest.approx(law.k_n_mm3_per_n.value, rel=0.02)


@pytest.mark.slow
def test_a_contact_law_needs_a_gauge_a_contact_and_a_sensor(press, tmp_path):
    file = write_bag(tmp_path / "bag", [("/cam", t, image(press[0.0], t)) for t in times_s(3)])
    with pytest.raises(PressError, match="Name it with --sensor"):
        calibrate_contact(LogSource(file), tmp_path / "law.yaml")
    source = LogSource(file, sensor="gelsight_mini")
    with pytest.raises(PressError, match="no forces beside the pictures; record a WrenchStamped"):
        calibrate_contact(source, tmp_path / "law.yaml")
    messages = [("/cam", t, image(press[0.0], t)) for t in times_s(30)]
    messages += [("/ft", t, wrench((0, 0, 1), t)) for t in times_s(30)]
    untouched = write_bag(tmp_path / "untouched", messages)
    with pytest.raises(PressError, match="no picture shows a contact"):
        calibrate_contact(replace(source, path=untouched), tmp_path / "law.yaml")


def write_video(path, pictures):
    height, width = pictures[0].shape[:2]
    video = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), FPS, (width, height))
    for picture in pictures:
        video.write(np.ascontiguousarray(picture[..., ::-1]))
    video.release()
    return path


@pytest.mark.slow
def test_a_camera_is_read_and_kept_and_its_file_reads_the_same(press, tmp_path):
    shown = [press[0.0]] * 12 + [press[1.0], press[2.0], press[1.0], press[0.0]]
    video, file = write_video(tmp_path / "camera.avi", shown), tmp_path / "kept.mcap"
    live = ["read", "--camera", str(video), "--record", str(file), "--sensor", "gelsight_mini"]
    result = CliRunner().invoke(app, [*live, "--out", str(tmp_path / "live")])
    assert result.exit_code == 0, result.output
    assert "touch nothing: 10 pictures of the gel at rest" in result.output
    again = ["read", str(file), "--sensor", "gelsight_mini", "--out", str(tmp_path / "again")]
    result = CliRunner().invoke(app, again)
    assert result.exit_code == 0, result.output
    seen, kept_rows = (
        pd.read_csv(tmp_path / name / "readings.csv").drop(columns="file")
        for name in ("live", "again")
    )
    assert len(seen) == 6
    pd.testing.assert_frame_equal(seen, kept_rows)
    # Another program reads it too.
    with rosbag2.Reader(file) as other:
        topics = {c.topic: c for c in other.connections}
        assert topics[BACKGROUND].msgcount == 1
        raw = [data for c, _, data in other.messages() if c.topic == BACKGROUND]
    message = STORE.deserialize_cdr(raw[0], COMPRESSED)
    assert message.format == "png"
    assert cv2.imdecode(message.data, cv2.IMREAD_COLOR).shape == (240, 320, 3)
    result = CliRunner().invoke(app, [*live, "--out", str(tmp_path / "live")])
    assert "new file that ends in .mcap" in str(result.exception)
    assert "touch nothing" not in result.output
    loud = file.rename(tmp_path / "KEPT.MCAP")
    assert len(list(open_recording(loud).pictures)) == 6


@pytest.mark.slow
def test_of_a_camera_that_stops_what_was_read_is_kept(reader, press, tmp_path):
    with pytest.raises(SensorError, match="camera none.avi: it gives no picture; connect it"):
        open_camera("none.avi", None)
    whole = write_video(tmp_path / "whole.avi", [press[0.0]] * 15 + [press[1.0]] * 25)
    cut, file = tmp_path / "cut.avi", tmp_path / "kept.mcap"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    camera = kept(open_camera(str(cut), None), file, reader.background_rgb)
    with pytest.raises(SensorError, match=r"it stopped after \d+ pictures; connect .* kept in"):
        read_recording(reader, camera, tmp_path / "out", nothing)
    rows = pd.read_csv(tmp_path / "out/readings.csv")
    assert len(list(open_recording(file).pictures)) == len(rows) > 0


def test_control_c_ends_a_camera_after_the_picture_at_hand(reader, press, tmp_path):
    video = write_video(tmp_path / "camera.avi", [press[0.0]] * 20)
    before = signal.getsignal(signal.SIGINT)

    def interrupt(picture, depth_mm, row):
        if picture.name == "000002":
            os.kill(os.getpid(), signal.SIGINT)

    camera = open_camera(str(video), reader.background_rgb)
    found = read_recording(reader, camera, tmp_path / "out", nothing, interrupt)
    assert found["pictures"] == 3
    assert signal.getsignal(signal.SIGINT) is before


def test_a_recording_is_shown_in_rerun(reader, press, tmp_path, monkeypatch):
    rr = pytest.importorskip("rerun")
    file = tmp_path / "shown.rrd"
    monkeypatch.setattr(rr.RecordingStream, "spawn", lambda stream: stream.save(file))
    bag = write_bag(tmp_path / "bag", [("/cam", EPOCH_S, image(press[1.0], EPOCH_S))])
    read_recording(reader, bag, tmp_path / "out", nothing, recordings.rerun_viewer())
    assert file.stat().st_size > 1000


def test_reading_needs_one_source(tmp_path):
    for given in ([], ["one.png", "--camera", "0"], ["one.png", "--record", "one.mcap"]):
        arguments = ["read", *given, "--sensor", "gelsight_mini", "--out", str(tmp_path / "out")]
        result = CliRunner().invoke(app, arguments)
        assert "give images, a recording or --camera, one of them" in str(result.exception)

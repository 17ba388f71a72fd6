"""Videos and folders, read picture by picture."""

import json

import cv2
import h5py
import numpy as np
import pandas as pd
import pytest
import trimesh
from typer.testing import CliRunner

import tacgen
from tacgen.cli import app
from tacgen.core.errors import SensorError
from tacgen.sensor.read_image import ImageReader
from tacgen.sensor.recordings import open_recording, read_recording

FORCES_N = (0.0, 2.0, 4.0, 0.0)
FPS = 25.0


@pytest.fixture(scope="module")
def pictures():
    """A ball that is pressed in and taken away."""
    sensor = tacgen.Sensor("gelsight_mini")
    ball = trimesh.creation.icosphere(subdivisions=4, radius=4.0)
    at_rest = sensor.at_rest_rgb()
    return [sensor.render(ball, np.eye(4), force_n=f).rgb if f else at_rest for f in FORCES_N]


@pytest.fixture(scope="module")
def reader():
    return ImageReader(tacgen.Sensor("gelsight_mini"))


def write_video(path, pictures):
    height, width = pictures[0].shape[:2]
    video = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), FPS, (width, height))
    assert video.isOpened()
    for picture in pictures:
        video.write(np.ascontiguousarray(picture[..., ::-1]))
    video.release()
    return path


def nothing(done, total, note):
    pass


def test_a_video_gives_a_row_a_picture_with_its_time(pictures, tmp_path):
    video, out = write_video(tmp_path / "press.avi", pictures), tmp_path / "out"
    arguments = ["read", str(video), "--sensor", "gelsight_mini", "--out", str(out), "--json"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert (found["pictures"], found["with_contact"]) == (4, 2)
    rows = pd.read_csv(out / "readings.csv")
    np.testing.assert_allclose(rows["time_s"], np.arange(4) / FPS, atol=1e-3)
    off = np.abs(rows["force_normal_n"] - np.array(FORCES_N))
    # What JPEG changes in the picture, beside what the reading states.
    assert (off <= 2 * rows["force_normal_stderr_n"] + 0.1).all()
    with h5py.File(out / "depth.h5") as depths:
        assert depths["depth_mm"].shape == (4, 240, 320)
        np.testing.assert_allclose(depths["depth_mm"][()].max(axis=(1, 2)), rows["indentation_mm"])
    assert cv2.imread(str(out / "overview.png")) is not None


def test_a_folder_is_read_in_the_order_of_its_names(pictures, reader, tmp_path):
    folder = tmp_path / "presses"
    folder.mkdir()
    for index, picture in enumerate(pictures[:2]):
        cv2.imwrite(str(folder / f"{index}.png"), picture[..., ::-1])
    (folder / "notes.txt").write_text("no picture")
    read_recording(reader, folder, tmp_path / "out", nothing)
    rows = pd.read_csv(tmp_path / "out/readings.csv")
    assert rows["file"].tolist() == ["0.png", "1.png"]
    # A folder's pictures are what the reader makes of each alone.
    alone = reader.read(pictures[1])
    assert rows["force_normal_n"][1] == pytest.approx(alone.force_n[2])
    assert rows["time_s"].isna().all()


def test_of_a_cut_video_what_was_read_is_kept(pictures, reader, tmp_path):
    whole = write_video(tmp_path / "whole.avi", pictures * 10)
    cut = tmp_path / "cut.avi"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    with pytest.raises(SensorError, match=r"cut.*readings of \d+ pictures are kept in") as error:
        read_recording(reader, cut, tmp_path / "out", nothing)
    kept = len(pd.read_csv(tmp_path / "out/readings.csv"))
    assert 0 < kept < 40
    assert f"readings of {kept} pictures" in str(error.value)
    with h5py.File(tmp_path / "out/depth.h5") as depths:
        assert len(depths["depth_mm"]) == kept


def test_what_is_no_recording_is_refused(reader, tmp_path):
    (tmp_path / "broken.mp4").write_bytes(b"no video")
    with pytest.raises(SensorError, match="broken.mp4: broken, cut, or"):
        open_recording(tmp_path / "broken.mp4")
    with pytest.raises(SensorError, match="none.mp4: no such file"):
        open_recording(tmp_path / "none.mp4")
    (tmp_path / "empty").mkdir()
    with pytest.raises(SensorError, match="no images in it"):
        open_recording(tmp_path / "empty")


def test_a_picture_that_does_not_fit_gets_a_row_and_the_first_one_is_refused(
    pictures, reader, tmp_path
):
    turned = np.ascontiguousarray(pictures[1][::-1, ::-1])
    for name, shown in (("later", [pictures[1], turned]), ("first", [turned])):
        (tmp_path / name).mkdir()
        for index, picture in enumerate(shown):
            cv2.imwrite(str(tmp_path / name / f"{index}.png"), picture[..., ::-1])
    read_recording(reader, tmp_path / "later", tmp_path / "out", nothing)
    rows = pd.read_csv(tmp_path / "out/readings.csv")
    assert "turned" in rows["message"][1]
    assert np.isnan(rows["force_normal_n"][1])
    with pytest.raises(SensorError, match=r"0\.png: .*turned"):
        read_recording(reader, tmp_path / "first", tmp_path / "none", nothing)

"""The export against what the LeRobot format v3.0 asks for."""

import json

import cv2
import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from tacgen.cli import app
from tacgen.core.errors import DatasetError, TacgenError
from tacgen.dataset import Dataset
from tacgen.dataset.export import export_dataset
from tests.messages import refused

from .conftest import collect_toy, make_spec


@pytest.fixture
def exported(toy, tmp_path):
    run = CliRunner().invoke(
        app, ["export", str(toy.root), "--format", "lerobot", "--out", str(tmp_path / "lerobot")]
    )
    assert run.exit_code == 0, run.output
    assert "8 episodes" in run.output
    assert "2 grasps that were not executed are not exported" in run.output
    return tmp_path / "lerobot"


def test_info_and_tables_agree(exported):
    info = json.loads((exported / "meta/info.json").read_text())
    assert info["codebase_version"] == "v3.0"
    assert (info["total_episodes"], info["total_frames"], info["fps"]) == (8, 24, 2)
    assert info["splits"] == {"train": "0:6", "test": "6:8"}
    frames = pq.read_table(exported / info["data_path"].format(chunk_index=0, file_index=0))
    assert set(frames.column_names) == set(info["features"])
    assert frames.num_rows == 24
    assert frames["index"].to_pylist() == list(range(24))
    np.testing.assert_allclose(frames["timestamp"].to_numpy()[:3], [0, 0.5, 1.0])
    for name, feature in info["features"].items():
        assert set(feature) == {"dtype", "shape", "names"}, name
        if feature["dtype"] == "float32" and feature["shape"][0] > 1:
            assert frames.schema.field(name).type.list_size == feature["shape"][0]


def test_episodes_point_into_the_data(exported):
    info = json.loads((exported / "meta/info.json").read_text())
    episodes = pd.read_parquet(exported / "meta/episodes/chunk-000/file-000.parquet")
    tasks = pd.read_parquet(exported / "meta/tasks.parquet")
    assert list(episodes["episode_index"]) == list(range(8))
    assert list(episodes["split"]) == ["train"] * 6 + ["test"] * 2
    frames = pq.read_table(exported / info["data_path"].format(chunk_index=0, file_index=0))
    for _, episode in episodes.iterrows():
        rows = slice(episode["dataset_from_index"], episode["dataset_to_index"])
        assert set(frames["episode_index"].to_numpy()[rows]) == {episode["episode_index"]}
        task = frames["task_index"].to_numpy()[rows][0]
        assert tasks.loc[episode["tasks"][0], "task_index"] == task


def test_images_and_forces_are_those_of_the_dataset(exported, toy):
    dataset = Dataset(toy.root)
    episodes = pd.read_parquet(exported / "meta/episodes/chunk-000/file-000.parquet")
    frames = pq.read_table(exported / "data/chunk-000/file-000.parquet").to_pylist()
    for _, episode in episodes.iterrows():
        sample = dataset.read(int(episode["grasp_index"]))
        for frame in range(3):
            row = frames[episode["dataset_from_index"] + frame]
            png = np.frombuffer(row["observation.images.gelsight"]["bytes"], np.uint8)
            np.testing.assert_array_equal(
                cv2.imdecode(png, cv2.IMREAD_COLOR)[..., ::-1], sample.pads["left"].rgb[frame]
            )
            assert row["observation.state"][0] == pytest.approx(
                sample.pads["left"].force_normal_n[frame], rel=1e-6
            )
            assert row["label"] == sample.label
            assert row["next.done"] == (frame == 2)


def test_statistics_are_those_of_all_frames(exported, toy):
    stats = json.loads((exported / "meta/stats.json").read_text())
    dataset = Dataset(toy.root)
    samples = [dataset.read(int(index)) for index in dataset.indices]
    executed = [sample for sample in samples if sample.label >= 0]
    images = np.concatenate([sample.pads["left"].rgb for sample in executed]) / 255.0
    told = stats["observation.images.gelsight"]
    assert np.shape(told["mean"]) == (3, 1, 1)
    np.testing.assert_allclose(np.ravel(told["mean"]), images.mean(axis=(0, 1, 2)))
    np.testing.assert_allclose(np.ravel(told["std"]), images.std(axis=(0, 1, 2)))
    np.testing.assert_allclose(np.ravel(told["max"]), images.max(axis=(0, 1, 2)))
    np.testing.assert_allclose(
        np.ravel(told["q50"]), np.median(images, axis=(0, 1, 2)), atol=1 / 255
    )
    assert told["count"] == [24]
    forces = np.concatenate([sample.pads["left"].force_normal_n for sample in executed])
    assert stats["observation.state"]["mean"][0] == pytest.approx(forces.mean())


def test_refusals_leave_nothing(toy, tmp_path):
    with refused(DatasetError):
        export_dataset(toy.root, tmp_path / "out", "zarr")
    with refused(TacgenError):
        export_dataset(toy.root, toy.root, "lerobot")
    toy.shard_path(1).unlink()
    with refused(DatasetError):
        export_dataset(toy.root, tmp_path / "out", "lerobot")
    assert [path.name for path in tmp_path.iterdir()] == ["toy"]


@pytest.mark.parametrize(("n_frames", "span_s", "fps"), [(24, 3.0, 23 / 3), (25, 3.0, 8)])
def test_timestamps_are_the_times_of_the_frames(tmp_path, n_frames, span_s, fps):
    """By the format's rule, timestamp = frame_index / fps, and within its tolerance of 0.1 ms."""
    times_s = tuple(np.linspace(0.0, span_s, n_frames).tolist())
    toy = collect_toy(tmp_path / "toy", make_spec(time_s=times_s))
    said = export_dataset(toy.root, tmp_path / "out", "lerobot")["content"]
    info = json.loads((tmp_path / "out/meta/info.json").read_text())
    assert info["fps"] == pytest.approx(fps, rel=1e-12)
    assert isinstance(info["fps"], type(fps))
    frames = pq.read_table(tmp_path / "out/data/chunk-000/file-000.parquet").to_pandas()
    for _, episode in frames.groupby("episode_index"):
        stamps = episode["timestamp"].to_numpy(np.float64)
        np.testing.assert_allclose(stamps, times_s, atol=1e-4)
        np.testing.assert_allclose(np.diff(stamps), 1 / info["fps"], atol=1e-4)
    assert "timestamps" not in said


def test_frames_that_are_not_evenly_spaced_are_said(tmp_path):
    toy = collect_toy(tmp_path / "toy", make_spec(time_s=(0.0, 0.2, 1.0)))
    said = export_dataset(toy.root, tmp_path / "out", "lerobot")["content"]
    assert "up to 0.300 s off the times at which frames were taken, which are in time_s" in said

"""Exports read back by readers that share no code with the writers."""

from __future__ import annotations

import io
import json
import math
import tarfile
from types import SimpleNamespace

import cv2
import h5py
import numpy as np
import pandas as pd
import pytest

from tacgen.dataset import Dataset, samples
from tacgen.dataset.export import export_dataset
from tacgen.dataset.schema import Field

from .conftest import collect_toy, make_spec


@pytest.fixture(scope="module")
def with_depth(tmp_path_factory):
    folder = collect_toy(tmp_path_factory.mktemp("depth") / "data", make_spec(depth=True))
    folder.merge()
    return Dataset(folder.root)


def executed(dataset):
    columns = dataset.columns()
    return columns["index"][columns["label"] >= 0]


def test_images_hold_frames_forces_and_depth(with_depth, tmp_path):
    export_dataset(with_depth.root, tmp_path / "out", "images")
    listed = pd.read_csv(tmp_path / "out" / "grasps.csv")
    indices = executed(with_depth)
    assert len(listed) == len(indices)
    for name, index in zip(listed["grasp_id"], indices, strict=True):
        sample = with_depth.read(int(index)).pads["left"]
        forces = pd.read_csv(tmp_path / "out" / "contact" / f"{name}.csv")
        np.testing.assert_allclose(forces["force_normal_n"], sample.force_normal_n)
        np.testing.assert_allclose(forces["force_shear_y_n"], sample.force_shear_n[:, 1])
        np.testing.assert_array_equal(
            np.load(tmp_path / "out" / "depth" / f"{name}.npy"), sample.depth_mm.astype(np.float32)
        )
        first = cv2.imread(str(tmp_path / "out" / "images" / name / "0.png"))[..., ::-1]
        np.testing.assert_array_equal(first, sample.rgb[0])


def test_webdataset_streams_every_grasp(with_depth, tmp_path):
    """Samples by WebDataset's rule: consecutive files whose names agree up to the first dot."""
    export_dataset(with_depth.root, tmp_path / "out", "webdataset")
    samples: dict[str, dict[str, bytes]] = {}
    order = []
    for path in sorted((tmp_path / "out").glob("*.tar")):
        with tarfile.open(path) as archive:
            for member in archive:
                key, extension = member.name.split(".", 1)
                order += [key] if key not in samples else []
                assert key == order[-1], "the files of a sample are consecutive"
                samples.setdefault(key, {})[extension] = archive.extractfile(member).read()
    indices = executed(with_depth)
    assert order == [f"g{index:05d}" for index in indices]
    for key, index in zip(order, indices, strict=True):
        sample, files = with_depth.read(int(index)), samples[key]
        about = json.loads(files["json"])
        assert (about["label"], about["object"]) == (sample.label, sample.config.object)
        pad = sample.pads["left"]
        picture = cv2.imdecode(np.frombuffer(files["left.1.png"], np.uint8), cv2.IMREAD_COLOR)
        np.testing.assert_array_equal(picture[..., ::-1], pad.rgb[1])
        np.testing.assert_array_equal(np.load(io.BytesIO(files["left.depth_mm.npy"])), pad.depth_mm)
        np.testing.assert_array_equal(
            np.load(io.BytesIO(files["left.force_normal_n.npy"])), pad.force_normal_n
        )


def test_webdataset_reads_it(with_depth, tmp_path):
    webdataset = pytest.importorskip("webdataset")
    export_dataset(with_depth.root, tmp_path / "out", "webdataset")
    tars = [str(path) for path in sorted((tmp_path / "out").glob("*.tar"))]
    read = list(webdataset.WebDataset(tars, shardshuffle=False).decode("rgb8"))
    assert [one["__key__"] for one in read] == [f"g{i:05d}" for i in executed(with_depth)]
    first = with_depth.read(int(executed(with_depth)[0])).pads["left"]
    np.testing.assert_array_equal(read[0]["left.0.png"], first.rgb[0])
    np.testing.assert_array_equal(read[0]["left.depth_mm.npy"], first.depth_mm)


def test_robomimic_has_what_its_documentation_asks_for(with_depth, tmp_path):
    export_dataset(with_depth.root, tmp_path / "out", "robomimic")
    indices = executed(with_depth)
    with h5py.File(tmp_path / "out" / "grasps.hdf5") as file:
        demos = sorted(file["data"], key=lambda name: int(name.split("_")[1]))
        assert len(demos) == len(indices)
        assert json.loads(file["data"].attrs["env_args"])["env_name"] == "tacgen"
        total = 0
        for name, index in zip(demos, indices, strict=True):
            demo, sample = file["data"][name], with_depth.read(int(index))
            n = demo.attrs["num_samples"]
            total += n
            assert all(len(values) == n for values in demo["obs"].values())
            assert demo["actions"].shape == (n, 5)
            low, high = (file["data"].attrs[f"action_{end}"] for end in ("low", "high"))
            scaled = demo["actions"][0]
            assert np.abs(scaled).max() <= 1.0
            assert file["data"].attrs["action_names"][0] == "force_n"
            value = low + (scaled + 1) / 2 * (high - low)
            changing = high > low
            wanted = [getattr(sample.config, a) for a in file["data"].attrs["action_names"]]
            np.testing.assert_allclose(value[changing], np.array(wanted)[changing], rtol=1e-12)
            assert not scaled[~changing].any()
            assert demo["rewards"][-1] == sample.label
            assert demo["dones"][:].tolist() == [0] * (n - 1) + [1]
            np.testing.assert_array_equal(demo["obs/left_rgb"], sample.pads["left"].rgb)
            np.testing.assert_array_equal(demo["depth_mm/left"], sample.pads["left"].depth_mm)
        assert total == file["data"].attrs["total"]
        masks = {key: [name.decode() for name in names] for key, names in file["mask"].items()}
        columns = with_depth.columns()
        split, label = (columns[name][columns["label"] >= 0] for name in ("split", "label"))
        for suffix, outcome in (("", 1), ("_failed", 0)):
            found = {side: set(masks[side + suffix]) for side in ("train", "valid", "test")}
            rows = list(zip(demos, split, label, strict=True))
            of = {s: {n for n, *one in rows if one == [s, outcome]} for s in ("train", "test")}
            # What a policy is chosen by is a part of the training side.
            assert (found["train"] | found["valid"], found["test"]) == (of["train"], of["test"])
            n = len(of["train"])
            assert len(found["valid"]) == min(math.ceil(0.1 * n), max(n - 1, 0))
        assert sorted(name for listed in masks.values() for name in listed) == sorted(demos)


def test_lerobot_has_the_depth_of_each_episode(with_depth, tmp_path):
    export_dataset(with_depth.root, tmp_path / "out", "lerobot")
    episodes = pd.read_parquet(tmp_path / "out" / "meta/episodes/chunk-000/file-000.parquet")
    for episode, index in zip(episodes["episode_index"], episodes["grasp_index"], strict=True):
        depth = np.load(tmp_path / "out" / "depth_mm" / f"episode_{episode:06d}_left.npy")
        np.testing.assert_array_equal(depth, with_depth.read(int(index)).pads["left"].depth_mm)


@pytest.fixture(scope="module")
def two_pads(tmp_path_factory):
    spec = make_spec(depth=True, pads=("left", "right"))
    folder = collect_toy(tmp_path_factory.mktemp("pads") / "data", spec)
    folder.merge()
    return Dataset(folder.root)


@pytest.mark.parametrize("name", ["images", "real-grasps"])
def test_folders_of_pictures_hold_both_pads(two_pads, tmp_path, name):
    out = tmp_path / "out"
    said = export_dataset(two_pads.root, out, name)["content"]
    index = int(executed(two_pads)[1])
    for pad, suffix in (("left", ""), ("right", "_right")):
        place = out / f"images{suffix}" / f"g{index:05d}"
        picture = cv2.imread(str(place / "2.png"))[..., ::-1]
        np.testing.assert_array_equal(picture, two_pads.rgb(index, pad, 2))
        assert (out / f"background{suffix}.png").is_file()
        if name == "images":
            sample = two_pads.read(index).pads[pad]
            forces = pd.read_csv(out / f"contact{suffix}" / f"g{index:05d}.csv")
            np.testing.assert_allclose(forces["force_normal_n"], sample.force_normal_n)
            depth = np.load(out / f"depth{suffix}" / f"g{index:05d}.npy")
            np.testing.assert_array_equal(depth, sample.depth_mm.astype(np.float32))
            assert "depth of the moment of grasp alone" in said
    assert "right pad" in said
    about = json.loads((out / "about.json").read_text())
    assert about["images"] == {"left": "images", "right": "images_right"}


def test_a_grasp_in_python_has_both_pads(two_pads):
    place = 1
    index, grasp = int(two_pads.indices[place]), two_pads[place]
    np.testing.assert_array_equal(grasp["rgb"], two_pads.rgb(index, "left"))
    for pad in ("left", "right"):
        np.testing.assert_array_equal(grasp[f"rgb_{pad}"], two_pads.rgb(index, pad))


def test_torch_stacks_both_pads(two_pads):
    pytest.importorskip("torch")
    index = int(executed(two_pads)[2])
    both = two_pads.torch(frames="sequence")[2][0].numpy()
    assert both.shape == (2, 3, 3, 24, 32)
    right = np.moveaxis(two_pads.rgb(index, "right"), -1, 1) / np.float32(255)
    np.testing.assert_allclose(both[1], right, rtol=1e-6)
    assert two_pads.torch()[2][0].shape == (2, 3, 24, 32)
    np.testing.assert_allclose(
        two_pads.torch(frames="sequence", pad="right")[2][0].numpy(), right, rtol=1e-6
    )


@pytest.mark.parametrize("depth", [False, True])
def test_exports_say_what_there_is_of_depth(tmp_path, depth):
    folder = collect_toy(tmp_path / "data", make_spec(depth=depth))
    said = export_dataset(folder.root, tmp_path / "out", "webdataset")["content"]
    assert "in 1 tar file of" in said
    assert ("depth of the moment of grasp alone" if depth else "no depth") in said


def test_flags_of_frames_are_columns_where_a_dataset_has_them(monkeypatch):
    def flag(name):
        return Field("contact", name, "bool", ("N", "T"), "1", "gel", "", f"pad.{name}")

    monkeypatch.setattr(samples, "FLAG_FIELDS", (flag("saturated"), flag("far_out")))
    pad = SimpleNamespace(saturated=np.array([0, 1, 1], np.uint8))
    found = samples.frame_flags(pad)
    assert list(found) == ["saturated"]
    assert found["saturated"].tolist() == [False, True, True]

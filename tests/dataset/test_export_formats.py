"""Exports read back by readers that share no code with the writers."""

from __future__ import annotations

import json
import math

import cv2
import h5py
import numpy as np
import pandas as pd
import pytest

from tacgen.dataset import Dataset
from tacgen.dataset.export import export_dataset

from .conftest import collect_toy, make_spec


@pytest.fixture(scope="module")
def with_depth(tmp_path_factory):
    folder = collect_toy(tmp_path_factory.mktemp("depth") / "data", make_spec(depth=True))
    folder.merge()
    return Dataset(folder.root)


def executed(dataset):
    columns = dataset.columns()
    return columns["index"][columns["label"] >= 0]


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

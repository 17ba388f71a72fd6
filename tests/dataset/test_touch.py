"""Depth, markers and force field of every frame: written, checked, read back and exported."""

import io
import json
import tarfile

import h5py
import numpy as np
import pandas as pd
import pytest

from tacgen.core.errors import DatasetError
from tacgen.dataset import Dataset
from tacgen.dataset.export import FORMATS, export_dataset
from tacgen.dataset.summary import summarize, summary_text, write_card
from tacgen.dataset.verify import verify
from tests.messages import refused

from .conftest import TOUCH, collect_toy, make_sample, make_spec, vouch_for

PADS = ("left", "right")
NAMES = ("depth_mm", "markers_mm", "force_field_n")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    spec = make_spec(pads=PADS, **TOUCH)
    folder = collect_toy(tmp_path_factory.mktemp("touch") / "data", spec)
    folder.merge()
    return Dataset(folder.root)


def written(index):
    return make_sample(index, make_spec(pads=PADS, **TOUCH))


def test_the_shard_holds_what_the_contract_says(dataset):
    with h5py.File(dataset.root / dataset.lines[0].file) as file:
        for pad in PADS:
            group = file[f"/tactile/gelsight_{pad}"]
            assert group["depth_mm"].shape == (4, 3, 24, 32)
            assert group["depth_mm"].dtype == np.float16
            assert group["markers_mm"].shape == (4, 3, 6, 2)
            np.testing.assert_array_equal(
                group["markers_mm"].attrs["rest_mm"], TOUCH["marker_rest_mm"]
            )
            field_n = group["force_field_n"]
            assert field_n.shape == (4, 3, 3, 4, 3)
            assert (field_n.attrs["unit"], field_n.attrs["frame"]) == ("N", "gel")
            contact = file[f"/contact/gelsight_{pad}"]
            total_n = field_n[:].sum(axis=(2, 3))
            np.testing.assert_allclose(total_n[..., 2], contact["force_normal_n"], rtol=0.01)
            np.testing.assert_allclose(total_n[..., :2], contact["force_shear_n"], rtol=0.01)
    assert not verify(dataset.root, decode=True).problems


def test_a_grasp_is_read_back_as_it_was(dataset):
    for index in (0, 6):
        found, there = dataset.read(index), written(index)
        for pad in PADS:
            for name in NAMES:
                value = getattr(there.pads[pad], name)
                np.testing.assert_array_equal(getattr(found.pads[pad], name), value)
                np.testing.assert_array_equal(dataset.touch(index, name, pad, 2), value[2])
                np.testing.assert_array_equal(dataset[index][f"{name}_{pad}"], value)
        np.testing.assert_array_equal(dataset[index]["markers_mm"], there.pads["left"].markers_mm)
    assert len(dataset[0:3]) == 3
    np.testing.assert_array_equal(dataset.marker_rest_mm("right"), TOUCH["marker_rest_mm"])
    assert dataset.touch(4, "markers_mm").tolist() == np.zeros((3, 6, 2)).tolist()  # not executed
    assert dataset.mm_per_px == 0.5


def test_torch_gives_the_channels_of_both_pads_as_a_dictionary(dataset):
    torch = pytest.importorskip("torch")
    grasps = dataset.torch(frames="sequence", channels=("rgb", *NAMES))
    sample, index = grasps[1], int(grasps.indices[1])
    assert sample["rgb"].shape == (2, 3, 3, 24, 32)
    assert sample["label"] == grasps.labels[1]
    for name in NAMES:
        both = np.stack([getattr(written(index).pads[pad], name) for pad in PADS])
        assert sample[name].dtype == torch.float32
        np.testing.assert_allclose(sample[name].numpy(), both, rtol=1e-6)
    one = dataset.torch(channels=("markers_mm",), pad="right")[1]
    np.testing.assert_allclose(one["markers_mm"], written(index).pads["right"].markers_mm[1])
    assert set(one) == {"markers_mm", "label"}
    loader = torch.utils.data.DataLoader(grasps, batch_size=4)
    assert next(iter(loader))["force_field_n"].shape == (4, 2, 3, 3, 4, 3)


def test_what_is_not_kept_is_said_with_the_way_to_keep_it(toy):
    plain = Dataset(toy.root)
    assert plain.touch_names == ()
    assert "markers_mm" not in plain[0]
    with refused(DatasetError):
        plain.touch(0, "markers_mm")
    with refused(DatasetError):
        plain.touch(0, "force_field_n")
    with refused(DatasetError):
        plain.touch(0, "markers_m")
    pytest.importorskip("torch")
    with refused(DatasetError):
        plain.torch(channels=("rgb", "depth_mm"))


def test_every_export_holds_it_of_both_pads(dataset, tmp_path):
    pytest.importorskip("pyarrow")
    said = {
        name: export_dataset(dataset.root, tmp_path / name, name)["content"] for name in FORMATS
    }
    for name in set(FORMATS) - {"real-grasps"}:
        assert "depth of every frame; the markers' motion; the force field" in said[name]
    index = 1
    for pad, suffix in (("left", ""), ("right", "_right")):
        there = written(index).pads[pad]
        images = tmp_path / "images"
        for name, stem in zip(NAMES, ("depth", "markers", "force_field"), strict=True):
            stored = np.load(images / f"{stem}{suffix}/g00001.npy")
            np.testing.assert_allclose(stored, getattr(there, name), rtol=1e-6)
        rest_mm = np.load(images / f"markers{suffix}/rest_mm.npy")
        np.testing.assert_array_equal(rest_mm, TOUCH["marker_rest_mm"])
        with tarfile.open(tmp_path / "webdataset/grasps-000000.tar") as archive:
            for name in NAMES:
                content = archive.extractfile(f"g00001.{pad}.{name}.npy").read()
                np.testing.assert_array_equal(np.load(io.BytesIO(content)), getattr(there, name))
            content = archive.extractfile(f"g00001.{pad}.marker_rest_mm.npy").read()
            assert np.load(io.BytesIO(content)).shape == (6, 2)
        with h5py.File(tmp_path / "robomimic/grasps.hdf5") as file:
            for name in NAMES:
                stored = file[f"data/demo_1/obs/{pad}_{name}"][:]
                np.testing.assert_array_equal(stored, getattr(there, name))
            assert file["data"].attrs[f"{pad}_marker_rest_mm"].shape == (6, 2)


def test_lerobot_has_markers_and_force_field_as_features(dataset, tmp_path):
    pytest.importorskip("pyarrow")
    export_dataset(dataset.root, tmp_path / "out", "lerobot")
    info = json.loads((tmp_path / "out/meta/info.json").read_text())
    stats = json.loads((tmp_path / "out/meta/stats.json").read_text())
    frames = pd.read_parquet(tmp_path / "out/data/chunk-000/file-000.parquet")
    episodes = pd.read_parquet(tmp_path / "out/meta/episodes/chunk-000/file-000.parquet")
    for pad in PADS:
        for name, shape in (("markers_mm", [6, 2]), ("force_field_n", [3, 4, 3])):
            key = f"observation.{pad}.{name}"
            feature = info["features"][key]
            assert (feature["dtype"], feature["shape"]) == ("float32", shape)
            assert len(feature["names"]) == len(shape)
            assert np.shape(stats[key]["mean"]) == tuple(shape)
            episode = episodes.iloc[2]
            rows = frames.iloc[episode["dataset_from_index"] : episode["dataset_to_index"]]
            stored = np.array([np.array(value.tolist()).tolist() for value in rows[key]], object)
            flat = np.array([_flat(value) for value in stored])
            there = getattr(written(int(episode["grasp_index"])).pads[pad], name)
            np.testing.assert_allclose(flat, there.reshape(3, -1), rtol=1e-6)
        rest_mm = info["features"][f"observation.{pad}.markers_mm"]["info"]["rest_mm"]
        assert rest_mm == TOUCH["marker_rest_mm"].tolist()
        depth = np.load(tmp_path / f"out/depth_mm/episode_000000_{pad}.npy")
        assert depth.shape == (3, 24, 32)


def _flat(nested):
    found = []
    for one in nested:
        found += _flat(one) if np.ndim(one) or isinstance(one, np.ndarray) else [float(one)]
    return found


def test_a_value_that_is_not_finite_is_found(tmp_path):
    toy = collect_toy(tmp_path / "data", make_spec(**TOUCH))
    with h5py.File(toy.shard_path(0), "r+") as file:
        file["/tactile/gelsight/force_field_n"][1, 2, 0, 0, 0] = np.nan
    vouch_for(toy, 0)
    problems = [problem.reason for problem in verify(toy.root, decode=True).problems]
    assert any("force_field_n: the image (1, 2) is not finite" in text for text in problems)


def test_inspect_and_card_say_what_is_kept_and_what_it_costs(dataset):
    found = summarize(dataset.root)["arrays"]
    assert list(found) == ["rgb", *NAMES]
    raw_kb = {"rgb": 24 * 32 * 3, "depth_mm": 24 * 32 * 2, "markers_mm": 48, "force_field_n": 144}
    for name, cost in found.items():
        assert cost["raw_bytes"] == raw_kb[name] * 3 * 2  # three frames, two pads
        assert cost["bytes"] > 0
    assert "6 markers" in summary_text(summarize(dataset.root))
    card = write_card(dataset.root).read_text()
    assert "force_field_n" in card
    assert "in kB a grasp: rgb" in card

"""A dataset in a user's own hands: indexing, slices, what it prints, torch."""

from dataclasses import replace

import h5py
import hdf5plugin  # noqa: F401  (registers the filters)
import numpy as np
import pytest

from tacgen import Dataset
from tacgen.core.errors import DatasetError
from tacgen.dataset.shard import open_shard
from tests.messages import refused

from .conftest import collect_toy, make_sample, make_spec


@pytest.fixture
def toy(tmp_path):
    spec = make_spec()
    collect_toy(tmp_path / "toy", spec)
    return Dataset(tmp_path / "toy"), spec


def test_an_item_holds_what_was_written(toy):
    dataset, spec = toy
    written = make_sample(3, spec)
    item = dataset[3]
    assert np.array_equal(item["rgb"], written.pads["left"].rgb)
    assert (item["label"], item["object"], item["split"]) == (written.label, "can", "test")
    assert (item["force_n"], item["x_mm"]) == (8.0, 1.5)
    assert dataset[-1]["index"] == 9


def test_torch_takes_executed_grasps_of_one_side(toy):
    torch = pytest.importorskip("torch")
    dataset, spec = toy
    train = dataset.torch(split="train")
    assert train.indices.tolist() == [0, 1, 2, 5, 6, 8]
    image, label = train[1]
    written = make_sample(1, spec)
    assert image.shape == (3, 24, 32)
    assert image.dtype == torch.float32
    expected = written.pads["left"].rgb[written.grasp_frame].astype(np.float32) / 255
    np.testing.assert_allclose(image.permute(1, 2, 0).numpy(), expected, atol=1e-7)
    assert int(label) == written.label
    assert [int(label) for _, label in train[0:2]] == [int(train[0][1]), written.label]
    whole = dataset.torch(frames="sequence")
    assert len(whole) == 8
    batch, labels = next(iter(torch.utils.data.DataLoader(whole, batch_size=4)))
    assert batch.shape == (4, 3, 3, 24, 32)
    assert labels.tolist() == [make_sample(k, spec).label for k in (0, 1, 2, 3)]


def test_a_pair_is_the_grasp_and_the_frame_before_it_about_the_gel_at_rest(toy):
    pytest.importorskip("torch")
    dataset, spec = toy
    pairs = dataset.torch(frames="pair", split="train")
    rest = dataset.reference().astype(float)
    for place in (0, 1, 2):
        index = int(pairs.indices[place])
        written, found = make_sample(index, spec), pairs[place][0].numpy()
        assert found.shape == (6, 24, 32)
        now = written.grasp_frame
        rgb = written.pads["left"].rgb.astype(float)
        for k, picture in enumerate((rgb[now], rgb[now - 1])):
            expected = np.clip((picture - rest) / 255 + 0.5, 0, 1)
            np.testing.assert_allclose(
                found[3 * k : 3 * k + 3].transpose(1, 2, 0), expected, atol=1e-6
            )
    assert dataset.torch(frames="pair", channels=["rgb"])[0]["rgb"].shape == (6, 24, 32)


def test_two_pads_have_a_pair_each_and_a_single_frame_has_none(tmp_path, monkeypatch):
    pytest.importorskip("torch")
    spec = make_spec(pads=("left", "right"))
    collect_toy(tmp_path / "two", spec)
    assert Dataset(tmp_path / "two").torch(frames="pair")[0][0].shape == (2, 6, 24, 32)

    def first_frame(index, spec):
        return replace(make_sample(index, spec), grasp_frame=0)

    monkeypatch.setattr("tests.dataset.conftest.make_sample", first_frame)
    collect_toy(tmp_path / "single", make_spec())
    with refused(DatasetError):
        Dataset(tmp_path / "single").torch(frames="pair")


def test_a_side_that_is_not_there_is_refused(toy):
    pytest.importorskip("torch")
    with refused(DatasetError):
        toy[0].torch(split="val")


@pytest.fixture
def noiseless(tmp_path):
    """A dataset of two pads to whose images the reader adds noise of 2 grey levels."""
    spec = make_spec(noise_at_load_grey=2.0, pads=("left", "right"))
    collect_toy(tmp_path / "noiseless", spec)
    return tmp_path / "noiseless", spec


def test_noise_at_load_is_that_of_a_camera(noiseless):
    root, spec = noiseless
    dataset = Dataset(root)
    clean = [make_sample(index, spec).pads for index in (0, 1, 2, 3)]
    left, right = (
        np.stack(
            [dataset.rgb(k, pad) - pads[pad].rgb.astype(float) for k, pads in enumerate(clean)]
        )
        for pad in ("left", "right")
    )
    # 27 648 values: the deviation of a standard deviation is 0.4 %, of a mean 0.012, of a
    # correlation 0.006; rounding adds a variance of 1/12.
    assert left.std() == pytest.approx(np.sqrt(4 + 1 / 12), rel=0.02)
    assert abs(left.mean()) < 0.05
    for other in (right, *(np.roll(left, 1, axis) for axis in (0, 1, -1))):
        assert abs(np.corrcoef(left.ravel(), other.ravel())[0, 1]) < 0.03


@pytest.mark.parametrize("value", [np.nan, -1.0, "2", [1.0, 2.0]])
def test_noise_at_load_that_is_no_deviation_is_refused(noiseless, value):
    root, _ = noiseless
    path = root / "shards" / "shard-00000.h5"
    with h5py.File(path, "r+") as file:
        del file.attrs["noise_at_load_grey"]
        file.attrs["noise_at_load_grey"] = value
    with refused(DatasetError):
        open_shard(path)

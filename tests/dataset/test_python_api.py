"""A dataset in a user's own hands: indexing, slices, what it prints, torch."""

import numpy as np
import pytest

from tacgen import Dataset
from tacgen.core.errors import DatasetError

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


def test_slices_are_lists_of_items(toy):
    dataset, _ = toy
    assert [item["index"] for item in dataset[2:8:3]] == [2, 5]
    assert [item["index"] for item in dataset] == dataset.indices.tolist()
    with pytest.raises(IndexError):
        dataset[10]


def test_it_says_what_it_is(toy):
    text = repr(toy[0])
    assert "10 grasps" in text
    assert "3 frames of 32×24 px from gelsight on left" in text


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
    whole = dataset.torch(frames="sequence")
    assert len(whole) == 8
    batch, labels = next(iter(torch.utils.data.DataLoader(whole, batch_size=4)))
    assert batch.shape == (4, 3, 3, 24, 32)
    assert labels.tolist() == [make_sample(k, spec).label for k in (0, 1, 2, 3)]


def test_a_side_that_is_not_there_is_refused(toy):
    pytest.importorskip("torch")
    with pytest.raises(DatasetError, match="split 'val' is not known; give one of train, test"):
        toy[0].torch(split="val")

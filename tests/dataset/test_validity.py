"""What an image does not show of its force: in shards, manifest, summary, pages and exports."""

import json
from dataclasses import replace

import h5py
import numpy as np
import pandas as pd
import pytest

from tacgen.dataset import Dataset, DatasetFolder
from tacgen.dataset.export import images
from tacgen.dataset.gallery import write_gallery
from tacgen.dataset.grasp_page import write_grasp_page
from tacgen.dataset.summary import summarize, summary_text, validity_lines, write_card
from tacgen.dataset.verify import verify

from .conftest import make_sample, make_spec, vouch_for

FLAGS = {
    # grasp: pad: flags of its three frames; the moment of grasp is frame 1
    0: {"left": {"saturated": [0, 1, 1], "no_contact": [1, 0, 0]}},
    1: {"left": {"no_contact": [1, 0, 0]}, "right": {"outside_window": [0, 1, 0]}},
    2: {"left": {"saturated": [0, 0, 1]}},
}
NAMES = ("saturated", "no_contact", "outside_window")


def flagged(index, spec):
    sample = make_sample(index, spec)
    given = FLAGS.get(index, {})
    pads = {
        pad: replace(
            own, **{n: np.array(given.get(pad, {}).get(n, [0, 0, 0]), np.uint8) for n in NAMES}
        )
        for pad, own in sample.pads.items()
    }
    return replace(sample, pads=pads)


@pytest.fixture
def dataset(tmp_path):
    spec = make_spec(pads=("left", "right"))
    folder = DatasetFolder(tmp_path / "toy")
    folder.prepare(spec)
    for shard in range(spec.n_shards):
        with folder.claim(shard):
            folder.write_shard(shard, (flagged(i, spec) for i in spec.shard_range(shard)), spec)
    folder.merge()
    return folder


def test_each_frame_of_a_shard_has_its_flags(dataset):
    with h5py.File(dataset.shard_path(0)) as shard:
        assert shard["/contact/gelsight_left/saturated"].dtype == np.uint8
        assert shard["/contact/gelsight_left/saturated"][:3].tolist() == [
            [0, 1, 1], [0, 0, 0], [0, 0, 1],
        ]  # fmt: skip
        assert shard["/contact/gelsight_right/outside_window"][1].tolist() == [0, 1, 0]
        assert "pressed through" in shard["/contact/gelsight_left/saturated"].attrs["description"]
    read = Dataset(dataset.root).read(0).pads["left"]
    assert read.saturated.tolist() == [0, 1, 1]
    assert (read.flags(0), read.flags(1)) == (["no contact"], ["saturated"])


def test_the_summary_counts_frames_and_grasps_at_their_moment(dataset):
    summary = summarize(dataset.root)
    # Eight grasps of ten are executed, of three frames on two pads each.
    assert summary["validity"] == {
        "frames": {"of": 48, "saturated": 3, "no_contact": 2, "outside_window": 1},
        "grasps": {"of": 8, "saturated": 1, "no_contact": 0, "outside_window": 1},
    }
    text = summary_text(summary)
    assert "images    48 of all pads: 3 saturated, 2 no contact, 1 outside window\nsize" in text
    line = "images that do not show the whole force at the moment of grasp, of 8 grasps: 1 "
    assert line in text
    assert validity_lines(summary)[0].startswith(line)
    assert "| … of which outside window | 1 |" in write_card(dataset.root).read_text()


def test_a_dataset_of_which_all_images_show_their_force_says_nothing(toy):
    assert validity_lines(summarize(toy.root)) == []


def test_verify_compares_the_flags_with_the_manifest(dataset):
    assert not verify(dataset.root).problems
    with h5py.File(dataset.shard_path(0), "a") as shard:
        shard["/contact/gelsight_left/saturated"][3] = 1
    vouch_for(dataset, 0)
    (problem,) = verify(dataset.root).problems
    assert "validity is" in problem.reason
    assert "in the manifest" in problem.reason


def test_the_pages_name_them(dataset, tmp_path):
    page = write_gallery(dataset.root).read_text()
    cards = page.split('<article class="card')[1:]
    assert '<b class="flag">saturated</b>' in cards[0]
    assert cards[1].count("flag") == 1
    assert '<b class="flag">outside window</b>' in cards[1]
    assert '<b class="flag">saturated in 1 of 3</b>' in cards[2]
    assert "flag" not in cards[3]
    write_grasp_page(dataset.root, 0, tmp_path / "grasp.html")
    text = (tmp_path / "grasp.html").read_text()
    assert "0.50 s, saturated" in text
    assert "0.00 s, no contact" in text


def test_exports_have_them(dataset, tmp_path):
    found = Dataset(dataset.root)
    columns = {name: list(values) for name, values in found.columns().items()}
    grasps = pd.DataFrame(columns).query("label >= 0")
    images.write(found, grasps, tmp_path)
    frames = pd.read_csv(tmp_path / "contact" / "g00000.csv")
    assert frames["saturated"].tolist() == [0, 1, 1]
    assert frames["no_contact"].tolist() == [1, 0, 0]


def test_lerobots_frames_have_them(dataset, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    from tacgen.dataset.export import export_dataset

    export_dataset(dataset.root, tmp_path / "out", "lerobot")
    table = parquet.read_table(tmp_path / "out" / "data").to_pandas()
    features = json.loads((tmp_path / "out/meta/info.json").read_text())["features"]
    named = [f"{pad}.{name}" for pad in ("left", "right") for name in NAMES]
    assert {features[name]["dtype"] for name in named} == {"bool"}
    assert table[[name for name in named if "saturated" in name]].to_numpy().sum() == 3
    assert table[[name for name in named if "outside_window" in name]].to_numpy().sum() == 1

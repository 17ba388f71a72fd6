"""What an image does not show of its force: in shards, manifest, summary, pages and exports."""

import re
from dataclasses import replace

import h5py
import numpy as np
import pandas as pd
import pytest

from tacgen.dataset import Dataset, DatasetFolder
from tacgen.dataset.export import images
from tacgen.dataset.gallery import write_gallery
from tacgen.dataset.grasp_page import write_grasp_page
from tacgen.dataset.summary import (
    cut_off_line,
    summarize,
    summary_text,
    validity_lines,
    write_card,
)
from tacgen.dataset.verify import verify

from .conftest import make_sample, make_spec, vouch_for

FLAGS = {
    # grasp: pad: flags of its three frames; the moment of grasp is frame 1
    0: {"left": {"saturated": [0, 1, 1], "no_contact": [1, 0, 0]}},
    1: {"left": {"no_contact": [1, 0, 0]}, "right": {"outside_window": [0, 1, 0]}},
    2: {"left": {"saturated": [0, 0, 1]}},
    3: {"right": {"nothing_to_see": [0, 1, 1]}},
}
NAMES = ("saturated", "no_contact", "nothing_to_see", "outside_window")


BEYOND = np.array([[0.0] * 4, [0.3, 0.0, 0.0, 0.02], [0.0] * 4])  # left, top, right, bottom


def flagged(index, spec):
    sample = make_sample(index, spec)
    given = FLAGS.get(index, {})
    pads = {
        pad: replace(
            own,
            **{n: np.array(given.get(pad, {}).get(n, [0, 0, 0]), np.uint8) for n in NAMES},
            outside_share=BEYOND if index == 1 else np.zeros((3, 4)),
            visible_share=np.full(3, 0.0 if index == 3 else 0.2),
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
        "frames": {"of": 48, **dict(zip(NAMES, (3, 2, 2, 1), strict=True))},
        "grasps": {"of": 8, **dict(zip(NAMES, (1, 0, 1, 1), strict=True))},
    }
    text = summary_text(summary)
    counts = "3 saturated, 2 no contact, 2 nothing to see, 1 cut off"
    assert f"images    48 of all pads: {counts}\nsize" in text
    assert "cut off: the contact goes on beyond the picture in 1 of 8 grasps" in text
    assert "| … of which cut off (`outside_window`) | 1 |" in write_card(dataset.root).read_text()


def test_a_warning_lists_the_grasps_with_nothing_to_see_and_what_to_change(dataset):
    summary = summarize(dataset.root)
    assert summary["nothing_to_see"] == {"can": [3]}
    saturated, empty = validity_lines(summary)
    assert saturated == "saturated: 1 of 8 grasps press the gel through"
    first, listed = empty.splitlines()
    assert first.startswith("nothing to see: in 1 of 8 grasps no pixel")
    assert listed == "  can: grasp 3"
    for fix in ("grid.force_n", "grid.x_mm", "sensor"):
        assert fix in first


def test_a_dataset_of_which_all_images_show_their_force_says_nothing(toy):
    summary = summarize(toy.root)
    assert [*validity_lines(summary), *cut_off_line(summary)] == []


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
    text = page.split('<article class="card')[1:]
    cards = {int(re.search(r'id="grasp-(\d+)"', card)[1]): card for card in text}
    assert '<p class="look">left pad: saturated</p>' in cards[0]
    # Cut off at the left, where nearly all of it is: a line there, and nothing over the picture.
    assert '<span class="edges left" title="cut off: ' in cards[1]
    assert 'class="look"' not in cards[1] + cards[2]
    assert '<p class="look">right pad: nothing to see</p>' in cards[3]
    assert [k for k, card in cards.items() if re.search(r'"edges \w', card)] == [1]
    select = page.split('<select name="picture">')[1].split("</select>")[0]
    assert re.findall("<option>(.*?)</option>", select) == [
        *("shows a contact", "saturated", "nothing to see", "cut off"),
    ]
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

"""The card and the gallery: what a person reads."""

import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tacgen.dataset import DatasetFolder, gallery
from tacgen.dataset.gallery import shown_grasps, thumbnails, write_gallery
from tacgen.dataset.input_hashes import Inputs
from tacgen.dataset.summary import write_card

from .conftest import collect_toy, make_sample, make_spec

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")


def test_card_says_counts_layout_and_origin(tmp_path):
    spec = make_spec(inputs=Inputs({"recipe": "ab" * 32}))
    text = write_card(collect_toy(tmp_path / "toy", spec).root).read_text()
    assert "10 simulated grasps" in text
    assert "| success | 5 |" in text
    assert "| can | 3 | 1 | 1 |" in text
    assert "| `/contact/force_shear_n` | N, T, 2 | float64 | N | gel |" in text
    assert f"| `recipe` | `{'ab' * 32}` |" in text


def test_gallery_needs_no_network_and_shows_every_grasp(toy):
    page = write_gallery(toy.root).read_text()
    outside = r"""(src|href)=(?!"data:)|@import|url\((?!"data:)|https?:(?!//www\.w3)"""
    assert not re.search(outside, page)
    assert sorted(re.findall(r'id="grasp-(\d+)"', page)) == [str(i) for i in range(10)]
    assert "too far away" in page
    points = json.loads(re.search(r"const POINTS = (.*);", page)[1])
    assert [point["outcome"] for point in points].count("success") == 5
    # Grasp 1: 6 N at the last of three frames, half of it at the moment of grasp.
    assert points[1]["normal"] == 3.0


def test_gallery_of_a_large_dataset_is_bounded_and_says_so(toy, monkeypatch):
    monkeypatch.setattr(gallery, "MAX_CARDS", 4)
    assert shown_grasps(make_spec()) == {0, 3, 6, 9}
    page = write_gallery(toy.root).read_text()
    assert sorted(re.findall(r'id="grasp-(\d+)"', page)) == ["0", "3", "6", "9"]
    assert "4 of the 10 grasps are below, taken evenly" in page
    monkeypatch.setattr(gallery, "MAX_PAGE_BYTES", 9_000)
    page = write_gallery(toy.root).read_text()
    assert 0 < page.count("<article") < 4


def test_thumbnails_made_as_grasps_are_made_are_those_of_the_shards(tmp_path):
    spec = make_spec(noise_at_load_grey=3.0, pads=("left", "right"))
    root = collect_toy(tmp_path, spec).root
    made = {k: thumbnails(make_sample(k, spec), spec.noise_at_load_grey) for k in range(10)}
    assert [len(one.strips) for one in made.values()] == [2, 2, 2, 2, 0] * 2
    page = write_gallery(root).read_text()
    assert write_gallery(root, made).read_text() == page
    assert made[0].images[1] in page
    made[0] = replace(made[0], picture="data:,made")
    assert write_gallery(root, made).read_text() != page


@pytest.fixture
def seen(tmp_path):
    """A dataset whose grasps show more or less."""
    spec = make_spec()
    folder = DatasetFolder(tmp_path / "seen")
    folder.prepare(spec)
    visible = {0: 0.3, 1: 0.2, 2: 0.015, 3: 0.4, 5: 0.0149, 6: 0.0, 7: 0.3, 8: 0.5}

    def sample(index):
        made = make_sample(index, spec)
        shown = {"visible_share": np.full(3, visible.get(index, 0.0))}
        return replace(made, pads={k: replace(pad, **shown) for k, pad in made.pads.items()})

    for shard in range(spec.n_shards):
        with folder.claim(shard):
            folder.write_shard(shard, map(sample, spec.shard_range(shard)), spec)
    return folder


def test_a_gallery_opens_on_grasps_that_show_something_of_all_objects_and_outcomes(seen):
    page = write_gallery(seen.root).read_text()
    order = [int(k) for k in re.findall(r'id="grasp-(\d+)"', page)]
    # One of each object and outcome, then the others; then what shows little, and what nothing.
    assert set(order[:4]) == {0, 1, 2, 3}
    assert set(order[4:6]) == {7, 8}
    assert order[6] == 5
    assert set(order[7:]) == {4, 6, 9}


@pytest.mark.parametrize(
    ("sliding", "turning", "label", "texts"),
    [
        (
            -0.3,
            1.0,
            1,
            ["-0.30 × weight: slides, but too little to fail", "+1.00 mm × weight: holds"],
        ),
        (0.5, -3.4, 0, ["+0.50 × weight: holds", "-3.40 mm × weight: turns"]),
        (float("nan"), float("nan"), 0, []),
    ],
)
def test_a_margin_says_what_its_sign_means(sliding, turning, label, texts):
    values = {"margin_translational": sliding, "margin_rotational": turning, "label": label}
    assert [text for _, text in gallery._margins(values)] == texts


def test_names_in_a_gallery_are_shown_not_run(tmp_path):
    recipe = {"name": "toy", "description": "<script>alert(1)</script>"}
    collect_toy(tmp_path, make_spec(recipe=recipe))
    assert "<script>alert" not in write_gallery(tmp_path).read_text()


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed")
@pytest.mark.parametrize(
    ("state", "shown"),
    [
        ("", {0, 1, 2, 3, 4, 5, 6, 7, 8, 9}),
        ("label=0&object=cup", {0, 6}),
        ("low=8&high=10&outcome=rotational_slip", {3}),
        ("split=test&motion=1", {3, 7}),
    ],
)
def test_filters_of_the_gallery(toy, tmp_path, state, shown):
    page = write_gallery(toy.root)
    assert shown_in_browser(page, state, tmp_path) == shown
    assert Path(page).stat().st_size < 1_000_000


def shown_in_browser(page, state, tmp_path):
    """The grasps that the page shows in a state of its filters."""
    command = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--dump-dom"]
    command += [f"--user-data-dir={tmp_path / 'chromium'}", f"file://{page}#{state}"]
    dom = subprocess.run(command, capture_output=True, text=True, timeout=60).stdout
    cards = re.findall(r'<article class="[^"]*" id="grasp-(\d+)"[^>]*?( hidden="")?>', dom)
    shown = {int(index) for index, hidden in cards if not hidden}
    assert f"{len(shown)} of 10 shown" in dom
    return shown

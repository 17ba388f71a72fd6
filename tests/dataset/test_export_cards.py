"""The README.md of every export is a dataset card; LeRobot's meta says what images are of."""

import json

import pytest
import yaml

from tacgen.dataset.export import FORMATS, export_dataset

from .conftest import collect_toy, make_spec


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    folder = collect_toy(tmp_path_factory.mktemp("cards") / "toy_set", make_spec(depth=True))
    folder.merge()
    return folder.root


@pytest.mark.parametrize("name", FORMATS)
def test_every_export_has_a_card_that_the_hub_reads(root, tmp_path, name):
    written = export_dataset(root, tmp_path / "out", name)
    text = (tmp_path / "out" / "README.md").read_text(encoding="utf-8")
    start, header, body = text.split("---\n", 2)
    assert start == ""
    found = yaml.safe_load(header)
    assert found["pretty_name"] == "toy_set"
    assert found["task_categories"] == ["robotics"]
    assert found["size_categories"] == ["n<1K"]
    assert ("LeRobot" in found["tags"]) == ("configs" in found) == (name == "lerobot")
    assert f"of {written['grasps']} grasps" in body


def test_lerobots_meta_has_the_sensor_its_table_and_what_is_depth(root, tmp_path):
    export_dataset(root, tmp_path / "out", "lerobot")
    meta = tmp_path / "out" / "meta"
    known = json.loads((meta / "tacgen.json").read_text())
    spec = make_spec(depth=True)
    assert known["sensor"] == spec.sensor.name
    assert known["mm_per_px"] == pytest.approx(spec.sensor.mm_per_px)
    assert known["sha256"] == dict(spec.inputs.sha256)
    assert known["arrays"]["depth_mm/episode_*_<pad>.npy"]["is_depth_map"] is True

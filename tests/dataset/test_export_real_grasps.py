"""A dataset written as real grasps: what is in the folder, and that it says it is not real."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from tacgen.cli import app
from tacgen.core.errors import DatasetError
from tacgen.dataset import Dataset
from tacgen.dataset.export import export_dataset
from tacgen.dataset.real_grasps import read_real_grasps
from tacgen.learning.grasps import RealGraspImages
from tests.messages import refused


def test_a_dataset_becomes_a_folder_of_grasps_that_says_it_is_not_real(toy, tmp_path):
    result = export_dataset(toy.root, tmp_path / "real", "real-grasps", split="train")
    found = RealGraspImages(tmp_path / "real")
    dataset, columns = Dataset(toy.root), Dataset(toy.root).columns()
    chosen = (columns["split"] == "train") & (columns["label"] >= 0)
    assert result["grasps"] == len(found.table) == chosen.sum()
    assert list(found.table.label) == list(columns["label"][chosen])
    index = int(columns["index"][chosen][3])
    np.testing.assert_array_equal(found.frames(3, [0, 1, 2]), dataset.rgb(index))
    np.testing.assert_array_equal(found.reference, dataset.reference())
    assert "Not real" in (tmp_path / "real" / "about.json").read_text()
    assert read_real_grasps(tmp_path / "real").is_simulated


def test_labels_alone(toy, tmp_path):
    out = tmp_path / "real"
    arguments = ["export", str(toy.root), "--format", "real-grasps", "--out", str(out)]
    run = CliRunner().invoke(app, [*arguments, "--no-images", "--json"])
    assert run.exit_code == 0, run.output
    n_executed = (Dataset(toy.root).columns()["label"] >= 0).sum()
    assert json.loads(run.stdout)["grasps"] == len(read_real_grasps(out).grasps) == n_executed
    assert not (out / "images").exists()


@pytest.mark.parametrize(
    "options",
    [
        {"format_name": "zarr"},
        {"split": "validation"},
        {"format_name": "lerobot", "images": False},
    ],
)
def test_what_cannot_be_exported_is_refused_before_anything_is_written(toy, tmp_path, options):
    given = {"format_name": "real-grasps"} | options
    with refused(DatasetError):
        export_dataset(toy.root, tmp_path / "out", **given)
    assert [path.name for path in tmp_path.iterdir()] == ["toy"]

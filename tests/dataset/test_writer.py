import hashlib
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from tacgen.core.errors import DatasetError
from tacgen.core.records import GraspConfig
from tacgen.dataset import DatasetFolder
from tests.messages import refused

from .conftest import collect_toy, make_sample


def digests(root: Path) -> list[str]:
    return [hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted(root.glob("shards/*.h5"))]


def test_contract_layout(toy):
    with h5py.File(toy.shard_path(0)) as file:
        for name in (
            *("index", "force_n", "x_mm", "y_mm", "z_mm", "seed"),
            *("label", "failure_mode", "status", "object"),
        ):
            assert file[f"/grasp/{name}"].shape == (4,)
        rgb = file["/tactile/gelsight/rgb"]
        assert (rgb.shape, rgb.dtype) == ((4, 3, 24, 32, 3), np.uint8)
        assert file["/contact/force_normal_n"].shape == (4, 3)
        assert file["/contact/force_shear_n"].shape == (4, 3, 2)
        assert file["/contact/indentation_mm"].shape == (4, 3)
        assert file["/object/pose"].shape == (4, 3, 7)
        np.testing.assert_array_equal(file["/time_s"], [0.0, 0.5, 1.0])
        assert file["/contact/force_normal_n"].attrs["unit"] == "N"
        assert file["/contact/force_normal_n"].attrs["frame"] == "gel"
        assert list(file["/grasp/object"].asstr()) == ["cup", "can", "cup", "can"]


def test_manifest_line_of_each_shard(toy, spec):
    lines = [json.loads(text) for text in toy.manifest_path.read_text().splitlines()]
    assert [line["index_range"] for line in lines] == [[0, 4], [4, 8], [8, 10]]
    assert [line["sha256"] for line in lines] == digests(toy.root)
    assert lines[0]["recipe_sha256"] == spec.recipe_sha256
    assert lines[0]["calibration"] == {"table": "cd" * 32}
    assert {"tacgen", "h5py", "numpy"} <= set(lines[0]["versions"])
    # Grasps 4 and 9 are not executed; of the others those with index % 3 > 0 succeed.
    outcome = {"success": 5, "failure": 3, "not_executed": 2}
    for name, count in outcome.items():
        assert sum(line["counts"][name] for line in lines) == count


def test_a_grasp_not_executed_is_kept_with_zeros(toy):
    with h5py.File(toy.shard_path(1)) as file:
        assert file["/grasp/label"][0] == -1
        assert file["/grasp/status"].asstr()[0] == "unreachable"
        assert file["/grasp/reason"].asstr()[0] == "too far away"
        assert not file["/tactile/gelsight/rgb"][0].any()


@pytest.mark.slow
def test_same_bytes_in_another_order_and_another_process(tmp_path, spec):
    one = collect_toy(tmp_path / "one", spec, shards=(0, 1, 2))
    two = collect_toy(tmp_path / "two", spec, shards=(2, 0, 1))
    script = (
        "import sys; sys.path.insert(0, sys.argv[1])\n"
        "from tests.dataset.conftest import collect_toy, make_spec\n"
        "from pathlib import Path\n"
        "collect_toy(Path(sys.argv[2]), make_spec())"
    )
    checkout = str(Path(__file__).parents[2])
    command = [sys.executable, "-c", script, checkout, str(tmp_path / "three")]
    subprocess.run(command, check=True, cwd=checkout)
    assert digests(one.root) == digests(two.root) == digests(tmp_path / "three")


@pytest.mark.parametrize(
    "change",
    [
        {"label": -1},
        {"status": "sleepy"},
        {"split": "half"},
        {"pads": {}},
        {"object_pose": np.full((3, 7), np.nan)},
        {"config": GraspConfig(2, "can", 5.0, 0.0, 0.0, 40.0)},
    ],
)
def test_a_grasp_that_does_not_fit_is_refused_and_leaves_nothing(tmp_path, spec, change):
    folder = DatasetFolder(tmp_path)
    folder.prepare(spec)
    samples = [make_sample(i, spec) for i in range(4)]
    samples[1] = replace(samples[1], **change)
    with refused(DatasetError):
        folder.write_shard(0, samples, spec)
    assert not list((tmp_path / "shards").iterdir())


@pytest.mark.parametrize("count", [3, 5])
def test_grasps_missing_or_too_many_are_refused_and_leave_nothing(tmp_path, spec, count):
    folder = DatasetFolder(tmp_path)
    folder.prepare(spec)
    with refused(ValueError):
        folder.write_shard(0, (make_sample(i, spec) for i in range(count)), spec)
    assert not list((tmp_path / "shards").iterdir())

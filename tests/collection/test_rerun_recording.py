"""A grasp as a recording for Rerun, read back by Rerun's own reader."""

import sys

import numpy as np
import pytest
from typer.testing import CliRunner

from tacgen import Dataset
from tacgen.cli import app
from tacgen.collection.recipe import load_recipe
from tacgen.collection.rerun_recording import write_recording
from tacgen.collection.run import collect
from tacgen.core.errors import DatasetError
from tacgen.core.records import PADS
from tests.messages import refused
from tests.small_world import write_world

INDEX = 1


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rerun")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)  # where the sensor is looked for
        camera = "{name: a, size_px: [24, 30], look_at: {from_mm: [300, 0, 90], to_mm: [0, 0, 90]}}"
        scene = f"{{frames: all, cameras: [{camera}]}}"
        recipe = load_recipe(write_world(folder, frames="{mode: sequence, count: 3}", scene=scene))
        collect(recipe, folder / "data", progress=False)
        yield folder / "data"


def columns(path):
    """Every logged column by entity and component, a row a time, as numpy arrays."""
    chunk = pytest.importorskip("rerun.chunk")
    found = {}
    for one in chunk.RrdReader(path).stream():
        batch = one.to_record_batch()
        for name in batch.schema.names:
            rows = [np.array(row).squeeze() for row in batch.column(name).to_pylist()]
            found[f"{one.entity_path} {name}"] = rows
    return found


def test_it_holds_what_the_dataset_and_the_physics_say(data, tmp_path):
    write_recording(data, INDEX, tmp_path / "grasp.rrd")
    found = columns(tmp_path / "grasp.rrd")
    sample = Dataset(data).read(INDEX)
    pad = sample.pads["left"]
    np.testing.assert_array_equal(
        found["/forces/left/normal_n Scalars:scalars"], pad.force_normal_n
    )
    images = np.array(found["/images/left Image:buffer"], np.uint8)
    np.testing.assert_array_equal(images.reshape(pad.rgb.shape), pad.rgb)
    seen = sample.cameras["a"]
    images = np.array(found["/scene/camera_a/rgb Image:buffer"], np.uint8)
    np.testing.assert_array_equal(images.reshape(seen.rgb.shape), seen.rgb)
    depths_mm = np.array(found["/scene/camera_a/depth DepthImage:buffer"], np.uint8)
    depths_mm = depths_mm.view(np.float32).reshape(seen.depth_mm.shape)
    np.testing.assert_array_equal(depths_mm, seen.depth_mm)
    place_mm = np.array(found["/scene/camera_a Transform3D:translation"]).ravel()
    np.testing.assert_array_equal(place_mm, [300, 0, 90])
    moved = np.array(found["/scene/object Transform3D:translation"])
    np.testing.assert_allclose(moved, sample.object_pose[:, :3], rtol=1e-6)
    # The fingers stand to either side of the gripper's centre, and close.
    left, right = (np.array(found[f"/scene/{p} Transform3D:translation"]) for p in PADS)
    # Each is where the physics has it, up to some µm as far out as the other.
    np.testing.assert_allclose((left + right)[:, 0] / 2, sample.config.x_mm, atol=0.02)
    assert left[0, 0] < left[1, 0] < 0 < right[1, 0] < right[0, 0]
    np.testing.assert_allclose([left[0, 2], right[0, 2]], sample.config.z_mm, atol=0.5)
    # The gel is drawn as deep as the dataset says, against the first frame, which is untouched.
    z_mm = np.array([p[:, 2] for p in found["/scene/left/gel Mesh3D:vertex_positions"]])
    np.testing.assert_allclose((z_mm[0] - z_mm).max(axis=1), pad.indentation_mm, atol=1e-3)


def test_the_command(data, monkeypatch):
    shown = CliRunner().invoke(
        app, ["view", str(data), "--grasp", str(INDEX), "--rerun", "--no-browser"]
    )
    assert shown.exit_code == 0, shown.output
    assert shown.stdout.strip() == str(data / "grasp-00001.rrd")
    monkeypatch.setitem(sys.modules, "rerun", None)
    without = CliRunner().invoke(app, ["view", str(data), "--rerun", "--no-browser"])
    assert "pip install 'tacgen[view]'" in str(without.exception)


def test_a_grasp_that_is_not_in_the_dataset(data, tmp_path):
    pytest.importorskip("rerun")
    with refused(DatasetError):
        write_recording(data, 99, tmp_path / "grasp.rrd")
    assert list(tmp_path.iterdir()) == []

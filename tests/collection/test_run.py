"""Collecting: the same bytes however the work is done, and nothing lost."""

import errno
import hashlib
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from tacgen.collection.recipe import load_recipe
from tacgen.collection.run import Collected, collect, describe
from tacgen.core.errors import DatasetError
from tacgen.core.processes import Event
from tacgen.core.sensors import load_sensor
from tacgen.dataset import Dataset
from tacgen.dataset.gallery import Thumbnails
from tacgen.optics import load_table
from tests.messages import refused
from tests.small_world import write_world

pytestmark = pytest.mark.slow


@pytest.fixture
def world(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return write_world(tmp_path)


def hashes(folder):
    return {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.glob("shards/*.h5"))
    }


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    """The small dataset, collected by one worker in one go."""
    folder = tmp_path_factory.mktemp("reference")
    before = os.getcwd()
    os.chdir(folder)
    try:
        recipe = load_recipe(write_world(folder))
        result = collect(recipe, folder / "out", workers=1, progress=False)
    finally:
        os.chdir(before)
    return folder / "out", result


def test_a_recipe_and_a_folder_may_be_given_by_their_names(world, tmp_path):
    collect(str(world), str(tmp_path / "named"), shards=[0], progress=False)
    collect(load_recipe(world), tmp_path / "out", shards=[0], progress=False)
    assert hashes(tmp_path / "named") == hashes(tmp_path / "out") != {}


def test_a_grasp_that_is_made_again_counts_once():
    result = Collected(found=())
    small = Thumbnails("", [], [])
    for item, label in ((0, 1), (1, 0), (0, 1), (2, -1)):
        result.add(Event("item", 0, item, (label, small if item == 0 else None)))
    result.add(Event("crashed", 0, 3, "the simulator died"))
    result.add(Event("done", 0, -1, True))
    # A shard that runs again may crash where it did not before, and the other way round.
    for _ in range(2):
        result.add(Event("crashed", 0, 0, "the simulator died"))
        assert not result.thumbnails
        result.add(Event("item", 0, 0, (1, small)))
    assert result.thumbnails == {0: small}
    counted = result.summary()
    assert counted["grasps_made"] == 4
    assert [counted[of] for of in ("successes", "failures", "not_executed", "crashed")] == [1] * 4
    assert result.made == [0]


def test_a_dataset_holds_every_grasp_of_the_plan_and_both_labels(reference):
    out, result = reference
    dataset = Dataset(out)
    assert len(dataset) == 6
    assert sorted(result.made) == [0, 1, 2]
    assert set(result.labels.values()) == {0, 1}
    assert (out / "index.html").is_file()
    assert (out / "README.md").is_file()


def test_what_is_felt_follows_the_force(reference):
    """The same place, gripped with 3 N and 25 N: a deeper imprint, a larger patch."""
    dataset = Dataset(reference[0])
    grasps = [dataset.read(k) for k in range(6)]
    weak = next(g for g in grasps if (g.config.force_n, g.config.z_mm) == (3.0, 90.0))
    firm = next(g for g in grasps if (g.config.force_n, g.config.z_mm) == (25.0, 90.0))
    assert firm.pads["left"].indentation_mm[0] > 1.5 * weak.pads["left"].indentation_mm[0] > 0
    at_rest = dataset.reference().astype(int)
    changed = [
        (np.abs(g.pads["left"].rgb[0].astype(int) - at_rest).max(axis=-1) > 8).sum()
        for g in (weak, firm)
    ]
    assert changed[1] > 1.5 * changed[0] > 0


def test_where_colours_come_from_is_said_at_the_start_and_in_the_gallery(
    reference, world, tmp_path, capsys
):
    out = shutil.copytree(reference[0], tmp_path / "out")
    recipe = load_recipe(world)
    collect(recipe, out)
    sensor = load_sensor(recipe.sensor)
    origin = load_table(sensor.table).origin
    first = capsys.readouterr().err.splitlines()[0]
    assert first == f"tacgen: sensor {sensor.name}: colours from {origin}"
    assert f"Colours from: {origin}." in (out / "index.html").read_text()


def test_a_disk_that_is_full_once_the_shards_are_done_is_named(
    reference, world, tmp_path, monkeypatch
):
    out = shutil.copytree(reference[0], tmp_path / "out")
    page = (out / "index.html").read_bytes()
    (out / "index.html").unlink()

    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("tacgen.collection.run.write_gallery", full)
    with refused(DatasetError):
        collect(load_recipe(world), out, progress=False)
    monkeypatch.undo()
    monkeypatch.chdir(tmp_path)
    collect(load_recipe(world), out, progress=False)
    assert (out / "index.html").read_bytes() == page


@pytest.mark.parametrize("workers", [2, 4])
def test_the_bytes_do_not_depend_on_the_number_of_workers(reference, world, tmp_path, workers):
    collect(load_recipe(world), tmp_path / "out", workers=workers, progress=False)
    assert hashes(tmp_path / "out") == hashes(reference[0])


def test_parts_collected_in_any_order_make_the_same_dataset(reference, world, tmp_path):
    recipe = load_recipe(world)
    for share in ([2], [0, 1]):
        collect(recipe, tmp_path / "out", shards=share, progress=False)
    assert hashes(tmp_path / "out") == hashes(reference[0])
    assert len(Dataset(tmp_path / "out")) == 6


def test_a_bad_shard_alone_is_remade(reference, world, tmp_path):
    recipe = load_recipe(world)
    out = tmp_path / "out"
    collect(recipe, out, progress=False)
    shard = out / "shards" / "shard-00001.h5"
    content = bytearray(shard.read_bytes())
    content[len(content) // 2] ^= 0x40
    shard.write_bytes(content)
    untouched = (out / "shards" / "shard-00000.h5").stat().st_mtime_ns
    result = collect(recipe, out, redo=[1], progress=False)
    assert result.made == [1]
    assert hashes(out) == hashes(reference[0])
    assert (out / "shards" / "shard-00000.h5").stat().st_mtime_ns == untouched


def test_a_dry_run_writes_nothing(world, tmp_path):
    plan = describe(load_recipe(world), tmp_path / "out")
    assert (plan["grasps"], plan["shards"], plan["shards_done"]) == (6, 3, 0)
    assert not (tmp_path / "out").exists()


def test_what_a_grasp_varies_does_not_depend_on_the_others(tmp_path, monkeypatch):
    """Domain randomisation by the grasp's own seed: one shard alone equals the same in a whole."""
    monkeypatch.chdir(tmp_path)
    spread = "{friction_relative: 0.2, mass_relative: 0.1, k_n_relative: 0.1, position_mm: 1.0}"
    recipe = load_recipe(write_world(tmp_path, randomize=spread))
    collect(recipe, tmp_path / "whole", progress=False)
    collect(recipe, tmp_path / "part", shards=[1], progress=False)
    name = "shard-00001.h5"
    assert hashes(tmp_path / "part")[name] == hashes(tmp_path / "whole")[name]


def test_ctrl_c_keeps_finished_shards_and_exits_130(reference, world, tmp_path):
    out = tmp_path / "out"
    command = [
        sys.executable,
        "-m",
        "tacgen",
        "collect",
        str(world),
        "--out",
        str(out),
        "--workers",
        "1",
    ]
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).resolve().parents[2])}
    process = subprocess.Popen(
        command, cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True
    )
    deadline = time.monotonic() + 60
    while not list(out.glob("shards/shard-*.json")) and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=30)
    assert process.returncode == 130, said
    assert "finished work is kept" in said
    assert not list(out.glob("shards/*.part"))
    collect(load_recipe(world), out, progress=False)
    assert hashes(out) == hashes(reference[0])

import json
import multiprocessing
import os
import pickle
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tacgen.cli import app
from tacgen.core import files as file_lock
from tacgen.core.errors import DatasetError
from tacgen.dataset import Dataset, DatasetFolder
from tacgen.dataset.verify import verify
from tests.messages import refused

from .conftest import collect_toy, make_sample, make_spec
from .test_writer import digests

CHECKOUT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    "change",
    [
        {
            "recipe": {"name": "toy", "seed": 4, "physics": {"time_step_s": 0.002}},
            "recipe_sha256": "ef",
        },
        {"calibration": {"table": "00"}},
        {"n_grasps": 12},
    ],
)
def test_another_recipe_is_refused_key_by_key(toy, spec, change):
    before = {p: p.stat().st_mtime_ns for p in toy.root.rglob("*")}
    with refused(DatasetError):
        DatasetFolder(toy.root).prepare(replace(spec, **change))
    assert {p: p.stat().st_mtime_ns for p in toy.root.rglob("*")} == before


def test_another_version_is_refused(toy, spec, monkeypatch):
    monkeypatch.setattr("tacgen.dataset.folder.__version__", "9.9.9")
    with refused(DatasetError):
        DatasetFolder(toy.root).prepare(spec)


def test_a_finished_shard_is_not_made_again(toy, spec):
    with toy.claim(0) as mine:
        assert not mine
    with toy.claim(0, redo=True) as mine:
        assert mine
    assert not list(toy.root.glob("shards/*.lock"))


def test_what_a_killed_process_leaves_is_made_again(toy, spec):
    whole = digests(toy.root)
    toy.shard_path(1).write_bytes(toy.shard_path(1).read_bytes()[:1000])
    toy.shard_path(2).unlink()
    (toy.root / "shards/.shard-00002.h5.4711.part").write_bytes(b"half")
    assert [toy.is_done(i) for i in range(3)] == [True, False, False]
    for shard in (1, 2):
        with toy.claim(shard) as mine:
            assert mine
            toy.write_shard(shard, (make_sample(i, spec) for i in spec.shard_range(shard)), spec)
    assert digests(toy.root) == whole
    assert not list(toy.root.glob("shards/.*"))


def _hold(root, shard, ready):
    with DatasetFolder(root).claim(shard, redo=True) as mine:
        assert mine
        ready.set()
        time.sleep(60)


@pytest.mark.slow
def test_the_second_on_a_shard_leaves_and_a_dead_holder_is_succeeded(toy):
    context = multiprocessing.get_context("spawn")
    ready = context.Event()
    holder = context.Process(target=_hold, args=(toy.root, 1, ready))
    holder.start()
    assert ready.wait(30)
    with toy.claim(1, redo=True) as mine:
        assert not mine
    ((shard, who),) = toy.running()
    assert (shard, str(holder.pid) in who) == (1, True)
    os.kill(holder.pid, signal.SIGKILL)
    holder.join()
    assert toy.running() == []
    with toy.claim(1, redo=True) as mine:
        assert mine


def test_without_locks_two_may_work_and_neither_corrupts(tmp_path, spec, monkeypatch):
    monkeypatch.setattr(file_lock, "_lock", lambda _: None)
    one, two = DatasetFolder(tmp_path), DatasetFolder(tmp_path)
    one.prepare(spec)
    with one.claim(0) as first, two.claim(0) as second:
        assert first
        assert second
        for folder in (one, two):
            folder.write_shard(0, (make_sample(i, spec) for i in range(4)), spec)
    assert not verify(tmp_path).problems[0].shard >= 0


def test_of_two_recipes_that_begin_at_once_one_writes(toy, spec):
    plan = json.loads(toy.plan_path.read_text())
    toy.plan_path.write_text(json.dumps(plan | {"recipe_sha256": "77"}))
    with refused(DatasetError):
        toy.write_shard(0, (make_sample(i, spec) for i in range(4)), spec)


def test_merge_is_the_same_however_often_and_keeps_lines_without_a_file(toy):
    text = toy.manifest_path.read_text()
    toy.merge()
    assert toy.manifest_path.read_text() == text
    toy.line_path(0).unlink()
    toy.merge()
    assert toy.manifest_path.read_text() == text
    toy.manifest_path.unlink()
    shutil.copy(toy.line_path(1), toy.line_path(1).with_suffix(".bak"))
    run = CliRunner().invoke(app, ["merge", str(toy.root)])
    assert run.exit_code == 0
    assert toy.manifest_path.read_text().splitlines() == text.splitlines()[1:]


def test_a_broken_manifest_is_remade_from_the_shards_own_lines(toy):
    text = toy.manifest_path.read_text()
    toy.manifest_path.write_text(text[:-200])
    with refused(DatasetError):
        Dataset(toy.root)
    toy.merge()
    assert toy.manifest_path.read_text() == text


def test_a_file_where_the_folder_should_be(tmp_path, spec):
    (tmp_path / "out").write_text("not a folder")
    with refused(DatasetError):
        DatasetFolder(tmp_path / "out").prepare(spec)


def test_a_folder_that_vanishes_is_not_made_anew_without_its_recipe(toy, spec):
    shutil.rmtree(toy.root)
    with refused(DatasetError):
        toy.write_shard(0, (make_sample(i, spec) for i in range(4)), spec)
    assert not toy.root.exists()
    with refused(DatasetError), toy.claim(0):
        pass


FULL_DISK = """
import sys
sys.path.insert(0, {checkout!r})
from tests.dataset.conftest import *
sensor = Sensor("gelsight", 240, 320, 0.1, 2.0)
reference = np.zeros((240, 320, 3), np.uint8)
spec = make_spec(sensor=sensor, reference_rgb=reference, n_grasps=20, shard_size=20)
folder = DatasetFolder({root!r})
folder.prepare(spec)
folder.write_shard(0, (make_sample(i, spec) for i in range(20)), spec)
"""


def test_a_full_disk_gives_one_message_and_no_half_shard(tmp_path):
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=1024k", "tmpfs", str(disk)]
    if subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("mounting a small tmpfs takes root")
    try:
        script = FULL_DISK.format(checkout=str(CHECKOUT), root=str(disk / "out"))
        run = subprocess.run(
            [sys.executable, "-c", script], cwd=CHECKOUT, capture_output=True, text=True
        )
        last = run.stderr.strip().splitlines()[-1]
        assert last.startswith("tacgen.core.errors.DatasetError")
        assert "no space left on device; free some space" in last
        assert "Can't close file" not in run.stderr
        assert not list((disk / "out" / "shards").iterdir())
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def test_a_read_only_disk(tmp_path, spec):
    disk = tmp_path / "disk"
    disk.mkdir()
    if subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "ro", "tmpfs", str(disk)], capture_output=True
    ).returncode:
        pytest.skip("mounting takes root")
    try:
        with refused(DatasetError):
            DatasetFolder(disk / "out").prepare(spec)
    finally:
        subprocess.run(["umount", str(disk)], check=True)


KILLED = """
import sys
import time
sys.path.insert(0, {checkout!r})
from tests.dataset.conftest import *
collect_toy(Path({root!r}), make_spec(n_grasps=200, shard_size=4), shards=range(40))
time.sleep(600)  # however late the kill comes, it comes before the end
"""


@pytest.mark.slow
def test_killed_at_random_moments_nothing_is_lost_or_wrong(tmp_path):
    spec = make_spec(n_grasps=200, shard_size=4)
    script = KILLED.format(checkout=str(CHECKOUT), root=str(tmp_path / "killed"))
    folder = DatasetFolder(tmp_path / "killed")
    process = subprocess.Popen([sys.executable, "-c", script], cwd=CHECKOUT)
    while not folder.is_done(3):
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    process.wait()
    done = [shard for shard in range(spec.n_shards) if folder.is_done(shard)]
    assert 3 < len(done) + 1 < spec.n_shards
    for shard in range(12):
        with folder.claim(shard) as mine:
            if mine:
                indices = spec.shard_range(shard)
                folder.write_shard(shard, (make_sample(i, spec) for i in indices), spec)
    straight = collect_toy(tmp_path / "straight", spec, shards=tuple(range(12)))
    assert digests(folder.root)[:12] == digests(straight.root)


def test_dataset_reads_after_pickling_and_in_another_process(toy):
    dataset = Dataset(toy.root)
    first = dataset.rgb(0).copy()
    again = pickle.loads(pickle.dumps(dataset))
    assert (again.rgb(0) == first).all()
    with multiprocessing.get_context("fork").Pool(1) as pool:
        assert (pool.apply(dataset.rgb, (0,)) == first).all()


def test_dataset_refuses_what_is_incomplete_mixed_or_damaged(tmp_path, spec):
    toy = collect_toy(tmp_path / "toy", spec, shards=(0, 1))
    with refused(DatasetError):
        Dataset(toy.root)
    assert len(Dataset(toy.root, partial=True)) == 8
    with refused(DatasetError):
        Dataset(toy.root, partial=True).read(8)
    line = json.loads(toy.line_path(1).read_text()) | {"sensor": "digit", "recipe_sha256": "77"}
    toy.line_path(1).write_text(json.dumps(line))
    with refused(DatasetError):
        Dataset(toy.root, partial=True)


def test_dataset_tells_damage_when_it_meets_it(toy):
    raw = bytearray(toy.shard_path(1).read_bytes())
    raw[-5] ^= 1
    toy.shard_path(1).write_bytes(raw)
    dataset = Dataset(toy.root)
    dataset.read(0)
    with refused(DatasetError):
        dataset.read(5)


def test_dataset_of_nothing(tmp_path):
    with refused(DatasetError):
        Dataset(tmp_path)


def test_inspect_counts(toy):
    run = CliRunner().invoke(app, ["inspect", str(toy.root), "--json"])
    told = json.loads(run.stdout)
    assert told["counts"] == {"success": 5, "failure": 3, "not_executed": 2}
    assert told["splits"] == {"test": 2, "train": 8}
    assert told["success_rate"] == pytest.approx(5 / 8)
    assert told["recipe"] == "toy"
    assert told["raw_bytes"] / told["bytes"] == pytest.approx(told["ratio"])
    text = CliRunner().invoke(app, ["inspect", str(toy.root)]).stdout
    assert "62% of the executed succeed" in text
    assert "can" in text
    assert told["not_executed"] == {"too far away": 2}
    assert "2 of 10 grasps could not be executed:\n  2 × too far away" in text

"""Processes killed at random moments: nothing lost, no wrong byte."""

import contextlib
import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest

from tacgen.core.processes import run_tasks
from tacgen.dataset import DatasetFolder
from tacgen.dataset.verify import verify
from tests.core.test_processes import ITEMS_PER_TASK, Script, items_of
from tests.dataset.conftest import collect_toy, make_sample, make_spec
from tests.small_world import write_world

from .conftest import digests

KILLS = 50
ONE = ("--workers", "1")
PATIENCE_S = 120


def write_what_is_missing(root, spec):
    folder = DatasetFolder(root)
    folder.prepare(spec)
    for shard in range(spec.n_shards):
        with folder.claim(shard) as mine:
            if mine:
                samples = (make_sample(i, spec) for i in spec.shard_range(shard))
                folder.write_shard(shard, samples, spec)
    folder.merge()


@pytest.mark.slow
def test_fifty_writers_killed_at_random_moments(tmp_path):
    """After every kill, what counts as done has the right bytes; the next one goes on."""
    spec = make_spec(n_grasps=40, shard_size=2)
    collect_toy(tmp_path / "first", spec)
    started_s = time.monotonic()
    right = digests(collect_toy(tmp_path / "right", spec).root)
    # Kills must fall amid the work, however busy the machine is.
    latest_s = (time.monotonic() - started_s) / 3
    context = multiprocessing.get_context("fork")
    rng = np.random.default_rng(0)
    kills = rounds = 0
    amid_work = 0
    while kills < KILLS:
        folder = DatasetFolder(tmp_path / f"round-{rounds}")
        rounds += 1
        while kills < KILLS:
            writer = context.Process(target=write_what_is_missing, args=(folder.root, spec))
            writer.start()
            writer.join(rng.uniform(0.0, latest_s))
            whole = not writer.is_alive()
            os.kill(writer.pid, signal.SIGKILL) if not whole else None
            writer.join()
            done = [shard for shard in range(spec.n_shards) if folder.is_done(shard)]
            made = digests(folder.root)
            assert all(
                made[folder.shard_path(n).name] == right[folder.shard_path(n).name] for n in done
            )
            if whole:
                latest_s *= 0.9  # and here more at rest
                break
            kills += 1
            amid_work += bool(done)
            latest_s *= 1.0 if done else 1.1  # the machine became busier
        write_what_is_missing(folder.root, spec)
        assert digests(folder.root) == right
        assert not verify(folder.root).problems
        assert not list(folder.root.glob("shards/.*"))
    assert amid_work > KILLS / 4, "the kills came too early to mean anything"


@pytest.mark.slow
def test_workers_killed_at_random_moments_lose_no_item(tmp_path):
    """Whenever news of an item comes, its worker may be shot, wherever it is by then."""
    rng = np.random.default_rng(1)
    n_tasks = 20
    shot = dict.fromkeys(range(n_tasks), 0)
    done = {}
    script = Script(tmp_path, dict.fromkeys(range(n_tasks * ITEMS_PER_TASK), "brief"))
    for event in run_tasks(range(n_tasks), script, workers=2, item_limit_s=60.0):
        if event.kind == "item" and shot[event.task] < 2 and rng.random() < 0.6:
            time.sleep(rng.uniform(0.0, 0.03))
            with contextlib.suppress(ProcessLookupError):
                os.kill(event.value, signal.SIGKILL)
                shot[event.task] += 1
        if event.kind == "done":
            assert event.task not in done
            done[event.task] = event.value
    assert done == {task: items_of(task) for task in range(n_tasks)}
    assert sum(shot.values()) > n_tasks


def children_of(pid, words=b""):
    """Its child processes, of those whose command has these words."""
    listed = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return [int(child) for child in listed if words in Path(f"/proc/{child}/cmdline").read_bytes()]


def wait_for_shards(out, count, process):
    deadline = time.monotonic() + PATIENCE_S
    while len(list(out.glob("shards/shard-*.json"))) < count:
        assert time.monotonic() < deadline
        assert process.poll() is None, "it ended before it was killed"
        time.sleep(0.01)


@pytest.mark.slow
@pytest.mark.parametrize("victim", ["worker", "the process it is a copy of"])
def test_a_worker_and_then_the_parent_are_killed_and_the_next_run_finds_no_lock(
    world, tmp_path, untroubled, victim
):
    """The next run starts at once: an orphan that still held its shard would make it leave it."""
    out = tmp_path / "out"
    command = [sys.executable, "-m", "tacgen", "collect", str(world), "--out", str(out), *ONE]
    first = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.DEVNULL)
    wait_for_shards(out, 1, first)
    (server,) = children_of(first.pid, b"forkserver")
    (worker,) = children_of(server)
    os.kill(worker if victim == "worker" else server, signal.SIGKILL)
    wait_for_shards(out, 2, first)
    first.send_signal(signal.SIGKILL)
    first.wait()
    subprocess.run(command, cwd=tmp_path, check=True, timeout=PATIENCE_S, capture_output=True)
    assert digests(out) == untroubled


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGHUP])
def test_nothing_outlives_a_killed_run(tmp_path, number):
    """No process and no temporary folder, five seconds later."""
    grid = "{force_n: [3, 25], y_mm: [0], z_mm: {linspace: [60, 140, 40]}}"
    world = write_world(tmp_path, grid=grid)  # long enough to be killed amid its work
    # Sockets lie there, whose paths may be 107 characters long.
    temporary = Path(tempfile.mkdtemp(prefix="killed-", dir="/tmp"))
    command = [sys.executable, "-m", "tacgen", "collect", str(world), "--out", "out", *ONE]
    environment = os.environ | {"TMPDIR": str(temporary)}
    heard = signal.signal(signal.SIGHUP, signal.SIG_DFL)  # tests under nohup ignore it
    run = subprocess.Popen(command, cwd=tmp_path, env=environment, stderr=subprocess.PIPE)
    signal.signal(signal.SIGHUP, heard)
    wait_for_shards(tmp_path / "out", 1, run)
    (server,) = children_of(run.pid, b"forkserver")
    started = [*children_of(run.pid), *children_of(server)]
    assert list(temporary.iterdir())
    run.send_signal(number)
    deadline = time.monotonic() + 5.0
    message = run.communicate()[1].decode()
    assert ("interrupted; finished work is kept" in message) == (number == signal.SIGHUP)
    while list(temporary.iterdir()) or any(Path(f"/proc/{pid}").exists() for pid in started):
        assert time.monotonic() < deadline, [temporary, started]
        time.sleep(0.05)
    temporary.rmdir()

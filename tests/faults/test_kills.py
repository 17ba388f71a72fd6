"""Processes killed at random moments: nothing lost, no wrong byte."""

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from tests.small_world import write_world

from .conftest import digests

ONE = ("--workers", "1")
PATIENCE_S = 120


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
@pytest.mark.parametrize(
    "victim", ["worker", pytest.param("its server", marks=pytest.mark.exhaustive)]
)
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


@pytest.mark.exhaustive
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

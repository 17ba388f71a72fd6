"""Grasps that take their process down, or never end; folders that go amid the work."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tacgen.collection.recipe import load_recipe
from tacgen.collection.run import collect
from tacgen.dataset import Dataset
from tacgen.dataset.verify import verify

from .conftest import digests

CHECKOUT = Path(__file__).parents[2]
FAULTY = Path(__file__).with_name("faulty")


def collect_faulty(world, out, *faults, limit_s=60):
    options = ["--out", str(out), "--grasp-limit-s", str(limit_s), "--workers", "1"]
    return subprocess.run(
        [sys.executable, "-m", "tacgen", "collect", str(world), *options],
        cwd=world.parent,
        env=os.environ
        | {"TACGEN_FAULTS": " ".join(faults), "PYTHONPATH": f"{FAULTY}{os.pathsep}{CHECKOUT}"},
        capture_output=True,
        text=True,
        timeout=150,
    )


@pytest.mark.slow
def test_a_crash_and_a_hang_are_recorded_and_the_rest_goes_on(world, tmp_path, untroubled):
    out = tmp_path / "out"
    run = collect_faulty(world, out, "0=segfault", "3=hang", limit_s=15)
    assert run.returncode == 0, run.stderr
    assert not verify(out, decode=True).problems
    dataset = Dataset(out)
    status = [dataset.read(index).status for index in range(6)]
    assert [index for index in range(6) if status[index] == "crashed"] == [0, 3]
    made = digests(out)
    assert made["shard-00002.h5"] == untroubled["shard-00002.h5"]
    # A crash belongs to its grasp: mended, the shards are what they would have been.
    collect(load_recipe(world), out, redo=[0, 1], progress=False)
    assert digests(out) == untroubled

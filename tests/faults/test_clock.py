"""Clocks that jump, and a look at a lock at the wrong moment."""

import itertools
import os
import time
from types import SimpleNamespace

import numpy as np

from tacgen.cluster import states
from tacgen.core import processes
from tacgen.core.processes import run_tasks
from tacgen.dataset.verify import verify
from tests.core.test_processes import ITEMS_PER_TASK, Script
from tests.dataset.conftest import collect_toy


def test_files_from_the_future_and_the_past_are_as_done_as_others(toy, spec):
    """Clocks of nodes differ, and are set: only bytes count, and the rate stays a rate."""
    for n, year_s in enumerate((-1e8, 4e9, 1e9)):
        os.utime(toy.shard_path(n), (year_s, year_s))
        os.utime(toy.line_path(n), (year_s, year_s))
    found = states.status(toy.root)
    assert (found.done, found.not_begun) == (3, ())
    assert found.rate_grasps_per_s is None
    assert not verify(toy.root).problems
    os.utime(toy.manifest_path, (4e9, 4e9))
    assert len(toy.merge()) == 3
    assert [toy.is_done(n) for n in range(3)] == [True] * 3


def test_the_rate_is_that_of_the_last_shards(tmp_path, spec):
    """Four grasps in the second shard and two in the third, ten seconds apart each."""
    folder = collect_toy(tmp_path, spec)
    for n in range(3):
        os.utime(folder.shard_path(n), (1e9 + 10 * n, 1e9 + 10 * n))
    assert states.status(tmp_path).rate_grasps_per_s == np.float64(6 / 20)
    assert states.status(tmp_path).time_left_s is None


def test_a_leap_of_the_clock_makes_no_grasp_hang(tmp_path, monkeypatch):
    leaps = iter(np.random.default_rng(0).uniform(-1e8, 1e8, 100_000))
    monkeypatch.setattr(time, "time", lambda: next(leaps))
    events = list(run_tasks(range(2), Script(tmp_path, {}), workers=1, item_limit_s=20.0))
    assert {event.kind for event in events} == {"item", "done"}


def test_a_job_that_was_suspended_blames_no_grasp(tmp_path, monkeypatch):
    """Between two looks of the supervisor an hour goes by, of which it was awake for a moment."""
    asleep_s = itertools.count(step=3600.0)
    now_s = time.monotonic
    monkeypatch.setattr(
        processes, "time", SimpleNamespace(monotonic=lambda: now_s() + next(asleep_s))
    )
    slow = Script(tmp_path, dict.fromkeys(range(2 * ITEMS_PER_TASK), "brief"))
    events = list(run_tasks(range(2), slow, workers=1, item_limit_s=60.0))
    assert {event.kind for event in events} == {"item", "done"}

"""The scheduler on paper against what can be told by hand."""

import numpy as np
import pytest

from validation.cluster.simulate import Workload, simulate


def run(**changes):
    given = {"shards": 2000, "shards_per_task": 20, "slots": 10, "shard_s": 30.0}
    return simulate(Workload(**(given | changes)), np.random.default_rng(0))


def test_without_trouble_the_slots_are_full():
    found = run(preemption=0.0, spread=0.0, start_s=0.0)
    assert found.done == 2000
    assert found.makespan_s == pytest.approx(2000 * 30.0 / 10)
    assert found.efficiency == pytest.approx(1.0)


def test_starts_cost_what_they_cost():
    found = run(preemption=0.0, spread=0.0, start_s=6.0)
    assert found.starts == 100
    assert found.start_share == pytest.approx(600 / (600 + 60_000))


@pytest.mark.parametrize("preemption", [0.05, 0.3])
def test_every_shard_is_made_once_and_preemptions_follow_the_geometric_law(preemption):
    """A shard meets with p / (1 − p) preemptions; each costs half a shard and a start.

    Tolerance: four standard deviations of the sum over 10 000 shards.
    """
    found = run(shards=10_000, preemption=preemption, spread=0.0, slots=100)
    expected = 10_000 * preemption / (1 - preemption)
    deviation = np.sqrt(10_000 * preemption) / (1 - preemption)
    assert found.done == 10_000
    assert abs(found.preemptions - expected) < 4 * deviation
    assert found.starts == 500 + found.preemptions
    used_s = 10_000 * 30.0 / (1 - found.lost_share - found.start_share)
    assert found.lost_share * used_s == pytest.approx(15.0 * found.preemptions, rel=0.1)

"""A scheduler on paper: how long a dataset takes on many slots, with preempted jobs requeued.

``python -m validation.cluster.simulate`` prints a table. A job is a list of shards;
each attempt costs a start, then shard after shard. A shard that is preempted is lost and made
again by the job's next attempt, which waits for the requeue; finished shards stay.
"""

from __future__ import annotations

import argparse
import heapq
import math
import sys
from collections import deque
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class Workload:
    """What there is to do and what it meets with.

    ``preemption`` is the chance that an attempt at a shard is cut off, at a moment uniform in it;
    ``spread`` the standard deviation of a shard's time over its mean (lognormal).
    """

    shards: int
    shards_per_task: int
    slots: int
    shard_s: float
    spread: float = 0.3
    start_s: float = 6.0
    requeue_s: float = 120.0
    preemption: float = 0.05


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of it; the shares are of all slot time that was used."""

    makespan_s: float
    ideal_s: float
    done: int
    preemptions: int
    starts: int
    lost_share: float
    start_share: float

    @property
    def efficiency(self) -> float:
        """How much of the best possible speed was reached."""
        return self.ideal_s / self.makespan_s


def simulate(work: Workload, rng: np.random.Generator) -> Outcome:
    """Run ``work`` through first-come, first-served slots until every shard is done once."""
    sigma = math.sqrt(math.log1p(work.spread**2))
    cost_s = work.shard_s * rng.lognormal(-(sigma**2) / 2, sigma, work.shards)
    tasks = -(-work.shards // work.shards_per_task)
    queue = deque((0.0, deque(range(task, work.shards, tasks))) for task in range(tasks))
    slots = [0.0] * work.slots
    done = preemptions = starts = 0
    lost_s = 0.0
    end_s = 0.0
    while queue:
        now_s = heapq.heappop(slots)
        # Jobs that may start come first; if all wait for their requeue, the slot waits too.
        ready = next((k for k, (from_s, _) in enumerate(queue) if from_s <= now_s), None)
        if ready is None:
            ready = min(range(len(queue)), key=lambda k: queue[k][0])
        from_s, left = queue[ready]
        del queue[ready]
        now_s = max(now_s, from_s) + work.start_s
        starts += 1
        while left:
            if rng.random() < work.preemption:
                part_s = rng.random() * cost_s[left[0]]
                now_s, lost_s = now_s + part_s, lost_s + part_s
                preemptions += 1
                queue.append((now_s + work.requeue_s, left))
                break
            now_s += cost_s[left.popleft()]
            done += 1
        heapq.heappush(slots, now_s)
        end_s = max(end_s, now_s)
    useful_s = float(cost_s.sum())
    used_s = useful_s + lost_s + starts * work.start_s
    return Outcome(
        makespan_s=end_s,
        ideal_s=useful_s / work.slots,
        done=done,
        preemptions=preemptions,
        starts=starts,
        lost_share=lost_s / used_s,
        start_share=starts * work.start_s / used_s,
    )


def table(shards: int, slots: int, shard_s: float, preemption: float, seed: int) -> str:
    """The outcome for several sizes of a job, as Markdown."""
    lines = [
        "| shards a job | hours | of the best speed | preemptions | starts | lost | starting |",
        "|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for size in (1, 5, 10, 20, 40, 80):
        work = Workload(shards, size, slots, shard_s, preemption=preemption)
        found = simulate(work, np.random.default_rng(seed))
        lines.append(
            f"| {size} | {found.makespan_s / 3600:.2f} | {found.efficiency:.0%} "
            f"| {found.preemptions} | {found.starts} | {found.lost_share:.1%} "
            f"| {found.start_share:.1%} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Print the table for the options given."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--shards", type=int, default=10_000)
    parser.add_argument("--slots", type=int, default=100)
    parser.add_argument("--shard-s", type=float, default=25.0, help="seconds a shard takes")
    parser.add_argument("--preemption", type=float, default=0.05, help="chance a shard")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    text = table(given.shards, given.slots, given.shard_s, given.preemption, given.seed)
    sys.stdout.write(f"{text}\n")


if __name__ == "__main__":
    main()

"""Time of a run by its workers: ``python -m validation.cluster.workers RECIPE WORKERS...``.

Collects the recipe with each number of workers, round after round, and prints JSON: seconds by the
clock and of processor time of the whole machine, which must have nothing else to do (Linux only).
More workers than cores share them in turns, with ``--slice-ms N`` of so long (Linux 6.12 or later).
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROUNDS = 2
_SCHED_SETATTR = 314  # number of the system call on x86-64
_ATTRIBUTES = "<IIQiIQQQII"  # struct sched_attr: size, policy, flags, nice, priority, runtime, ...


def workers_of(recipe: str, counts: list[int]) -> list[dict[str, float]]:
    """Times of every run, those of one round next to each other."""
    return [_run(recipe, count) for _ in range(ROUNDS) for count in counts]


def _run(recipe: str, workers: int) -> dict[str, float]:
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "tacgen", "--quiet", "collect", recipe, "--out", folder]
        start_s, busy_s = time.time(), _machine_s()
        subprocess.run([*command, "--workers", str(workers)], check=True, stdout=subprocess.DEVNULL)
        found = {"wall_s": time.time() - start_s, "processor_s": _machine_s() - busy_s}
    return {"workers": workers, **{name: round(value, 1) for name, value in found.items()}}


def _machine_s() -> float:
    """Processor time of all that ran since the machine started: user, nice, system."""
    ticks = map(int, Path("/proc/stat").read_text().split(maxsplit=4)[1:4])
    return sum(ticks) / os.sysconf("SC_CLK_TCK")


def _set_slice(slice_ms: float) -> None:
    """How long this process, and every one that it starts, runs at a time where others wait."""
    size = struct.calcsize(_ATTRIBUTES)
    attributes = struct.pack(_ATTRIBUTES, size, 0, 0, 0, 0, int(1e6 * slice_ms), 0, 0, 0, 0)
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.syscall(_SCHED_SETATTR, 0, attributes, 0) != 0:
        sys.exit(f"--slice-ms: {os.strerror(ctypes.get_errno())}; leave it out")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recipe")
    parser.add_argument("workers", type=int, nargs="+")
    parser.add_argument("--slice-ms", type=float)
    given = parser.parse_args()
    if given.slice_ms is not None:
        _set_slice(given.slice_ms)
    sys.stdout.write(f"{json.dumps(workers_of(given.recipe, given.workers))}\n")

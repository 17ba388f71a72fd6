"""How soon a killed run is back at its full rate: ``python -m validation.cluster.restart RECIPE``.

Collects the recipe with every grasp a shard of its own, kills all its processes amid the work,
starts the same command again, and reads from the shards' files when each grasp was done. Prints
JSON; times are by the clock, so the machine must have nothing else to do.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

GRASPS = 40
"""Grasps of each run; the rate is that of the second half."""


def restart_of(recipe: str, workers: int) -> dict[str, float]:
    """Seconds from the command to the first grasp, and those lost against a run at full rate."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "restarted.yaml"
        path.write_text(f"extends: {recipe}\nname: restarted\ndataset: {{shard_size: 1}}\n")
        out = Path(folder) / "out"
        _run_and_kill(path, out, workers)
        times_s = _run_and_kill(path, out, workers)
    half = GRASPS // 2
    rate = half / (times_s[-1] - times_s[-1 - half])
    return {
        "workers": workers,
        "first_grasp_s": float(times_s[0]),
        "grasps_per_s": float(rate),
        "lost_s": float(times_s[half - 1] - half / rate),
    }


def _run_and_kill(recipe: Path, out: Path, workers: int) -> NDArray[np.float64]:
    """When each of the next ``GRASPS`` grasps was done, from the command on; then SIGKILL."""
    before = set(out.glob("shards/*.json"))
    start_s = time.time()
    command = [sys.executable, "-m", "tacgen", "collect", str(recipe), "--out", str(out)]
    process = subprocess.Popen([*command, "--workers", str(workers)], start_new_session=True)
    try:
        while len(made := set(out.glob("shards/*.json")) - before) < GRASPS:
            if process.poll() is not None:
                sys.exit(
                    f"{recipe}: the run ended before it made {GRASPS} grasps; give a larger one"
                )
            time.sleep(0.02)
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    return np.sort([path.stat().st_mtime for path in made])[:GRASPS] - start_s


if __name__ == "__main__":
    found = restart_of(sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else os.cpu_count() or 1)
    sys.stdout.write(f"{json.dumps(found)}\n")

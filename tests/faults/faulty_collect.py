"""``tacgen collect`` with grasps that misbehave: RECIPE OUT LIMIT_S, and index=act for each.

The workers import this file anew, so the fault is in each of them.
"""

import os
import signal
import sys
import time
from pathlib import Path

from tacgen.cli import main
from tacgen.grasp_pipeline import GraspPipeline

RECIPE, OUT, LIMIT_S, *FAULTS = sys.argv[1:]
ACTS = dict(fault.split("=") for fault in FAULTS)
_sample = GraspPipeline.sample


def _faulty_sample(self, planned):
    act = ACTS.get(str(planned.config.index))
    if act == "segfault":
        os.kill(os.getpid(), signal.SIGSEGV)
    elif act == "hang":
        time.sleep(600)
    elif act == "vanish":
        Path(OUT).rename(f"{OUT}.gone")
    return _sample(self, planned)


GraspPipeline.sample = _faulty_sample

if __name__ == "__main__":
    sys.argv = ["tacgen", "collect", RECIPE, "--out", OUT, "--grasp-limit-s", LIMIT_S]
    main()

"""``tacgen`` with grasps that misbehave as the environment says: ``TACGEN_FAULTS="3=hang"``.

The workers import this file anew, so the fault is in each of them.
"""

import os
import signal
import time
from pathlib import Path

from tacgen.cli import main
from tacgen.collection.pipeline import GraspPipeline

ACTS = dict(fault.split("=") for fault in os.environ["TACGEN_FAULTS"].split())
_sample = GraspPipeline.sample


def _faulty_sample(self, planned):
    act = ACTS.get(str(planned.config.index))
    if act == "segfault":
        os.kill(os.getpid(), signal.SIGSEGV)
    elif act == "hang":
        time.sleep(600)
    elif act == "vanish":
        Path("out").rename("out.gone")
    return _sample(self, planned)


GraspPipeline.sample = _faulty_sample

if __name__ == "__main__":
    main()

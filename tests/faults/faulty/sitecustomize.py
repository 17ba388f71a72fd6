"""Grasps that misbehave as the environment says: ``TACGEN_FAULTS="3=hang"``.

Python imports a module of this name, found on ``PYTHONPATH``, in each process that it starts: the
process that workers are copied from has the faults too.
"""

import os
import signal
import sys
import time
from pathlib import Path

ACTS = dict(fault.split("=") for fault in os.environ["TACGEN_FAULTS"].split())


def _make_grasps_faulty():
    from tacgen.collection.pipeline import GraspPipeline

    sample = GraspPipeline.sample

    def faulty_sample(self, planned):
        act = ACTS.get(str(planned.config.index))
        if act == "segfault":
            os.kill(os.getpid(), signal.SIGSEGV)
        elif act == "hang":
            time.sleep(600)
        elif act == "vanish":
            Path("out").rename("out.gone")
        return sample(self, planned)

    GraspPipeline.sample = faulty_sample


if "resource_tracker" not in " ".join(sys.orig_argv):
    _make_grasps_faulty()

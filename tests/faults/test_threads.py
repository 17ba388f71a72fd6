"""Bytes do not follow the number of threads that libraries may use on a machine."""

import os
import subprocess
import sys

import pytest

GRASP = """
import hashlib, cv2
from tacgen.collection.pipeline import GraspPipeline
from tacgen.collection.grid import plan_recipe
from tacgen.collection.recipe import load_recipe
cv2.setNumThreads({threads})
recipe = load_recipe("quickstart")
with GraspPipeline(recipe) as pipeline:
    sample = pipeline.sample(plan_recipe(recipe)[0])
pad = sample.pads["left"]
assert pad.rgb.shape[1:3] == (480, 640)
digest = hashlib.sha256()
for array in (pad.rgb, pad.indentation_mm, pad.force_shear_n, sample.object_pose):
    digest.update(array.tobytes())
print(digest.hexdigest())
"""


def digest_with(threads):
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
    run = subprocess.run(
        [sys.executable, "-c", GRASP.format(threads=threads)],
        env=os.environ | dict.fromkeys(names, str(threads)),
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert run.returncode == 0, run.stderr
    return run.stdout


@pytest.mark.slow
def test_a_grasp_is_the_same_with_one_thread_and_with_four():
    """A whole sequence of full-size frames, from the physics to the pixels."""
    assert digest_with(1) == digest_with(4)

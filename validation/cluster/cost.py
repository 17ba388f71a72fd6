"""What a grasp of a recipe costs here: ``python -m validation.cluster.cost RECIPE``, as JSON.

Processor time of one thread, so that a busy machine changes little.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TypeVar

import numpy as np

from tacgen.collection.grid import plan_recipe
from tacgen.collection.pipeline import GraspPipeline, dataset_spec
from tacgen.collection.recipe import Recipe, load_recipe
from tacgen.dataset import DatasetFolder, GraspSample

Result = TypeVar("Result")

GRASPS = 100
SHARD_SIZE = 25  # as recipes have it that do not say
WRITES = 3


def cost_of(recipe: Recipe) -> dict[str, float]:
    """Seconds and bytes of a grasp, over a hundred of the plan's that are spread evenly.

    Every object is loaded and grasped before, as in a run so long that this is nothing. ``write_s``
    is the least of three writes of a shard of them: compression, hash and check.
    """
    options = recipe.dataset.model_copy(update={"shard_size": SHARD_SIZE})
    recipe = recipe.model_copy(update={"dataset": options})
    planned = plan_recipe(recipe)
    chosen = [planned[k] for k in np.linspace(0, len(planned) - 1, GRASPS).astype(int)]
    grasp_s, samples = 0.0, list[GraspSample]()
    with GraspPipeline(recipe) as pipeline:
        for first in {one.entry: one for one in planned}.values():
            pipeline.sample(first)
        for k, one in enumerate(chosen):
            seconds, sample = _processor_s(partial(pipeline.sample, one))
            grasp_s += seconds
            if k % (GRASPS // SHARD_SIZE) == 0:
                samples.append(replace(sample, config=replace(sample.config, index=len(samples))))
    spec = dataset_spec(recipe, SHARD_SIZE)
    with tempfile.TemporaryDirectory() as root:
        folder = DatasetFolder(root)
        folder.prepare(spec)
        runs = [_processor_s(lambda: folder.write_shard(0, samples, spec)) for _ in range(WRITES)]
    line = runs[0][1]
    return {
        "grasps": len(planned),
        "frames": line.frames,
        "grasp_s": grasp_s / GRASPS,
        "write_s": min(run[0] for run in runs) / SHARD_SIZE,
        "bytes": line.bytes / SHARD_SIZE,
        "raw_bytes": line.raw_bytes / SHARD_SIZE,
    }


def _processor_s(work: Callable[[], Result]) -> tuple[float, Result]:
    before_s = time.process_time()
    result = work()
    return time.process_time() - before_s, result


if __name__ == "__main__":
    sys.stdout.write(f"{json.dumps(cost_of(load_recipe(sys.argv[1])))}\n")

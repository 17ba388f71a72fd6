"""The grasps of a recipe in both physics engines: where their labels differ, and by what margin.

``python -m validation.physics.compare_engines RECIPE [--out DIR]`` lists them, and writes
``grasps.csv`` and ``comparison.json`` into the folder.
"""

import argparse
import contextlib
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any, get_args

import pandas as pd

from tacgen.collection.grid import PlannedGrasp, plan_recipe
from tacgen.collection.pipeline import GraspPipeline
from tacgen.collection.recipe import Recipe, load_recipe
from tacgen.core.files import refuse_existing, write_text
from tacgen.core.processes import Report, run_tasks
from tacgen.core.progress import print_status, progress_counter
from tacgen.core.records import GraspTrace
from tacgen.physics.settings import EngineName

ENGINES: tuple[EngineName, ...] = get_args(EngineName)
NEAR_MARGIN = 0.05  # of what the grasp needs; nearer to slipping, engines may well differ
GRASP_LIMIT_S = 120.0  # of both simulations, which take 0.1 to 1 s; one that hangs has crashed


def compare_engines(
    recipe: Recipe, *, workers: int = 1, show: Callable[[int, int], None] = lambda done, total: None
) -> pd.DataFrame:
    """A row for each grasp of ``recipe``: its configuration and its ending in each engine.

    ``<engine>_margin`` is what friction and torsion can hold over what is asked of them, the
    smaller ratio less 1; NaN where the grasp was not executed. ``agree``: the labels are the same.

    Raises ``PhysicsError`` if an engine is missing, or lacks the recipe's robot.
    """
    for engine in ENGINES:
        _pipeline(recipe, engine)
    planned = plan_recipe(recipe)
    crashed = {f"{engine}_{key}": value for engine in ENGINES for key, value in _CRASHED.items()}
    rows = [asdict(grasp.config) | crashed for grasp in planned]
    tasks, job = range(len(planned)), partial(_grasp_job, recipe, planned)
    done = 0
    for event in run_tasks(tasks, job, workers=workers, item_limit_s=GRASP_LIMIT_S):
        if event.kind == "done":
            rows[event.task] |= event.value
            done += 1
            show(done, len(planned))
    found = pd.DataFrame(rows)
    found["agree"] = found["pybullet_label"] == found["mujoco_label"]
    return found


def counts_of(found: pd.DataFrame) -> pd.DataFrame:
    """Grasps and equal labels by object.

    ``executed``: in one engine at least; ``far``: of those, PyBullet's margin, if it has one, is
    beyond ``NEAR_MARGIN``, away from the border between success and failure.
    """
    executed = (found[[f"{engine}_label" for engine in ENGINES]] >= 0).any(axis=1)
    far = executed & ~(found["pybullet_margin"].abs() <= NEAR_MARGIN)
    agree = found["agree"]
    flags = {"grasps": True, "executed": executed, "agree": agree, "far": far}
    flags["agree_far"] = far & agree
    counts = pd.DataFrame(flags, found.index).groupby(found["object"], sort=False).sum()
    counts.loc["all"] = counts.sum()
    return counts


_CRASHED = {"status": "crashed", "label": -1, "failure_mode": "", "reason": ""} | dict.fromkeys(
    ("margin", "rise_mm", "turn_rad"), float("nan")
)


def _ending(trace: GraspTrace) -> dict[str, Any]:
    ending = {key: getattr(trace, key, None) for key in _CRASHED}
    margin = trace.margin
    ratios = (margin.friction_ratio, margin.torsion_ratio) if margin else (float("nan"),)
    return ending | {"margin": min(ratios) - 1}


def _pipeline(recipe: Recipe, engine: EngineName) -> GraspPipeline:
    physics = replace(recipe.physics, engine=engine)
    return GraspPipeline(recipe.model_copy(update={"physics": physics}))


@contextlib.contextmanager
def _grasp_job(
    recipe: Recipe, planned: Sequence[PlannedGrasp]
) -> Iterator[Callable[[int, Mapping[int, str], Report], dict[str, Any]]]:
    """One process: a task is one grasp, its items are the engines."""
    with contextlib.ExitStack() as stack:
        pipelines = [stack.enter_context(_pipeline(recipe, engine)) for engine in ENGINES]

        def job(task: int, crashed: Mapping[int, str], report: Report) -> dict[str, Any]:
            found: dict[str, Any] = {}
            for k, (engine, pipeline) in enumerate(zip(ENGINES, pipelines, strict=True)):
                item = len(ENGINES) * task + k
                if item not in crashed:
                    report("start", item, None)
                    ending = _ending(pipeline.simulate(planned[task]).trace)
                    found |= {f"{engine}_{key}": value for key, value in ending.items()}
            return found

        yield job


def main() -> None:
    """Compare the engines on one recipe."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recipe")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    loaded = load_recipe(options.recipe)
    table, record = (Path(options.out or "") / name for name in ("grasps.csv", "comparison.json"))
    if options.out:
        refuse_existing(False, table, record)
        options.out.mkdir(parents=True, exist_ok=True)
    with progress_counter("grasp") as show:
        found = compare_engines(loaded, workers=os.cpu_count() or 1, show=show)
    counts = counts_of(found)
    if options.out:
        write_text(table, found.to_csv(index=False))
        result = {"near_margin": NEAR_MARGIN, "counts": counts.to_dict(orient="index")}
        write_text(record, json.dumps(result, indent=2) + "\n")
    differing = found[~found["agree"]].drop(columns="agree").set_index("index").round(3)
    for index, row in differing.iterrows():
        print_status(f"grasp {index}\n{row.to_string()}\n")
    print_status(counts.to_string())


if __name__ == "__main__":
    main()

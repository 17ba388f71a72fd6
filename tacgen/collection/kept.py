"""Results kept in a file of JSON lines, so that an interrupted run goes on from there."""

import contextlib
import json
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from tacgen.core.files import append_json_lines, read_json_lines
from tacgen.core.processes import TaskFunction, run_tasks

GRASP_LIMIT_S = 120.0
"""A grasp takes 0.1 to 1 s; one that takes this long hangs and counts as crashed."""
Result = TypeVar("Result")


def kept_results(
    path: Path,
    tasks: Sequence[Sequence[Mapping[str, Any]]],
    make_job: Callable[..., contextlib.AbstractContextManager[TaskFunction]],
    of_data: Callable[[Any], Result],
    *,
    workers: int,
    show: Callable[[int, int], None],
) -> list[list[Result]]:
    """The result of every item of every task: kept in the file ``path``, or made and added to it.

    An item is plain data that names all that its result depends on; it is a line of the file with
    its ``outcome``, which ``of_data`` turns into the result. ``make_job``, given the places of the
    items that are missing of each task, is that of ``run_tasks``; its job returns their outcomes as
    plain data. Lines of other items, and damaged ones, are passed over.
    """
    kept: dict[str, Result] = {}
    for line in read_json_lines(path):
        with contextlib.suppress(AttributeError, KeyError, TypeError, ValueError):
            outcome = line.pop("outcome")
            kept[_key(line)] = of_data(outcome)
    missing = [[k for k, item in enumerate(items) if _key(item) not in kept] for items in tasks]
    pending = [task for task, places in enumerate(missing) if places]
    done = len(tasks) - len(pending)
    show(done, len(tasks))
    job = partial(make_job, missing)
    for event in run_tasks(pending, job, workers=workers, item_limit_s=GRASP_LIMIT_S):
        if event.kind == "done":
            items = [tasks[event.task][k] for k in missing[event.task]]
            pairs = list(zip(items, event.value, strict=True))
            append_json_lines(path, [{**item, "outcome": one} for item, one in pairs])
            kept |= {_key(item): of_data(one) for item, one in pairs}
            done += 1
            show(done, len(tasks))
    return [[kept[_key(item)] for item in items] for items in tasks]


def _key(item: Mapping[str, Any]) -> str:
    return json.dumps(item, sort_keys=True)

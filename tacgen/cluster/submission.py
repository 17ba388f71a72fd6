"""Handing work to a scheduler: a recipe's shards as arrays of jobs, a long command as one job."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from tacgen.cluster.records import JobsFolder, Submission, Task, note_path, write_submission
from tacgen.cluster.scheduler import site_array_limit
from tacgen.cluster.states import ALIVE, Status, TaskState, job_states, status
from tacgen.cluster.task import CollectTask, CommandTask
from tacgen.collection.grid import plan_recipe
from tacgen.collection.pipeline import dataset_spec
from tacgen.collection.recipe import Cluster, Recipe
from tacgen.core.errors import ClusterError
from tacgen.dataset import DatasetFolder

EXECUTORS = ("local", "slurm")
COMMANDS = ("friction", "train")
"""Long commands that write into ``--out`` and, run again, resume."""

SIGNAL_DELAY_S = 60  # time to finish and write a shard before the limit
_A_WEEK_MIN = 7 * 24 * 60
_POLL_S = 1.0


@dataclass(frozen=True, slots=True)
class Submitted:
    """What was handed over; ``arrays`` is into how many arrays the jobs were split."""

    folder: str
    executor: str
    shards: int
    jobs: tuple[str, ...]
    arrays: int


def submit(recipe: Recipe, out: Path, executor: str, *, failed_only: bool = False) -> Submitted:
    """Submit jobs for every shard that ``out`` lacks and no running or waiting job will make.

    Raises ``ClusterError`` if submitit or the scheduler is missing or refuses, or jobs of this
    dataset still run (unless ``failed_only``). Raises ``DatasetError`` if the folder cannot
    be written to or holds another dataset.
    """
    require_executor(executor)
    planned = plan_recipe(recipe)
    DatasetFolder(out).prepare(dataset_spec(recipe, len(planned)))
    found = status(out)
    shards = _shards_to_submit(found, failed_only=failed_only)
    if not shards:
        return Submitted(str(out), executor, 0, (), 0)
    cluster = recipe.cluster
    limit = 1 if executor == "local" else cluster.max_array or site_array_limit()
    folder = JobsFolder(out.resolve()).create()
    # Every n-th shard: objects differ in what they cost, neighbours are alike.
    count = _task_count(len(shards), executor, cluster)
    tasks = [
        CollectTask(
            recipe,
            out.resolve(),
            tuple(shards[number::count]),
            cluster.cpus_per_task,
            note_path(folder, number),
        )
        for number in range(count)
    ]
    jobs = _hand_over(tasks, folder, _engine(folder, executor, cluster, recipe.name), limit)
    return Submitted(str(folder), executor, len(shards), jobs, -(-len(jobs) // limit))


def wait_for(root: Path, show: Callable[[Status], None] = lambda _: None) -> Status:
    """Wait until no job of the dataset runs or waits; ``show`` gets each status on the way."""
    while (found := status(root)).alive:
        show(found)
        time.sleep(_POLL_S)
    show(found)
    return found


def submit_command(
    command: Sequence[str],
    out: Path,
    run: Callable[[Sequence[str]], None],
    executor: str,
    cluster: Cluster,
) -> Submitted:
    """Submit a command, as typed after ``tacgen``, as one job that is requeued and resumed.

    ``out`` is the folder that it writes to, where the job's record and logs go too, in ``jobs/``;
    ``run`` runs the command.

    Raises ``ClusterError`` if the command is none that resumes, a job of its folder still runs, or
    the scheduler is missing or refuses.
    """
    require_command(command)
    require_executor(executor)
    alive = [task.job_id for task in job_states(out) if task.state in ALIVE]
    if alive:
        ids = ", ".join(alive)
        msg = f"{out}: job {ids} still runs or waits; wait for it (`tacgen status {out}`)"
        raise ClusterError(msg)
    folder = JobsFolder(out.resolve()).create()
    task = CommandTask(tuple(command), run, Path.cwd(), note_path(folder, 0))
    jobs = _hand_over([task], folder, _engine(folder, executor, cluster, command[0]), 1)
    return Submitted(str(folder), executor, 0, jobs, 1)


def wait_for_command(out: Path) -> tuple[TaskState, ...]:
    """Wait until no job of ``out`` runs or waits, and return their states."""
    tasks = job_states(out)
    while any(task.state in ALIVE for task in tasks):
        time.sleep(_POLL_S)
        tasks = job_states(out)
    return tasks


def require_command(command: Sequence[str]) -> None:
    """Raise a ``ClusterError`` unless this command can be one job."""
    if not command or command[0] not in COMMANDS:
        msg = (
            f"`{' '.join(command)}`: give {' or '.join(COMMANDS)} and its options after `--`, "
            "or a recipe with --out, to collect its dataset"
        )
        raise ClusterError(msg)


def require_executor(executor: str) -> None:
    """Raise a ``ClusterError`` unless jobs can be handed to this executor from here."""
    problems = []
    if executor not in EXECUTORS:
        problems.append(f"--executor {executor}: give {' or '.join(EXECUTORS)}")
    if find_spec("submitit") is None:
        problems.append(
            "batch jobs need submitit, not installed here; install it with "
            "`pip install 'tacgen[cluster]'` (in a checkout: `make setup`)"
        )
    if executor == "slurm":
        missing = [name for name in ("sbatch", "srun", "squeue") if shutil.which(name) is None]
        if missing:
            problems.append(
                f"Slurm's {', '.join(missing)} not found here; submit from a login node of the "
                "cluster, or give --executor local"
            )
    if problems:
        raise ClusterError.from_problems(problems)


def _shards_to_submit(found: Status, *, failed_only: bool) -> list[int]:
    if found.alive and not failed_only:
        alive = [task.job_id for task in found.tasks if task.state in ALIVE]
        msg = (
            f"{found.root}: jobs {', '.join(alive[:5])} of this dataset still run or "
            "wait; wait for them (`tacgen status`), or give --failed to submit only what none of "
            "them will make"
        )
        raise ClusterError(msg)
    return sorted(found.failed + found.missing)


def _task_count(n_shards: int, executor: str, cluster: Cluster) -> int:
    """Jobs of ``shards_per_task`` each; here, no more than the processors can run at once."""
    wanted = -(-n_shards // cluster.shards_per_task)
    if executor == "local":
        return min(wanted, max(1, (os.cpu_count() or 1) // cluster.cpus_per_task))
    return wanted


def _hand_over(
    tasks: Sequence[CollectTask | CommandTask], folder: Path, engine: Any, limit: int
) -> tuple[str, ...]:
    """Submit the tasks, an array at a time, and record each array as soon as it is accepted."""
    from submitit.core.utils import FailedJobError, FailedSubmissionError

    executor, host = engine.name(), socket.gethostname()
    recorded: list[Task] = []
    with _background():
        for start in range(0, len(tasks), limit):
            batch = tasks[start : start + limit]
            try:
                with engine.batch():
                    jobs = [engine.submit(task) for task in batch]
            except (FailedJobError, FailedSubmissionError, OSError) as error:
                msg = (
                    f"{executor} refused the jobs: {error}; see the section `cluster` of the "
                    "recipe, or the flags"
                )
                raise ClusterError(msg) from error
            recorded += [
                Task(start + k, job.job_id, task.shards)
                for k, (job, task) in enumerate(zip(jobs, batch, strict=True))
            ]
            write_submission(folder, Submission(executor, host, tuple(recorded)))
    return tuple(task.job_id for task in recorded)


def _engine(folder: Path, executor: str, cluster: Cluster, name: str) -> Any:
    import submitit

    if executor == "local":
        here = submitit.LocalExecutor(folder)
        here.update_parameters(timeout_min=_A_WEEK_MIN, setup=list(cluster.setup))
        return here
    slurm = submitit.SlurmExecutor(folder, max_num_timeout=cluster.max_timeouts)
    slurm.update_parameters(**slurm_parameters(cluster, name))
    return slurm


def slurm_parameters(cluster: Cluster, name: str) -> dict[str, Any]:
    """The section ``cluster`` as the parameters of submitit's executor for Slurm."""
    parameters: dict[str, Any] = {
        "job_name": f"tacgen-{name}",
        "time": cluster.time_min,
        "mem": f"{round(cluster.mem_gb * 1024)}MB",
        "cpus_per_task": cluster.cpus_per_task,
        "partition": cluster.partition,
        "account": cluster.account,
        "qos": cluster.qos,
        "constraint": cluster.constraint,
        "array_parallelism": cluster.max_running,
        "signal_delay_s": SIGNAL_DELAY_S,
        "setup": list(cluster.setup) or None,
        # A node that fails, and a preemption, requeue the job; it resumes.
        "additional_parameters": {"requeue": True} | dict(cluster.sbatch),
    }
    return {key: value for key, value in parameters.items() if value is not None}


@contextlib.contextmanager
def _background() -> Iterator[None]:
    """Processes started here survive the terminal and hold none of this process's output.

    submitit's local executor hands its own output and signals on; a pipe behind ``tacgen
    submit`` would stay open for as long as the jobs run.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    kept = [os.dup(number) for number in (1, 2)]
    nowhere = os.open(os.devnull, os.O_WRONLY)
    hang_up = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
        yield
    finally:
        for number, copy in zip((1, 2), kept, strict=True):
            os.dup2(copy, number)
            os.close(copy)
        os.close(nowhere)
        signal.signal(signal.SIGHUP, hang_up)

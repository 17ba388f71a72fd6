"""Handing work to a scheduler: a recipe's shards as arrays of jobs, a long command as one job."""

import contextlib
import os
import shutil
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from tacgen.cluster.records import (
    JobsFolder,
    Note,
    Submission,
    Task,
    note_path,
    read_note,
    write_record,
)
from tacgen.cluster.scheduler import site_array_limit
from tacgen.cluster.states import ALIVE, DatasetStatus, TaskState, job_states, status
from tacgen.collection.recipe import Cluster, Recipe
from tacgen.collection.run import collect, prepare
from tacgen.core.errors import ClusterError, TacgenError, missing_extra
from tacgen.core.files import alone
from tacgen.core.progress import print_status

EXECUTORS = ("local", "slurm")
COMMANDS = ("friction", "train")  # long commands that write into ``--out`` and, run again, resume

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


@dataclass(frozen=True)
class Job:
    """A job that resumes when it is called again: collects ``shards``, or runs a command."""

    run: Callable[[], object]
    note: Path
    shards: tuple[int, ...] = ()

    def __call__(self) -> None:
        """Run, and keep a note for ``tacgen status``: running, then done, failed or interrupted."""
        before = read_note(self.note)
        attempt = before.attempt + 1 if before else 1

        def record(state: str, reason: str = "") -> None:
            note = Note(state, attempt, socket.gethostname(), os.getpid(), reason)
            write_record(self.note, note)

        record("running")
        try:
            self.run()
        except Exception as error:
            kind = "" if isinstance(error, TacgenError) else f"{type(error).__name__}: "
            record("failed", f"{kind}{error}")
            raise
        except BaseException:
            record("interrupted", "preempted, out of time or cancelled")
            raise
        record("done")

    def checkpoint(self) -> Any:
        """What submitit queues instead of this job when it is preempted: the same again."""
        from submitit.helpers import DelayedSubmission

        return DelayedSubmission(self)


def submit(
    recipe: Recipe, out: Path, executor: str, *, failed_only: bool = False, grow: bool = False
) -> Submitted:
    """Submit jobs for every shard that ``out`` lacks and no running or waiting job will make.

    With ``grow`` the dataset first gains the grasps that the recipe's grid has gained.

    Raises ``ClusterError`` if submitit or the scheduler is missing or refuses, or jobs of this
    dataset still run (unless ``failed_only``). Raises ``DatasetError`` if the folder cannot
    be written to or holds another dataset.
    """
    require_executor(executor)
    prepare(recipe, out, grow=grow)
    with _one_at_a_time(out):
        return _submit(recipe, out, executor, failed_only=failed_only)


def _submit(recipe: Recipe, out: Path, executor: str, *, failed_only: bool) -> Submitted:
    found = status(out)
    if not failed_only and (alive := _alive(found.tasks)):
        msg = (
            f"{out}: jobs {alive} of this dataset still run or wait; wait for them (`tacgen "
            "status`), or give --failed to submit only what none of them will make"
        )
        raise ClusterError(msg)
    shards = sorted(found.failed + found.missing)
    if not shards:
        return Submitted(str(out), executor, 0, (), 0)
    cluster = recipe.cluster
    limit = 1 if executor == "local" else cluster.max_array or site_array_limit()
    folder = JobsFolder(out.resolve()).create()
    count = -(-len(shards) // cluster.shards_per_task)
    if executor == "local":  # no more than the processors can run at once
        count = min(count, max(1, (os.cpu_count() or 1) // cluster.cpus_per_task))
    # Every n-th shard: objects differ in what they cost, neighbours are alike.
    shares = [tuple(shards[number::count]) for number in range(count)]
    run = partial(collect, recipe, out.resolve(), workers=cluster.cpus_per_task, progress=False)
    tasks = [
        Job(partial(run, shards=share), note_path(folder, number), share)
        for number, share in enumerate(shares)
    ]
    jobs = _hand_over(tasks, folder, _engine(folder, executor, cluster, recipe.name), limit)
    return Submitted(str(folder), executor, len(shards), jobs, -(-len(jobs) // limit))


@contextlib.contextmanager
def _one_at_a_time(out: Path) -> Iterator[None]:
    """Keep a second submission from finding that there is none yet."""
    jobs = JobsFolder(out).root
    jobs.mkdir(parents=True, exist_ok=True)
    fix = f"see `tacgen status {out}`"
    with alone(jobs / ".lock", out, "submitting it", ClusterError, fix):
        yield


def wait_for(root: Path) -> DatasetStatus:
    """Wait until no job of the dataset runs or waits."""
    while (found := status(root)).alive:
        time.sleep(_POLL_S)
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
    with _one_at_a_time(out):
        if alive := _alive(job_states(out)):
            msg = f"{out}: job {alive} still runs or waits; wait for it (`tacgen status {out}`)"
            raise ClusterError(msg)
        folder = JobsFolder(out.resolve()).create()
        task = Job(partial(_run_in, Path.cwd(), run, tuple(command)), note_path(folder, 0))
        jobs = _hand_over([task], folder, _engine(folder, executor, cluster, command[0]), 1)
        return Submitted(str(folder), executor, 0, jobs, 1)


def wait_for_command(out: Path) -> tuple[TaskState, ...]:
    """Wait until no job of ``out`` runs or waits, and return their states."""
    while _alive(tasks := job_states(out)):
        time.sleep(_POLL_S)
    return tasks


def require_command(command: Sequence[str]) -> None:
    """Raise a ``ClusterError`` unless this command can be one job."""
    if not command or command[0] not in COMMANDS:
        known = f"give {' or '.join(COMMANDS)} and its options after `--`"
        msg = f"`{' '.join(command)}`: {known}, or a recipe with --out, to collect its dataset"
        raise ClusterError(msg)


def require_executor(executor: str) -> None:
    """Raise a ``ClusterError`` unless jobs can be handed to this executor from here."""
    problems = []
    if executor not in EXECUTORS:
        problems.append(f"--executor {executor}: give {' or '.join(EXECUTORS)}")
    if problem := missing_extra("cluster", "batch jobs need"):
        problems.append(problem)
    if executor == "slurm":
        missing = [name for name in ("sbatch", "srun", "squeue") if shutil.which(name) is None]
        if missing:
            fix = "submit from a login node of the cluster, or give --executor local"
            problems.append(f"Slurm's {', '.join(missing)} not found here; {fix}")
    ClusterError.raise_if(problems)


def _run_in(folder: Path, run: Callable[[Sequence[str]], None], command: Sequence[str]) -> None:
    os.chdir(folder)
    run(command)


def _alive(tasks: Sequence[TaskState]) -> str:
    return ", ".join([task.job_id for task in tasks if task.state in ALIVE][:5])


def _hand_over(tasks: Sequence[Job], folder: Path, engine: Any, limit: int) -> tuple[str, ...]:
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
                fix = "see the section `cluster` of the recipe, or the flags"
                msg = f"{executor} refused the jobs: {error}; {fix}"
                raise ClusterError(msg) from error
            recorded += [
                Task(start + k, job.job_id, task.shards)
                for k, (job, task) in enumerate(zip(jobs, batch, strict=True))
            ]
            record = Submission(executor, host, tuple(recorded), str(os.getuid()))
            write_record(folder / "submission.json", record)
    return tuple(task.job_id for task in recorded)


def _engine(folder: Path, executor: str, cluster: Cluster, name: str) -> Any:
    import submitit

    if executor == "local":
        here = submitit.LocalExecutor(folder)
        here.update_parameters(timeout_min=_A_WEEK_MIN, setup=list(cluster.setup))
        return here
    if cluster.time_min * 60 <= 2 * SIGNAL_DELAY_S:
        limit = f"a time limit of {cluster.time_min} min"
        fix = (
            f"jobs get the signal to stop {SIGNAL_DELAY_S} s before it; give cluster.time_min more"
        )
        print_status(f"warning: {limit} leaves hardly any time to work: {fix}")
    slurm = submitit.SlurmExecutor(folder, max_num_timeout=cluster.max_timeouts)
    slurm.update_parameters(**slurm_parameters(cluster, name))
    return slurm


def slurm_parameters(cluster: Cluster, name: str) -> dict[str, Any]:
    """The section ``cluster`` as the parameters of submitit's executor for Slurm."""
    same = {"cpus_per_task", "partition", "account", "qos", "constraint"}
    return cluster.model_dump(include=same, exclude_none=True) | {
        "job_name": f"tacgen-{name}",
        "time": cluster.time_min,
        "mem": f"{round(cluster.mem_gb * 1024)}MB",
        "array_parallelism": cluster.max_running,
        "signal_delay_s": SIGNAL_DELAY_S,
        "setup": list(cluster.setup),
        # A node that fails, and a preemption, requeue the job; it resumes.
        "additional_parameters": {"requeue": True} | dict(cluster.sbatch),
    }


@contextlib.contextmanager
def _background() -> Iterator[None]:
    """Processes started here survive the terminal and hold none of this process's output.

    submitit's local executor hands its own output and signals on; a pipe behind ``tacgen
    submit`` would stay open for as long as the jobs run.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    kept = [os.dup(number) for number in (1, 2)]
    hang_up = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), 1)
            os.dup2(nowhere.fileno(), 2)
            yield
    finally:
        for number, copy in zip((1, 2), kept, strict=True):
            os.dup2(copy, number)
            os.close(copy)
        signal.signal(signal.SIGHUP, hang_up)

"""Commands that are one long job, handed to a scheduler: ``train`` and ``friction``."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

from tacgen.cluster.ledger import JobsFolder, note_path
from tacgen.cluster.states import TaskState, job_states
from tacgen.cluster.submission import Submitted, Target, hand_over, require_executor
from tacgen.cluster.task import CommandTask
from tacgen.collection.recipe import Cluster
from tacgen.core.errors import ClusterError

COMMANDS = ("friction", "train")
"""Those that write into ``--out`` and, run again, go on where they stopped."""

_ALIVE = ("queued", "running", "unknown")
_POLL_S = 1.0


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

    Raises
    ------
    ClusterError
        If the command is none that resumes, a job of its folder still lives, or the scheduler is
        missing or refuses.
    """
    require_command(command)
    require_executor(executor)
    alive = [task.job_id for task in job_states(out) if task.state in _ALIVE]
    if alive:
        msg = f"{out}: job {', '.join(alive)} still lives; wait for it (`tacgen status {out}`)"
        raise ClusterError(msg)
    folder = JobsFolder(out.resolve()).create()
    task = CommandTask(tuple(command), run, Path.cwd(), note_path(folder, 0))
    jobs = hand_over([task], folder, Target(executor, cluster, command[0], 1))
    return Submitted(str(folder), executor, 0, jobs, 1)


def wait_for_command(out: Path) -> tuple[TaskState, ...]:
    """Wait until no job of ``out`` lives, and say what became of them."""
    tasks = job_states(out)
    while any(task.state in _ALIVE for task in tasks):
        time.sleep(_POLL_S)
        tasks = job_states(out)
    return tasks


def require_command(command: Sequence[str]) -> None:
    """Raise a ``ClusterError`` unless this command can be one job."""
    if not command or command[0] not in COMMANDS:
        msg = (
            f"`{' '.join(command)}`: give {' or '.join(COMMANDS)} and its options after `--`; "
            "a dataset's recipe goes to `tacgen submit`"
        )
        raise ClusterError(msg)

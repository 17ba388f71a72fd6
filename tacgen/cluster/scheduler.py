"""The jobs that a scheduler has in its queue at the moment."""

import os
import re
import shutil
import socket
import subprocess
from collections.abc import Iterable
from pathlib import Path

from tacgen.cluster.records import Submission
from tacgen.core.errors import ClusterError

SCHEDULER_TIMEOUT_S = 60  # a slurmctld that is only busy answers earlier
_RUNNING = {"RUNNING", "COMPLETING", "STOPPED", "SUSPENDED"}
_DEFAULT_MAX_ARRAY = 1000  # Slurm's default MaxArraySize, less one


def live_jobs(submissions: Iterable[Submission]) -> dict[str, tuple[str, str]] | None:
    """Job id → (``running`` or ``queued``, the scheduler's reason) of every job not yet ended.

    None where that is unknown here: another machine's processes, or no ``squeue``.

    Raises ``ClusterError`` if ``squeue`` fails.
    """
    live: dict[str, tuple[str, str]] = {}
    slurm_ids: set[str] = set()
    users: set[str] = set()
    for submission in submissions:
        ids = [task.job_id for task in submission.tasks]
        if submission.executor == "slurm":
            slurm_ids.update(job_id.split("_")[0] for job_id in ids)
            users.add(submission.user or str(os.getuid()))
        elif submission.host != socket.gethostname():
            return None
        else:
            live.update({job_id: ("running", "") for job_id in ids if _is_ours(job_id)})
    if slurm_ids and shutil.which("squeue") is None:
        return None
    return live | (_slurm_jobs(users) if slurm_ids else {})


def site_array_limit() -> int:
    """The most tasks of one array that this site's Slurm takes."""
    found = re.search(r"^MaxArraySize\s*=\s*(\d+)\s*$", _ask(["scontrol", "show", "config"]), re.M)
    return max(1, int(found[1])) if found else _DEFAULT_MAX_ARRAY


def _slurm_jobs(users: Iterable[str]) -> dict[str, tuple[str, str]]:
    # All of the users' jobs: asking for single ids fails as soon as one of them is forgotten.
    whose = f"--user={','.join(sorted(users))}"
    text = _ask(["squeue", whose, "--noheader", "--array", "--format=%i|%T|%r"])
    jobs = {}
    for line in text.splitlines():
        job_id, state, reason = line.strip().split("|", 2)
        word = "running" if state in _RUNNING else "queued"
        jobs[job_id] = (word, "" if reason == "None" else reason)
    return jobs


def _ask(command: list[str]) -> str:
    try:
        result = subprocess.run(
            command, capture_output=True, text=True, timeout=SCHEDULER_TIMEOUT_S, check=True
        )
    except (OSError, subprocess.SubprocessError) as error:
        reason = (getattr(error, "stderr", "") or str(error)).strip()
        msg = f"`{' '.join(command)}` failed: {reason}; is the scheduler up?"
        raise ClusterError(msg) from error
    return result.stdout


def _is_ours(pid: str) -> bool:
    """Whether the process runs and is one of submitit's: numbers are used again."""
    try:
        return b"submitit" in Path(f"/proc/{int(pid)}/cmdline").read_bytes()
    except (OSError, ValueError):
        return False

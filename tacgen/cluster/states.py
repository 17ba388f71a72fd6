"""How far a dataset is, wherever its shards are being made, and what went wrong."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tacgen.cluster.records import JobsFolder, Note, Submission, Task, note_path, read_note
from tacgen.cluster.scheduler import live_jobs
from tacgen.dataset import DatasetFolder
from tacgen.dataset.input_hashes import changed_roles
from tacgen.dataset.manifest import ShardLine

ALIVE = ("queued", "running", "unknown")
"""States of a job that has not ended, or may not have (where that is unknown)."""

RATE_WINDOW_S = 600.0  # short enough to follow a queue that speeds up or slows down
RATE_SHARDS = 200
"""The rate is that of the shards that were finished last: at most so long ago, and so many."""


@dataclass(frozen=True, slots=True)
class TaskState:
    """One job: ``state`` is queued, running, done, failed or unknown."""

    submission: str
    task: int
    job_id: str
    state: str
    reason: str
    log: str
    attempt: int
    shards: tuple[int, ...]
    shards_done: int


@dataclass(frozen=True, slots=True)
class DatasetStatus:
    """The figures of ``tacgen status``.

    Every shard is in one of ``done``, ``running`` (some process holds it), ``queued`` (a running
    or waiting job will make it), ``failed`` (its job ended without it) and ``missing`` (no job
    has it).
    """

    root: str
    grasps: int
    grasps_done: int
    done: int
    running: tuple[tuple[int, str], ...]
    queued: tuple[int, ...]
    failed: tuple[int, ...]
    missing: tuple[int, ...]
    rate_grasps_per_s: float | None
    time_left_s: float | None
    tasks: tuple[TaskState, ...]

    @property
    def shards(self) -> int:
        """How many there are to be."""
        return self.done + len(self.running) + len(self.not_begun)

    @property
    def not_begun(self) -> tuple[int, ...]:
        """Shards that are neither done nor in hand."""
        return tuple(sorted(self.queued + self.failed + self.missing))

    @property
    def alive(self) -> bool:
        """Whether some job still runs or waits, or might (where that is unknown)."""
        return any(task.state in ALIVE for task in self.tasks)

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``."""
        return {"shards": self.shards} | asdict(self)


def status(root: Path) -> DatasetStatus:
    """Look at the dataset in ``root`` and at its jobs; writes nothing.

    Raises ``DatasetError`` if there is no dataset. Raises ``ClusterError`` if the record of a
    submission cannot be read, or the scheduler does not answer.
    """
    folder = DatasetFolder(root)
    plan = folder.plan()
    # The jobs first: a shard finished in between is then done, never failed.
    submissions = JobsFolder(root).submissions()
    live = live_jobs(submissions.values())
    running = folder.running()
    lines = {
        n: line
        for n, line in folder.manifest().items()
        if folder.shard_path(n).is_file() and not changed_roles(line.inputs, plan["inputs"])
    }
    tasks = _task_states(submissions, live, lines)
    begun = set(lines) | {shard for shard, _ in running}
    queued = _shards_of(tasks, *ALIVE) - begun
    failed = _shards_of(tasks, "failed") - begun - queued
    left = set(range(plan["n_shards"])) - begun - queued - failed
    grasps_done = sum(line.n_grasps for line in lines.values())
    rate = _rate(folder, lines)
    busy = bool(running) or any(task.state == "running" for task in tasks)
    return DatasetStatus(
        root=str(root),
        grasps=plan["n_grasps"],
        grasps_done=grasps_done,
        done=len(lines),
        running=tuple(entry for entry in running if entry[0] not in lines),
        queued=tuple(sorted(queued)),
        failed=tuple(sorted(failed)),
        missing=tuple(sorted(left)),
        rate_grasps_per_s=rate,
        time_left_s=(plan["n_grasps"] - grasps_done) / rate if rate and busy else None,
        tasks=tasks,
    )


def job_states(root: Path) -> tuple[TaskState, ...]:
    """The jobs of ``root``, where commands rather than shards were submitted.

    Raises ``ClusterError`` if the record of a submission cannot be read, or the scheduler does not
    answer.
    """
    submissions = JobsFolder(root).submissions()
    return _task_states(submissions, live_jobs(submissions.values()), {})


def jobs_text(root: Path, tasks: Sequence[TaskState]) -> str:
    """Submitted commands as text."""
    lines = [f"{root}: {len(tasks)} job{'' if len(tasks) == 1 else 's'}"]
    for task in tasks:
        attempt = f", attempt {task.attempt}" if task.attempt > 1 else ""
        reason = f": {task.reason}" if task.reason else ""
        lines += [f"  job {task.job_id} {task.state}{attempt}{reason}", f"    log: {task.log}"]
    return "\n".join(lines)


def status_text(found: DatasetStatus) -> str:
    """What a person reads: the counts, the rate, and every job that needs attention."""
    lines = [
        f"{found.root}: {found.done} of {found.shards} shards done, "
        f"{found.grasps_done} of {found.grasps} grasps",
        f"  running {len(found.running)}, queued {len(found.queued)}, "
        f"failed {len(found.failed)}, in no job {len(found.missing)}",
    ]
    if found.rate_grasps_per_s:
        left = f", {_duration(found.time_left_s)} left" if found.time_left_s is not None else ""
        lines.append(f"  {found.rate_grasps_per_s:.2g} grasps/s{left}")
    lines += [f"  shard {shard} running: {holder}" for shard, holder in found.running]
    for task in found.tasks:
        if task.state in ("failed", "unknown") or (task.state == "queued" and task.reason):
            lines.append(f"  job {task.job_id} {task.state}: {task.reason}")
        if task.state == "failed":
            lines.append(f"    log: {task.log}")
    if found.failed or found.missing:
        submit = f"tacgen submit {found.root}/recipe.yaml --out {found.root} --failed"
        lines.append(f"  `{submit}` runs what is missing")
    return "\n".join(lines)


def _task_states(
    submissions: Mapping[Path, Submission],
    live: Mapping[str, tuple[str, str]] | None,
    lines: Mapping[int, ShardLine],
) -> tuple[TaskState, ...]:
    found = []
    for folder, submission in submissions.items():
        for task in submission.tasks:
            note = read_note(note_path(folder, task.number))
            done = sum(shard in lines for shard in task.shards)
            state, reason = _verdict(task, note, live, whole=done == len(task.shards) > 0)
            log = str(folder / f"{task.job_id}_0_log.err")  # where submitit sends standard error
            facts = (folder.name, task.number, task.job_id, state, reason, log)
            found.append(TaskState(*facts, note.attempt if note else 0, task.shards, done))
    return tuple(found)


def _verdict(
    task: Task, note: Note | None, live: Mapping[str, tuple[str, str]] | None, *, whole: bool
) -> tuple[str, str]:
    """(state, reason): by the scheduler's queue, then the dataset's shards, then the job's note."""
    if live is not None and task.job_id in live:
        return live[task.job_id]
    if whole:
        return "done", ""
    if note is not None and note.state == "done":
        return "done", "another job made the rest" if task.shards else ""
    if note is not None and note.state == "failed":
        return "failed", note.reason
    if live is None:
        return "unknown", "ask on the machine that it was submitted from"
    reason = "ended before it began: cancelled, or its node could not start it"
    if note is not None:
        killed = f"ended without a message on {note.host}: killed, or out of memory"
        reason = note.reason if note.state == "interrupted" else killed
    return "failed", reason


def _shards_of(tasks: tuple[TaskState, ...], *states: str) -> set[int]:
    return {shard for task in tasks if task.state in states for shard in task.shards}


def _rate(folder: DatasetFolder, lines: Mapping[int, ShardLine]) -> float | None:
    """Grasps a second over the shards finished last, by the clock of the file system alone."""
    finished = sorted((folder.shard_path(n).stat().st_mtime, n) for n in lines)[-RATE_SHARDS:]
    recent = [(at_s, n) for at_s, n in finished if at_s >= finished[-1][0] - RATE_WINDOW_S]
    if len(recent) < 2 or recent[-1][0] <= recent[0][0]:
        return None
    return sum(lines[n].n_grasps for _, n in recent[1:]) / (recent[-1][0] - recent[0][0])


def _duration(seconds: float | None) -> str:
    minutes = (seconds or 0.0) / 60
    return f"{minutes:.0f} min" if minutes < 120 else f"{minutes / 60:.1f} h"

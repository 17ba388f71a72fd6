"""Records of submitted jobs and of their progress: small JSON files.

``out/jobs/000/submission.json`` is written by whoever submits, ``out/jobs/000/task-00000.json``
by the task, so no two processes write one file. Logs and submitit's own files stand beside them.
"""

import contextlib
import json
from dataclasses import asdict
from pathlib import Path

from pydantic import TypeAdapter
from pydantic.dataclasses import dataclass

from tacgen.core.errors import ClusterError
from tacgen.core.files import read_small_text, write_text

MAX_RECORD_BYTES = 1 << 26  # of a hundred thousand tasks, each with its shards, a tenth


@dataclass(frozen=True, slots=True)
class Task:
    """One job of a submission: the scheduler's id for it, and its shards."""

    number: int
    job_id: str
    shards: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Submission:
    """Jobs handed over by one ``tacgen submit``; ``host`` is where that was, ``user`` by whom."""

    executor: str
    host: str
    tasks: tuple[Task, ...]
    user: str = ""  # its number; not recorded by earlier versions


@dataclass(frozen=True, slots=True)
class Note:
    """The last state of a task: ``state`` is running, done, failed or interrupted."""

    state: str
    attempt: int
    host: str
    pid: int
    reason: str = ""


class JobsFolder:
    """Every path of a dataset's batch jobs."""

    def __init__(self, dataset_root: Path) -> None:
        self.root = Path(dataset_root) / "jobs"

    def create(self) -> Path:
        """The folder of a new submission: the next number."""
        while True:
            number = max((int(path.name) for path in self._folders()), default=-1) + 1
            folder = self.root / f"{number:03d}"
            with contextlib.suppress(FileExistsError):  # another submission took it meanwhile
                folder.mkdir(parents=True)
                return folder

    def submissions(self) -> dict[Path, Submission]:
        """Every submission by its folder, in order; empty where nothing was submitted.

        Raises ``ClusterError`` if the record of one cannot be read.
        """
        found = {}
        for folder in self._folders():
            path = folder / "submission.json"
            try:
                if path.is_file():
                    found[folder] = TypeAdapter(Submission).validate_json(
                        read_small_text(path, MAX_RECORD_BYTES)
                    )
            except ValueError as error:
                msg = f"{path}: not the record of a submission; delete the folder {folder}"
                raise ClusterError(msg) from error
        return found

    def _folders(self) -> list[Path]:
        return sorted(path for path in self.root.glob("*") if path.name.isdecimal())


def note_path(folder: Path, task: int) -> Path:
    """``task-00000.json`` of a submission."""
    return folder / f"task-{task:05d}.json"


def write_record(path: Path, record: Submission | Note) -> None:
    """Write or replace a record."""
    write_text(path, json.dumps(asdict(record)))


def read_note(path: Path) -> Note | None:
    """The last state of a task; None where it has not begun, or the file was cut short."""
    try:
        return TypeAdapter(Note).validate_json(read_small_text(path, MAX_RECORD_BYTES))
    except (OSError, ValueError):
        return None

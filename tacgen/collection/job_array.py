"""Which shards of a dataset are one job's share, in arrays of batch jobs too."""

from __future__ import annotations

from collections.abc import Mapping

from tacgen.core.errors import DatasetError


def share_of(n_shards: int, part: int, parts: int) -> range:
    """The shards of part ``part`` of ``parts`` (counted from 0): every parts-th one."""
    return range(part, n_shards, parts)


def parse_share(text: str, environment: Mapping[str, str]) -> tuple[int, int, str]:
    """(part, parts, where it comes from) of ``--shard I/N`` or ``--shard auto``.

    ``auto`` reads a Slurm array's or a Kubernetes indexed job's place. I counts from 0.

    Raises ``DatasetError`` if the text is neither, or ``auto`` finds no such place.
    """
    if text == "auto":
        return _share_of_the_job(environment)
    part_text, slash, parts_text = text.partition("/")
    if not (slash and part_text.isdecimal() and parts_text.isdecimal()):
        msg = f"--shard {text}: give I/N with I from 0 to N − 1, or auto"
        raise DatasetError(msg)
    part, parts = int(part_text), int(parts_text)
    if parts == 0:
        msg = f"--shard {text}: there is at least one part; give I/N with I from 0 to N − 1"
        raise DatasetError(msg)
    if part >= parts:
        msg = f"--shard {text}: I counts from 0, so it is at most {parts - 1} here"
        raise DatasetError(msg)
    return part, parts, "--shard"


def _share_of_the_job(environment: Mapping[str, str]) -> tuple[int, int, str]:
    if "SLURM_ARRAY_TASK_ID" in environment:
        task = _number(environment, "SLURM_ARRAY_TASK_ID")
        first = _number(environment, "SLURM_ARRAY_TASK_MIN", 0)
        step = max(1, _number(environment, "SLURM_ARRAY_TASK_STEP", 1))
        parts = _number(environment, "SLURM_ARRAY_TASK_COUNT")
        part = (task - first) // step
        if not 0 <= part < parts:
            msg = (
                f"--shard auto: task {task} of a Slurm array with gaps has no place by itself "
                f"among {parts} from {first} on; give --shard I/N, or submit the array without gaps"
            )
            raise DatasetError(msg)
        return part, parts, "SLURM_ARRAY_TASK_ID"
    if "JOB_COMPLETION_INDEX" in environment:
        if "JOB_COMPLETIONS" not in environment:
            msg = (
                "--shard auto: JOB_COMPLETION_INDEX is set, but not how many there are; "
                "set JOB_COMPLETIONS to the job's `completions`"
            )
            raise DatasetError(msg)
        part = _number(environment, "JOB_COMPLETION_INDEX")
        parts = _number(environment, "JOB_COMPLETIONS")
        if not 0 <= part < parts:
            msg = (
                f"--shard auto: JOB_COMPLETION_INDEX is {part}, but JOB_COMPLETIONS {parts}; "
                "set JOB_COMPLETIONS to the job's `completions`"
            )
            raise DatasetError(msg)
        return part, parts, "JOB_COMPLETION_INDEX"
    msg = (
        "--shard auto: neither SLURM_ARRAY_TASK_ID nor JOB_COMPLETION_INDEX is set; "
        "give --shard I/N"
    )
    raise DatasetError(msg)


def _number(environment: Mapping[str, str], name: str, default: int | None = None) -> int:
    text = environment.get(name)
    if text is None and default is not None:
        return default
    if text is None or not (text.isascii() and text.strip().isdecimal()):
        msg = f"--shard auto: {name} is {text!r}, not a whole number; give --shard I/N"
        raise DatasetError(msg)
    return int(text)

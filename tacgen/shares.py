"""Which shards of a dataset are one job's share, in arrays of batch jobs too."""

from __future__ import annotations

from collections.abc import Mapping

from tacgen.errors import DatasetError


def share_of(n_shards: int, part: int, parts: int) -> range:
    """The shards of part ``part`` of ``parts`` (counted from 0): every parts-th one."""
    return range(part, n_shards, parts)


def parse_share(text: str, environment: Mapping[str, str]) -> tuple[int, int, str]:
    """(part, parts, where it comes from) of ``--shard I/N`` or ``--shard auto``.

    ``auto`` reads a Slurm array's or a Kubernetes indexed job's place. I counts from 0.

    Raises
    ------
    DatasetError
        If the text is neither, or ``auto`` finds no such place.
    """
    if text == "auto":
        return _share_of_the_job(environment)
    part_text, slash, parts_text = text.partition("/")
    if not (slash and part_text.isdecimal() and parts_text.isdecimal()):
        msg = f"--shard {text}: give I/N with I from 0 to N − 1, or auto"
        raise DatasetError(msg)
    part, parts = int(part_text), int(parts_text)
    if part >= parts:
        msg = f"--shard {text}: I counts from 0, so it is at most {parts - 1} here"
        raise DatasetError(msg)
    return part, parts, "--shard"


def _share_of_the_job(environment: Mapping[str, str]) -> tuple[int, int, str]:
    if "SLURM_ARRAY_TASK_ID" in environment:
        first = int(environment.get("SLURM_ARRAY_TASK_MIN", "0"))
        step = max(1, int(environment.get("SLURM_ARRAY_TASK_STEP", "1")))
        part = (int(environment["SLURM_ARRAY_TASK_ID"]) - first) // step
        parts = int(environment["SLURM_ARRAY_TASK_COUNT"])
        if part >= parts:
            msg = (
                f"--shard auto: task {environment['SLURM_ARRAY_TASK_ID']} of a Slurm array with "
                "gaps has no place by itself; give --shard I/N, or submit the array without gaps"
            )
            raise DatasetError(msg)
        return part, parts, "SLURM_ARRAY_TASK_ID"
    if "JOB_COMPLETION_INDEX" in environment:
        completions = environment.get("JOB_COMPLETIONS")
        if completions is None:
            msg = (
                "--shard auto: JOB_COMPLETION_INDEX is set, but not how many there are; "
                "set JOB_COMPLETIONS to the job's `completions`"
            )
            raise DatasetError(msg)
        return int(environment["JOB_COMPLETION_INDEX"]), int(completions), "JOB_COMPLETION_INDEX"
    msg = (
        "--shard auto: neither SLURM_ARRAY_TASK_ID nor JOB_COMPLETION_INDEX is set; "
        "give --shard I/N"
    )
    raise DatasetError(msg)

"""Which shards of a dataset are one job's share, in arrays of batch jobs too."""

from collections.abc import Mapping

from tacgen.core.errors import DatasetError


def parse_share(text: str, environment: Mapping[str, str]) -> tuple[int, int, str]:
    """(part, parts, where it comes from) of ``--shard I/N`` or ``--shard auto``.

    ``auto`` reads a Slurm array's or a Kubernetes indexed job's place. I counts from 0.

    Raises ``DatasetError`` if the text is neither, or ``auto`` finds no such place.
    """
    if text == "auto":
        return _share_of_the_job(environment)
    part_text, _, parts_text = text.partition("/")
    if not (part_text.isdecimal() and parts_text.isdecimal() and int(part_text) < int(parts_text)):
        msg = f"--shard {text}: give I/N with I from 0 to N − 1, or auto"
        raise DatasetError(msg)
    return int(part_text), int(parts_text), "--shard"


def _share_of_the_job(environment: Mapping[str, str]) -> tuple[int, int, str]:
    if "SLURM_ARRAY_TASK_ID" in environment:
        task = _number(environment, "SLURM_ARRAY_TASK_ID")
        first = _number(environment, "SLURM_ARRAY_TASK_MIN", 0)
        step = max(1, _number(environment, "SLURM_ARRAY_TASK_STEP", 1))
        parts = _number(environment, "SLURM_ARRAY_TASK_COUNT")
        part, source = (task - first) // step, "SLURM_ARRAY_TASK_ID"
        problem = (
            f"task {task} of a Slurm array with gaps has no place by itself among {parts} from "
            f"{first} on; give --shard I/N, or submit the array without gaps"
        )
    elif "JOB_COMPLETION_INDEX" in environment:
        part = _number(environment, "JOB_COMPLETION_INDEX")
        parts = _number(environment, "JOB_COMPLETIONS")
        source = "JOB_COMPLETION_INDEX"
        problem = (
            f"JOB_COMPLETION_INDEX is {part}, but JOB_COMPLETIONS {parts}; set JOB_COMPLETIONS to "
            "the job's `completions`"
        )
    else:
        part, parts, source = 0, 0, ""
        problem = "neither SLURM_ARRAY_TASK_ID nor JOB_COMPLETION_INDEX is set; give --shard I/N"
    if not 0 <= part < parts:
        msg = f"--shard auto: {problem}"
        raise DatasetError(msg)
    return part, parts, source


def _number(environment: Mapping[str, str], name: str, default: int | None = None) -> int:
    text = environment.get(name)
    if text is None and default is not None:
        return default
    if text is None or not (text.isascii() and text.strip().isdecimal()):
        msg = f"--shard auto: {name} is {text!r}, not a whole number; give --shard I/N"
        raise DatasetError(msg)
    return int(text)

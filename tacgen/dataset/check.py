"""What must hold for a grasp, whether it is about to be written or was read back."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tacgen.core.records import LABEL_FAILURE, LABEL_NOT_EXECUTED, LABEL_SUCCESS
from tacgen.dataset.samples import DatasetSpec, GraspSample, PadSample
from tacgen.dataset.schema import FAILURE_MODES, MAX_OBJECT_BYTES, SPLITS, STATUSES


def sample_problems(sample: GraspSample, spec: DatasetSpec) -> list[str]:
    """Everything about ``sample`` that does not fit ``spec`` or itself; empty where it fits."""
    problems = [outcome_problem(sample.label, sample.status, sample.failure_mode)]
    if sample.split not in SPLITS:
        problems.append(f"split {sample.split!r} is not one of {', '.join(SPLITS)}")
    if not 1 <= len(sample.config.object.encode()) <= MAX_OBJECT_BYTES:
        problems.append(f"object {sample.config.object!r} is not of 1 to {MAX_OBJECT_BYTES} bytes")
    n_frames = len(spec.time_s)
    if not 0 <= sample.grasp_frame < n_frames:
        problems.append(f"grasp_frame {sample.grasp_frame} is not one of {n_frames} frames")
    problems += _array_problems("object_pose", sample.object_pose, (n_frames, 7))
    if sample.picture is not None and spec.picture_px is not None:
        problems += _array_problems("picture", sample.picture, (*spec.picture_px, 3), "uint8")
    if sample.status == "executed" and set(sample.pads) != set(spec.pads):
        problems.append(
            f"pads {', '.join(sorted(sample.pads)) or 'none'} are not {', '.join(spec.pads)}"
        )
    for pad in sorted(set(sample.pads) & set(spec.pads)):
        problems += [f"{pad} pad: {text}" for text in _pad_problems(sample.pads[pad], spec)]
    return [text for text in problems if text]


def outcome_problem(label: int, status: str, failure_mode: str) -> str:
    """What is wrong between a label, its status and failure mode; empty where nothing is."""
    if status not in STATUSES:
        return f"status {status!r} is not one of {', '.join(STATUSES)}"
    if failure_mode not in FAILURE_MODES:
        return f"failure mode {failure_mode!r} is not one of {', '.join(FAILURE_MODES[1:])}"
    if label not in (LABEL_SUCCESS, LABEL_FAILURE, LABEL_NOT_EXECUTED):
        return f"label {label} is not 1, 0 or -1"
    if (label == LABEL_NOT_EXECUTED) != (status != "executed"):
        return f"label {label} does not go with status {status}"
    if failure_mode and label != LABEL_FAILURE:
        return f"failure mode {failure_mode} does not go with label {label}"
    return ""


def _pad_problems(felt: PadSample, spec: DatasetSpec) -> Iterator[str]:
    n_frames, shape_px = len(spec.time_s), spec.sensor.shape_px
    yield from _array_problems("rgb", felt.rgb, (n_frames, *shape_px, 3), "uint8")
    yield from _array_problems("force_normal_n", felt.force_normal_n, (n_frames,))
    yield from _array_problems("force_shear_n", felt.force_shear_n, (n_frames, 2))
    yield from _array_problems("indentation_mm", felt.indentation_mm, (n_frames,))
    if spec.depth:
        if felt.depth_mm is None:
            yield "depth_mm is missing"
        yield from _array_problems("depth_mm", felt.depth_mm, shape_px)


def _array_problems(
    name: str, array: np.ndarray | None, shape: tuple[int, ...], dtype: str = ""
) -> Iterator[str]:
    if array is None:
        return
    if array.shape != shape:
        yield f"{name} has shape {array.shape}, not {shape}"
    elif dtype and array.dtype != dtype:
        yield f"{name} is {array.dtype}, not {dtype}"
    elif array.dtype.kind not in "fiu":
        yield f"{name} is {array.dtype}, not numbers"
    elif array.dtype.kind == "f" and not np.isfinite(array).all():
        yield f"{name} is not finite"

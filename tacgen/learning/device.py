"""The device that torch computes on, and settings that make its results reproducible."""

import contextlib
import os
from collections.abc import Iterator

import torch

from tacgen.core.errors import LearningError
from tacgen.learning.training_recipe import TrainingOptions


def choose_device(options: TrainingOptions, device: str | None = None) -> str:
    """``device``, or the one that the recipe asks for: ``cuda`` or ``cpu``.

    Raises ``LearningError`` if it is a GPU and there is none.
    """
    asked, has_gpu = device or options.device, torch.cuda.is_available()
    if asked == "cuda" and not has_gpu:
        given = "--device cuda" if device else "training.device: cuda"
        msg = f"{given}, but torch finds no GPU here; ask for auto, or install torch for your GPU"
        raise LearningError(msg)
    return "cuda" if has_gpu and asked != "cpu" else "cpu"


@contextlib.contextmanager
def exact_torch(threads: int) -> Iterator[None]:
    """Deterministic algorithms on a fixed number of threads, inside a ``with`` block.

    The number of threads decides the order of sums, and thereby their last bits.
    """
    before = (
        torch.get_num_threads(),
        torch.are_deterministic_algorithms_enabled(),
        torch.is_deterministic_algorithms_warn_only_enabled(),
    )
    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
    torch.set_num_threads(threads)
    torch.use_deterministic_algorithms(True, warn_only=torch.cuda.is_available())
    try:
        with torch.random.fork_rng():
            yield
    finally:
        torch.set_num_threads(before[0])
        torch.use_deterministic_algorithms(before[1], warn_only=before[2])

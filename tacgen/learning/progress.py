"""What is seen of a training while it runs: a bar, lines on standard error, TensorBoard."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from tqdm import tqdm

_SHOWN = (
    "train_loss",
    "train_accuracy",
    "validation_loss",
    "validation_accuracy",
    "validation_balanced_accuracy",
    "learning_rate",
    "backbone_rate",
    "loader_share",
)


def tell(text: str) -> None:
    """A line on standard error, past any progress bar."""
    tqdm.write(f"tacgen: {text}", file=sys.stderr)


def epoch_bar(name: str, epochs: int, done: int) -> tqdm:
    """A bar over the epochs of one model; nothing where nobody looks."""
    return tqdm(
        total=epochs,
        initial=done,
        desc=name,
        unit="epoch",
        file=sys.stderr,
        disable=not sys.stderr.isatty(),
    )


class Board:
    """A TensorBoard log; epochs after ``done`` that an earlier start left there are cut off."""

    def __init__(self, folder: Path, done: int) -> None:
        from torch.utils.tensorboard import SummaryWriter

        self._writer = SummaryWriter(str(folder), purge_step=done + 1)

    def __enter__(self) -> Board:
        return self

    def __exit__(self, *raised: object) -> None:
        self._writer.close()

    def add(self, line: dict[str, Any]) -> None:
        """The figures of one epoch."""
        for name in _SHOWN:
            group, _, rest = name.partition("_")
            self._writer.add_scalar(f"{group}/{rest}", line[name], line["epoch"])

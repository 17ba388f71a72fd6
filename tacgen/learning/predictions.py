"""What a model said of some grasps, beside what is true of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tacgen.learning.grasps import GraspTable


@dataclass(frozen=True, slots=True)
class Predictions:
    """One model's judgement of N grasps.

    ``probabilities`` (N,) are of success; ``frames(i)`` gives grasp i's images as the network saw
    them, (T, h, w, 3) uint8.
    """

    model: str
    table: GraspTable
    probabilities: NDArray[np.float64]
    frames: Callable[[int], NDArray[np.uint8]]

    def wrong(self) -> list[int]:
        """Positions of the misjudged grasps."""
        judged = self.probabilities >= 0.5
        return [int(i) for i in np.flatnonzero(judged != (self.table.label == 1))]

    @staticmethod
    def joined(
        parts: Sequence[Predictions],
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Labels and probabilities of all parts, in their order."""
        labels = np.concatenate([part.table.label for part in parts])
        return labels, np.concatenate([part.probabilities for part in parts])

"""Predicted probabilities of success, beside the true outcomes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from tacgen.learning.device import Device
from tacgen.learning.grasps import GraspTable
from tacgen.learning.networks import StabilityNet


@dataclass(frozen=True, slots=True)
class Predictions:
    """One model's predictions for N grasps.

    ``probabilities`` (N,) are of success; ``frames(i)`` gives grasp i's images as the network saw
    them, (T, h, w, 3) uint8.
    """

    table: GraspTable
    probabilities: NDArray[np.float64]
    frames: Callable[[int], NDArray[np.uint8]]

    def wrong(self) -> list[int]:
        """Positions of the misclassified grasps."""
        predicted = self.probabilities >= 0.5
        return [int(i) for i in np.flatnonzero(predicted != (self.table.label == 1))]

    @staticmethod
    def joined(
        parts: Sequence[Predictions],
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Labels and probabilities of all parts, in their order."""
        labels = np.concatenate([part.table.label for part in parts])
        return labels, np.concatenate([part.probabilities for part in parts])


def predict(
    network: StabilityNet,
    batches: Iterable[tuple[torch.Tensor, torch.Tensor, NDArray[np.int64]]],
    device: Device,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Probability of success (N,) and label (N,) of every grasp in ``batches``."""
    network.eval()
    probabilities, labels = [np.empty(0)], [np.empty(0, np.int64)]
    with torch.inference_mode():
        for images, truth, _ in batches:
            with device.autocast():
                logits = network(images.to(device.name))
            probabilities.append(logits.double().softmax(1)[:, 1].cpu().numpy())
            labels.append(truth.numpy())
    return np.concatenate(probabilities), np.concatenate(labels)

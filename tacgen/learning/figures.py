"""Pictures of a training and of an evaluation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tacgen.learning.scores import ReliabilityBin

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CLASS_NAMES = ("failure", "success")
_BLUE, _ORANGE, _GREY = "#2a6f97", "#d1603d", "#8a8a8a"


def curves(metrics: Sequence[Mapping[str, Any]], best_epoch: int) -> Figure:
    """Loss, accuracy and rate over the epochs."""
    figure = _figure(11, 3.2)
    epochs = [line["epoch"] for line in metrics]
    for place, (title, names) in enumerate(
        [
            ("loss", ("train_loss", "validation_loss")),
            ("accuracy", ("train_accuracy", "validation_accuracy")),
            ("learning rate", ("learning_rate", "backbone_rate")),
        ],
        start=1,
    ):
        axes = figure.add_subplot(1, 3, place)
        for name, color in zip(names, (_BLUE, _ORANGE), strict=True):
            axes.plot(
                epochs,
                [line[name] for line in metrics],
                color=color,
                label=name.replace("_", " "),
                marker=".",
                markersize=3,
            )
        axes.axvline(best_epoch, color=_GREY, linewidth=0.8, linestyle=":", label="best epoch")
        axes.set_xlabel("epoch")
        axes.set_title(title)
        axes.legend(frameon=False, fontsize=8)
    figure.axes[1].set_ylim(-0.02, 1.02)
    figure.axes[2].set_yscale("log")
    figure.tight_layout()
    return figure


def confusion_figure(confusion: Sequence[Sequence[int]]) -> Figure:
    """Truth by row, judgement by column, with counts."""
    figure = _figure(3.6, 3.0)
    axes = figure.add_subplot()
    counts = np.asarray(confusion)
    axes.imshow(counts, cmap="Blues", vmin=0, vmax=max(int(counts.max()), 1))
    for (row, column), count in np.ndenumerate(counts):
        dark = count > 0.6 * counts.max()
        axes.text(
            column, row, str(count), ha="center", va="center", color="white" if dark else "black"
        )
    axes.set_xticks([0, 1], CLASS_NAMES)
    axes.set_yticks([0, 1], CLASS_NAMES)
    axes.set_xlabel("judged")
    axes.set_ylabel("true")
    figure.tight_layout()
    return figure


def reliability_figure(bins: Sequence[ReliabilityBin]) -> Figure:
    """Predicted probability of success against what came true, and how many grasps each bin has."""
    figure = _figure(4.2, 4.2)
    upper, lower = figure.subplots(2, 1, height_ratios=(3, 1), sharex=True)
    upper.plot([0, 1], [0, 1], color=_GREY, linewidth=0.8, linestyle=":")
    upper.plot([b.predicted for b in bins], [b.succeeded for b in bins], color=_BLUE, marker="o")
    upper.set_ylabel("share that succeeded")
    upper.set_ylim(-0.03, 1.03)
    lower.bar(
        [(b.lo + b.hi) / 2 for b in bins],
        [b.n for b in bins],
        width=0.09,
        color=_BLUE,
    )
    lower.set_ylabel("grasps")
    lower.set_xlabel("predicted probability of success")
    lower.set_xlim(-0.02, 1.02)
    figure.tight_layout()
    return figure


def strip(frames: NDArray[np.uint8], height_px: int = 120, most: int = 8) -> NDArray[np.uint8]:
    """Up to ``most`` frames (T, h, w, 3) side by side, RGB."""
    chosen = np.unique(np.round(np.linspace(0, len(frames) - 1, most)).astype(int))
    width_px = round(height_px * frames.shape[2] / frames.shape[1])
    images = [
        cv2.resize(frames[k], (width_px, height_px), interpolation=cv2.INTER_AREA) for k in chosen
    ]
    return np.concatenate(images, axis=1)


def _figure(width_in: float, height_in: float) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(width_in, height_in))

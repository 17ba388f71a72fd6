"""The statistics that LeRobot keeps of every feature, by episode and over all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
_GREY = np.arange(256) / 255.0


@dataclass(frozen=True, slots=True)
class ImageStats:
    """Of images, channel by channel, scaled to [0, 1]; exact, from a histogram of grey levels."""

    histogram: NDArray[np.int64]
    n_frames: int

    @classmethod
    def of(cls, images: NDArray[np.uint8]) -> ImageStats:
        """Those of images (T, H, W, C)."""
        channels = np.moveaxis(images, -1, 0).reshape(images.shape[-1], -1)
        return cls(np.stack([np.bincount(c, minlength=256) for c in channels]), len(images))

    @classmethod
    def merged(cls, parts: Sequence[ImageStats]) -> ImageStats:
        """Those of all the images that ``parts`` are of."""
        histogram = np.sum([part.histogram for part in parts], axis=0)
        return cls(histogram, sum(part.n_frames for part in parts))

    def as_dict(self) -> dict[str, Any]:
        """``min``, ``max``, ``mean``, ``std`` and quantiles (C, 1, 1), and ``count`` (1,)."""
        share = self.histogram / self.histogram.sum(axis=1, keepdims=True)
        mean = share @ _GREY
        seen = self.histogram > 0
        below = np.cumsum(share, axis=1)
        found = {
            "min": _GREY[seen.argmax(axis=1)],
            "max": _GREY[255 - seen[:, ::-1].argmax(axis=1)],
            "mean": mean,
            "std": np.sqrt(np.maximum(0.0, share @ _GREY**2 - mean**2)),
        } | {
            name: _GREY[(below >= level - 1e-12).argmax(axis=1)]
            for name, level in QUANTILES.items()
        }
        stats: dict[str, Any] = {key: v.reshape(-1, 1, 1).tolist() for key, v in found.items()}
        return stats | {"count": [self.n_frames]}


@dataclass(frozen=True, slots=True)
class VectorStats:
    """Of vectors or numbers, component by component."""

    rows: NDArray[np.float64]

    @classmethod
    def of(cls, values: NDArray[Any]) -> VectorStats:
        """Those of (T, n) or (T,)."""
        return cls(np.asarray(values, np.float64).reshape(len(values), -1))

    @classmethod
    def merged(cls, parts: Sequence[VectorStats]) -> VectorStats:
        """Those of all the values that ``parts`` are of."""
        return cls(np.concatenate([part.rows for part in parts]))

    def as_dict(self) -> dict[str, Any]:
        """``min``, ``max``, ``mean``, ``std`` and quantiles (n,), and ``count`` (1,)."""
        found = {
            "min": self.rows.min(axis=0),
            "max": self.rows.max(axis=0),
            "mean": self.rows.mean(axis=0),
            "std": self.rows.std(axis=0),
        } | {name: np.quantile(self.rows, level, axis=0) for name, level in QUANTILES.items()}
        stats: dict[str, Any] = {name: values.tolist() for name, values in found.items()}
        return stats | {"count": [len(self.rows)]}

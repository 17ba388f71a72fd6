"""What a recording of a sensor is, wherever it comes from: pictures in time, a gauge's forces."""

import math
from collections.abc import Generator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tacgen.core.types import FloatArray

LAGS_S = np.arange(-200, 201) * 0.005
"""What is tried: drivers on one machine, or on machines kept by NTP, are less than 1 s apart."""
LEAST_FOR_LAG, LEAST_EXPLAINED = 20, 0.5
"""Pictures, and the share of their forces' squares that the gauge explains, that show a lag: by
chance its three axes explain 0.15 of 20 pictures."""


@dataclass(frozen=True, slots=True)
class Recorded:
    """A picture of a recording: its name, its time, s (NaN where unknown), and RGB (H, W, 3)."""

    name: str
    time_s: float
    rgb: NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Wrench:
    """Forces (n, 3), N, of a topic in the gauge's own axes, at times (n,), s, that never fall."""

    topic: str
    time_s: FloatArray
    force_n: FloatArray
    most_gap_s: float

    def at(self, time_s: FloatArray) -> FloatArray:
        """Forces (..., 3) between the two beside each time; NaN outside, and in longer gaps."""
        after = np.clip(np.searchsorted(self.time_s, time_s), 1, len(self.time_s) - 1)
        start, end = self.time_s[after - 1], self.time_s[after]
        share = (time_s - start) / np.maximum(end - start, 1e-9)
        is_known = (share >= 0.0) & (share <= 1.0) & (end - start <= self.most_gap_s)
        before = self.force_n[after - 1]
        between = before + share[..., None] * (self.force_n[after] - before)
        return np.where(is_known[..., None], between, np.nan)

    def lag_s(self, time_s: FloatArray, force_n: FloatArray) -> float:
        """How much later than the pictures (N,) its times are, s; NaN where that does not show.

        That is where its three axes together explain most of the ``force_n`` (N,) that was read.
        """
        is_read = np.isfinite(force_n)
        time_s, force_n = time_s[is_read], force_n[is_read]
        explained = np.zeros(len(LAGS_S))
        for k, lag_s in enumerate(LAGS_S):
            gauge_n = self.at(time_s + lag_s)
            known = np.isfinite(gauge_n).all(axis=1)
            if known.sum() >= max(LEAST_FOR_LAG, len(time_s) / 2):
                axes = np.column_stack([gauge_n, np.ones(len(gauge_n))])[known]
                read_n = force_n[known]
                residual_n = read_n - axes @ np.linalg.lstsq(axes, read_n, rcond=None)[0]
                explained[k] = 1.0 - residual_n.var() / max(float(read_n.var()), 1e-12)
        best = int(explained.argmax())
        is_seen = explained[best] >= LEAST_EXPLAINED and 0 < best < len(LAGS_S) - 1
        return float(LAGS_S[best]) if is_seen else math.nan


@dataclass(frozen=True, slots=True)
class Recording:
    """A recording, open: ``pictures`` come one by one, ``stated`` of them, 0 where unknown.

    ``background_rgb`` (H, W, 3) is the gel at rest and ``wrench`` the forces of a gauge, where it
    has them; ``notes`` are what the user should know. The pictures end in ``SensorError`` where it
    is broken or cut.
    """

    name: str
    stated: int
    pictures: Generator[Recorded]
    background_rgb: NDArray[np.uint8] | None = None
    wrench: Wrench | None = None
    notes: tuple[str, ...] = ()

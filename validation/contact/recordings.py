"""Ways in which laboratories record a press log, so that its rows are not independent.

Each takes a log as a rig measured it, one independent reading a row, and returns it as software
would have written it down.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pandas as pd

FORCES = ("force_normal_n", "force_shear_x_n", "force_shear_y_n")
RESPONSES = ("volume_mm3", "shear_x_mm", "shear_y_mm")
Record = Callable[[pd.DataFrame], pd.DataFrame]


def smoothed(frame: pd.DataFrame, rows: int = 5) -> pd.DataFrame:
    """Every measured column as its moving average over ``rows`` of its trial."""
    frame = frame.copy()
    for name in _present(frame, (*FORCES, *RESPONSES)):
        window = frame.groupby("trial")[name].rolling(rows, center=True, min_periods=1)
        frame[name] = window.mean().to_numpy()
    return frame


def resampled(frame: pd.DataFrame, rate: int = 2) -> pd.DataFrame:
    """Numbers interpolated linearly in time at ``rate`` times the rate, texts of the row before."""
    parts = []
    for _, trial in frame.groupby("trial", sort=False):
        at = np.arange(rate * (len(trial) - 1) + 1) / rate
        rows = np.arange(len(trial), dtype=np.float64)
        columns = {
            name: np.interp(at, rows, values)
            if values.dtype.kind == "f"
            else values.to_numpy()[at.astype(int)]
            for name, values in trial.items()
        }
        parts.append(pd.DataFrame(columns))
    return pd.concat(parts, ignore_index=True)


def doubled(frame: pd.DataFrame, *, clock_runs: bool = False) -> pd.DataFrame:
    """Every row twice; with ``clock_runs`` the second at a time of its own."""
    twice = frame.loc[frame.index.repeat(2)].reset_index(drop=True)
    if clock_runs:
        step_s = frame.groupby("trial")["time_s"].diff().median()
        twice.loc[1::2, "time_s"] += 0.5 * step_s
    return twice


def held(frame: pd.DataFrame, rows: int, names: tuple[str, ...] = FORCES) -> pd.DataFrame:
    """Readings of ``names`` that stand for ``rows`` rows each, since their device is slower."""
    frame = frame.copy()
    place = frame.groupby("trial").cumcount().to_numpy()
    for name in _present(frame, names):
        frame[name] = frame[name].to_numpy()[np.arange(len(frame)) - place % rows]
    return frame


def _present(frame: pd.DataFrame, names: tuple[str, ...]) -> list[str]:
    return [name for name in names if name in frame]


RECORDINGS: dict[str, Record] = {
    "moving average over 5 rows": smoothed,
    "resampled to twice the rate": resampled,
    "every row twice": doubled,
    "every row twice, clock running": partial(doubled, clock_runs=True),
    "force held for 2 rows": partial(held, rows=2),
    "force held for 4 rows": partial(held, rows=4),
    "volume held for 3 rows": partial(held, rows=3, names=RESPONSES),
}

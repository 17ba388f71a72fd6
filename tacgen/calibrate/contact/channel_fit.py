"""One channel of a press log: its compliance, pooled and by group, and its held-out error."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from tacgen.calibrate.contact.slope_fit import SlopeFit, fit_slope
from tacgen.core.errors import PressError
from tacgen.presses.press_log import SHEAR_FORCES, SHEAR_MOTIONS, PressLog

MAX_FOLDS = 20
MIN_SAMPLES_FOR_NOISE = 10
"""In shorter presses neighbouring samples are too far apart to show a sample's own noise."""
BLOCKS_OF_A_TRIAL = 8
"""Parts into which a group of one single trial is cut, as its samples are not independent."""

PLAIN_UNITS = {"normal": ("mm3", "mm3/N"), "shear": ("mm", "mm/N")}
"""Of the response and of the compliance."""


@dataclass(frozen=True, slots=True)
class Agreement:
    """Welch's test that all groups share one k: the law does not depend on them."""

    statistic: float
    dof: tuple[float, float]
    p_value: float
    spread: float
    """(largest − smallest k) / pooled k."""


@dataclass(frozen=True, slots=True)
class HeldOut:
    """Error on whole trials that the fit did not see; ``nrmse`` is per RMS of what was measured."""

    rmse: float
    nrmse: float
    unit: str
    by_trial: Mapping[int, float]
    folds: int


@dataclass(frozen=True, slots=True)
class ChannelFit:
    """One channel's compliance: pooled, by group, and how well it does on unseen trials."""

    channel: str
    pooled: SlopeFit
    by: str
    groups: Mapping[str, SlopeFit]
    agreement: Agreement | None
    held_out: HeldOut
    noise: float
    """Standard deviation of a sample's own noise, from how the residual jumps in time."""


def fit_channel(log: PressLog, channel: str, by: str) -> ChannelFit:
    """Pooled and grouped compliance of the ``normal`` or ``shear`` channel."""
    load, response = channel_arrays(log, channel)
    trial = log["trial"]
    pooled = fit_slope(load, response, trial)
    if not pooled.value > 0:
        unit = PLAIN_UNITS[channel][1]
        msg = (
            f"{log.path}: the {channel} response does not grow with the load (k = "
            f"{pooled.value:.3g} {unit}); check the signs of force and "
            f"{'volume' if channel == 'normal' else 'marker motion'}"
        )
        raise PressError(msg)
    groups = {
        str(name): _fit_group(load[rows], response[rows], trial[rows])
        for name in np.unique(log[by])
        if _loaded(load[rows := log[by] == name])
    }
    return ChannelFit(
        channel, pooled, by, MappingProxyType(groups), agreement_of(groups, pooled.value),
        _held_out(load, response, trial, PLAIN_UNITS[channel][0]),
        _own_noise(response - pooled.value * load, trial),
    )  # fmt: skip


def channel_arrays(log: PressLog, channel: str) -> tuple[NDArray[Any], NDArray[Any]]:
    """Load and response (N, c) of a channel."""
    if channel == "normal":
        return log["force_normal_n"][:, None], log["volume_mm3"][:, None]
    return (
        np.column_stack([log[name] for name in SHEAR_FORCES]),
        np.column_stack([log[name] for name in SHEAR_MOTIONS]),
    )


def agreement_of(groups: Mapping[str, SlopeFit], pooled: float) -> Agreement | None:
    """Welch's test over the groups; None where fewer than two have an error of their own.

    Source
    ------
    Welch 1951, On the comparison of several mean values, Biometrika 38.
    """
    usable = [fit for fit in groups.values() if np.isfinite(fit.stderr) and fit.stderr > 0]
    if len(usable) < 2:
        return None
    n = len(usable)
    k = np.array([fit.value for fit in usable])
    weight = 1.0 / np.array([fit.stderr for fit in usable]) ** 2
    dof = np.array([max(fit.dof, 1.0) for fit in usable])
    mean = (weight * k).sum() / weight.sum()
    unevenness = ((1.0 - weight / weight.sum()) ** 2 / dof).sum()
    between = (weight * (k - mean) ** 2).sum() / (n - 1)
    statistic = float(between / (1.0 + 2.0 * (n - 2) / (n**2 - 1) * unevenness))
    dof_within = float((n**2 - 1) / (3.0 * unevenness))
    p_value = float(fdtrc(n - 1, dof_within, statistic))
    return Agreement(statistic, (n - 1.0, dof_within), p_value, float(np.ptp(k) / pooled))


def _fit_group(load: NDArray[Any], response: NDArray[Any], trial: NDArray[Any]) -> SlopeFit:
    """A group of one trial is cut into blocks of equal load, whose scatter gives its error."""
    if len(np.unique(trial)) > 1:
        return fit_slope(load, response, trial)
    power = np.cumsum((load**2).sum(axis=1))
    blocks = np.minimum(power * BLOCKS_OF_A_TRIAL // power[-1], BLOCKS_OF_A_TRIAL - 1).astype(int)
    return replace(fit_slope(load, response, blocks), n_trials=1, outlying_trials=())


def _loaded(load: NDArray[Any]) -> bool:
    return len(load) > 1 and bool(np.abs(load).max() > 0)


def _held_out(
    load: NDArray[Any], response: NDArray[Any], trial: NDArray[Any], unit: str
) -> HeldOut:
    """Every trial predicted by a fit to the other folds' trials."""
    numbers = np.unique(trial)
    folds = min(len(numbers), MAX_FOLDS)
    fold = np.searchsorted(numbers, trial) % folds
    error = np.empty_like(response)
    for index in range(folds):
        out = fold == index
        k = fit_slope(load[~out], response[~out], trial[~out]).value
        error[out] = response[out] - k * load[out]
    squared = (error**2).sum(axis=1)
    by_trial = {int(n): float(np.sqrt(squared[trial == n].mean())) for n in numbers}
    rmse = float(np.sqrt(squared.mean()))
    size = float(np.sqrt((response**2).sum(axis=1).mean()))
    return HeldOut(rmse, rmse / size, unit, MappingProxyType(by_trial), folds)


def _own_noise(residual: NDArray[Any], trial: NDArray[Any]) -> float:
    """Robust noise of a sample, all components: second differences know no slow course."""
    bends = residual[:-2] - 2.0 * residual[1:-1] + residual[2:]
    _, index, counts = np.unique(trial, return_inverse=True, return_counts=True)
    long = counts[index] >= MIN_SAMPLES_FOR_NOISE
    bends = bends[(trial[:-2] == trial[2:]) & long[1:-1]]
    if not len(bends):
        return float("nan")
    by_component = 1.4826 * np.median(np.abs(bends), axis=0) / np.sqrt(6.0)
    return float(np.sqrt((by_component**2).sum()))

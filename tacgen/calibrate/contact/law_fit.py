"""The contact law of a press log: k_n, k_s, whether indenters agree, and the held-out error.

``summary_dict`` is all of it as data, ``summary_text`` for a terminal.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from scipy.special import fdtrc

from tacgen.calibrate.contact.align import ContactPoint, align, limits_of, without_zero
from tacgen.calibrate.contact.rules import RULES
from tacgen.calibrate.contact.slope_fit import SlopeFit, fit_slope
from tacgen.contact.law import PLAIN_UNITS, ContactLaw
from tacgen.contact.noise import sample_noise
from tacgen.core.errors import PressError
from tacgen.core.records import Estimate
from tacgen.core.resources import versions
from tacgen.core.types import FloatArray, IntArray
from tacgen.presses.press_log import SHEAR_FORCES, SHEAR_MOTIONS, PressLog
from tacgen.report.formatting import p_value, percent, unit_text
from tacgen.report.page import templates

SYMBOLS = {"normal": "k_n", "shear": "k_s"}


@dataclass(frozen=True, slots=True)
class Agreement:
    """Welch's test that all groups share one k: the law does not depend on them."""

    p_value: float
    spread: float  # (largest − smallest k) / pooled k


@dataclass(frozen=True, slots=True)
class HeldOut:
    """Error on held-out trials, by number too; ``nrmse`` is per RMS of what was measured.

    Both are of one component, so that shear's are of one axis, as in a diagnosis.
    """

    rmse: float
    nrmse: float
    unit: str
    folds: int
    by_trial: dict[str, float]


@dataclass(frozen=True, slots=True)
class ChannelFit:
    """One channel's compliance: pooled, by group, and its error on held-out trials."""

    channel: str
    pooled: SlopeFit
    by: str
    groups: Mapping[str, SlopeFit]
    agreement: Agreement | None
    held_out: HeldOut
    noise: float
    """Standard deviation of a sample's own noise, from how the residual jumps in time."""


@dataclass(frozen=True, slots=True)
class ContactFit:
    """The contact law of a press log."""

    log: PressLog  # the samples that were fitted, contact points shifted where they were free
    normal: ChannelFit
    shear: ChannelFit | None
    contact_points: tuple[ContactPoint, ...]
    warnings: tuple[str, ...] = ()

    @property
    def law(self) -> ContactLaw:
        """The linear law of the pooled fits."""
        estimates = {"normal": Estimate(1.0), "shear": Estimate(np.nan, np.nan, "mm/N")}
        for one in self.channels:
            unit = PLAIN_UNITS[one.channel][1]
            estimates[one.channel] = Estimate(one.pooled.value, one.pooled.stderr, unit)
        return ContactLaw(
            "volume_linear",
            estimates["normal"],
            estimates["shear"],
            self.log.marker_pitch_mm,
            provenance=_provenance(self),
        )

    @property
    def channels(self) -> tuple[ChannelFit, ...]:
        """The channels that were fitted."""
        return (self.normal,) if self.shear is None else (self.normal, self.shear)


def fit_contact(
    log: PressLog,
    *,
    by: str | None = None,
    free_contact_point: bool | None = None,
) -> ContactFit:
    """Fit V = k_n F_n and D = k_s F_s to a press log.

    ``by`` is ``trial`` or a column whose values are compared with each other; by default
    ``indenter`` where there are several, else the first text covariate that splits the trials.
    ``free_contact_point`` is as for ``align``; where no contact points are fitted, what gauge and
    gel read at rest is subtracted. Raises ``PressError`` with fewer than three presses, unless they
    have depths, an unknown column, or a response that does not grow with the load.

    Source: Si et al. 2022, arXiv 2208.02885, Eq. 1.
    """
    if len(log.trials) < RULES.min_trials and "depth_mm" not in log:
        left_out = [str(trial) for trial in log.dropped]
        msg = (
            f"{log.path}: {len(log.trials)} usable presses, fewer than {RULES.min_trials}: no "
            "interval and no held-out error can be given; press more often, number each press in "
            "`trial`"
        )
        raise PressError.from_problems([msg, *left_out])
    log, points = align(log, free_contact_point=free_contact_point)
    if len(points) < len(log.trials):
        log = without_zero(log)
    by = _grouping(log, by)
    normal = fit_channel(log, "normal", by, points)
    sheared = log.with_shear() if log.has_shear else None
    shear = None
    if (
        sheared is not None
        and len(sheared.trials) >= RULES.min_trials
        and all(np.abs(values).max() > 0 for values in channel_arrays(sheared, "shear"))
    ):
        shear = fit_channel(sheared, "shear", by)
    fit = ContactFit(log, normal, shear, points)
    return replace(fit, warnings=_warnings(fit))


def fit_channel(
    log: PressLog, channel: str, by: str, points: Sequence[ContactPoint] = ()
) -> ChannelFit:
    """Pooled and grouped compliance of the ``normal`` or ``shear`` channel.

    Contact ``points`` that were fitted make the compliance of a single trial less certain.
    """
    load, response = channel_arrays(log, channel)
    trial = log["trial"]
    share = log.volume_stderr_share if channel == "normal" else 0.0
    pooled = _with_contact_point(linear_slope(load, response, trial, share), trial[0], points)
    if not pooled.value > 0:
        unit = unit_text(PLAIN_UNITS[channel][1])
        msg = (
            f"{log.path}: the {channel} response does not grow with the load (k = "
            f"{pooled.value:.3g} {unit}); check the signs of force and "
            f"{'volume' if channel == 'normal' else 'marker motion'}"
        )
        raise PressError(msg)
    groups = {}
    for name in np.unique(log[by]):
        rows = log[by] == name
        if rows.sum() > 1 and np.abs(load[rows]).max() > 0:
            group = _with_contact_point(
                linear_slope(load[rows], response[rows], trial[rows]), trial[rows][0], points
            )
            groups[str(name)] = group
    return ChannelFit(
        channel,
        pooled,
        by,
        groups,
        agreement_of(groups, pooled.value),
        _held_out(load, response, trial, PLAIN_UNITS[channel][0]),
        _own_noise(response - pooled.value * load, trial),
    )


def channel_arrays(log: PressLog, channel: str) -> tuple[FloatArray, FloatArray]:
    """Load and response (N, c) of a channel."""
    if channel == "normal":
        return log["force_normal_n"][:, None], log["volume_mm3"][:, None]
    return (
        np.column_stack([log[name] for name in SHEAR_FORCES]),
        np.column_stack([log[name] for name in SHEAR_MOTIONS]),
    )


def agreement_of(groups: Mapping[str, SlopeFit], pooled: float) -> Agreement | None:
    """Welch's test over the groups; None where fewer than two have an error of their own.

    Source: Welch 1951, On the comparison of several mean values, Biometrika 38.
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
    p = float(fdtrc(n - 1, dof_within, statistic))
    return Agreement(p, float(np.ptp(k) / pooled))


def _with_contact_point(fit: SlopeFit, trial: int, points: Sequence[ContactPoint]) -> SlopeFit:
    """The fit with the error that the contact point of a single trial puts on it."""
    least = max((p.k_stderr_share for p in points if p.trial == trial), default=0.0)
    return replace(fit, stderr=max(fit.stderr, least * fit.value)) if fit.n_trials == 1 else fit


def linear_slope(
    load: FloatArray, response: FloatArray, trial: IntArray, volume_stderr_share: float = 0.0
) -> SlopeFit:
    """The compliance without effects: k_n or k_s, with its error, of every command and page.

    ``volume_stderr_share`` is an error of all volumes alike, which presses' scatter does not show.
    """
    parts = _parts(load, trial)
    fit = fit_slope(load, response, parts)
    if parts is not trial:
        fit = replace(fit, n_trials=1, outlying_trials=())
    return replace(fit, stderr=math.hypot(fit.stderr, volume_stderr_share * fit.value))


def _parts(load: FloatArray, trial: IntArray) -> IntArray:
    """Trials (N,), or of a single one blocks of equal load, whose scatter gives its error."""
    if len(np.unique(trial)) > 1:
        return trial
    power = np.cumsum((load**2).sum(axis=1))
    blocks = np.minimum(power * RULES.parts_of_a_trial // power[-1], RULES.parts_of_a_trial - 1)
    return np.asarray(blocks, dtype=np.int64)


def _held_out(load: FloatArray, response: FloatArray, trial: IntArray, unit: str) -> HeldOut:
    """Every trial, or part of a single one, predicted by a fit to the other folds'."""
    parts = _parts(load, trial)
    numbers, first, index = np.unique(parts, return_index=True, return_inverse=True)
    folds = min(len(numbers), RULES.max_folds)
    fold = np.argsort(np.argsort(first))[index] % folds  # in the order of pressing
    error = np.empty_like(response)
    for k_th in range(folds):
        out = fold == k_th
        k = fit_slope(load[~out], response[~out], parts[~out]).value
        error[out] = response[out] - k * load[out]
    squared = (error**2).mean(axis=1)
    by_trial = {str(n): float(np.sqrt(squared[trial == n].mean())) for n in np.unique(trial)}
    rmse = float(np.sqrt(squared.mean()))
    size = float(np.sqrt((response**2).mean()))
    return HeldOut(rmse, rmse / size, unit, folds, by_trial)


def _own_noise(residual: FloatArray, trial: IntArray) -> float:
    """Noise of a sample, of one component, where presses are long enough to tell it."""
    _, index, counts = np.unique(trial, return_inverse=True, return_counts=True)
    kept = counts[index] >= RULES.min_samples_for_noise
    starts = np.flatnonzero(np.diff(trial[kept], prepend=np.nan, append=np.nan) != 0)
    return sample_noise(residual[kept], starts)


def _grouping(log: PressLog, by: str | None) -> str:
    if by is not None and by not in log:
        msg = f"{log.path}: no column {by!r} to group by; there are {', '.join(log.columns)}"
        raise PressError(msg)
    if by is not None:
        return by
    for name in ("indenter", *log.covariates):
        if name in log and log[name].dtype.kind == "U":
            values = len(np.unique(log[name]))
            pairs = len({*zip(log[name].tolist(), log["trial"].tolist(), strict=True)})
            if 1 < values <= len(log.trials) and pairs == len(log.trials):
                return name
    return "indenter" if "indenter" in log else "trial"


def _warnings(fit: ContactFit) -> tuple[str, ...]:
    texts = [*fit.log.warnings, *(str(trial) for trial in fit.log.dropped)]
    for channel in fit.channels:
        agreement = channel.agreement
        if agreement is not None and agreement.p_value < RULES.disagreement_p:
            texts.append(
                f"{fit.log.path}: {channel.channel}: k differs between values of {channel.by!r} "
                f"(p = {agreement.p_value:.2g}, spread {100 * agreement.spread:.1f} %): the pooled "
                "k averages presses that differ; `tacgen diagnose contact` looks for the cause"
            )
        held_out, unit = channel.held_out.rmse, unit_text(channel.held_out.unit)
        if held_out > RULES.structure_factor * channel.noise > 0:
            texts.append(
                f"{fit.log.path}: {channel.channel}: the linear law is off by {held_out:.3g} "
                f"{unit} on held-out presses, samples jitter by {channel.noise:.3g} {unit}: an "
                "effect is missing; `tacgen diagnose contact` looks for it"
            )
        for trial in channel.pooled.outlying_trials:
            row = fit.log.rows[fit.log["trial"] == trial][0]
            texts.append(
                f"{fit.log.path}: row {row}: trial {trial} lies far from the others' "
                f"{channel.channel} law and was given no weight; look at it or delete it"
            )
    texts += [f"{fit.log.path}: {limit}" for limit in limits_of(fit.log)]
    return tuple(texts)


def _provenance(fit: ContactFit) -> dict[str, Any]:
    held_out = {one.channel: asdict(one.held_out) for one in fit.channels}
    for error in held_out.values():
        del error["by_trial"]
    return {
        "data": {fit.log.path.name: fit.log.sha256},
        "versions": versions("numpy", "scipy"),
        "trials": {"fit": len(fit.log.trials), "left_out": len(fit.log.dropped)},
        "samples": len(fit.log),
        "contact_point": "free" if fit.contact_points else "fixed",
        "held_out_error": held_out,
        "warnings": list(fit.warnings),
    }


def summary_dict(fit: ContactFit) -> dict[str, Any]:
    """The result as plain data: what ``--json`` prints and the page shows."""
    limits = limits_of(fit.log)
    return {
        "channels": {channel.channel: _channel_dict(channel) for channel in fit.channels},
        "contact_points": [asdict(point) for point in fit.contact_points],
        "trials": {"fit": len(fit.log.trials), "left_out": len(fit.log.dropped)},
        "left_out": [
            {key: getattr(trial, key) for key in ("trial", "rows", "reason", "fix")}
            for trial in fit.log.dropped
        ],
        "warnings": list(fit.warnings),
        "cannot_tell": [limit.cannot_tell for limit in limits],
        "press_next": [limit.press_next for limit in limits],
    }


def _channel_dict(channel: ChannelFit) -> dict[str, Any]:
    agreement = channel.agreement
    return {
        SYMBOLS[channel.channel]: channel.pooled.summary(),
        "unit": PLAIN_UNITS[channel.channel][1],
        "by": channel.by,
        "groups": {name: group.summary() for name, group in channel.groups.items()},
        "agreement": agreement and {"p_value": agreement.p_value, "spread": agreement.spread},
        "held_out": asdict(channel.held_out),
    }


def summary_text(result: Mapping[str, Any]) -> str:
    """The result of ``summary_dict`` in a few lines for a terminal."""
    template = templates(escaped=False).get_template("contact_calibration.txt")
    return template.render(
        result=result,
        symbols=SYMBOLS,
        most_groups=RULES.max_groups_shown,
        half_width=half_width,
        agreement_text=agreement_text,
    ).rstrip()


def half_width(slope: Mapping[str, Any]) -> float | None:
    """Half of a compliance's 95 % interval; None where it has no error."""
    return None if slope["stderr"] is None else 1.96 * float(slope["stderr"])


def agreement_text(name: str, channel: Mapping[str, Any]) -> str:
    """Whether the groups share one compliance, in one sentence."""
    symbol, by, agreement = SYMBOLS[name], channel["by"], channel["agreement"]
    if agreement is None:
        return f"whether {symbol} depends on {by} is unknown: only one group has an error"
    verdict = "agree on" if agreement["p_value"] >= RULES.disagreement_p else "do not agree on"
    return (
        f"the values of {by} {verdict} one {symbol} (Welch p = {p_value(agreement['p_value'])}, "
        f"largest difference {percent(agreement['spread'], 2)})"
    )

"""The contact law of a press log: k_n, k_s, whether indenters agree, and the held-out error."""

from __future__ import annotations

import platform
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np
import scipy

from tacgen import __version__
from tacgen.calibrate.contact.channel_fit import ChannelFit, channel_arrays, fit_channel
from tacgen.calibrate.contact.contact_point import ContactPoint, free_contact_points
from tacgen.calibrate.contact.identifiability import limits_of
from tacgen.contact.law import ContactLaw
from tacgen.core.errors import PressError
from tacgen.core.records import Estimate
from tacgen.presses.press_log import PressLog

MIN_TRIALS = 3
DISAGREEMENT_P = 0.01
STRUCTURE_FACTOR = 1.5
"""Held-out errors this many times a sample's own noise are no noise."""


@dataclass(frozen=True, slots=True)
class ContactFit:
    """What a press log says about the contact law."""

    log: PressLog
    """The samples that were fitted, contact points shifted where they were free."""
    normal: ChannelFit
    shear: ChannelFit | None
    contact_points: tuple[ContactPoint, ...]
    marker_pitch_mm: float
    warnings: tuple[str, ...] = field(default_factory=tuple)

    @property
    def law(self) -> ContactLaw:
        """The linear law of the pooled fits."""
        k_s = self.shear.pooled if self.shear else None
        return ContactLaw(
            law="volume_linear",
            k_n_mm3_per_n=Estimate(self.normal.pooled.value, self.normal.pooled.stderr, "mm3/N"),
            k_s_mm_per_n=Estimate(
                k_s.value if k_s else np.nan, k_s.stderr if k_s else np.nan, "mm/N"
            ),
            marker_pitch_mm=self.marker_pitch_mm,
            provenance=MappingProxyType(_provenance(self)),
        )


def fit_contact(
    log: PressLog,
    *,
    by: str | None = None,
    free_contact_point: bool | None = None,
    marker_pitch_mm: float = np.nan,
) -> ContactFit:
    """Fit V = k_n F_n and D = k_s F_s to a press log.

    Parameters
    ----------
    log : PressLog
    by : str, optional
        ``trial`` or a column whose values are compared with each other; by default ``indenter``
        where there are several, else the first text covariate that splits the trials.
    free_contact_point : bool, optional
        Estimate the contact point of every trial. By default only where the volume was computed
        from the depth of a known ball, whose zero is then what is least certain.
    marker_pitch_mm : float
        Pitch of the markers whose motion was summed.

    Raises
    ------
    PressError
        With fewer than three presses, an unknown column, or a response that does not grow with
        the load.

    Source
    ------
    Si et al. 2022, arXiv 2208.02885, Eq. 1.
    """
    if len(log.trials) < MIN_TRIALS:
        left_out = [str(trial) for trial in log.dropped]
        msg = (
            f"{log.path}: {len(log.trials)} presses that can be used, fewer than {MIN_TRIALS}: no "
            "interval and no held-out error can be given; press more often, number each press in "
            "`trial`"
        )
        raise PressError.from_problems([msg, *left_out])
    if free_contact_point is None:
        free_contact_point = "depth_mm" in log and "radius_mm" in log
    points: tuple[ContactPoint, ...] = ()
    if free_contact_point:
        log, points = free_contact_points(log)
    by = _grouping(log, by)
    normal = fit_channel(log, "normal", by)
    sheared = log.with_shear() if log.has_shear else None
    shear = None
    if sheared is not None and len(sheared.trials) >= MIN_TRIALS and _is_sheared(sheared):
        shear = fit_channel(sheared, "shear", by)
    fit = ContactFit(log, normal, shear, points, marker_pitch_mm)
    return replace(fit, warnings=_warnings(fit))


def _is_sheared(log: PressLog) -> bool:
    load, response = channel_arrays(log, "shear")
    return bool(np.abs(load).max() > 0 and np.abs(response).max() > 0)


def _grouping(log: PressLog, by: str | None) -> str:
    if by is not None:
        if by not in log:
            msg = f"{log.path}: no column {by!r} to group by; there are {', '.join(log.columns)}"
            raise PressError(msg)
        return by
    candidates = ["indenter", *log.covariates]
    for name in candidates:
        if name in log and log[name].dtype.kind == "U":
            values = len(np.unique(log[name]))
            pairs = len({*zip(log[name].tolist(), log["trial"].tolist(), strict=True)})
            if 1 < values <= len(log.trials) and pairs == len(log.trials):
                return name
    return "indenter" if "indenter" in log else "trial"


def _warnings(fit: ContactFit) -> tuple[str, ...]:
    texts = [*fit.log.warnings, *(str(trial) for trial in fit.log.dropped)]
    for channel in (fit.normal, fit.shear):
        if channel is None:
            continue
        agreement = channel.agreement
        if agreement is not None and agreement.p_value < DISAGREEMENT_P:
            texts.append(
                f"{fit.log.path}: {channel.channel}: k differs between values of {channel.by!r} "
                f"(p = {agreement.p_value:.2g}, spread {100 * agreement.spread:.1f} %): the pooled "
                "k is an average of unlike things; `tacgen diagnose contact` looks for the cause"
            )
        held_out, unit = channel.held_out.rmse, channel.held_out.unit
        if held_out > STRUCTURE_FACTOR * channel.noise > 0:
            texts.append(
                f"{fit.log.path}: {channel.channel}: the linear law is off by {held_out:.3g} "
                f"{unit} on unseen presses, samples jitter by {channel.noise:.3g} {unit}: an "
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
    channels = {c.channel: c for c in (fit.normal, fit.shear) if c is not None}
    return {
        "data": {fit.log.path.name: fit.log.sha256},
        "versions": {
            "tacgen": __version__,
            "numpy": np.__version__,
            "scipy": scipy.__version__,
            "python": platform.python_version(),
        },
        "trials": {"fit": len(fit.log.trials), "left_out": len(fit.log.dropped)},
        "left_out": [str(trial) for trial in fit.log.dropped],
        "samples": len(fit.log),
        "contact_point": "free" if fit.contact_points else "fixed",
        "held_out_error": {
            name: {"rmse": c.held_out.rmse, "nrmse": c.held_out.nrmse, "unit": c.held_out.unit,
                   "folds": c.held_out.folds}
            for name, c in channels.items()
        },
        "groups": {name: _group_summary(c) for name, c in channels.items()},
        "warnings": list(fit.warnings),
    }  # fmt: skip


def _group_summary(channel: ChannelFit) -> dict[str, Any]:
    agreement = channel.agreement
    return {
        "by": channel.by,
        "agree_p_value": agreement.p_value if agreement else None,
        "values": {
            name: {"value": fit.value, "stderr": fit.stderr, "trials": fit.n_trials,
                   "r_squared": fit.r_squared}
            for name, fit in channel.groups.items()
        },
    }  # fmt: skip

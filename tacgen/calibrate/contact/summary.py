"""The result of a contact calibration as text and as data."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.calibrate.contact.depth_curves import RADII_MM, BallFit, DepthReport
from tacgen.calibrate.contact.identifiability import limits_of
from tacgen.calibrate.contact.law_fit import PLAIN_UNITS, ChannelFit, ContactFit
from tacgen.calibrate.contact.slope_fit import SlopeFit
from tacgen.report.formatting import interval, number, p_value, percent, unit_text, with_error

SYMBOLS = {"normal": "k_n", "shear": "k_s"}
AGREEMENT_LEVEL = 0.05
"""Welch's p below which groups are said to differ."""
MAX_GROUPS_SHOWN = 12
"""Groups that a terminal's text lists; the page has all."""
SYSTEMATIC_CORRELATION = 0.5
"""Correlation of neighbouring residuals above which they are shape, not noise."""


def summary_dict(fit: ContactFit) -> dict[str, Any]:
    """The result as plain data: what ``--json`` prints and the page shows."""
    channels = {c.channel: _channel_dict(c) for c in (fit.normal, fit.shear) if c is not None}
    limits = limits_of(fit.log)
    return {
        "channels": channels,
        "contact_points": [
            {"trial": p.trial, "depth_mm": p.depth_mm, "force_n": p.force_n}
            for p in fit.contact_points
        ],
        "trials": {"fit": len(fit.log.trials), "left_out": len(fit.log.dropped)},
        "left_out": [
            {"trial": t.trial, "rows": list(t.rows), "reason": t.reason, "fix": t.fix}
            for t in fit.log.dropped
        ],
        "warnings": list(fit.warnings),
        "cannot_tell": [limit.cannot_tell for limit in limits],
        "press_next": [limit.press_next for limit in limits],
    }


def _channel_dict(channel: ChannelFit) -> dict[str, Any]:
    agreement, held = channel.agreement, channel.held_out
    return {
        SYMBOLS[channel.channel]: _slope_dict(channel.pooled),
        "unit": PLAIN_UNITS[channel.channel][1],
        "by": channel.by,
        "groups": {name: _slope_dict(group) for name, group in channel.groups.items()},
        "agreement": None
        if agreement is None
        else {"p_value": agreement.p_value, "spread": agreement.spread},
        "held_out": {
            "rmse": held.rmse,
            "nrmse": held.nrmse,
            "unit": held.unit,
            "folds": held.folds,
            "by_trial": {str(k): v for k, v in held.by_trial.items()},
        },
    }


def _slope_dict(fit: SlopeFit) -> dict[str, Any]:
    return {
        "value": fit.value,
        "stderr": fit.stderr if np.isfinite(fit.stderr) else None,
        "interval": list(fit.interval) if np.isfinite(fit.stderr) else None,
        "r_squared": fit.r_squared,
        "trials": fit.n_trials,
        "samples": fit.n_samples,
        "outliers": fit.outliers,
    }


def summary_text(result: Mapping[str, Any]) -> str:
    """The result of ``summary_dict`` in a few lines for a terminal."""
    lines = []
    for name, channel in result["channels"].items():
        symbol, unit = SYMBOLS[name], unit_text(channel["unit"])
        pooled, held = channel[symbol], channel["held_out"]
        ends = pooled["interval"] or (None, None)
        lines.append(
            f"{symbol} = {number(pooled['value'], 5)} {unit}, 95 % interval {interval(ends)}, "
            f"{pooled['trials']} presses, {pooled['samples']} samples, "
            f"{pooled['outliers']} outliers"
        )
        lines.append(
            f"  held-out presses: RMSE {number(held['rmse'])} {unit_text(held['unit'])} "
            f"({percent(held['nrmse'], 2)} of the RMS response)"
        )
        lines += [
            f"  {channel['by']} {group}: {with_error(one['value'], half_width(one))} {unit}, "
            f"R² {one['r_squared']:.5f}, {one['trials']} presses"
            for group, one in list(channel["groups"].items())[:MAX_GROUPS_SHOWN]
        ]
        lines.append(f"  {agreement_text(name, channel)}")
    if result["contact_points"]:
        lines.append("contact points were free; the report lists depth and force zeros by trial")
    return "\n".join(lines)


def half_width(slope: Mapping[str, Any]) -> float | None:
    """Half of a compliance's 95 % interval; None where it has no error."""
    return None if slope["stderr"] is None else 1.96 * float(slope["stderr"])


def agreement_text(name: str, channel: Mapping[str, Any]) -> str:
    """Whether the groups share one compliance, in one sentence."""
    symbol, by, agreement = SYMBOLS[name], channel["by"], channel["agreement"]
    if agreement is None:
        return f"whether {symbol} depends on {by} is unknown: only one group has an error"
    verdict = "agree on" if agreement["p_value"] >= AGREEMENT_LEVEL else "do not agree on"
    return (
        f"the values of {by} {verdict} one {symbol} (Welch p = {p_value(agreement['p_value'])}, "
        f"largest difference {percent(agreement['spread'], 2)})"
    )


def depth_dict(report: DepthReport) -> dict[str, Any]:
    """The result as plain data."""
    return {
        "curves": {fit.name: _curve_dict(fit, report) for fit in report.curves},
        "shared_k_n": report.shared_k_n_mm3_per_n,
        "one_k_n_will_do": report.one_k_n_will_do,
        "p_value": report.p_value,
    }


def _curve_dict(fit: BallFit, report: DepthReport) -> dict[str, Any]:
    return {
        "radius_mm": fit.radius_mm,
        "radius_interval_mm": list(fit.radius_interval_mm),
        "k_n": fit.k_n_mm3_per_n,
        "k_interval": list(fit.k_interval),
        "contact_point_mm": fit.contact_point_mm,
        "r_squared": fit.r_squared,
        "rmse_n": fit.rmse_n,
        "log_log_exponent": fit.exponent,
        "residual_correlation": fit.waviness,
        "samples": fit.n_samples,
        "with_shared_k_n": {
            "radius_mm": report.shared_radius_mm[fit.name],
            "rmse_n": report.shared_rmse_n[fit.name],
        },
    }


def depth_text(result: Mapping[str, Any]) -> str:
    """The result of ``depth_dict`` in a few lines for a terminal; the last is the verdict."""
    lines = []
    several = len(result["curves"]) > 1
    for name, fit in result["curves"].items():
        lines += [
            f"{name}: ball of radius {number(fit['radius_mm'], 3)} mm, 95 % interval "
            f"{interval(fit['radius_interval_mm'])}; k_n = {number(fit['k_n'], 3)} mm³/N, "
            f"{interval(fit['k_interval'])}; contact {number(-fit['contact_point_mm'], 3)} mm "
            "along the depth axis",
            f"  R² {fit['r_squared']:.5f}, RMSE {number(fit['rmse_n'], 3)} N over "
            f"{fit['samples']} samples; log-log exponent {fit['log_log_exponent']:.2f}",
        ]
        if several:
            shared = fit["with_shared_k_n"]
            lines.append(
                f"  with the shared k_n: radius {number(shared['radius_mm'], 3)} mm, RMSE "
                f"{number(shared['rmse_n'], 3)} N"
            )
    if several:
        verdict = "explains" if result["one_k_n_will_do"] else "does not explain"
        lines.append(
            f"one constant k_n = {number(result['shared_k_n'], 3)} mm³/N {verdict} all curves "
            f"(F test, p = {p_value(result['p_value'])})"
        )
    return "\n".join(lines)


def depth_warnings(path: Path, report: DepthReport) -> tuple[str, ...]:
    """What the reader has to know before using the law."""
    texts = [
        f"{path}: depths and no volumes: the volume is that of a ball whose radius was fitted with "
        "k_n, and a radius and k_n that grow together fit almost as well; measure the ball or "
        "log volume_mm3"
    ]
    for fit in report.curves:
        if fit.radius_interval_mm[1] >= 0.99 * RADII_MM[1]:
            texts.append(f"{path}: curve {fit.name}: the radius has no upper bound")
        if fit.waviness > SYSTEMATIC_CORRELATION:
            texts.append(
                f"{path}: curve {fit.name}: neighbouring residuals correlate by "
                f"{fit.waviness:.2f}, so the residual is not noise: this was not exactly a ball "
                "on a linear gel, and the intervals are too narrow"
            )
    if not report.one_k_n_will_do:
        texts.append(
            f"{path}: one constant k_n does not explain these curves; contact.yaml holds the best "
            "shared one with an error as wide as the curves are apart"
        )
    return tuple(texts)

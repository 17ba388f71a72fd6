"""What a contact calibration says, in words and as data."""

from __future__ import annotations

from typing import Any

import numpy as np

from tacgen.calibrate.contact.channel_fit import PLAIN_UNITS, ChannelFit
from tacgen.calibrate.contact.identifiability import limits_of
from tacgen.calibrate.contact.law_fit import ContactFit
from tacgen.calibrate.contact.slope_fit import SlopeFit

SYMBOLS = {"normal": "k_n", "shear": "k_s"}
UNITS = {"normal": ("mm³", "mm³/N"), "shear": ("mm", "mm/N")}
"""Of the response and of the compliance, as people write them."""


def summary_dict(fit: ContactFit) -> dict[str, Any]:
    """The result as plain data, for ``--json``."""
    channels = {c.channel: _channel_dict(c) for c in (fit.normal, fit.shear) if c is not None}
    return {
        "channels": channels,
        "contact_points": [
            {"trial": p.trial, "depth_mm": p.depth_mm, "force_n": p.force_n}
            for p in fit.contact_points
        ],
        "trials": {"fit": len(fit.log.trials), "left_out": len(fit.log.dropped)},
        "left_out": [
            {"trial": t.trial, "rows": list(t.rows), "reason": t.reason, "mend": t.mend}
            for t in fit.log.dropped
        ],
        "warnings": list(fit.warnings),
        "press_next": [limit.press_next for limit in limits_of(fit.log)],
    }


def _channel_dict(channel: ChannelFit) -> dict[str, Any]:
    agreement = channel.agreement
    return {
        SYMBOLS[channel.channel]: _slope_dict(channel.pooled),
        "unit": PLAIN_UNITS[channel.channel][1],
        "by": channel.by,
        "groups": {name: _slope_dict(group) for name, group in channel.groups.items()},
        "agreement": None
        if agreement is None
        else {"p_value": agreement.p_value, "spread": agreement.spread},
        "held_out": {
            "rmse": channel.held_out.rmse,
            "nrmse": channel.held_out.nrmse,
            "unit": channel.held_out.unit,
            "by_trial": {str(k): v for k, v in channel.held_out.by_trial.items()},
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


def summary_text(fit: ContactFit) -> str:
    """The result in a few lines for a terminal."""
    lines = []
    for channel in (fit.normal, fit.shear):
        if channel is None:
            continue
        symbol, unit = SYMBOLS[channel.channel], UNITS[channel.channel][1]
        pooled, held = channel.pooled, channel.held_out
        low, high = pooled.interval
        lines.append(
            f"{symbol} = {pooled.value:.5g} {unit}, 95 % in [{low:.5g}, {high:.5g}], "
            f"{pooled.n_trials} presses, {pooled.n_samples} samples, {pooled.outliers} outliers"
        )
        lines.append(
            f"  held out by trial: RMSE {held.rmse:.4g} {UNITS[channel.channel][0]} "
            f"({100 * held.nrmse:.2f} % of the RMS response)"
        )
        lines += [
            f"  {channel.by} {name}: {group.value:.5g} ± {1.96 * group.stderr:.2g} {unit}, "
            f"R² {group.r_squared:.5f}, {group.n_trials} presses"
            for name, group in list(channel.groups.items())[:12]
        ]
        lines.append(f"  {agreement_words(channel)}")
    if fit.contact_points:
        lines.append("contact points were free; depth and force zeros by trial stand in the report")
    return "\n".join(lines)


def agreement_words(channel: ChannelFit) -> str:
    """Whether the groups share one compliance, in one sentence."""
    symbol, agreement = SYMBOLS[channel.channel], channel.agreement
    if agreement is None:
        return f"whether {symbol} depends on {channel.by} cannot be told: only one can be judged"
    verdict = "agree on" if agreement.p_value >= 0.05 else "do not agree on"
    return (
        f"the values of {channel.by} {verdict} one {symbol} (Welch p = {agreement.p_value:.3g}, "
        f"largest difference {100 * agreement.spread:.2f} %)"
    )

"""The result of a contact calibration as text and as data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tacgen.calibrate.contact.depth_curves import RADII_MM, DepthReport
from tacgen.calibrate.contact.identifiability import limits_of
from tacgen.calibrate.contact.law_fit import PLAIN_UNITS, ChannelFit, ContactFit
from tacgen.report.formatting import p_value, percent
from tacgen.report.page import templates

SYMBOLS = {"normal": "k_n", "shear": "k_s"}
AGREEMENT_LEVEL = 0.05
"""Welch's p below which groups are said to differ."""
MAX_GROUPS_SHOWN = 12
"""Groups that a terminal's text lists; the page has all."""
SYSTEMATIC_CORRELATION = 0.5
"""Correlation of neighbouring residuals above which they are shape, not noise."""


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
        most_groups=MAX_GROUPS_SHOWN,
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
    verdict = "agree on" if agreement["p_value"] >= AGREEMENT_LEVEL else "do not agree on"
    return (
        f"the values of {by} {verdict} one {symbol} (Welch p = {p_value(agreement['p_value'])}, "
        f"largest difference {percent(agreement['spread'], 2)})"
    )


def depth_text(result: Mapping[str, Any]) -> str:
    """The content of a ``DepthReport`` in a few lines for a terminal; the last is the verdict."""
    template = templates(escaped=False).get_template("depth_curves.txt")
    return template.render(result=result).rstrip()


def depth_warnings(path: Path, report: DepthReport) -> tuple[str, ...]:
    """What the reader has to know before using the law."""
    texts = [
        f"{path}: depths and no volumes: the volume is that of a ball whose radius was fitted with "
        "k_n, and a radius and k_n that grow together fit almost as well; measure the ball or "
        "log volume_mm3"
    ]
    for name, fit in report.curves.items():
        if fit.radius_interval_mm[1] >= 0.99 * RADII_MM[1]:
            texts.append(f"{path}: curve {name}: the radius has no upper bound")
        if fit.residual_correlation > SYSTEMATIC_CORRELATION:
            texts.append(
                f"{path}: curve {name}: neighbouring residuals correlate by "
                f"{fit.residual_correlation:.2f}, so the residual is not noise: this was not "
                "exactly a ball on a linear gel, and the intervals are too narrow"
            )
    if not report.one_k_n_will_do:
        texts.append(
            f"{path}: one constant k_n does not explain these curves; contact.yaml holds the best "
            "shared one with an error as wide as the curves are apart"
        )
    return tuple(texts)

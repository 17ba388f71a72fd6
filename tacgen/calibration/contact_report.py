"""What a contact calibration says, in words, as data and as a page with pictures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from tacgen.calibration.contact_law import UNITS, ChannelFit, ContactFit, channel_arrays
from tacgen.calibration.press_limits import limits_of
from tacgen.calibration.slope_fit import SlopeFit
from tacgen.report import Section, figure_section, table_section, text_section, write_page

MAX_POINTS = 20_000
"""Samples drawn in a scatter plot; more only make the page heavy."""
SYMBOLS = {"normal": "k_n", "shear": "k_s"}
RESPONSES = {"normal": "V", "shear": "D"}
COLORS = ("#1f6f8b", "#c8553d", "#588157", "#8d6a9f", "#e09f3e", "#5c677d", "#9c6644", "#2b2d42")


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
        "unit": UNITS[channel.channel][1],
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
            f"  held out by trial: RMSE {held.rmse:.4g} {held.unit} "
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


def write_report(fit: ContactFit, folder: Path) -> Path:
    """Write ``contact.html`` into ``folder``; it needs no network."""
    sections: list[Section] = []
    for channel in (fit.normal, fit.shear):
        if channel is not None:
            sections += _channel_sections(fit, channel)
    if fit.contact_points:
        sections.append(
            table_section(
                "Contact points",
                ("trial", "depth zero, mm", "force zero, N"),
                [(p.trial, p.depth_mm, p.force_n) for p in fit.contact_points],
                "Added to the logged depth, taken from the logged force.",
            )
        )
    sections.append(text_section("Warnings", *(fit.warnings or ("None.",))))
    nexts = [str(limit) for limit in limits_of(fit.log)]
    sections.append(text_section("What to press next", *(nexts or ("Nothing is missing.",))))
    path = Path(folder) / "contact.html"
    write_page(path, "Contact calibration", sections, summary=_headline(fit))
    return path


def _headline(fit: ContactFit) -> str:
    parts = [
        f"{SYMBOLS[c.channel]} = {c.pooled.value:.4g} ± {1.96 * c.pooled.stderr:.2g} "
        f"{UNITS[c.channel][1]} (95 %), held-out error {100 * c.held_out.nrmse:.2f} %"
        for c in (fit.normal, fit.shear)
        if c is not None
    ]
    return f"{fit.log.path.name}: " + "; ".join(parts) + "."


def _channel_sections(fit: ContactFit, channel: ChannelFit) -> list[Section]:
    symbol, (unit, k_unit) = SYMBOLS[channel.channel], UNITS[channel.channel]
    log = fit.log if channel.channel == "normal" else fit.log.with_shear()
    load, response = channel_arrays(log, channel.channel)
    held = channel.held_out
    worst = sorted(held.by_trial.items(), key=lambda item: -item[1])[:15]
    title = "Normal" if channel.channel == "normal" else "Shear"
    return [
        figure_section(
            f"{title}: fit and residual",
            _fit_figure(channel, load, response, log[channel.by]),
            "Left: what was measured and the pooled line. Right: what the line leaves over; a "
            "pattern here is an effect that the linear law lacks (tacgen diagnose contact).",
        ),
        figure_section(
            f"{title}: {symbol} by {channel.by}",
            _agreement_figure(channel),
            f"95 % intervals; the band is the pooled value. {agreement_words(channel)}.",
        ),
        figure_section(
            f"{title}: held out by trial",
            _held_out_figure(held.by_trial, held.rmse, unit),
            f"Each press predicted by a fit to the other folds ({held.folds} folds). RMSE "
            f"{held.rmse:.4g} {unit}, {100 * held.nrmse:.2f} % of the RMS response.",
        ),
        table_section(
            f"{title}: presses with the largest held-out error",
            ("trial", "first row", f"RMSE, {unit}"),
            [(trial, int(log.rows[log["trial"] == trial][0]), rmse) for trial, rmse in worst],
            f"k in {k_unit}; rows as a spreadsheet counts them.",
        ),
    ]


def _fit_figure(
    channel: ChannelFit, load: np.ndarray, response: np.ndarray, group: np.ndarray
) -> Figure:
    symbol, unit = RESPONSES[channel.channel], UNITS[channel.channel][0]
    load, response, group = _drawn(load, response, group)
    step = max(1, len(load) // MAX_POINTS)
    load, response, group = load[::step], response[::step], group[::step]
    figure = Figure(figsize=(10.5, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    for name, color in _colors(channel.groups).items():
        rows = group.astype(str) == name
        label = name if len(channel.groups) <= len(COLORS) else None
        left.plot(load[rows], response[rows], ".", ms=2.5, alpha=0.4, color=color, label=label)
        residual = response[rows] - channel.pooled.value * load[rows]
        right.plot(load[rows], residual, ".", ms=2.5, alpha=0.4, color=color)
    ends = np.array([load.min(), load.max()])
    left.plot(ends, channel.pooled.value * ends, color="#111111", lw=1.2, label="pooled fit")
    right.axhline(0.0, color="#111111", lw=1.0)
    for axes, what in ((left, symbol), (right, f"{symbol} − {SYMBOLS[channel.channel]} F")):
        axes.set_xlabel("force, N")
        axes.set_ylabel(f"{what}, {unit.replace('mm3', 'mm³')}")
    left.legend(frameon=False, markerscale=4, fontsize=8)
    return figure


def _drawn(
    load: np.ndarray, response: np.ndarray, group: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Components one after the other: x and y of the shear share one line."""
    return load.T.ravel(), response.T.ravel(), np.tile(group, load.shape[1])


def _agreement_figure(channel: ChannelFit) -> Figure:
    names = list(channel.groups)
    figure = Figure(figsize=(7.5, 0.6 + 0.32 * max(3, len(names))), layout="constrained")
    axes = figure.subplots()
    low, high = channel.pooled.interval
    axes.axvspan(low, high, color="#1f6f8b", alpha=0.18, lw=0)
    axes.axvline(channel.pooled.value, color="#1f6f8b", lw=1.0)
    for index, name in enumerate(names):
        group = channel.groups[name]
        half = 1.96 * group.stderr if np.isfinite(group.stderr) else 0.0
        axes.errorbar(group.value, index, xerr=half, fmt="o", ms=4, color="#111111", capsize=3)
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_xlabel(f"{SYMBOLS[channel.channel]}, {UNITS[channel.channel][1]}")
    return figure


def _held_out_figure(by_trial: Mapping[int, float], rmse: float, unit: str) -> Figure:
    figure = Figure(figsize=(9.5, 2.8), layout="constrained")
    axes = figure.subplots()
    axes.bar(range(len(by_trial)), list(by_trial.values()), color="#1f6f8b", width=0.8)
    axes.axhline(rmse, color="#c8553d", lw=1.2)
    axes.set_xlabel("press, in the order of trial numbers")
    axes.set_ylabel(f"RMSE, {unit.replace('mm3', 'mm³')}")
    return figure


def _colors(groups: Mapping[str, SlopeFit]) -> dict[str, str]:
    return {name: COLORS[index % len(COLORS)] for index, name in enumerate(groups)}

"""A contact calibration as a page with pictures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from tacgen.calibrate.contact.channel_fit import ChannelFit, channel_arrays
from tacgen.calibrate.contact.identifiability import limits_of
from tacgen.calibrate.contact.law_fit import ContactFit
from tacgen.calibrate.contact.slope_fit import SlopeFit
from tacgen.calibrate.contact.summary import SYMBOLS, UNITS, agreement_words
from tacgen.report import Section, figure_section, table_section, text_section, write_page

MAX_POINTS = 20_000
"""Samples drawn in a scatter plot; more only make the page heavy."""
MAX_WORST = 8
RESPONSES = {"normal": "V", "shear": "D"}
COLORS = ("#1f6f8b", "#c8553d", "#588157", "#8d6a9f", "#e09f3e", "#5c677d", "#9c6644", "#2b2d42")


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
    warnings = [text.replace(f"{fit.log.path}: ", "") for text in fit.warnings]
    sections.append(text_section("Warnings", *(warnings or ["None."])))
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
    symbol, (unit, _) = SYMBOLS[channel.channel], UNITS[channel.channel]
    log = fit.log if channel.channel == "normal" else fit.log.with_shear()
    load, response = channel_arrays(log, channel.channel)
    held = channel.held_out
    worst = sorted(held.by_trial.items(), key=lambda item: -item[1])[:MAX_WORST]
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
            f"95 % intervals; the band is the pooled one. In short: {agreement_words(channel)}.",
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
            "Rows as a spreadsheet counts them.",
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
        axes.set_ylabel(f"{what}, {unit}")
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
    places = np.arange(len(by_trial))
    axes.bar(places, list(by_trial.values()), color="#1f6f8b", width=0.8)
    axes.axhline(rmse, color="#c8553d", lw=1.2)
    every = max(1, len(by_trial) // 24)
    axes.set_xticks(places[::every], [str(trial) for trial in by_trial][::every])
    axes.set_xlabel("trial")
    axes.set_ylabel(f"RMSE, {unit}")
    return figure


def _colors(groups: Mapping[str, SlopeFit]) -> dict[str, str]:
    return {name: COLORS[index % len(COLORS)] for index, name in enumerate(groups)}

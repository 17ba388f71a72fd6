"""The pages of a contact calibration: of a press log, and of force–depth curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from tacgen.calibrate.contact.depth_curves import DepthCurve, DepthReport
from tacgen.calibrate.contact.law_fit import ContactFit, channel_arrays
from tacgen.calibrate.contact.summary import (
    SYMBOLS,
    agreement_text,
    depth_dict,
    depth_text,
    half_width,
    summary_dict,
)
from tacgen.presses.ball import ball_volume_mm3
from tacgen.presses.press_log import PressLog
from tacgen.report import Section, figure_section, table_section, text_section, write_page
from tacgen.report import figures as plots
from tacgen.report.formatting import interval, number, percent, unit_text, with_error

MAX_WORST = 8
"""Presses in the table of the largest held-out errors."""
RESPONSES = {"normal": "V", "shear": "D"}


def write_report(fit: ContactFit, folder: Path) -> Path:
    """Write ``contact.html`` into ``folder``; it needs no network."""
    result = summary_dict(fit)
    channels = result["channels"]
    sections: list[Section] = []
    for name, channel in channels.items():
        sections += _channel_sections(name, channel, fit.log)
    if result["contact_points"]:
        points = result["contact_points"]
        sections.append(
            table_section(
                "Contact points",
                ("press", "depth zero, mm", "force zero, N"),
                [(p["trial"], p["depth_mm"], p["force_n"]) for p in points],
                "Added to the logged depth, subtracted from the logged force.",
            )
        )
    warnings = [text.replace(f"{fit.log.path}: ", "") for text in result["warnings"]]
    limits = zip(result["cannot_tell"], result["press_next"], strict=True)
    advice = [f"{cannot_tell}; {press_next}" for cannot_tell, press_next in limits]
    sections.append(text_section("Warnings", *(warnings or ["None."])))
    sections.append(text_section("What to press next", *(advice or ["Nothing is missing."])))
    path = Path(folder) / "contact.html"
    verdict = "; ".join(_verdict(name, channel) for name, channel in channels.items())
    write_page(path, "Contact calibration", sections, summary=f"{fit.log.path.name}: {verdict}.")
    return path


def _verdict(name: str, channel: Mapping[str, Any]) -> str:
    pooled = channel[SYMBOLS[name]]
    value = with_error(pooled["value"], half_width(pooled), channel["unit"])
    error = percent(channel["held_out"]["nrmse"], 2)
    return f"{SYMBOLS[name]} = {value} (95 %), error on held-out presses {error}"


def _channel_sections(name: str, channel: Mapping[str, Any], log: PressLog) -> list[Section]:
    if name == "shear":
        log = log.with_shear()
    title, symbol, by, held = name.capitalize(), SYMBOLS[name], channel["by"], channel["held_out"]
    unit, response_unit = unit_text(channel["unit"]), unit_text(held["unit"])
    groups = {symbol: channel[symbol], **channel["groups"]}
    worst = sorted(held["by_trial"].items(), key=lambda item: -item[1])[:MAX_WORST]
    return [
        figure_section(
            f"{title}: fit and residual",
            _fit_figure(name, channel, log),
            "Left: the measurement and the pooled fit. Right: the residual; a pattern in it is an "
            "effect that the linear law lacks (tacgen diagnose contact).",
        ),
        figure_section(
            f"{title}: {symbol} by {by}",
            plots.intervals(
                {
                    group: (fit["value"], half_width(fit) or 0.0)
                    for group, fit in channel["groups"].items()
                },
                (channel[symbol]["value"], half_width(channel[symbol]) or 0.0),
                f"{symbol}, {unit}",
            ),
            f"95 % intervals; the band is the pooled one: {agreement_text(name, channel)}.",
        ),
        table_section(
            f"{title}: {symbol} in numbers",
            (by, f"{symbol} ± 95 %, {unit}", "R²", "presses", "samples", "outliers"),
            [
                (
                    "all" if group == symbol else group,
                    with_error(fit["value"], half_width(fit)),
                    f"{fit['r_squared']:.5f}",
                    fit["trials"],
                    fit["samples"],
                    fit["outliers"],
                )
                for group, fit in groups.items()
            ],
        ),
        figure_section(
            f"{title}: error of held-out presses",
            plots.columns(held["by_trial"], held["rmse"], ("press", f"RMSE, {response_unit}")),
            f"Each press predicted by a fit to the other folds ({held['folds']} folds). RMSE "
            f"{number(held['rmse'])} {response_unit}, {percent(held['nrmse'], 2)} of the RMS "
            "response (line).",
        ),
        table_section(
            f"{title}: largest held-out errors",
            ("press", "first row", f"RMSE, {response_unit}"),
            [
                (trial, int(log.rows[log["trial"] == int(trial)][0]), error)
                for trial, error in worst
            ],
            "Rows as a spreadsheet counts them.",
        ),
    ]


def _fit_figure(name: str, channel: Mapping[str, Any], log: PressLog) -> Figure:
    """Components one after the other: x and y of the shear share one line."""
    load, response = channel_arrays(log, name)
    group = np.tile(log[channel["by"]].astype(str), load.shape[1])
    symbol, unit = RESPONSES[name], unit_text(channel["held_out"]["unit"])
    residual = f"{symbol} − {SYMBOLS[name]} F"
    return plots.fit_and_residual(
        load.T.ravel(), response.T.ravel(), group, channel[SYMBOLS[name]]["value"],
        ("force, N", f"{symbol}, {unit}", f"{residual}, {unit}"),
    )  # fmt: skip


def write_depth_page(
    report: DepthReport, curves: Sequence[DepthCurve], warnings: Sequence[str], folder: Path
) -> Path:
    """Write ``contact.html`` of force–depth curves into ``folder``; it needs no network."""
    result = depth_dict(report)
    path = Path(folder) / "contact.html"
    header = ("curve", "radius, mm", "95 %", "k_n, mm³/N", "95 %", "contact point, mm", "R²",
              "RMSE, N", "RMSE with one k_n, N", "log-log exponent", "samples")  # fmt: skip
    rows = [
        (name, fit["radius_mm"], interval(fit["radius_interval_mm"]), fit["k_n"],
         interval(fit["k_interval"]), fit["contact_point_mm"], f"{fit['r_squared']:.5f}",
         fit["rmse_n"], fit["with_shared_k_n"]["rmse_n"], f"{fit['log_log_exponent']:.2f}",
         fit["samples"])
        for name, fit in result["curves"].items()
    ]  # fmt: skip
    sections = [
        figure_section(
            "Force against depth",
            _depth_figure(result["curves"], curves),
            "Dots: measured. Lines: the ball and k_n that fit each curve best. Right: residual.",
        ),
        table_section("Fitted balls", header, rows, "95 %: profile intervals, all else refitted."),
        text_section("Warnings", *(text.partition(": ")[2] for text in warnings)),
    ]
    verdict = depth_text(result).splitlines()[-1].strip()
    write_page(path, "Force–depth curves", sections, summary=f"{verdict[0].upper()}{verdict[1:]}.")
    return path


def _depth_figure(fits: Mapping[str, Mapping[str, Any]], curves: Sequence[DepthCurve]) -> Figure:
    figure, grid = plots.new_figure(10.5, 3.6 * len(curves), len(curves), 2)
    for (left, right), curve in zip(grid, curves, strict=True):
        fit = fits[curve.name]
        left.plot(curve.depth_mm, curve.force_n, ".", color=plots.INK, ms=4, label="measured")
        fine = np.linspace(0.0, curve.depth_mm.max(), 200)
        label = f"R = {fit['radius_mm']:.3g} mm, k_n = {fit['k_n']:.3g} mm³/N"
        left.plot(fine, _force_n(fine, fit), color=plots.ACCENT, lw=1.2, label=label)
        left.set(title=curve.name, ylabel="force, N", xlabel="depth, mm")
        left.legend(frameon=False, fontsize=8)
        residual = curve.force_n - _force_n(curve.depth_mm, fit)
        right.plot(curve.depth_mm, residual, ".", color=plots.BAD, ms=4)
        right.axhline(0.0, color=plots.INK, lw=1.0)
        right.set(ylabel="measured − fitted, N", xlabel="depth, mm")
    return figure


def _force_n(depth_mm: np.ndarray, fit: Mapping[str, Any]) -> np.ndarray:
    volume = ball_volume_mm3(depth_mm + fit["contact_point_mm"], fit["radius_mm"])
    return np.asarray(volume / fit["k_n"])

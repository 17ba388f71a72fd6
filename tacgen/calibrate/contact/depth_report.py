"""Force–depth curves and the balls that explain them, as a page with pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from tacgen.calibrate.contact.depth_curves import BallFit, DepthCurve, DepthReport
from tacgen.calibrate.contact.depth_summary import depth_text
from tacgen.presses.ball import ball_volume_mm3
from tacgen.report import figure_section, table_section, text_section, write_page


def write_depth_page(
    report: DepthReport, curves: Sequence[DepthCurve], warnings: Sequence[str], folder: Path
) -> Path:
    """Write ``contact.html`` into ``folder``; it needs no network."""
    path = Path(folder) / "contact.html"
    header = ("curve", "radius, mm", "from", "to", "k_n, mm³/N", "from", "to", "contact point, mm",
              "R²", "RMSE, N", "RMSE with one k_n, N")  # fmt: skip
    rows = [
        (fit.name, fit.radius_mm, *fit.radius_interval_mm, fit.k_n_mm3_per_n, *fit.k_interval,
         fit.contact_point_mm, f"{fit.r_squared:.5f}", fit.rmse_n, report.shared_rmse_n[fit.name])
        for fit in report.curves
    ]  # fmt: skip
    sections = [
        figure_section(
            "Force against depth",
            _figure(report, curves),
            "Dots: measured. Lines: the ball and k_n that explain each curve best. Right: what is "
            "left over.",
        ),
        table_section(
            "Best balls", header, rows, "From–to: 95 % profile intervals, all else refitted."
        ),
        text_section("Warnings", *warnings),
    ]
    write_page(path, "Force–depth curves", sections, summary=depth_text(report).splitlines()[-1])
    return path


def _figure(report: DepthReport, curves: Sequence[DepthCurve]) -> Figure:
    figure = Figure(figsize=(10.5, 3.6 * len(curves)), layout="constrained")
    axes = figure.subplots(len(curves), 2, squeeze=False)
    for (left, right), curve, fit in zip(axes, curves, report.curves, strict=True):
        left.plot(curve.depth_mm, curve.force_n, ".", color="#111111", ms=4, label="measured")
        fine = np.linspace(0.0, curve.depth_mm.max(), 200)
        label = f"R = {fit.radius_mm:.3g} mm, k_n = {fit.k_n_mm3_per_n:.3g} mm³/N"
        left.plot(fine, _force_n(fine, fit), color="#1f6f8b", lw=1.2, label=label)
        left.set_title(curve.name, fontsize=10)
        left.legend(frameon=False, fontsize=8)
        left.set_ylabel("force, N")
        right.plot(curve.depth_mm, curve.force_n - _force_n(curve.depth_mm, fit), ".",
                   color="#c8553d", ms=4)  # fmt: skip
        right.axhline(0.0, color="#111111", lw=1.0)
        right.set_ylabel("measured − fitted, N")
        for each in (left, right):
            each.set_xlabel("depth, mm")
    return figure


def _force_n(depth_mm: np.ndarray, fit: BallFit) -> np.ndarray:
    volume = ball_volume_mm3(depth_mm + fit.contact_point_mm, fit.radius_mm)
    return np.asarray(volume / fit.k_n_mm3_per_n)

"""What force–depth curves say, in words and as data."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tacgen.calibrate.contact.depth_curves import RADII_MM, BallFit, DepthReport

WAVY = 0.5
"""Correlation of neighbouring residuals above which they are shape, not noise."""


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


def depth_text(report: DepthReport) -> str:
    """The result in a few lines."""
    lines = []
    for fit in report.curves:
        (r_low, r_high), (k_low, k_high) = fit.radius_interval_mm, fit.k_interval
        lines += [
            f"{fit.name}: ball of radius {fit.radius_mm:.3g} mm [{r_low:.3g}, {r_high:.3g}], "
            f"k_n = {fit.k_n_mm3_per_n:.3g} mm³/N [{k_low:.3g}, {k_high:.3g}], contact "
            f"{-fit.contact_point_mm:.3g} mm along the depth axis",
            f"  R² {fit.r_squared:.5f}, RMSE {fit.rmse_n:.3g} N over {fit.n_samples} samples; "
            f"log-log exponent {fit.exponent:.2f}",
        ]
        if len(report.curves) > 1:
            lines.append(
                f"  with the shared k_n: radius {report.shared_radius_mm[fit.name]:.3g} mm, RMSE "
                f"{report.shared_rmse_n[fit.name]:.3g} N"
            )
    if len(report.curves) > 1:
        verdict = "explains" if report.one_k_n_will_do else "does not explain"
        lines.append(
            f"one constant k_n = {report.shared_k_n_mm3_per_n:.3g} mm³/N {verdict} all curves "
            f"(F test, p = {report.p_value:.2g})"
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
            texts.append(f"{path}: curve {fit.name}: no upper bound of the radius can be told")
        if fit.waviness > WAVY:
            texts.append(
                f"{path}: curve {fit.name}: what is left over runs in waves (neighbours correlate "
                f"by {fit.waviness:.2f}), so it is no noise: this was not exactly a ball on a "
                "linear gel, and the intervals are too narrow"
            )
    if not report.one_k_n_will_do:
        texts.append(
            f"{path}: one constant k_n does not explain these curves; contact.yaml holds the best "
            "shared one with an error as wide as the curves are apart"
        )
    return tuple(texts)

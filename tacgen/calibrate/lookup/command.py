"""What ``tacgen calibrate lookup`` and ``score`` do: read, check, fit or score, write."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from tacgen.calibrate.lookup.scale import ScaleEvidence
from tacgen.calibrate.lookup.score import TableScore, score_table
from tacgen.calibrate.lookup.table_fit import Calibration, calibrate
from tacgen.optics.dots import filled_in
from tacgen.optics.table import LookupTable, load_table, save_table
from tacgen.presses.press_folder import read_presses
from tacgen.presses.press_images import PressImages
from tacgen.presses.screening import usable_presses


def calibrate_lookup(
    presses_path: Path,
    out: Path,
    report: Path | None = None,
    *,
    mm_per_px: float | None = None,
    ball_radius_mm: float | None = None,
    without_dots: bool = False,
) -> tuple[Calibration, PressImages]:
    """Fit a table to the presses at ``presses_path`` and write it to ``out``.

    ``without_dots`` removes printed dots from the table's background, for simulations that draw
    moving ones.
    """
    raw = read_presses(presses_path, mm_per_px=mm_per_px, ball_radius_mm=ball_radius_mm)
    presses = usable_presses(raw)
    calibration = calibrate(presses, heldout=True)
    table = calibration.table
    if without_dots and presses.dots is not None:
        table = replace(table, background=filled_in(table.background, presses.dots))
    save_table(table, out)
    if report is not None:
        from tacgen.calibrate.lookup.report import write_table_report

        write_table_report(report, presses, calibration)
    return calibration, presses


def score_presses(
    table_path: Path,
    presses_path: Path,
    *,
    mm_per_px: float | None = None,
    ball_radius_mm: float | None = None,
) -> tuple[TableScore, PressImages]:
    """Score the table at ``table_path`` on presses.

    The scale and the ball, which a dataPack does not hold, are those that the table was made with.
    """
    table = load_table(table_path)
    if Path(presses_path).is_file():
        mm_per_px = mm_per_px or table.mm_per_px
        ball_radius_mm = ball_radius_mm or _ball_of(table)
    raw = read_presses(presses_path, mm_per_px=mm_per_px, ball_radius_mm=ball_radius_mm)
    presses = usable_presses(raw, least=1)
    return score_table(table, presses, gradients=True), presses


def _ball_of(table: LookupTable) -> float | None:
    """The ball that a table was made with, where it was one."""
    balls = table.provenance.get("ball_radius_mm", ())
    return float(balls[0]) if len(balls) == 1 else None


def warning_lines(presses: PressImages, scale: ScaleEvidence | None = None) -> Iterator[str]:
    """Warnings and rejected presses, a line each."""
    yield from presses.warnings
    if scale is not None:
        yield from (*scale.warnings, *scale.notes)
    yield from (str(press) for press in presses.dropped)


def lookup_text(made: Calibration, presses: PressImages, *, json_output: bool = False) -> str:
    """What ``tacgen calibrate lookup`` prints: held-out score, scale, rejected presses."""
    if not json_output:
        return score_text(made.heldout)
    found = {} if made.heldout is None else made.heldout.as_dict()
    if made.scale is not None:
        found["scale"] = made.scale.as_dict()
    found["left_out"] = [
        {"file": press.file, "row": press.row, "reason": press.reason} for press in presses.dropped
    ]
    return json.dumps(found)


def score_text(score: TableScore | None, *, json_output: bool = False) -> str:
    """The score as text for a terminal, or as JSON."""
    if score is None:
        return ""
    if json_output:
        return json.dumps(score.as_dict())
    labels, labels_rgb = score.rmse("labels")
    refined, refined_rgb = score.rmse("refined")
    return "\n".join(
        [
            f"{len(score.presses)} presses, {score.n_pixels} pixels inside the contact circles; "
            "RMSE in grey levels (R, G, B)",
            f"  labels as given             {labels:6.2f}  {_channels(labels_rgb)}",
            f"  centre, radius re-estimated {refined:6.2f}  {_channels(refined_rgb)}",
            *(
                f"  {ring['from_radii']:g} to {ring['to_radii']:g} radii: "
                f"{ring['rmse_labels']:.2f}, re-estimated {ring['rmse_refined']:.2f}, "
                f"without a contact {ring['rmse_bare']:.2f}"
                for ring in score.rings()[1:]
            ),
            _likeness_line(score.likeness()),
        ]
    )


def _likeness_line(likeness: Mapping[str, float]) -> str:
    """SSIM, PSNR and, where it was computed, the error of the normals."""
    line = (
        f"  SSIM {likeness['ssim_labels']:.3f}, re-estimated {likeness['ssim_refined']:.3f}; PSNR "
        f"{likeness['psnr_db_labels']:.1f} dB, re-estimated {likeness['psnr_db_refined']:.1f} dB"
    )
    if "gradient_error_deg" in likeness:
        line += f"; normals read from the photographs {likeness['gradient_error_deg']:.1f}° off"
    return line


def _channels(values: list[float]) -> str:
    return f"({', '.join(f'{value:.2f}' for value in values)})"

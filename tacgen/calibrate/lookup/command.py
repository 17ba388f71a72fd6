"""What ``tacgen calibrate lookup`` and ``score`` do: read, check, fit or score, write."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.calibrate.lookup.scale import ScaleEvidence
from tacgen.calibrate.lookup.score import TableScore, score_table
from tacgen.calibrate.lookup.settings import RULES
from tacgen.calibrate.lookup.table_fit import Calibration, calibrate
from tacgen.core.files import refuse_other_page
from tacgen.optics.dots import filled_in
from tacgen.optics.table import load_table, save_table
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
    if report is not None:
        refuse_other_page(Path(report) / "index.html", "calibrate lookup")
    raw = read_presses(presses_path, mm_per_px=mm_per_px, ball_radius_mm=ball_radius_mm)
    presses = usable_presses(raw)
    calibration = calibrate(presses)
    table = calibration.table
    if without_dots and presses.dots is not None:
        table = replace(table, background=filled_in(table.background, presses.dots))
    save_table(table, out)
    if report is not None:
        from tacgen.calibrate.lookup.report import write_table_report

        write_table_report(report, lookup_record(calibration, presses), presses, calibration)
    return calibration, presses


def differs_by_more_than_noise(calibration: Calibration) -> bool:
    """Whether held-out presses differ, in or beside a contact, by what a camera's noise is not."""
    error = max(calibration.heldout.rmse("refined", ring)[0] for ring in range(2))
    return error > calibration.table.noise_grey + RULES.structure_grey


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
        balls = table.provenance.get("ball_radius_mm", ())
        ball_radius_mm = ball_radius_mm or (float(balls[0]) if len(balls) == 1 else None)
    raw = read_presses(presses_path, mm_per_px=mm_per_px, ball_radius_mm=ball_radius_mm)
    presses = usable_presses(raw, least=1, every=True)
    return score_table(table, presses, gradients=True), presses


def warning_lines(presses: PressImages, scale: ScaleEvidence | None = None) -> Iterator[str]:
    """Warnings and rejected presses, a line each."""
    yield from presses.warnings
    if scale is not None:
        yield from (*scale.warnings, *scale.notes)
    yield from (str(press) for press in presses.dropped)


def contrast_warning(score: TableScore) -> list[str]:
    """A warning where the presses come from other lamps or another sensor than the table."""
    contrast, (low, high) = score.as_dict()["contrast"], RULES.contrast_range
    fix = "other lamps or another sensor; calibrate again with `tacgen calibrate lookup`"
    text = f"the images' contrast is {contrast:.2f} of the table's: {fix}"
    return [] if low <= contrast <= high else [text]


def lookup_record(made: Calibration, presses: PressImages) -> dict[str, Any]:
    """What ``tacgen calibrate lookup --json`` prints and its page shows."""
    height, width = presses.shape_px
    return {
        **made.heldout.as_dict(),
        "scale": made.scale.as_dict(),
        "left_out": [
            {"file": press.file, "row": press.row, "reason": press.reason}
            for press in presses.dropped
        ],
        "warnings": list(warning_lines(presses, made.scale)),
        "candidates": made.choice.errors,
        "gel": {
            "height_px": height,
            "width_px": width,
            "circles_found": int(presses.found.sum()),
            "contact_radius_mm": made.fit.press_model.labels.contact_radius_mm,
            "labelled_radius_px": float(presses.radius_px.mean()),
            "printed_dots": presses.dots is not None,
        },
        "press_next": what_to_press_next(presses, made),
    }


def what_to_press_next(presses: PressImages, made: Calibration) -> list[str]:
    """Advice: parts of the gel without a press, steeper slopes, more presses."""
    height, width = presses.shape_px
    ninth = np.clip(presses.center_px * 3 / (width, height), 0, 2).astype(int)
    pressed = set(map(tuple, ninth.tolist()))
    empty = [
        f"{row} {column}"
        for j, row in enumerate(("upper", "middle", "lower"))
        for i, column in enumerate(("left", "centre", "right"))
        if (i, j) not in pressed
    ]
    advice = []
    if empty:
        advice.append(
            "No press is centred in these ninths of the image, where the table is extrapolated: "
            f"{', '.join(empty)}. Press there first."
        )
    advice.append(
        f"The steepest slope in the presses is {np.degrees(made.table.max_slope_rad):.0f}°; "
        "steeper ones are rendered like it. A smaller ball or a deeper press reaches further."
    )
    if presses.n_experiments < RULES.many_presses:
        advice.append(
            f"{presses.n_experiments} presses; with {RULES.many_presses} to 50 the error settles."
        )
    return advice


def score_text(score: TableScore) -> str:
    """The score as text for a terminal."""
    found = score.as_dict()

    def line(name: str, which: str) -> str:
        rgb = ", ".join(f"{value:.2f}" for value in found[f"rmse_{which}_rgb"])
        return f"  {name:27} {found[f'rmse_{which}']:6.2f}  ({rgb})"

    normals = found.get("gradient_error_deg")
    return "\n".join(
        [
            f"{found['n_presses']} presses in {found['n_images']} pictures, {found['n_pixels']} "
            "pixels inside the contact circles; RMSE in grey levels (R, G, B)",
            line("labels as given", "labels"),
            line("centre, radius re-estimated", "refined"),
            *(
                f"  {ring['from_radii']:g} to {ring['to_radii']:g} radii: "
                f"{ring['rmse_labels']:.2f}, re-estimated {ring['rmse_refined']:.2f}, "
                f"without a contact {ring['rmse_bare']:.2f}"
                for ring in found["rings"][1:]
            ),
            f"  SSIM {found['ssim_labels']:.3f}, re-estimated {found['ssim_refined']:.3f}; PSNR "
            f"{found['psnr_db_labels']:.1f} dB, re-estimated {found['psnr_db_refined']:.1f} dB"
            + (f"; normals read from the press images {normals:.1f}° off" if normals else ""),
        ]
    )

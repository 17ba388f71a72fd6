"""The report of a table's calibration: one HTML page with the pictures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tacgen.calibrate.lookup.press_fit import sample_design
from tacgen.calibrate.lookup.scale import evidence_lines
from tacgen.calibrate.lookup.score import PressRenderer
from tacgen.calibrate.lookup.table_fit import Calibration
from tacgen.presses.press_images import PressImages, label_mm
from tacgen.report import (
    Section,
    figure_section,
    image_section,
    table_section,
    text_section,
    write_page,
)

MAX_PICTURES = 40
DIFFERENCE_GAIN = 4
PICTURE_WIDTH_PX = 960


def write_table_report(folder: Path, presses: PressImages, calibration: Calibration) -> Path:
    """Write ``folder/report.html``: errors, pictures, coverage, what to press next."""
    sections = [
        _summary(presses, calibration),
        *_scale(calibration),
        _settings(calibration),
        _bins(calibration),
        _errors(calibration),
        _label_figure(presses, calibration),
        _residual_figure(presses, calibration),
        _coverage_figure(presses, calibration),
        text_section("What to press next", *what_to_press_next(presses, calibration)),
        *_pictures(presses, calibration),
    ]
    path = Path(folder) / "report.html"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_page(path, "Lookup table from ball presses", sections, summary=_headline(calibration))
    return path


def _headline(calibration: Calibration) -> str:
    if calibration.heldout is None:
        return "No presses were held out."
    labels, _ = calibration.heldout.rmse("labels")
    refined, _ = calibration.heldout.rmse("refined")
    return (
        f"On presses that had no part in the fit the table is off by {refined:.2f} grey levels "
        f"(RMSE) with each press's place re-estimated, by {labels:.2f} with the labels as they "
        "stand."
    )


def _summary(presses: PressImages, calibration: Calibration) -> Section:
    lines = [
        f"{len(presses)} presses of {presses.shape_px[1]}×{presses.shape_px[0]} px at "
        f"{presses.mm_per_px:.4f} mm/px; {int(presses.found.sum())} circles were found in the "
        "image, the others were labelled.",
        *presses.warnings,
        *(str(press) for press in presses.dropped),
    ]
    if presses.dots is not None:
        lines.append(
            "The gel has printed dots; their pixels are left out of the fit and of the score, and "
            "they stay in the table's background."
        )
    radius_mm = calibration.fit.press_model.labels.contact_radius_mm
    lines.append(
        f"Estimated contact radius: {radius_mm:.2f} mm, {radius_mm / presses.mm_per_px:.1f} px on "
        f"average; labelled or found: {presses.radius_px.mean():.1f} px."
    )
    return text_section("The presses", *lines)


def _scale(calibration: Calibration) -> list[Section]:
    if calibration.scale is None:
        return []
    lines = [line[0].upper() + line[1:] for line in evidence_lines(calibration.scale)]
    return [text_section("Scale and balls", *lines)]


def _settings(calibration: Calibration) -> Section:
    ranked = sorted(calibration.choice.errors.items(), key=lambda item: item[1])
    return table_section(
        "Settings, by cross-validation over whole presses",
        ("candidate", "RMSE, grey levels"),
        [(name, f"{error:.3f}") for name, error in ranked[:10]],
        note="The ten best of all; a background other than the photographed one is only taken "
        "where it is better by more than one standard error.",
    )


def _bins(calibration: Calibration) -> Section:
    choice = calibration.choice
    ranked = sorted(choice.bin_errors.items(), key=lambda item: item[1])
    return table_section(
        "Smooth model against bins, by the same cross-validation",
        ("candidate", "RMSE, grey levels"),
        [(name, f"{error:.3f}") for name, error in ranked],
        note=f"Taken: {choice.bins}. In each bin of slope and direction six coefficients are "
        "fitted to what the smooth model leaves over and held back by as many presses; bins are "
        "only taken where they are better by more than one standard error over the presses.",
    )


def _errors(calibration: Calibration) -> Section:
    if calibration.heldout is None:
        return text_section("Held-out error", "No presses were held out.")
    rows = [
        (press.name, f"{press.rmse_labels:.2f}", f"{press.rmse_refined:.2f}", press.n_pixels)
        for press in calibration.heldout.presses
    ]
    return table_section(
        "Held-out error of each press, grey levels",
        ("press", "labels as they stand", "place re-estimated", "pixels"),
        rows,
    )


def _label_figure(presses: PressImages, calibration: Calibration) -> Section:
    labels = label_mm(presses)
    apart = (calibration.fit.geometry - labels) / presses.mm_per_px
    figure = Figure(figsize=(10, 4))
    left, right = figure.subplots(1, 2)
    left.quiver(
        presses.center_px[:, 0], presses.center_px[:, 1], apart[:, 0], apart[:, 1],
        angles="xy", scale_units="xy", scale=0.2,
    )  # fmt: skip
    left.set(
        xlim=(0, presses.shape_px[1]), ylim=(presses.shape_px[0], 0), aspect="equal",
        title="from label to estimated centre, 5 times enlarged",
    )  # fmt: skip
    right.scatter(presses.radius_px, calibration.fit.geometry[:, 2] / presses.mm_per_px)
    right.set(xlabel="labelled radius, px", ylabel="estimated contact radius, px")
    return figure_section("Labels against estimates", figure)


def _residual_figure(presses: PressImages, calibration: Calibration) -> Section:
    radius, residual, change, fitted = _residuals(presses, calibration)
    figure = Figure(figsize=(11, 4))
    left, right = figure.subplots(1, 2)
    for channel, (name, color) in enumerate((("R", "C3"), ("G", "C2"), ("B", "C0"))):
        left.plot(fitted[:, channel], change[:, channel], ".", color=color, ms=2, alpha=0.4)
        edges = np.linspace(0, 1.5, 16)
        index = np.digitize(radius, edges)
        spread = [
            float(np.sqrt((residual[index == k, channel] ** 2).mean()))
            if (index == k).any()
            else np.nan
            for k in range(1, len(edges))
        ]
        right.plot((edges[1:] + edges[:-1]) / 2, spread, "o-", color=color, label=name)
    left.axline((0, 0), slope=1, color="k", lw=0.7)
    left.set(xlabel="change that the model gives, grey levels", ylabel="change in the image")
    right.axvline(1, color="k", lw=0.7, ls=":")
    right.set(xlabel="distance from the centre / labelled radius", ylabel="RMS residual, grey")
    right.legend()
    return figure_section("Fit and residual", figure)


def _residuals(
    presses: PressImages, calibration: Calibration
) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Distance (n,), residual, change and fit (n, 3) at a thinned set of pixels of all presses."""
    fit = calibration.fit
    parts: list[list[NDArray]] = [[], [], [], []]
    for sample, place in zip(
        calibration.presses.samples(calibration.background, limit=150),
        fit.geometry,
        strict=True,
    ):
        features = sample_design(sample, place, fit.press_model, fit.model.degree)
        fitted = features @ fit.model.weights.reshape(-1, 3)
        distance = np.hypot(sample.pixels.x_mm - place[0], sample.pixels.y_mm - place[1])
        found = (distance / sample.label[2], sample.change - fitted, sample.change, fitted)
        for part, values in zip(parts, found, strict=True):
            part.append(values)
    radius, residual, change, fitted = (np.concatenate(part) for part in parts)
    return radius, residual, change, fitted


def coverage(presses: PressImages, calibration: Calibration) -> NDArray[np.float64]:
    """Pixels (n_slope, n_direction) of all presses in coarse bins of slope and direction."""
    fit = calibration.fit
    counts = np.zeros((12, 24))
    for sample, place in zip(
        calibration.presses.samples(calibration.background),
        fit.geometry,
        strict=True,
    ):
        gx, gy = fit.press_model.slopes(place, sample.ball_radius_mm, sample.pixels)
        slope = np.arctan(np.hypot(gx, gy)) / calibration.table.max_slope_rad * 12
        direction = (np.arctan2(gy, gx) + np.pi) / (2 * np.pi) * 24
        flat = np.clip(slope, 0, 11).astype(int) * 24 + np.clip(direction, 0, 23).astype(int)
        counts += np.bincount(flat, minlength=12 * 24).reshape(12, 24)
    return counts


def _coverage_figure(presses: PressImages, calibration: Calibration) -> Section:
    counts = coverage(presses, calibration)
    steepest = float(np.degrees(calibration.table.max_slope_rad))
    figure = Figure(figsize=(11, 3.6))
    left, right = figure.subplots(1, 2)
    shown = left.imshow(
        np.log10(counts + 1), origin="lower", aspect="auto", extent=(-180, 180, 0, steepest)
    )
    left.set(xlabel="direction of the slope, degrees", ylabel="slope, degrees")
    figure.colorbar(shown, ax=left, label="log₁₀(pixels + 1)")
    radius = np.median(presses.radius_px)
    right.scatter(
        presses.center_px[:, 0], presses.center_px[:, 1], s=radius**2, alpha=0.25, edgecolors="k"
    )
    right.set(
        xlim=(0, presses.shape_px[1]), ylim=(presses.shape_px[0], 0), aspect="equal",
        title="where the gel was pressed",
    )  # fmt: skip
    return figure_section("Coverage of the table", figure)


def what_to_press_next(presses: PressImages, calibration: Calibration) -> list[str]:
    """Advice in words: parts of the gel without a press, steeper slopes, more balls."""
    height, width = presses.shape_px
    grid = np.zeros((3, 3), dtype=int)
    for x, y in presses.center_px:
        grid[min(int(3 * y / height), 2), min(int(3 * x / width), 2)] += 1
    names = [
        f"{row} {column}".strip()
        for row in ("upper", "middle", "lower")
        for column in ("left", "centre", "right")
    ]
    empty = [name for name, count in zip(names, grid.ravel(), strict=True) if count == 0]
    advice = []
    if empty:
        advice.append(
            "No press is centred in these ninths of the image, where the table is extrapolated: "
            f"{', '.join(empty)}. Press there first."
        )
    steepest = float(np.degrees(calibration.table.max_slope_rad))
    advice.append(
        f"The steepest slope that was seen is {steepest:.0f}°; steeper ones render like it. A "
        "smaller ball or a deeper press reaches further."
    )
    if len(presses) < 30:
        advice.append(f"{len(presses)} presses; with 30 to 50 the error settles.")
    return advice


def _pictures(presses: PressImages, calibration: Calibration) -> list[Section]:
    """Real, rendered and difference of each press; rendered by tables made without it."""
    if calibration.heldout is None:
        return []
    sections = []
    renderers = [
        PressRenderer(table, calibration.fit.press_model) for table in calibration.fold_tables
    ]
    for k, press in enumerate(calibration.heldout.presses[:MAX_PICTURES]):
        renderer = renderers[k % len(renderers)]
        made = renderer.picture(press.refined_mm, float(presses.ball_radius_mm[k]))
        real = presses.images[k]
        apart = DIFFERENCE_GAIN * (real.astype(np.float32) - made) + 128
        row = np.hstack([real, made, np.clip(apart, 0, 255).astype(np.uint8)])
        sections.append(
            image_section(
                press.name,
                row,
                f"real, rendered without having seen it, difference ×{DIFFERENCE_GAIN}; "
                f"{press.rmse_refined:.2f} grey levels in the contact",
                width_px=PICTURE_WIDTH_PX,
            )
        )
    return sections

"""The page of a table's calibration: pictures of held-out presses, errors, coverage."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tacgen.calibrate.lookup.press_fit import predicted
from tacgen.calibrate.lookup.score import PressRenderer
from tacgen.calibrate.lookup.table_fit import Calibration
from tacgen.core.arrays import FloatArray
from tacgen.core.images import difference, evenly, no_wider, side_by_side
from tacgen.presses.press_images import PressImages, label_mm
from tacgen.report import figures as plots
from tacgen.report.page import write_page

MAX_PICTURES, SHOWN_FIRST = 40, 6
"""Presses that the page shows, and those of them at its top, from the best to the worst."""
PICTURE_WIDTH_PX = 320  # four pictures fit into a page's width
DIFFERENCE_GAIN = 4  # errors of a few grey levels become visible
RADIUS_EDGES = np.linspace(0, 2.5, 26)  # rings, in labelled radii, whose residual is shown
SLOPE_BINS, DIRECTION_BINS = 12, 24  # of the map of coverage
DRAWN_PIXELS = 150  # of a press, in the figure of fit and residual
CHANNEL_COLORS = {"R": "C3", "G": "C2", "B": "C0"}


def write_table_report(
    folder: Path, result: Mapping[str, Any], presses: PressImages, calibration: Calibration
) -> None:
    """Write ``folder/report.html`` from the command's JSON and figures of the fit."""
    pictures = _pictures(presses, calibration)
    first = set(evenly(len(pictures), SHOWN_FIRST))
    errors = {press["name"]: press["rmse_refined"] for press in result["images"]}
    write_page(
        Path(folder) / "report.html",
        "Lookup table from ball presses",
        summary=f"Error on held-out presses: {result['rmse_refined']:.2f} grey levels (RMSE) with "
        f"each press's place re-estimated, {result['rmse_labels']:.2f} with places as labelled.",
        template="lookup_calibration.html",
        result=result,
        strips=[pictures[k] for k in sorted(first)],
        further=[picture for k, picture in enumerate(pictures) if k not in first],
        difference_gain=DIFFERENCE_GAIN,
        errors=plots.columns(errors, result["rmse_refined"], ("press", "RMSE, grey levels")),
        residuals=_residual_figure(calibration),
        labels=_label_figure(presses, calibration),
        coverage=_coverage_figure(calibration),
    )


def _pictures(
    presses: PressImages, calibration: Calibration
) -> list[tuple[str, NDArray[np.uint8]]]:
    """Captions and strips of held-out presses, the one with the smallest error first."""
    renderers = [
        PressRenderer(table, calibration.fit.press_model) for table in calibration.fold_tables
    ]
    strips = []
    scored = list(enumerate(calibration.heldout.presses[:MAX_PICTURES]))
    for k, press in sorted(scored, key=lambda item: item[1].rmse("refined")):
        renderer = renderers[calibration.folds[k]]
        made = renderer.picture(press.refined_mm, float(presses.ball_radius_mm[k]))
        real = presses.images[k]
        strip = [real, made, difference(real, made, DIFFERENCE_GAIN)]
        caption = f"{press.name}: {press.rmse('refined'):.2f} grey levels in the contact"
        strips.append(
            (caption, side_by_side([no_wider(image, PICTURE_WIDTH_PX) for image in strip]))
        )
    return strips


def _label_figure(presses: PressImages, calibration: Calibration) -> Figure:
    estimated = calibration.fit.geometry
    apart = (estimated - label_mm(presses)) / presses.mm_per_px
    height, width = presses.shape_px
    figure, grid = plots.new_figure(10, 4, 1, 2)
    left, right = grid[0]
    left.quiver(
        *presses.center_px.T, apart[:, 0], apart[:, 1], angles="xy", scale_units="xy", scale=0.2
    )
    left.set(xlim=(0, width), ylim=(height, 0), aspect="equal", xlabel="column, px")
    left.set_ylabel("row, px")
    right.scatter(presses.radius_px, estimated[:, 2] / presses.mm_per_px, color=plots.ACCENT)
    right.set(xlabel="labelled radius, px", ylabel="estimated contact radius, px")
    return figure


def _residual_figure(calibration: Calibration) -> Figure:
    """Measured over fitted change at some pixels of all presses; its error by the distance."""
    fit = calibration.fit
    samples = calibration.presses.samples(calibration.background, DRAWN_PIXELS)
    radius: list[FloatArray] = []
    fitted: list[FloatArray] = []
    for sample, place in zip(samples, fit.geometry, strict=True):
        fitted.append(predicted(sample, place, fit.press_model, fit.model))
        distance = np.hypot(sample.pixels.x_mm - place[0], sample.pixels.y_mm - place[1])
        radius.append(distance / sample.label[2])
    change, model = np.concatenate([sample.change for sample in samples]), np.concatenate(fitted)
    ring = np.digitize(np.concatenate(radius), RADIUS_EDGES) - 1
    kept = (ring >= 0) & (ring < len(RADIUS_EDGES) - 1)
    count = np.bincount(ring[kept], minlength=len(RADIUS_EDGES) - 1)
    figure, grid = plots.new_figure(11, 4, 1, 2)
    left, right = grid[0]
    for channel, (name, color) in enumerate(CHANNEL_COLORS.items()):
        left.plot(model[:, channel], change[:, channel], ".", color=color, ms=2, alpha=0.4)
        square = (change - model)[kept, channel] ** 2
        mean = np.bincount(ring[kept], square, len(count))[count > 0] / count[count > 0]
        middle = (0.5 * (RADIUS_EDGES[1:] + RADIUS_EDGES[:-1]))[count > 0]
        right.plot(middle, np.sqrt(mean), "o-", color=color, label=name)
    left.axline((0, 0), slope=1, color=plots.INK, lw=0.7)
    left.set(xlabel="change by the model, grey levels", ylabel="change in the image, grey levels")
    right.axvline(1, color=plots.INK, lw=0.7, ls=":")
    right.set(xlabel="distance from the centre / labelled radius")
    right.set_ylabel("RMS residual, grey levels")
    right.legend(frameon=False)
    return figure


def _coverage_figure(calibration: Calibration) -> Figure:
    """Pixels of all presses in coarse bins of slope and direction."""
    fit, steepest = calibration.fit, calibration.table.max_slope_rad
    counts = np.zeros((SLOPE_BINS, DIRECTION_BINS))
    samples = calibration.presses.samples(calibration.background)
    for sample, place in zip(samples, fit.geometry, strict=True):
        gx, gy, _ = fit.press_model.surface(place, sample.ball_radius_mm, sample.pixels)
        slope = np.minimum(np.arctan(np.hypot(gx, gy)), steepest)
        bounds = [[0, steepest], [-np.pi, np.pi]]
        counts += np.histogram2d(slope, np.arctan2(gy, gx), counts.shape, bounds)[0]
    return plots.heat_map(
        np.log10(counts + 1), (-180, 180, 0, float(np.degrees(steepest))),
        ("direction of the slope, degrees", "slope, degrees", "log₁₀(pixels + 1)"),
    )  # fmt: skip

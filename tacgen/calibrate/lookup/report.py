"""The page of a table's calibration: pictures of held-out presses and their errors."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tacgen.calibrate.lookup.press_fit import predicted
from tacgen.calibrate.lookup.score import PressRenderer
from tacgen.calibrate.lookup.settings import RULES
from tacgen.calibrate.lookup.table_fit import Calibration
from tacgen.core.images import difference, evenly, no_wider, side_by_side
from tacgen.core.types import FloatArray
from tacgen.presses.press_images import PressImages
from tacgen.report import figures as plots
from tacgen.report.page import write_page

DIFFERENCE_GAIN = 4  # errors of a few grey levels become visible
RADIUS_EDGES = np.linspace(0, 2.5, 26)  # rings, in labelled radii, whose residual is shown
CHANNEL_COLORS = {"R": "C3", "G": "C2", "B": "C0"}


def write_table_report(
    folder: Path, result: Mapping[str, Any], presses: PressImages, calibration: Calibration
) -> None:
    """Write ``folder/index.html`` from the command's JSON and figures of the fit."""
    errors = {press["name"]: press["rmse_refined"] for press in result["images"]}
    write_page(
        Path(folder) / "index.html",
        "Lookup table from ball presses",
        summary=f"Error on held-out presses: {result['rmse_refined']:.2f} grey levels (RMSE) with "
        f"each press's place re-estimated, {result['rmse_labels']:.2f} with places as labelled.",
        template="lookup_calibration.html",
        made_by="calibrate lookup",
        result=result,
        strips=_pictures(presses, calibration),
        difference_gain=DIFFERENCE_GAIN,
        errors=plots.columns(errors, result["rmse_refined"], ("press", "RMSE, grey levels")),
        residuals=_residual_figure(calibration),
    )


def _pictures(
    presses: PressImages, calibration: Calibration
) -> list[tuple[str, NDArray[np.uint8]]]:
    """Captions and strips of held-out presses, the one with the smallest error first."""
    renderers = [
        PressRenderer(table, calibration.fit.press_model) for table in calibration.fold_tables
    ]
    strips = []
    scored = sorted(enumerate(calibration.heldout.presses), key=lambda one: one[1].rmse("refined"))
    for k, press in (scored[place] for place in evenly(len(scored), RULES.drawn_presses)):
        renderer = renderers[calibration.folds[k]]
        made = renderer.picture(press.refined_mm, float(presses.ball_radius_mm[k]))
        real = presses.images[k]
        strip = [real, made, difference(real, made, DIFFERENCE_GAIN)]
        caption = f"{press.name}: {press.rmse('refined'):.2f} grey levels in the contact"
        strips.append(
            (caption, side_by_side([no_wider(image, RULES.drawn_width_px) for image in strip]))
        )
    return strips


def _residual_figure(calibration: Calibration) -> Figure:
    """Measured over fitted change at some pixels of all presses; its error by the distance."""
    fit = calibration.fit
    samples = calibration.presses.samples(calibration.background, RULES.drawn_pixels)
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

"""The page of a table's calibration: pictures of held-out presses, errors, coverage."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tacgen.calibrate.lookup.press_fit import predicted
from tacgen.calibrate.lookup.scale import evidence_lines
from tacgen.calibrate.lookup.score import PICTURES, PressRenderer
from tacgen.calibrate.lookup.table_fit import Calibration
from tacgen.core.images import difference, evenly, no_wider, side_by_side
from tacgen.presses.press_images import PressImages, label_mm
from tacgen.report import (
    Section,
    figure_section,
    pictures_section,
    table_section,
    text_section,
    write_page,
)
from tacgen.report import figures as plots
from tacgen.report.formatting import fixed

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MAX_PICTURES, SHOWN_FIRST = 40, 6
"""Presses that the page shows, and those of them at its top, from the best to the worst."""
PICTURE_WIDTH_PX = 320  # four pictures fit into a page's width
DIFFERENCE_GAIN = 4  # errors of a few grey levels become visible
MAX_CANDIDATES = 10
"""Settings in the ranking."""
RADIUS_EDGES = np.linspace(0, 2.5, 26)
"""Rings, in labelled radii, whose residual is shown."""
SLOPE_BINS, DIRECTION_BINS = 12, 24
"""Of the map of coverage."""
MANY_PRESSES = 30
"""From so many presses on, spread over the gel, the held-out error hardly falls any more."""
CHANNEL_COLORS = {"R": "C3", "G": "C2", "B": "C0"}


def write_table_report(folder: Path, presses: PressImages, calibration: Calibration) -> Path:
    """Write ``folder/report.html``: pictures, errors, coverage, what to press next."""
    pictures = list(_pictures(presses, calibration))
    first = set(evenly(len(pictures), SHOWN_FIRST))
    note = (
        "Photograph, the image rendered by a table that was fitted without this press, and their "
        f"difference {DIFFERENCE_GAIN}× about grey."
    )
    sections = [
        *_picture_section("Held-out presses", [pictures[k] for k in sorted(first)], note),
        *_error_figure(calibration),
        _residual_figure(presses, calibration),
        _summary(presses, calibration),
        *_scale(calibration),
        _ranking("Settings, by cross-validation over whole presses", calibration.choice.errors,
                 "A background other than the photographed one is chosen only where it is better "
                 "by more than one standard error."),
        _label_figure(presses, calibration),
        *_coverage_figures(presses, calibration),
        text_section("What to press next", *what_to_press_next(presses, calibration)),
        *_ring_table(calibration),
        *_error_table(calibration),
        *_picture_section(
            "Further held-out presses",
            [picture for k, picture in enumerate(pictures) if k not in first],
            note,
        ),
    ]  # fmt: skip
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
        f"Error on held-out presses: {refined:.2f} grey levels (RMSE) with each press's place "
        f"re-estimated, {labels:.2f} with the places as labelled."
    )


def _picture_section(
    title: str, pictures: Sequence[tuple[str, NDArray[np.uint8]]], note: str
) -> list[Section]:
    return [pictures_section(title, pictures, note)] if pictures else []


def _pictures(
    presses: PressImages, calibration: Calibration
) -> Iterator[tuple[str, NDArray[np.uint8]]]:
    """Captions and strips of held-out presses, the one with the smallest error first."""
    if calibration.heldout is None:
        return
    renderers = [
        PressRenderer(table, calibration.fit.press_model) for table in calibration.fold_tables
    ]
    scored = list(enumerate(calibration.heldout.presses[:MAX_PICTURES]))
    for k, press in sorted(scored, key=lambda item: item[1].rmse("refined")):
        renderer = renderers[k % len(renderers)]
        made = renderer.picture(press.refined_mm, float(presses.ball_radius_mm[k]))
        real = presses.images[k]
        strip = [real, made, difference(real, made, DIFFERENCE_GAIN)]
        yield (
            f"{press.name}: {press.rmse('refined'):.2f} grey levels in the contact",
            side_by_side([no_wider(image, PICTURE_WIDTH_PX) for image in strip]),
        )


def _error_figure(calibration: Calibration) -> list[Section]:
    score = calibration.heldout
    if score is None:
        return []
    errors = {press.name: press.rmse("refined") for press in score.presses}
    figure = plots.columns(errors, score.rmse("refined")[0], ("press", "RMSE, grey levels"))
    note = "With its place re-estimated; the line is the error over all."
    return [figure_section("Error of each held-out press", figure, note)]


def _error_table(calibration: Calibration) -> list[Section]:
    if calibration.heldout is None:
        return []
    rows = [
        (
            press.name,
            fixed(press.rmse("labels"), 2),
            fixed(press.rmse("refined"), 2),
            press.n_pixels,
        )
        for press in calibration.heldout.presses
    ]
    header = ("press", "as labelled", "place re-estimated", "pixels")
    return [table_section("Errors of held-out presses, grey levels", header, rows)]


def _ring_table(calibration: Calibration) -> list[Section]:
    if calibration.heldout is None:
        return []
    rows = [
        (
            f"{ring['from_radii']:g} to {ring['to_radii']:g}",
            *(fixed(ring[f"rmse_{picture}"], 2) for picture in PICTURES),
        )
        for ring in calibration.heldout.rings(calibration.presses.rules)
    ]
    header = ("labelled radii from the centre", "as labelled", "place re-estimated", "background")
    note = "The last column is the error of the reference image, which shows no contact."
    return [table_section("Held-out errors around the contact, grey levels", header, rows, note)]


def _summary(presses: PressImages, calibration: Calibration) -> Section:
    radius_mm = calibration.fit.press_model.labels.contact_radius_mm
    lines = [
        f"{len(presses)} presses of {presses.shape_px[1]}×{presses.shape_px[0]} px at "
        f"{presses.mm_per_px:.4f} mm/px; {int(presses.found.sum())} circles were found in the "
        "image, the others were labelled.",
        f"Estimated contact radius: {radius_mm:.2f} mm, {radius_mm / presses.mm_per_px:.1f} px on "
        f"average; labelled or found: {presses.radius_px.mean():.1f} px.",
        *presses.warnings,
        *(str(press) for press in presses.dropped),
    ]
    if presses.dots is not None:
        lines.append(
            "The gel has printed dots; their pixels are excluded from the fit and the score, and "
            "they stay in the table's background."
        )
    return text_section("The presses", *lines)


def _scale(calibration: Calibration) -> list[Section]:
    if calibration.scale is None:
        return []
    lines = [line[0].upper() + line[1:] for line in evidence_lines(calibration.scale)]
    return [text_section("Scale and balls", *lines)]


def _ranking(title: str, errors: Mapping[str, float], note: str) -> Section:
    ranked = sorted(errors.items(), key=lambda item: item[1])[:MAX_CANDIDATES]
    rows = [(name, fixed(error, 3)) for name, error in ranked]
    return table_section(title, ("candidate", "RMSE, grey levels"), rows, note)


def _label_figure(presses: PressImages, calibration: Calibration) -> Section:
    apart = (calibration.fit.geometry - label_mm(presses)) / presses.mm_per_px
    figure, grid = plots.new_figure(10, 4, 1, 2)
    left, right = grid[0]
    left.quiver(
        presses.center_px[:, 0], presses.center_px[:, 1], apart[:, 0], apart[:, 1],
        angles="xy", scale_units="xy", scale=0.2,
    )  # fmt: skip
    _as_image(left, presses)
    left.set_title("from label to estimated centre, 5 × enlarged")
    right.scatter(
        presses.radius_px, calibration.fit.geometry[:, 2] / presses.mm_per_px, color=plots.ACCENT
    )
    right.set(xlabel="labelled radius, px", ylabel="estimated contact radius, px")
    return figure_section("Labels and estimates", figure)


def _as_image(axes: Axes, presses: PressImages) -> None:
    height, width = presses.shape_px
    axes.set(xlim=(0, width), ylim=(height, 0), aspect="equal")


def _residual_figure(presses: PressImages, calibration: Calibration) -> Section:
    radius, residual, change, fitted = _residuals(presses, calibration)
    figure, grid = plots.new_figure(11, 4, 1, 2)
    left, right = grid[0]
    ring = np.digitize(radius, RADIUS_EDGES)
    for channel, (name, color) in enumerate(CHANNEL_COLORS.items()):
        left.plot(fitted[:, channel], change[:, channel], ".", color=color, ms=2, alpha=0.4)
        rms = [
            float(np.sqrt((residual[ring == k, channel] ** 2).mean()))
            if (ring == k).any()
            else np.nan
            for k in range(1, len(RADIUS_EDGES))
        ]
        right.plot((RADIUS_EDGES[1:] + RADIUS_EDGES[:-1]) / 2, rms, "o-", color=color, label=name)
    left.axline((0, 0), slope=1, color=plots.INK, lw=0.7)
    left.set(xlabel="change by the model, grey levels", ylabel="change in the image, grey levels")
    right.axvline(1, color=plots.INK, lw=0.7, ls=":")
    right.set(xlabel="distance from the centre / labelled radius",
              ylabel="RMS residual, grey levels")  # fmt: skip
    right.legend(frameon=False)
    return figure_section("Fit and residual", figure)


def _residuals(
    presses: PressImages, calibration: Calibration
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Distance (n,), residual, change and fit (n, 3) at a thinned set of pixels of all presses."""
    fit = calibration.fit
    parts: list[list[NDArray[Any]]] = [[], [], [], []]
    for sample, place in zip(
        calibration.presses.samples(calibration.background, limit=150),
        fit.geometry,
        strict=True,
    ):
        fitted = predicted(sample, place, fit.press_model, fit.model)
        distance = np.hypot(sample.pixels.x_mm - place[0], sample.pixels.y_mm - place[1])
        found = (distance / sample.label[2], sample.change - fitted, sample.change, fitted)
        for part, values in zip(parts, found, strict=True):
            part.append(values)
    radius, residual, change, fitted = (np.concatenate(part) for part in parts)
    return radius, residual, change, fitted


def coverage(presses: PressImages, calibration: Calibration) -> NDArray[np.float64]:
    """Pixels (n_slope, n_direction) of all presses in coarse bins of slope and direction."""
    fit = calibration.fit
    counts = np.zeros((SLOPE_BINS, DIRECTION_BINS))
    for sample, place in zip(
        calibration.presses.samples(calibration.background),
        fit.geometry,
        strict=True,
    ):
        gx, gy, _ = fit.press_model.surface(place, sample.ball_radius_mm, sample.pixels)
        slope = np.arctan(np.hypot(gx, gy)) / calibration.table.max_slope_rad * SLOPE_BINS
        direction = (np.arctan2(gy, gx) + np.pi) / (2 * np.pi) * DIRECTION_BINS
        places = (
            np.clip(slope, 0, SLOPE_BINS - 1).astype(int),
            np.clip(direction, 0, DIRECTION_BINS - 1).astype(int),
        )
        np.add.at(counts, places, 1)
    return counts


def _coverage_figures(presses: PressImages, calibration: Calibration) -> list[Section]:
    steepest = float(np.degrees(calibration.table.max_slope_rad))
    covered = plots.heat_map(
        np.log10(coverage(presses, calibration) + 1), (-180, 180, 0, steepest),
        ("direction of the slope, degrees", "slope, degrees", "log₁₀(pixels + 1)"),
    )  # fmt: skip
    return [
        figure_section("Coverage: slopes in the table", covered),
        figure_section("Coverage: where the gel was pressed", _places_figure(presses)),
    ]


def _places_figure(presses: PressImages) -> Figure:
    figure, grid = plots.new_figure(5, 3.6)
    x, y = presses.center_px.T
    grid[0, 0].scatter(x, y, s=np.median(presses.radius_px) ** 2, alpha=0.25, edgecolors="k")
    _as_image(grid[0, 0], presses)
    grid[0, 0].set(xlabel="column, px", ylabel="row, px")
    return figure


def what_to_press_next(presses: PressImages, calibration: Calibration) -> list[str]:
    """Advice: parts of the gel without a press, steeper slopes, more presses."""
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
        f"The steepest slope in the presses is {steepest:.0f}°; steeper ones are rendered like it. "
        "A smaller ball or a deeper press reaches further."
    )
    if len(presses) < MANY_PRESSES:
        advice.append(f"{len(presses)} presses; with {MANY_PRESSES} to 50 the error settles.")
    return advice

"""Figures that several pages share: fits, residuals, intervals, rankings, outcomes, scores."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pandas as pd  # slow to import, and most pages do without it

Array: TypeAlias = NDArray[Any]

INK, ACCENT, MUTED, GOOD, BAD = "#1c2430", "#0b6e99", "#8a94a3", "#2a7d4f", "#b3402e"
GROUP_COLORS = (
    "#0b6e99", "#c8553d", "#588157", "#8d6a9f", "#e09f3e", "#5c677d", "#9c6644", "#2b2d42",
)  # fmt: skip
MAX_POINTS = 20_000  # samples drawn in a scatter plot; more only make the page heavy
MEAN_BINS = 14  # bins of equal count whose means a residual plot shows
MAX_ZEROS_SHOWN = 9  # cells of a confusion matrix up to which zeros are written too
MAX_TICKS = 24  # names of bars that fit beside each other


def new_figure(
    width_in: float, height_in: float, rows: int = 1, columns: int = 1, **options: Any
) -> tuple[Figure, Array]:
    """A figure and its axes (rows, columns) in the style of the pages."""
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False, **options)
    for axes in grid.flat:
        axes.spines[["top", "right"]].set_visible(False)
        axes.tick_params(labelsize=9)
    return figure, grid


def thinned(count: int) -> slice:
    """Every so many of ``count`` samples, that no more than ``MAX_POINTS`` are drawn."""
    return slice(None, None, max(1, -(-count // MAX_POINTS)))


def draw_groups(axes: Axes, x: Array, y: Array, group: Array) -> None:
    """Dots, coloured by the group (N,) that each belongs to; a legend where they are few."""
    names = list(dict.fromkeys(group.astype(str)))
    for index, name in enumerate(names):
        rows = np.flatnonzero(group.astype(str) == name)
        rows = rows[thinned(len(group))]
        color = GROUP_COLORS[index % len(GROUP_COLORS)]
        label = name if len(names) <= len(GROUP_COLORS) else None
        axes.plot(x[rows], y[rows], ".", ms=2.5, alpha=0.4, color=color, label=label)


def fit_and_residual(
    load: Array, response: Array, group: Array, slope: float, labels: tuple[str, str, str]
) -> Figure:
    """A measured response with its proportional fit, and beside it the residual.

    ``labels`` name the load, the response and the residual.
    """
    figure, grid = new_figure(10.5, 4.2, 1, 2)
    left, right = grid[0]
    draw_groups(left, load, response, group)
    draw_groups(right, load, response - slope * load, group)
    ends = np.array([min(0.0, load.min()), load.max()])
    left.plot(ends, slope * ends, color=INK, lw=1.2, label="fit")
    right.axhline(0.0, color=INK, lw=1.0)
    for axes, label in ((left, labels[1]), (right, labels[2])):
        axes.set(xlabel=labels[0], ylabel=label)
    left.legend(frameon=False, markerscale=4, fontsize=8)
    return figure


def draw_residual(axes: Axes, covariate: Array, residual: Array, noise: float) -> None:
    """A residual over a covariate, numbers or names: dots, means, and the noise as a band."""
    axes.axhspan(-noise, noise, color="0.92")
    axes.axhline(0.0, color="0.5", lw=0.8)
    if covariate.dtype.kind == "U":
        levels, place = np.unique(covariate, return_inverse=True)
        axes.set_xticks(range(levels.size), [str(level)[:10] for level in levels], fontsize=8)
        x, bins = place.astype(np.float64), place
    else:
        finite = np.isfinite(covariate)
        x, residual = covariate[finite], residual[finite]
        edges = np.unique(np.quantile(x, np.linspace(0, 1, MEAN_BINS + 1)))
        bins = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, max(edges.size - 2, 0))
    few = thinned(len(x))
    axes.plot(x[few], residual[few], ".", ms=1.5, alpha=0.35, color=MUTED)
    count = np.bincount(bins)
    kept = count > 0
    means = (np.bincount(bins, values)[kept] / count[kept] for values in (x, residual))
    axes.plot(*means, "o-", color=BAD, ms=3)


def before_after(rows: Sequence[tuple[str, float, float, float | None]], unit: str) -> Figure:
    """Error before and after of each named row, its noise floor as a mark."""
    figure, grid = new_figure(7.5, 0.9 + 0.7 * len(rows))
    axes = grid[0, 0]
    for place, (_, before, after, floor) in enumerate(rows):
        for shift, value, color in ((-0.19, before, MUTED), (0.19, after, ACCENT)):
            axes.barh(place + shift, value, height=0.34, color=color)
            beside = max(value, value if floor is None else floor)
            axes.text(beside, place + shift, f" {value:.3g}", va="center", fontsize=9)
        if floor is not None:
            axes.plot([floor, floor], [place - 0.42, place + 0.42], color=INK, lw=1.4, ls="--")
    axes.set_yticks(range(len(rows)), [name for name, *_ in rows])
    axes.invert_yaxis()
    axes.set_xlim(0, 1.15 * max(max(before, after) for _, before, after, _ in rows) or 1.0)
    axes.set_xlabel(unit)
    marks = [(MUTED, "-", 7, "before"), (ACCENT, "-", 7, "after"), (INK, "--", 1.4, "noise floor")]
    with_floor = any(floor is not None for *_, floor in rows)
    for color, style, width, label in marks[: 3 if with_floor else 2]:
        axes.plot([], [], color=color, ls=style, lw=width, label=label)
    axes.legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def intervals(
    estimates: Mapping[str, tuple[float, float]], pooled: tuple[float, float], label: str
) -> Figure:
    """Estimates with their 95 % intervals, one a line, and the pooled one as a band.

    Each estimate, and the pooled one, is a value and half the length of its interval.
    """
    figure, grid = new_figure(7.5, 0.6 + 0.32 * max(3, len(estimates)))
    axes = grid[0, 0]
    axes.axvspan(pooled[0] - pooled[1], pooled[0] + pooled[1], color=ACCENT, alpha=0.18, lw=0)
    axes.axvline(pooled[0], color=ACCENT, lw=1.0)
    for place, (value, half) in enumerate(estimates.values()):
        axes.errorbar(value, place, xerr=half, fmt="o", ms=4, color=INK, capsize=3)
    axes.set_yticks(range(len(estimates)), list(estimates))
    axes.set_ylim(len(estimates) - 0.5, -0.5)
    axes.set_xlabel(label)
    return figure


def arrows(
    rows: Sequence[tuple[str, Array, Array, Array]], window_mm: tuple[float, float]
) -> Figure:
    """Motion of markers, a row a frame: measured, model, and their difference.

    A row is a title, places at rest, measured and modelled motion (n, 2), mm; the window's width
    and height in mm. Arrows of the difference are longer, by a factor that the panel states.
    """
    figure, grid = new_figure(10.5, 0.4 + 2.7 * len(rows), len(rows), 3, sharex=True, sharey=True)
    width, height = window_mm
    for axes, (title, places, measured, model) in zip(grid, rows, strict=True):
        left = measured - model
        length = max(float(np.nanmax(np.hypot(*measured.T))), 1e-9)
        magnified = 0.08 * width / length
        largest = max(float(np.nanmax(np.hypot(*left.T))), 1e-12)
        more = max(1.0, float(f"{length / largest:.1g}"))
        names = (f"{title}: measured", "model", f"difference × {more:g}")
        for panel, name, motion, color, factor in zip(
            axes, names, (measured, model, left), (INK, ACCENT, BAD), (1.0, 1.0, more), strict=True
        ):
            seen = np.isfinite(motion).all(axis=1)
            panel.quiver(
                *places[seen].T, *(magnified * factor * motion[seen]).T, color=color,
                angles="xy", scale_units="xy", scale=1.0, width=0.005,
            )  # fmt: skip
            panel.set_title(name, fontsize=9)
            panel.set(xlim=(-width / 2, width / 2), ylim=(height / 2, -height / 2), aspect="equal")
    for axes in grid:
        axes[0].set_ylabel("y, mm")
    for panel in grid[-1]:
        panel.set_xlabel("x, mm")
    return figure


def columns(values: Mapping[str, float], line: float, labels: tuple[str, str]) -> Figure:
    """A bar for each name, in their order, and a line across."""
    figure, grid = new_figure(9.5, 2.8)
    axes = grid[0, 0]
    axes.bar(range(len(values)), list(values.values()), color=ACCENT, width=0.8)
    axes.axhline(line, color=BAD, lw=1.2)
    every = max(1, len(values) // MAX_TICKS)
    turned = 90 if max(map(len, values)) > 4 else 0
    axes.set_xticks(range(0, len(values), every), list(values)[::every], rotation=turned)
    axes.set(xlabel=labels[0], ylabel=labels[1])
    return figure


def rankings(
    panels: Sequence[tuple[str, Mapping[str, float], Sequence[str], float]], label: str
) -> Figure:
    """Bars of candidates, best on top, in a panel each: title, values, those to mark, a line."""
    counts = [max(1, len(values)) for _, values, _, _ in panels]
    figure, grid = new_figure(
        9, 0.6 + sum(0.3 + 0.28 * count for count in counts), len(panels), 1, sharex=True,
        height_ratios=counts,
    )  # fmt: skip
    for axes, (title, values, marked, line) in zip(grid[:, 0], panels, strict=True):
        colors = [ACCENT if name in marked else MUTED for name in values]
        axes.barh(range(len(values)), list(values.values()), height=0.65, color=colors)
        axes.set_yticks(range(len(values)), list(values))
        axes.invert_yaxis()
        axes.axvline(line, color=INK, lw=0.9, ls="--")
        axes.set_title(title, fontsize=10, loc="left")
    grid[-1, 0].set_xlabel(label)
    return figure


def draw_curve(
    axes: Axes, x: Array, y: Array, chosen: float, interval: tuple[float, float]
) -> None:
    """A curve over a parameter, the chosen value as a line and its interval as a band."""
    axes.axvspan(*interval, color=ACCENT, alpha=0.12)
    axes.axvline(chosen, color=ACCENT)
    axes.plot(x, y, "o-", color=INK, ms=4)


OUTCOME_SPREAD = 0.07
"""How far grasps that differ in y alone are drawn apart, as a part of the range of heights."""
OUTCOME_NOTE = (
    "Green dots succeed, red crosses fail, grey squares could not be executed; rings mark "
    "simulated labels that differ from the real ones. Grasps at larger y are drawn a little higher."
)


def draw_outcomes(
    axes: Axes, places: Mapping[str, Array], labels: Array, real: Array, title: str
) -> None:
    """Outcomes over force and height; rings mark labels that differ from the real ones.

    ``places`` holds ``force_n``, ``y_mm`` and ``z_mm`` (N,); labels are 1, 0, or −1 where a grasp
    could not be executed.
    """
    force, side = places["force_n"], places["y_mm"]
    height = places["z_mm"]
    largest = max(float(np.abs(side).max()), 1e-9)
    height = height + OUTCOME_SPREAD * np.ptp(height) * side / largest
    for label, marker, color in ((1, "o", GOOD), (0, "X", BAD), (-1, "s", MUTED)):
        own = labels == label
        axes.scatter(force[own], height[own], marker=marker, color=color, s=42, alpha=0.85)
    wrong = labels != real
    axes.scatter(force[wrong], height[wrong], s=150, facecolors="none", edgecolors=INK)
    axes.set(xlabel="gripping force, N", ylabel="height, mm", title=title)


def confusion(counts: Array, rows: Sequence[str], columns: Sequence[str]) -> Figure:
    """True class by row, predicted class by column, with counts or per cent in the cells."""
    size_in = max(2.2, 0.38 * len(columns))
    figure, grid = new_figure(size_in + 1.4, 0.8 + 0.38 * max(5, len(rows)))
    draw_confusion(grid[0, 0], counts, rows, columns)
    grid[0, 0].set(xlabel="predicted", ylabel="true")
    return figure


def draw_confusion(axes: Axes, counts: Array, rows: Sequence[str], columns: Sequence[str]) -> None:
    """A confusion matrix; the shade follows the number in each cell."""
    largest = max(float(counts.max()), 1.0)
    axes.imshow(counts, cmap="Blues", vmin=0, vmax=largest, aspect="auto")
    for (row, column), value in np.ndenumerate(counts):
        if not value and counts.size > MAX_ZEROS_SHOWN:
            continue
        color = "white" if value > 0.6 * largest else "black"
        axes.text(column, row, f"{value:.0f}", ha="center", va="center", color=color, fontsize=9)
    turned = 90 if max(map(len, columns)) > 9 else 0
    axes.set_xticks(range(len(columns)), columns, rotation=turned)
    axes.set_yticks(range(len(rows)), rows)


def training_curves(metrics: Sequence[Mapping[str, Any]], best_epoch: int) -> Figure:
    """Loss, accuracy and learning rate over the epochs of a training."""
    figure, grid = new_figure(11, 3.2, 1, 3)
    panels = (
        ("loss", ("train_loss", "validation_loss")),
        ("accuracy", ("train_accuracy", "validation_accuracy")),
        ("learning rate", ("learning_rate", "backbone_rate")),
    )
    epochs = [line["epoch"] for line in metrics]
    for axes, (title, names) in zip(grid[0], panels, strict=True):
        for name, color in zip(names, GROUP_COLORS, strict=False):
            values = [line[name] for line in metrics]
            axes.plot(epochs, values, ".-", ms=5, color=color, label=name.replace("_", " "))
        axes.axvline(best_epoch, color=MUTED, lw=0.8, ls=":", label="epoch kept")
        axes.set(xlabel="epoch", title=title)
        axes.legend(frameon=False, fontsize=8)
    grid[0, 1].set_ylim(-0.02, 1.02)
    grid[0, 2].set_yscale("log")
    return figure


def reliability_diagram(bins: "pd.DataFrame") -> Figure:
    """Probability that was ``predicted`` against the share that ``succeeded``, of each bin.

    A bin runs from ``lo`` to ``hi`` and holds ``n`` grasps.
    """
    figure, grid = new_figure(4.6, 4.2, 2, 1, height_ratios=(3, 1), sharex=True)
    upper, lower = grid[:, 0]
    upper.plot([0, 1], [0, 1], color=MUTED, lw=0.8, ls=":")
    upper.plot(bins["predicted"], bins["succeeded"], "o-", color=ACCENT)
    upper.set(ylabel="share that succeeded", ylim=(-0.03, 1.03))
    lower.bar((bins["lo"] + bins["hi"]) / 2, bins["n"], width=0.09, color=ACCENT)
    lower.set(ylabel="grasps", xlabel="predicted probability of success", xlim=(-0.02, 1.02))
    return figure

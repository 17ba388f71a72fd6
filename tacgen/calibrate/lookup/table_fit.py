"""Press images → lookup table."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen import __version__
from tacgen.calibrate.lookup.background import (
    BackgroundRecipe,
    bare_changes,
    bare_gel_change,
    make_background,
    press_drift,
)
from tacgen.calibrate.lookup.bins import Bins, bin_sums, polar_slopes, solve_bins
from tacgen.calibrate.lookup.model_choice import Choice, choose, fold_of
from tacgen.calibrate.lookup.press_fit import (
    FitSettings,
    JointFit,
    fit_jointly,
    gather,
    predicted,
)
from tacgen.calibrate.lookup.press_model import PressModel
from tacgen.calibrate.lookup.samples import place_mm
from tacgen.calibrate.lookup.scale import ScaleEvidence, scale_evidence
from tacgen.calibrate.lookup.score import PressScore, TableScore, score_table
from tacgen.calibrate.lookup.smooth_model import SmoothModel, position_terms
from tacgen.core.folds import in_processes
from tacgen.optics.table import LookupTable
from tacgen.presses.geometry import press_slope, rest_slope
from tacgen.presses.press_images import PressImages

N_SLOPE, N_DIRECTION = 48, 120
"""Nodes of the table: fine enough that interpolation adds less than 0.1 grey levels."""

FIRST_BACKGROUND = BackgroundRecipe(smooth=0.05, drift=True)
"""What the presses are first placed on; smooth, so that the choice among backgrounds is open."""

IMAGES_FOR_NOISE = 12

WHOLE = -1
"""In place of the number of a fold: none is left out."""

BEYOND_STEEPEST = 1.02
"""The table ends a little above the steepest slope that the presses hold."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """A table, how it was fitted, and its score on presses that had no part in fitting it.

    ``fold_tables`` are those that the score is of: press k was left out of table k mod their
    number.
    """

    table: LookupTable
    fit: JointFit
    choice: Choice
    background: NDArray[np.float32]
    heldout: TableScore | None = None
    scale: ScaleEvidence | None = None
    fold_tables: tuple[LookupTable, ...] = ()


def fit_lookup(presses: PressImages) -> LookupTable:
    """The lookup table of a sensor from its ball presses.

    Every press must have a centre and a radius, labelled or found; both are taken as a start and
    estimated. Degree, ridge and background are chosen by cross-validation over whole presses.
    """
    return calibrate(presses).table


def calibrate(
    presses: PressImages, *, heldout: bool = False, processes: int | None = None
) -> Calibration:
    """Fit a table; with ``heldout`` also repeat everything five times, each without a fifth.

    The held-out presses of a fold take no part in the fit, in the choice of settings or in the
    estimate of the background that they are scored against. The six fits run in ``processes``
    processes, by default one a core; the result does not depend on how many.
    """
    changes = bare_changes(presses)
    if not heldout:
        return _fit(presses, changes)
    folds = fold_of(len(presses))
    task = _FoldTask(presses, changes, folds)
    whole, *parts = in_processes(task, [WHOLE, *np.unique(folds).tolist()], processes)
    scored: list[PressScore | None] = [None] * len(presses)
    for fold, (_, score) in enumerate(parts):
        for k, press in zip(np.nonzero(folds == fold)[0], score.presses, strict=True):
            scored[k] = press
    total = TableScore(tuple(press for press in scored if press is not None))
    made: Calibration = whole[0]
    provenance = {**made.table.provenance, "heldout": _without_images(total)}
    if made.scale is not None:
        provenance["scale"] = made.scale.as_dict()
    table = replace(made.table, provenance=MappingProxyType(provenance))
    return replace(
        made, table=table, heldout=total, fold_tables=tuple(part.table for part, _ in parts)
    )


@dataclass(frozen=True, slots=True)
class _FoldTask:
    """Calibrates without one fold and scores on it.

    ``WHOLE`` leaves nothing out and scores nothing; it also looks at the scale.
    """

    presses: PressImages
    changes: NDArray[np.floating]
    folds: NDArray[np.int64]

    def __call__(self, fold: int) -> tuple[Calibration, TableScore]:
        kept = self.folds != fold
        made = _portable(_fit(self.presses.select(kept), self.changes[kept]))
        if fold == WHOLE:
            scale = scale_evidence(self.presses, made.fit, self.changes)
            return replace(made, scale=scale), TableScore(())
        return made, score_table(made.table, self.presses.select(~kept))


def _portable(made: Calibration) -> Calibration:
    """The same with plain mappings, which go from process to process."""
    table = made.table
    plain = replace(table, effects=dict(table.effects), provenance=dict(table.provenance))
    return replace(made, table=plain)


def _fit(presses: PressImages, changes: NDArray[np.floating]) -> Calibration:
    first = FitSettings()
    change = bare_gel_change(presses, changes)
    start = make_background(presses.background, change, FIRST_BACKGROUND, presses.dots)
    rough = fit_jointly(presses, start, first, changes=changes)
    choice = choose(presses, rough, first, changes)
    background = make_background(presses.background, change, choice.background, presses.dots)
    fit = rough
    if (choice.settings, choice.background) != (first, FIRST_BACKGROUND):
        fit = fit_jointly(
            presses, background, choice.settings, start=rough, iterations=3, changes=changes
        )
    bins = fit_bins(presses, fit, background, choice, changes)
    table = tabulate(presses, fit, background, choice, bins)
    return Calibration(table, fit, choice, background)


def fit_bins(
    presses: PressImages,
    fit: JointFit,
    background: NDArray[np.float32],
    choice: Choice,
    changes: NDArray[np.floating],
) -> Bins | None:
    """What the chosen bins add to the smooth model; None where it stands alone."""
    if not choice.bins.n_slope:
        return None
    offsets = fit.drift_share * press_drift(presses, changes)
    steepest = steepest_slope_rad(presses, fit)
    parts: list[list[NDArray]] = [[], [], [], []]
    for k, (sample, place) in enumerate(
        zip(gather(presses, background, choice.settings), fit.geometry, strict=True)
    ):
        inside = sample.pixels.inside
        polar = polar_slopes(sample, place, fit)[inside]
        smooth = predicted(sample, place, fit.press_model, fit.model)
        residual = (sample.change - offsets[k] - smooth)[inside]
        found = (polar, sample.pixels.position[inside], residual, np.full(len(polar), k))
        for part, values in zip(parts, found, strict=True):
            part.append(values)
    polar, position, residual, press = (np.concatenate(part) for part in parts)
    sums = bin_sums(polar, position, residual, press, choice.bins, steepest)
    return solve_bins(sums, choice.bins, steepest)


def _without_images(score: TableScore) -> dict[str, Any]:
    return {name: value for name, value in score.as_dict().items() if name != "images"}


def tabulate(
    presses: PressImages,
    fit: JointFit,
    background: NDArray[np.float32],
    choice: Choice,
    bins: Bins | None = None,
) -> LookupTable:
    """The fitted model as a table that renders without any of the fit's code."""
    steepest = steepest_slope_rad(presses, fit)
    slope = np.linspace(0.0, steepest, N_SLOPE)
    direction = -np.pi + 2 * np.pi * np.arange(N_DIRECTION) / N_DIRECTION
    provenance: dict[str, Any] = {
        "made_by": f"tacgen {__version__} calibrate lookup",
        "data_sha256": dict(presses.sha256),
        "n_presses": len(presses),
        "left_out": [str(press) for press in presses.doubtful],
        "ball_radius_mm": sorted({float(r) for r in presses.ball_radius_mm}),
        "press_model": fit.press_model.as_dict(),
        "settings": {
            **asdict(choice.settings),
            **asdict(choice.background),
            "bins": asdict(choice.bins),
        },
        "drift_share": fit.drift_share,
    }
    coefficients = fit.model.coefficients(slope, direction)
    if bins is not None:
        added = bins.at(*np.meshgrid(slope, direction, indexing="ij"))
        coefficients = (coefficients + added.swapaxes(-1, -2)).astype(np.float32)
    return LookupTable(
        coefficients=coefficients,
        background=without_rest(background, fit.model, fit.press_model, presses.mm_per_px),
        mm_per_px=presses.mm_per_px,
        max_slope_rad=float(steepest),
        sensor=presses.sensor,
        noise_grey=camera_noise_grey(presses),
        provenance=MappingProxyType(provenance),
    )


def camera_noise_grey(presses: PressImages) -> float:
    """Standard deviation of the camera's noise: what neighbouring pixels of bare gel differ by.

    Second differences along rows hold nothing of a smooth picture; for white noise of σ they
    have √6 σ.
    """
    noises = []
    for image in presses.images[:: max(1, len(presses) // IMAGES_FOR_NOISE)]:
        grey = image[::2].astype(np.float32)
        second = grey[:, :-2] - 2 * grey[:, 1:-1] + grey[:, 2:]
        noises.append(1.4826 * float(np.median(np.abs(second))) / math.sqrt(6))
    return float(np.median(noises))


def steepest_slope_rad(presses: PressImages, fit: JointFit) -> float:
    """The steepest slope of the gel that any of the presses holds, and a little more."""
    model = fit.press_model
    steepest = 0.0
    for (_, _, radius), ball_radius_mm in zip(fit.geometry, presses.ball_radius_mm, strict=True):
        r = np.linspace(0.0, float(ball_radius_mm), 400)
        slope, _ = press_slope(
            r,
            np.zeros_like(r),
            float(radius),
            float(ball_radius_mm),
            model.membrane,
            model.dome_radius_mm,
        )
        steepest = max(steepest, float(np.arctan(slope).max()))
    return min(BEYOND_STEEPEST * steepest, math.pi / 2)


def without_rest(
    reference: NDArray[np.float32], model: SmoothModel, press_model: PressModel, mm_per_px: float
) -> NDArray[np.float32]:
    """The reference image less what the table adds for the gel at rest (0 for a flat gel)."""
    if press_model.dome_radius_mm <= 0:
        return reference
    height, width = reference.shape[:2]
    rows, columns = np.mgrid[:height, :width]
    x_mm, y_mm = place_mm(columns.ravel(), rows.ravel(), (height, width), mm_per_px)
    u, v = (columns.ravel() + 0.5) / width - 0.5, (rows.ravel() + 0.5) / height - 0.5
    slope = rest_slope(x_mm, y_mm, press_model.dome_radius_mm)
    at_rest = model.change(*slope, position_terms(u, v))
    return np.asarray(reference - at_rest.reshape(height, width, 3), dtype=np.float32)

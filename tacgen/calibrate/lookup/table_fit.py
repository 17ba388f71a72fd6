"""Press images → lookup table."""

import math
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from tacgen.calibrate.lookup.gel_skirt import with_skirt
from tacgen.calibrate.lookup.model_choice import Choice, choose, fold_of
from tacgen.calibrate.lookup.prepared import PreparedPresses
from tacgen.calibrate.lookup.press_fit import JointFit, fit_light, place_jointly
from tacgen.calibrate.lookup.scale import ScaleEvidence, scale_evidence
from tacgen.calibrate.lookup.score import TableScore, score_table
from tacgen.calibrate.lookup.settings import RULES, SMOOTH_WITH_DRIFT, FitSettings
from tacgen.calibrate.lookup.smooth_model import (
    CONTACT_DEPTH_MM,
    light_terms,
    position_degree_of,
    position_features,
)
from tacgen.core.processes import map_in_processes
from tacgen.core.resources import __version__
from tacgen.core.types import FloatArray, IntArray
from tacgen.optics.image_models.base import between_nodes
from tacgen.optics.table import ContactLight, LookupTable, features
from tacgen.presses.geometry import PressedGel, rest_slope
from tacgen.presses.press_images import PressImages, label_mm, place_mm

WHOLE = -1  # in place of the number of a fold: no press is held out


@dataclass(frozen=True, slots=True)
class Calibration:
    """A table, how it was fitted, and its score on held-out presses.

    ``fold_tables`` are those that the score is of: picture k was held out of table ``folds[k]``.
    """

    presses: PreparedPresses
    table: LookupTable
    fit: JointFit
    choice: Choice
    heldout: TableScore
    scale: ScaleEvidence
    fold_tables: tuple[LookupTable, ...]
    folds: IntArray

    @property
    def background(self) -> FloatArray:
        """The background (H, W, 3) that was chosen."""
        return self.presses.backgrounds[self.choice.background]


def fit_lookup(presses: PressImages) -> LookupTable:
    """The lookup table of a sensor from its ball presses.

    Every press must have a centre and a radius, labelled or found; both are taken as a start and
    estimated. Degree, ridge and background are chosen by cross-validation over whole presses.
    """
    return _fit(PreparedPresses.of(presses))[0]


def calibrate(presses: PressImages, *, processes: int | None = None) -> Calibration:
    """Fit a table, and repeat everything once a fold, each without a fold, to score it.

    The held-out presses of a fold take no part in the fit, in the choice of settings or in the
    estimate of the background that they are scored against. The fits run in ``processes``
    processes, by default one a core; the result does not depend on how many.
    """
    prepared = PreparedPresses.of(presses)
    folds = fold_of(presses.experiment)
    task = _FoldTask(prepared, folds)
    whole, *parts = map_in_processes(task, [WHOLE, *np.unique(folds).tolist()], processes)
    table, fit, choice, scale = whole
    scores = [iter(score.presses) for _, score in parts]
    total = TableScore(tuple(next(scores[fold]) for fold in folds.tolist()), presses.n_experiments)
    found = {name: value for name, value in total.as_dict().items() if name != "images"}
    provenance = {**table.provenance, "heldout": found, "scale": scale.as_dict()}
    table = with_skirt(replace(table, provenance=provenance))
    tables = tuple(fold_table for fold_table, _ in parts)
    return Calibration(prepared, table, fit, choice, total, scale, tables, folds)


@dataclass(frozen=True, slots=True)
class _FoldTask:
    """Calibrates without one fold and scores on it; ``WHOLE`` looks at the scale instead.

    The arrays are small, so that each fit computes with one thread.
    """

    presses: PreparedPresses
    folds: IntArray

    @threadpool_limits.wrap(limits=1)  # type: ignore[untyped-decorator]
    def __call__(self, fold: int) -> tuple[Any, ...]:
        if fold == WHOLE:
            table, fit, choice = _fit(self.presses)
            return _portable(table), fit, choice, scale_evidence(self.presses, fit)
        table, *_ = _fit(self.presses.select(self.folds != fold))
        score = score_table(table, self.presses.presses.select(self.folds == fold))
        return _portable(table), score


def _portable(table: LookupTable) -> LookupTable:
    """The same with plain mappings, which go from process to process."""
    return replace(table, effects=dict(table.effects), provenance=dict(table.provenance))


def _fit(prepared: PreparedPresses) -> tuple[LookupTable, JointFit, Choice]:
    first = FitSettings()
    placed = place_jointly(prepared, prepared.backgrounds[SMOOTH_WITH_DRIFT], first)
    choice = choose(prepared, placed)
    background = prepared.backgrounds[choice.background]
    if (choice.settings, choice.background) != (first, SMOOTH_WITH_DRIFT):
        placed = place_jointly(prepared, background, choice.settings, start=placed, iterations=3)
    placed = replace(placed, drift_share=choice.drift_share)
    fit = fit_light(prepared, background, choice.settings, placed)
    return _tabulate(prepared, fit, choice), fit, choice


def _tabulate(prepared: PreparedPresses, fit: JointFit, choice: Choice) -> LookupTable:
    """The fitted model as a table that renders without any of the fit's code."""
    presses = prepared.presses
    steepest = steepest_slope_rad(presses, fit)
    labels = label_mm(presses)
    off = (fit.geometry - fit.press_model.labels.geometry(labels)) / labels[:, 2:]
    provenance: dict[str, Any] = {
        "made_by": f"tacgen {__version__} calibrate lookup",
        "data_sha256": dict(presses.sha256),
        "n_presses": presses.n_experiments,
        "n_images": len(presses),
        "left_out": [str(press) for press in presses.dropped],
        "ball_radius_mm": sorted({float(r) for r in presses.ball_radius_mm}),
        "press_model": fit.press_model.as_dict(),
        "label_scatter_radii": float(np.exp(0.5 * np.log((off**2).mean(axis=1) + 1e-6).mean())),
        "settings": {
            **asdict(choice.settings),
            "ring_weights": list(RULES.ring_weights),
            **asdict(choice.background),
        },
        "drift_share": fit.drift_share,
    }
    quadratic, response, contact = _looked_up(prepared, fit, steepest)
    background = prepared.backgrounds[choice.background]
    return LookupTable(
        coefficients=quadratic,
        background=without_rest(background, fit, presses, prepared.light),
        response=response,
        contact=ContactLight(contact, CONTACT_DEPTH_MM, presses.dome_radius_mm),
        mm_per_px=presses.mm_per_px,
        max_slope_rad=float(steepest),
        sensor=presses.sensor,
        noise_grey=camera_noise_grey(presses),
        provenance=provenance,
    )


def _looked_up(
    prepared: PreparedPresses, fit: JointFit, steepest_rad: float
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """The quadratic in position, the response nearest which it is, and what a contact adds."""
    model = fit.model
    height, width = prepared.presses.shape_px
    per_side = (RULES.response_places - 1) / max(height, width)
    n_rows, n_columns = (max(2, 1 + round(side * per_side)) for side in (height, width))
    v = np.repeat(np.linspace(-0.5, 0.5, n_rows), n_columns)
    u = np.tile(np.linspace(-0.5, 0.5, n_columns), n_rows)
    degree = position_degree_of(model.weights.shape[1])
    position = position_features(u, v, prepared.light, degree)

    def nodes(n_slope: int, n_direction: int) -> tuple[FloatArray, FloatArray]:
        turn = np.arange(n_direction) / n_direction
        return np.linspace(0.0, steepest_rad, n_slope), -np.pi + 2 * np.pi * turn

    slope_rad, direction_rad = nodes(RULES.response_slopes, RULES.response_directions)
    # Half precision: a twentieth of a grey level in a change of a hundred, in half the file.
    response = model.responses(slope_rad, direction_rad, position)
    quadratic = np.einsum("fp,sdpc->sdfc", np.linalg.pinv(features(u, v)), response)[..., None, :]
    slope_rad, direction_rad = nodes(RULES.n_slope, RULES.n_direction)
    tangent = np.tan(slope_rad)[:, None]
    gx, gy = tangent * np.cos(direction_rad), tangent * np.sin(direction_rad)
    coefficients = between_nodes(quadratic, steepest_rad, gx, gy)[..., 0, :].swapaxes(-1, -2)
    shape = (RULES.response_slopes, RULES.response_directions, n_rows, n_columns, 3)
    return (
        coefficients.astype(np.float32),
        response.reshape(shape).astype(np.float16).astype(np.float32),
        model.of_contact(position).reshape(n_rows, n_columns, 3, 3).astype(np.float32),
    )


def camera_noise_grey(presses: PressImages) -> float:
    """Standard deviation of the camera's noise: the median of some of the pictures."""
    images = presses.images[:: max(1, len(presses) // RULES.images_for_noise)]
    return float(np.median([image_noise_grey(image) for image in images]))


def image_noise_grey(image: NDArray[np.uint8]) -> float:
    """Standard deviation of the noise of an image (H, W, 3), grey levels.

    Second differences along rows hold nothing of a smooth picture; for white noise of σ they
    have √6 σ. Each whole number stands for what is rounded to it; saturated pixels do not count.
    An image of one colour has that of rounding.
    """
    grey = image[::2].astype(int)
    second = grey[:, :-2] - 2 * grey[:, 1:-1] + grey[:, 2:]
    counts = np.bincount(np.abs(second[grey[:, 1:-1] < grey.max()]), minlength=1)
    below = np.cumsum(counts)
    shares = np.append(0.0, below / max(below[-1], 1))
    median = np.interp(0.5, shares, np.append(0.0, np.arange(len(below)) + 0.5))
    return 1.4826 * float(median) / math.sqrt(6)


def steepest_slope_rad(presses: PressImages, fit: JointFit) -> float:
    """The steepest slope of the gel that any of the presses holds, and a little more."""
    model = fit.press_model
    steepest = 0.0
    for (_, _, radius), ball_radius_mm in zip(fit.geometry, presses.ball_radius_mm, strict=True):
        r = np.linspace(0.0, float(ball_radius_mm), 400)
        shape = float(radius), float(ball_radius_mm), model.membrane, model.dome_radius_mm
        steepest = max(steepest, float(np.arctan(PressedGel(*shape).radial_slope(r)).max()))
    return min(RULES.beyond_steepest * steepest, math.pi / 2)


def without_rest(
    reference: FloatArray, fit: JointFit, presses: PressImages, light: FloatArray
) -> FloatArray:
    """The reference image less what the table adds for the gel at rest (0 for a flat gel)."""
    if presses.dome_radius_mm <= 0:
        return reference
    height, width = reference.shape[:2]
    model, background = fit.model, np.array(reference, dtype=np.float32)
    columns, degree = np.arange(width, dtype=float), position_degree_of(model.weights.shape[1])
    for row in range(height):
        x_mm, y_mm = place_mm(columns, np.full(width, row), (height, width), presses.mm_per_px)
        u, v = (columns + 0.5) / width - 0.5, np.full(width, (row + 0.5) / height - 0.5)
        slope = rest_slope(x_mm, y_mm, presses.dome_radius_mm)
        position = position_features(u, v, light, degree)
        terms = light_terms(*slope, np.zeros_like(u), model.degree, model.bend)
        background[row] -= model.of_terms(terms, position)
    return background

"""Joint fit of a smooth table and of where each ball is: centres, radii and the gel's rim."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tacgen.calibrate.lookup.background import press_drift
from tacgen.calibrate.lookup.press_model import (
    PressModel,
    label_mm,
    learn_labels,
    plain_press_model,
)
from tacgen.calibrate.lookup.samples import Pixels, disc_pixels, place_mm
from tacgen.calibrate.lookup.smooth_model import (
    SmoothModel,
    design,
    monomial_derivatives,
    monomials,
    n_terms,
    normal_parts,
    solve_ridge,
)
from tacgen.core.arrays import FloatArray
from tacgen.presses.geometry import MAX_RADIUS_SHARE, Membrane, rest_slope
from tacgen.presses.press_images import PressImages

REACH = 1.5
"""Pixels up to this many label radii from the centre are looked at."""

PIXELS_PER_PRESS = 2000
"""No more pixels of a press than this are used; they are an even lattice."""

PIXELS_FOR_PLACES = 600
"""As many are enough to find a press's centre and radius."""

FIRST_RADIUS_SHARE = 0.85
"""Where the contact radius starts, as a share of the labelled one: people circle the dark rim."""

NOISE_GREY = 6.0
CORRELATED_PIXELS = 20.0
"""Residuals of neighbouring pixels go together (JPEG blocks, texture): so many count as one."""

DRIFT_NOISE_GREY = 0.5
"""How well the drift of a whole picture can be told from its bare gel."""

SEEN_PRIOR_RADII = 0.07
"""Standard deviation, in radii, of the centre of a circle that is seen in the picture: what is left
of its distance from 37 real labels (1.6 px of 17) beside the labels' own scatter of 1 px."""

CENTER_PRIOR_RADII = 0.15
RADIUS_PRIOR_RADII = 0.10
"""Standard deviations of a label's scatter, in label radii, that hold an estimate near it."""

LABEL_SCATTER = np.array([CENTER_PRIOR_RADII, CENTER_PRIOR_RADII, RADIUS_PRIOR_RADII])


@dataclass(frozen=True, slots=True)
class FitSettings:
    """What cross-validation chooses among.

    Attributes
    ----------
    degree : int
        Of the polynomial in the surface normal.
    ridge : float
        Strength of the penalty on rough terms, relative to the mean of the normal matrix.
    rim_weight : float
        Weight of pixels outside the labelled circle.
    """

    degree: int = 7
    ridge: float = 1e-4
    rim_weight: float = 0.05


@dataclass(frozen=True, slots=True)
class Sample:
    """The pixels of one press and what the fit needs with them."""

    pixels: Pixels
    change: FloatArray
    weight: FloatArray
    label: FloatArray
    ball_radius_mm: float


@dataclass(frozen=True, slots=True)
class JointFit:
    """A smooth model, the press model, and the geometry (N, 3), mm, of each press.

    ``drift_share`` is the share of what a picture's bare gel is brighter by than that of the
    other pictures (lamps and camera drift in a session) that was taken off its contact, so that
    it does not go into the table.
    """

    model: SmoothModel
    press_model: PressModel
    geometry: NDArray[np.float64]
    drift_share: float = 0.0


def gather(
    presses: PressImages, background: FloatArray, settings: FitSettings, *, limit: int | None = None
) -> list[Sample]:
    """The samples of every press, with the background taken off."""
    labels = label_mm(presses)
    samples = []
    for k in range(len(presses)):
        pixels = disc_pixels(
            presses.images[k],
            presses.center_px[k],
            float(presses.radius_px[k]),
            presses.mm_per_px,
            reach=REACH if settings.rim_weight > 0 else 1.0,
            limit=PIXELS_PER_PRESS if limit is None else limit,
            hidden=presses.hidden_in(k),
        )
        samples.append(
            Sample(
                pixels=pixels,
                change=pixels.grey - background[pixels.rows, pixels.columns],
                weight=np.where(pixels.inside, 1.0, settings.rim_weight),
                label=labels[k],
                ball_radius_mm=float(presses.ball_radius_mm[k]),
            )
        )
    return samples


def sample_design(
    sample: Sample, geometry: FloatArray, press_model: PressModel, degree: int
) -> FloatArray:
    """Design matrix (n, n_terms · 6) of a press: what its slopes add to the gel at rest."""
    terms = _added_terms(sample, geometry, press_model, degree)
    return design(terms, sample.pixels.position)


def predicted(
    sample: Sample, geometry: FloatArray, press_model: PressModel, model: SmoothModel
) -> FloatArray:
    """Change of grey level (n, 3) that ``model`` gives at a press's pixels."""
    terms = _added_terms(sample, geometry, press_model, model.degree)
    return model.of_terms(terms, sample.pixels.position)


def _added_terms(
    sample: Sample, geometry: FloatArray, press_model: PressModel, degree: int
) -> FloatArray:
    gx, gy = press_model.slopes(geometry, sample.ball_radius_mm, sample.pixels)
    terms = monomials(*normal_parts(gx, gy), degree)
    if press_model.dome_radius_mm > 0:
        at_rest = rest_slope(sample.pixels.x_mm, sample.pixels.y_mm, press_model.dome_radius_mm)
        terms = terms - monomials(*normal_parts(*at_rest), degree)
    return terms


def fit_model(
    samples: list[Sample], geometry: FloatArray, press_model: PressModel, settings: FitSettings
) -> SmoothModel:
    """The smooth model by ridge regression, for a given geometry of the presses."""
    size = 6 * n_terms(settings.degree)
    gram, moment = np.zeros((size, size)), np.zeros((size, 3))
    for sample, place in zip(samples, geometry, strict=True):
        features = sample_design(sample, place, press_model, settings.degree)
        root = np.sqrt(sample.weight)[:, None]
        weighted = features * root
        gram += weighted.T @ weighted
        moment += weighted.T @ (sample.change * root)
    return solve_ridge(gram, moment, settings.ridge, settings.degree)


def drift_share(
    samples: list[Sample],
    geometry: FloatArray,
    press_model: PressModel,
    model: SmoothModel,
    drift: FloatArray,
) -> float:
    """The share, 0 to 1, of the bare gel's drift (N, 3) that shows in the contacts too."""
    residual = np.zeros_like(drift)
    for k, (sample, place) in enumerate(zip(samples, geometry, strict=True)):
        inside = sample.pixels.inside
        left = sample.change - predicted(sample, place, press_model, model)
        residual[k] = left[inside].mean(axis=0)
    residual -= residual.mean(axis=0)
    size = float((drift**2).sum()) + len(drift) * DRIFT_NOISE_GREY**2
    return float(np.clip((residual * drift).sum() / size, 0.0, 1.0))


def refine_press(
    sample: Sample,
    model: SmoothModel,
    press_model: PressModel,
    expected: FloatArray,
    *,
    steps: int = 5,
    scatter: FloatArray | None = None,
) -> FloatArray:
    """Centre and contact radius (3,), mm, of one press: Gauss–Newton around what is expected.

    ``scatter`` (3,) are the standard deviations that hold it there, in label radii; a label's,
    where left out.
    """
    pixels = sample.pixels
    at_rest: FloatArray = np.zeros((len(pixels), 3))
    if press_model.dome_radius_mm > 0:
        slope = rest_slope(pixels.x_mm, pixels.y_mm, press_model.dome_radius_mm)
        at_rest = model.change(*slope, pixels.position)
    scale = sample.label[2]
    prior = 1.0 / ((LABEL_SCATTER if scatter is None else scatter) * scale) ** 2
    precision = np.repeat(sample.weight, 3) / (NOISE_GREY**2 * CORRELATED_PIXELS)
    geometry = np.array(expected, dtype=np.float64)
    largest = MAX_RADIUS_SHARE * sample.ball_radius_mm
    nudge = 1e-4 * scale
    for _ in range(steps):
        normal = normal_parts(*press_model.slopes(geometry, sample.ball_radius_mm, pixels))
        value = model.of_terms(monomials(*normal, model.degree), pixels.position)
        along_x, along_y = (
            model.of_terms(terms, pixels.position)
            for terms in monomial_derivatives(*normal, model.degree)
        )
        columns = []
        for k in range(3):
            moved = geometry.copy()
            moved[k] += nudge
            shifted = normal_parts(*press_model.slopes(moved, sample.ball_radius_mm, pixels))
            dx, dy = ((after - now) / nudge for after, now in zip(shifted, normal, strict=True))
            columns.append((along_x * dx[:, None] + along_y * dy[:, None]).ravel())
        jacobian = np.stack(columns, axis=-1)
        residual = (sample.change - value + at_rest).ravel()
        weighted = jacobian * precision[:, None]
        step = np.linalg.solve(
            weighted.T @ jacobian + np.diag(prior),
            weighted.T @ residual - prior * (geometry - expected),
        )
        geometry += np.clip(step, -0.06 * scale, 0.06 * scale)
        geometry[2] = np.clip(geometry[2], 0.1 * scale, largest)
        if np.abs(step).max() < 1e-3 * scale:
            break
    return geometry


def refine_membrane(
    samples: list[Sample], geometry: FloatArray, model: SmoothModel, press_model: PressModel
) -> Membrane:
    """One Gauss–Newton step, in logarithms, for how the gel leaves the ball."""
    now = press_model.membrane
    trials = (
        replace(now, decay_mm=now.decay_mm * 1.02),
        replace(now, sharpness=now.sharpness * 1.02),
    )
    normal_matrix, moment = np.zeros((2, 2)), np.zeros(2)
    for sample, place in zip(samples, geometry, strict=True):

        def render(membrane: Membrane, sample: Sample = sample, place: FloatArray = place):  # type: ignore[no-untyped-def]
            changed = replace(press_model, membrane=membrane)
            return predicted(sample, place, changed, model)

        value = render(now)
        jacobian = np.stack([((render(t) - value) / 0.02).ravel() for t in trials], axis=-1)
        weighted = jacobian * np.repeat(sample.weight, 3)[:, None]
        normal_matrix += weighted.T @ jacobian
        moment += weighted.T @ (sample.change - value).ravel()
    damped = normal_matrix + 1e-3 * np.trace(normal_matrix) * np.eye(2)
    step = np.clip(np.linalg.solve(damped, moment), -0.2, 0.2)
    radius = press_model.labels.contact_radius_mm
    return Membrane(
        decay_mm=float(np.clip(now.decay_mm * np.exp(step[0]), 0.05 * radius, 3.0 * radius)),
        sharpness=float(np.clip(now.sharpness * np.exp(step[1]), 1.5, 30.0)),
    )


def fit_jointly(
    presses: PressImages,
    background: FloatArray,
    settings: FitSettings,
    *,
    iterations: int = 8,
    start: JointFit | None = None,
    changes: FloatArray | None = None,
) -> JointFit:
    """Alternate between the smooth model, each press's place, the rim and the label model.

    The places are found on a thinned lattice of pixels; the model is then fitted to more of them.
    ``start`` is an earlier fit of the same presses to go on from; ``changes`` is what
    ``bare_changes`` gives, where it is already known.
    """
    thinned = gather(presses, background, settings, limit=PIXELS_FOR_PLACES)
    labels = np.array([sample.label for sample in thinned])
    balls = presses.ball_radius_mm
    first_radius = np.minimum(FIRST_RADIUS_SHARE * labels[:, 2], 0.9 * balls)
    press_model = plain_press_model(float(first_radius.mean()), presses.dome_radius_mm)
    geometry = np.column_stack([labels[:, :2], first_radius])
    rough = replace(settings, degree=min(settings.degree, 4))
    drift = press_drift(presses, changes)
    share = 0.0
    if start is not None:
        press_model, geometry, share = start.press_model, start.geometry, start.drift_share
    for _ in range(iterations):
        samples = _without(thinned, share * drift)
        model = fit_model(samples, geometry, press_model, rough)
        expected, scatter = _expected(presses, press_model.labels.geometry(labels))
        geometry = np.array(
            [
                refine_press(sample, model, press_model, place, scatter=held)
                for sample, place, held in zip(samples, expected, scatter, strict=True)
            ]
        )
        membrane = refine_membrane(samples, geometry, model, press_model)
        press_model = replace(press_model, membrane=membrane, labels=learn_labels(labels, geometry))
        share = drift_share(thinned, geometry, press_model, model, drift)
    dense = _without(gather(presses, background, settings), share * drift)
    model = fit_model(dense, geometry, press_model, settings)
    return JointFit(model, press_model, geometry, share)


def _expected(presses: PressImages, by_label: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Expected geometry (N, 3), mm, and its scatter (N, 3), label radii.

    A circle that is seen in the picture says more about the centre than a label does, and keeps a
    shift that all labels share from going into the table.
    """
    expected = np.array(by_label)
    expected[:, 2] = np.minimum(expected[:, 2], 0.95 * presses.ball_radius_mm)
    scatter = np.tile(LABEL_SCATTER, (len(presses), 1))
    if presses.seen_px is not None:
        known = np.isfinite(presses.seen_px).all(axis=1)
        x, y = presses.seen_px[:, 0], presses.seen_px[:, 1]
        seen = np.column_stack(place_mm(x, y, presses.shape_px, presses.mm_per_px))
        share = CENTER_PRIOR_RADII**2 / (CENTER_PRIOR_RADII**2 + SEEN_PRIOR_RADII**2)
        expected[known, :2] += share * (seen - expected[:, :2])[known]
        scatter[known, :2] = SEEN_PRIOR_RADII * np.sqrt(share)
    return expected, scatter


def _without(samples: list[Sample], offsets: FloatArray) -> list[Sample]:
    """The samples with each press's offset taken off."""
    return [
        replace(sample, change=sample.change - offset)
        for sample, offset in zip(samples, offsets, strict=True)
    ]

"""A table with any set of optical effects, fitted to presses and scored on others.

The baseline is the table as it is usually made: a quadratic in image position for every slope, a
background as photographed, labels of centre and radius at their word up to one factor, and one
shape of rim for all presses. Each effect frees what its name says.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tacgen.calibration.press_fit import (
    CORRELATED_PIXELS,
    NOISE_GREY,
    FitSettings,
    Sample,
    drift_share,
    gather,
    refine_membrane,
    refine_press,
    sample_design,
)
from tacgen.calibration.press_geometry import Membrane
from tacgen.calibration.press_images import PressImages
from tacgen.calibration.press_model import LabelModel, PressModel, learn_labels, plain_press_model
from tacgen.calibration.smooth_model import SmoothModel, solve_ridge
from tacgen.calibration.table_background import (
    BackgroundRecipe,
    bare_gel_change,
    make_background,
    press_drift,
)
from tacgen.loop.optics_terms import clip_level, shadow_terms, unclipped

FloatArray = NDArray[np.floating]

SETTINGS = FitSettings(degree=4, ridge=1e-3, rim_weight=0.05)
PIXELS = 400
ITERATIONS = 5

SMOOTH = 0.03
"""Width, as a share of the image's, that the background is always smoothed with: its noise is no
effect to find."""

OFFSET_GREY = 3.0
"""Standard deviation, between pictures, of what lamps and camera drift by."""

SHARP = 20.0
"""Sharpness of the rim of a gel that does not bridge."""

FLAT_POSITION = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


@dataclass(frozen=True, slots=True)
class OpticsFit:
    """A table with effects: which, and what was fitted.

    Attributes
    ----------
    effects : frozenset of str
    model : SmoothModel
    press_model : PressModel
    background : (H, W, 3) float32
    geometry : (N, 3) float
        Of the presses it was fitted to, mm.
    labels : (N, 3) float
    drift_share : float
        Share of the bare gel's drift that shows in the contact.
    vignetting : float
        Loss at the corners.
    level_grey : float
        Where the camera clips.
    shadow : (10, 3) float
        Grey levels of the shadow terms.
    """

    effects: frozenset[str]
    model: SmoothModel
    press_model: PressModel
    background: FloatArray
    geometry: FloatArray
    labels: FloatArray
    drift_share: float = 0.0
    vignetting: float = 0.0
    level_grey: float = 255.0
    shadow: FloatArray | None = None


def fit_optics(presses: PressImages, effects: frozenset[str]) -> OpticsFit:
    """Fit a table with ``effects`` to presses."""
    recipe = BackgroundRecipe(smooth=SMOOTH, drift="background_gain" in effects)
    change = bare_gel_change(presses) if recipe.drift else None
    background = make_background(presses.background, change, recipe)
    samples = gather(presses, background, SETTINGS, limit=PIXELS)
    labels = np.array([sample.label for sample in samples])
    press_model = _first_model(labels, presses)
    geometry = _expected(press_model, labels, presses.ball_radius_mm)
    drift = press_drift(presses)
    share, vignetting, level = 0.0, 0.0, 255.0
    if "saturation" in effects:
        level = clip_level(presses)
    shadow: FloatArray | None = None
    for _ in range(ITERATIONS):
        used = [
            replace(sample, change=sample.change - share * offset)
            for sample, offset in zip(samples, drift, strict=True)
        ]
        model, shadow = _solve(used, geometry, press_model, effects, vignetting, background, level)
        fit = OpticsFit(
            effects, model, press_model, background, geometry, labels, share, vignetting, level,
            shadow,
        )  # fmt: skip
        if "vignetting" in effects:
            vignetting = _refine_vignetting(used, fit)
        expected = _expected(press_model, labels, presses.ball_radius_mm)
        found = np.array(
            [
                refine_press(sample, model, press_model, place, steps=3)
                for sample, place in zip(used, expected, strict=True)
            ]
        )
        learnt = _held(labels, found, press_model, effects)
        press_model = replace(press_model, labels=learnt)
        expected = _expected(press_model, labels, presses.ball_radius_mm)
        geometry = np.where(_free(effects), found, expected)
        if "no_blur" not in effects:
            membrane = refine_membrane(used, geometry, model, press_model)
            press_model = replace(press_model, membrane=membrane)
        if "background_gain" in effects:
            share = drift_share(samples, geometry, press_model, model, drift)
    return fit


def _first_model(labels: FloatArray, presses: PressImages) -> PressModel:
    model = plain_press_model(float(labels[:, 2].mean()), presses.dome_radius_mm)
    sharp = Membrane(decay_mm=0.35 * float(labels[:, 2].mean()), sharpness=SHARP)
    return replace(model, membrane=sharp)


def _expected(model: PressModel, labels: FloatArray, balls: FloatArray) -> FloatArray:
    expected = model.labels.geometry(labels)
    expected[:, 2] = np.minimum(expected[:, 2], 0.95 * balls)
    return expected


def _held(
    labels: FloatArray, found: FloatArray, before: PressModel, effects: frozenset[str]
) -> LabelModel:
    """What the presses say about the labels, only of what is free; one factor of radius always."""
    learnt = learn_labels(labels, found)
    factor = float(found[:, 2].mean() / labels[:, 2].mean())
    held = replace(
        before.labels,
        contact_radius_mm=factor * float(labels[:, 2].mean()),
        reference_radius_mm=float(labels[:, 2].mean()),
        radius_slope=factor,
    )
    if "press_center" in effects:
        held = replace(held, shift_mm=learnt.shift_mm)
    if "scale" in effects:
        held = replace(held, radius_slope=learnt.radius_slope)
    return held


def _free(effects: frozenset[str]) -> NDArray[np.bool_]:
    """Which of centre x, centre y and radius may differ from press to press."""
    return np.array(["press_center" in effects] * 2 + ["scale" in effects])


def _place(sample: Sample, fit: OpticsFit, expected: FloatArray, *, steps: int = 4) -> FloatArray:
    """A press's geometry with only the free quantities moved."""
    found = refine_press(sample, fit.model, fit.press_model, expected, steps=steps)
    return np.where(_free(fit.effects), found, expected)


def features_of(
    sample: Sample,
    geometry: FloatArray,
    press_model: PressModel,
    effects: frozenset[str],
    vignetting: float,
) -> FloatArray:
    """Design matrix of a press, dimmed towards the corners where the lens vignettes."""
    features = sample_design(sample, geometry, press_model, SETTINGS.degree)
    if "no_illumination" in effects:
        features = (features.reshape(len(features), -1, 6) * FLAT_POSITION).reshape(
            len(features), -1
        )
    if vignetting:
        features = features * (1 - 2 * vignetting * _corner(sample))[:, None]
    return features


def _corner(sample: Sample) -> FloatArray:
    """Half the square of the distance from the image's centre, ½ at the corners."""
    return np.asarray(sample.pixels.position[:, 0] + sample.pixels.position[:, 1])


def _solve(
    samples: list[Sample],
    geometry: FloatArray,
    press_model: PressModel,
    effects: frozenset[str],
    vignetting: float,
    background: FloatArray,
    level: float,
) -> tuple[SmoothModel, FloatArray | None]:
    gram: FloatArray | None = None
    moment: FloatArray | None = None
    cast = "shadow" in effects
    stacked: list[tuple[FloatArray, FloatArray, FloatArray]] = []
    for sample, place in zip(samples, geometry, strict=True):
        features = features_of(sample, place, press_model, effects, vignetting)
        weight = unclipped(sample, background, level)
        stacked.append((features, sample.change, weight))
        weighted = features * weight[:, None]
        gram = weighted.T @ features if gram is None else gram + weighted.T @ features
        here = weighted.T @ sample.change
        moment = here if moment is None else moment + here
    if gram is None or moment is None:
        msg = "no presses to fit"
        raise ValueError(msg)
    if not cast:
        return solve_ridge(gram, moment, SETTINGS.ridge, SETTINGS.degree), None
    return _solve_with_shadow(samples, geometry, stacked)


def _solve_with_shadow(
    samples: list[Sample],
    geometry: FloatArray,
    stacked: list[tuple[FloatArray, FloatArray, FloatArray]],
) -> tuple[SmoothModel, FloatArray]:
    """The table and the shadow terms together: a few rounds of one after the other."""
    terms = [shadow_terms(s, place) for s, place in zip(samples, geometry, strict=True)]
    shadow: FloatArray = np.zeros((terms[0].shape[1], 3))
    gram = np.sum([(f * w[:, None]).T @ f for f, _, w in stacked], axis=0)
    shade_gram = np.sum(
        [(t * w[:, None]).T @ t for t, (_, _, w) in zip(terms, stacked, strict=True)], axis=0
    )
    shade_gram = shade_gram + 1e-3 * np.trace(shade_gram) / len(shade_gram) * np.eye(
        len(shade_gram)
    )
    for _ in range(4):
        moment = np.sum(
            [
                (f * w[:, None]).T @ (y - t @ shadow)
                for t, (f, y, w) in zip(terms, stacked, strict=True)
            ],
            axis=0,
        )
        model = solve_ridge(gram, moment, SETTINGS.ridge, SETTINGS.degree)
        weights = model.weights.reshape(-1, 3)
        rest = np.sum(
            [
                (t * w[:, None]).T @ (y - f @ weights)
                for t, (f, y, w) in zip(terms, stacked, strict=True)
            ],
            axis=0,
        )
        shadow = np.linalg.solve(shade_gram, rest)
    return model, shadow


def _refine_vignetting(samples: list[Sample], fit: OpticsFit) -> float:
    """One Gauss–Newton step for the loss at the corners."""
    weights = fit.model.weights.reshape(-1, 3)
    top, bottom = 0.0, 1e-9
    for sample, place in zip(samples, fit.geometry, strict=True):
        plain = features_of(sample, place, fit.press_model, fit.effects, 0.0) @ weights
        corner = 2 * _corner(sample)[:, None]
        residual = sample.change - plain * (1 - fit.vignetting * corner)
        slope = -corner * plain
        top += float((sample.weight[:, None] * slope * residual).sum())
        bottom += float((sample.weight[:, None] * slope**2).sum())
    return float(np.clip(fit.vignetting + np.clip(top / bottom, -0.1, 0.1), -0.5, 0.9))


def predict(fit: OpticsFit, sample: Sample, place: FloatArray) -> FloatArray:
    """Change of grey level (n, 3) against the fit's background at a sample's pixels."""
    features = features_of(sample, place, fit.press_model, fit.effects, fit.vignetting)
    change = features @ fit.model.weights.reshape(-1, 3)
    if fit.shadow is not None:
        change = change + shadow_terms(sample, place) @ fit.shadow
    if fit.level_grey < 255:
        under = fit.background[sample.pixels.rows, sample.pixels.columns]
        change = np.minimum(under + change, fit.level_grey) - under
    return change


def heldout_squares(fit: OpticsFit, presses: PressImages) -> tuple[FloatArray, FloatArray]:
    """Mean squared error (N,) inside each contact circle, and how many pixels (N,).

    What an effect frees for every press (its centre, radius, offset) is estimated on one half of
    a chess board of blocks and scored on the other, in both ways.
    """
    samples = gather(presses, fit.background, SETTINGS, limit=4 * PIXELS)
    squares, counts = np.zeros(len(samples)), np.zeros(len(samples))
    for k, sample in enumerate(samples):
        inside = sample.pixels.inside
        expected = _expected(fit.press_model, sample.label[None], np.array([sample.ball_radius_mm]))
        total, count = 0.0, 0
        for odd in (False, True):
            first = _part(sample, inside & (sample.pixels.odd_block == odd))
            second = _part(sample, inside & (sample.pixels.odd_block != odd))
            if not len(first.pixels) or not len(second.pixels):
                continue
            place = expected[0]
            if fit.effects & {"press_center", "scale"}:
                place = _place(first, fit, place, steps=8)
            offset = np.zeros(3)
            if "background_gain" in fit.effects:
                known = len(first.pixels) / CORRELATED_PIXELS
                share = known / (known + (NOISE_GREY / OFFSET_GREY) ** 2)
                offset = share * (first.change - predict(fit, first, place)).mean(axis=0)
            error = second.change - predict(fit, second, place) - offset
            total += float((error**2).sum() / 3)
            count += len(second.pixels)
        squares[k], counts[k] = total / max(count, 1), count
    return squares, counts


def _part(sample: Sample, mask: NDArray[np.bool_]) -> Sample:
    return replace(
        sample,
        pixels=sample.pixels.select(mask),
        change=sample.change[mask],
        weight=sample.weight[mask],
    )

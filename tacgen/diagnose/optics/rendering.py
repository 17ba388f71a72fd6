"""Ball presses as a table with optical effects renders them, at some of their pixels."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tacgen.calibrate.lookup.prepared import Pixels, disc_pixels
from tacgen.calibrate.lookup.score import PressRenderer, press_model_of
from tacgen.core.types import BoolArray, FloatArray, IntArray
from tacgen.diagnose.rules import OpticsRules
from tacgen.optics.effects import OpticalEffect, Patch, Stage, optical_effects
from tacgen.optics.render import Effects
from tacgen.optics.table import LookupTable, features
from tacgen.presses.geometry import MAX_RADIUS_SHARE
from tacgen.presses.press_images import PressImages, label_mm, place_mm


def _patch(table: LookupTable, pixels: Pixels, time: float) -> Patch:
    """Pixels as an optical effect sees them."""
    background = table.background[pixels.rows, pixels.columns].astype(np.float64)
    u, v = pixels.position[:, 3], pixels.position[:, 4]
    return Patch(background, u, v, table.mm_per_px, time=time)


def _bare_pixels(presses: PressImages, k: int, rules: OpticsRules) -> Pixels:
    """A lattice of the pixels of press ``k`` that lie beyond its contact."""
    corner = math.hypot(*presses.shape_px) / float(presses.radius_px[k])
    whole = disc_pixels(presses, k, reach=corner, inner=rules.bare_beyond_radii)
    step = max(1, round(math.sqrt(len(whole) / rules.bare_pixels)))
    return whole.select((whole.rows % step == step // 2) & (whole.columns % step == step // 2))


@dataclass(frozen=True, slots=True)
class PressView:
    """One press: some of its pixels, and the table that renders it.

    Attributes
    ----------
    contact, pixels : Pixels
        Those of the contact; the same, and after them those of the bare gel.
    patch : Patch
        The pixels (n,) as an optical effect sees them.
    expected : (3,) float
        Centre and contact radius by the label, mm.
    radius_mm, ball_mm : float
        Labelled radius of the contact; radius of the ball.
    renderer : PressRenderer
    """

    contact: Pixels
    pixels: Pixels
    patch: Patch
    expected: FloatArray
    radius_mm: float
    ball_mm: float
    renderer: PressRenderer

    @classmethod
    def of(
        cls, presses: PressImages, k: int, renderer: PressRenderer, rules: OpticsRules
    ) -> PressView:
        """Press ``k`` on a lattice of at most ``limit`` of its pixels."""
        label, ball = label_mm(presses)[k], float(presses.ball_radius_mm[k])
        labels = renderer.model.labels
        expected = labels.geometry(label)
        expected[2] = label[2] * labels.contact_radius_mm / labels.reference_radius_mm
        contact = disc_pixels(presses, k, reach=rules.reach_radii, limit=rules.pixels_per_press)
        both = contact, _bare_pixels(presses, k, rules)
        pixels = Pixels(*(np.concatenate([getattr(p, n) for p in both]) for n in Pixels.__slots__))
        time = k / max(len(presses) - 1, 1) - 0.5
        patch = _patch(renderer.table, pixels, time)
        return cls(contact, pixels, patch, expected, float(label[2]), ball, renderer)

    def on_square(self, presses: PressImages, k: int, reach: float) -> PressView:
        """The same press ``k``, on all pixels of a square of half a width of ``reach`` radii."""
        half, shape = reach * float(presses.radius_px[k]), presses.shape_px
        spans = [
            np.arange(*(int(np.clip(at + sign * half, 0, end)) for sign in (-1, 1)), dtype=float)
            for at, end in zip(presses.center_px[k], shape[::-1], strict=True)
        ]
        columns, rows = (part.ravel() for part in np.meshgrid(*spans))
        x_mm, y_mm = place_mm(columns, rows, shape, presses.mm_per_px)
        position = features((columns + 0.5) / shape[1] - 0.5, (rows + 0.5) / shape[0] - 0.5)
        rows, columns = rows.astype(int), columns.astype(int)
        grey = presses.images[k][rows, columns].astype(np.float64)
        everywhere = np.ones(len(rows), dtype=bool)
        pixels = Pixels(rows, columns, x_mm, y_mm, position, grey, everywhere)
        patch = _patch(self.renderer.table, pixels, self.patch.time)
        return replace(self, contact=pixels, pixels=pixels, patch=patch)

    def place_by_label(self, effects: Effects) -> tuple[FloatArray, float]:
        """Centre and contact radius (3,) by the label, and the ball's radius, mm."""
        place, ball = self.expected, self.ball_mm
        for effect, values in _active(effects, Stage.PRESS, Stage.PRESS):
            place, ball = effect.on_press(place, ball, **values)
        return np.append(place[:2], _possible(place[2], ball)), ball

    def lit(self, effects: Effects, place: FloatArray | None = None) -> FloatArray:
        """Grey levels (n, 3) up to the focus as labelled; at a place those of the contact alone."""
        labelled, ball = self.place_by_label(effects)
        pixels = self.pixels if place is None else self.contact
        place = labelled if place is None else np.append(place[:2], _possible(place[2], ball))
        early = {
            effect.name: values for effect, values in _active(effects, Stage.SURFACE, Stage.FOCUS)
        }
        factors = [
            e.slope_factors(**values) for e, values in _active(effects, Stage.GEL, Stage.GEL)
        ]
        return self.renderer.lit(place, ball, pixels, early, *factors)

    def finished(self, lit: FloatArray, effects: Effects) -> FloatArray:
        """Grey levels (n, 3) after the stages that follow, which act pixel by pixel."""
        grey = lit
        for effect, values in _active(effects, Stage.LIGHT, Stage.CAMERA):
            grey = effect.apply(grey, self.patch, **values)
        return np.clip(grey, 0.0, 255.0)


def _possible(radius_mm: float, ball_mm: float) -> float:
    return float(np.clip(radius_mm, 0.05 * ball_mm, MAX_RADIUS_SHARE * ball_mm))


def _active(
    effects: Effects, first: Stage, last: Stage
) -> list[tuple[OpticalEffect, Mapping[str, float]]]:
    return [
        (effect, effects[effect.name])
        for effect in optical_effects(first, last)
        if effect.name in effects
    ]


def views_of(
    presses: PressImages,
    shown: BoolArray,
    tables: Sequence[LookupTable],
    rules: OpticsRules,
    folds: IntArray | None = None,
) -> list[PressView]:
    """The pictures that are shown, each rendered by the table of its fold, by default the first."""
    renderers = [PressRenderer(table, press_model_of(table, presses)) for table in tables]
    return [
        PressView.of(presses, number, renderers[0 if folds is None else folds[k]], rules)
        for k, number in enumerate(np.nonzero(shown)[0].tolist())
    ]

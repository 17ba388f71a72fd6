"""How far the renderer's gel is from real pictures beside a contact, by how wide its skirt is.

    python -m validation.optics.skirt_width NAME=PRESSES ...

Of each sensor that ships a row. On one half of the presses, by a seeded split, a table is fitted,
which says how wide a skirt its gel has, and the width is sought whose pictures are nearest to the
presses. On the other half: errors from 1.1 to 2.2 contact radii, grey levels, of the gel as the fit
bends it, and of the renderer's with Taxim's skirt and with both widths. The ball lies where the fit
sees it and as deep as the picture within 1.1 radii says best; each channel is as bright as the bare
gel.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

import numpy as np

from scripts.make_default_tables import real_presses
from tacgen.calibrate.lookup.gel_skirt import WIDTH_STEP, fitted_overlap, with_skirt
from tacgen.calibrate.lookup.table_fit import fit_lookup
from tacgen.core.types import BoolArray, FloatArray
from tacgen.diagnose.optics.fit import PressFit
from tacgen.diagnose.optics.rendering import PressView, views_of
from tacgen.diagnose.rules import OPTICS
from tacgen.optics.deform import Deformer
from tacgen.optics.effects.skirt import SKIRT, skirt_width
from tacgen.optics.render import Shader
from tacgen.optics.smooth import grown
from tacgen.presses.geometry import rest_height
from tacgen.presses.press_images import place_mm

RIM_RADII = 1.1
SEED = 7
TAXIMS = SKIRT.parameters["width"].identity
WIDTHS = np.arange(TAXIMS, SKIRT.parameters["width"].upper + 1e-9, WIDTH_STEP)


class DrawnPress:
    """A real press at a place (3,), and what the renderer's gel makes of it."""

    def __init__(self, view: PressView, place: FloatArray) -> None:
        table, pixels = view.renderer.table, view.pixels
        rows, columns = np.indices(table.shape_px, dtype=float)
        x_mm, y_mm = place_mm(columns, rows, table.shape_px, table.mm_per_px)
        self._view, self._place, self._shader = view, place, Shader(table)
        self._rest_mm = rest_height(x_mm, y_mm, view.renderer.model.dome_radius_mm)
        self._distance_mm = np.hypot(x_mm - place[0], y_mm - place[1])
        away_mm = np.hypot(pixels.x_mm - place[0], pixels.y_mm - place[1])
        self._ring = np.digitize(away_mm / place[2], (RIM_RADII, OPTICS.reach_radii))

    def _ball_mm(self, distance_mm: FloatArray) -> FloatArray:
        """Height of the ball's lower half, downwards, less that of the gel at rest."""
        dome_mm = self._view.renderer.model.dome_radius_mm
        depth = np.sqrt(np.maximum(self._view.ball_mm**2 - distance_mm**2, 0.0))
        return np.asarray(depth - (0.5 / dome_mm if dome_mm else 0.0) * distance_mm**2)

    def _errors(self, grey: FloatArray) -> FloatArray:
        """Mean squares (2,), inside and beside the contact, of grey levels (n, 3)."""
        off = grey - self._view.pixels.grey
        off -= np.median(off[self._ring == 2], axis=0)
        return np.array([(off[self._ring == k] ** 2).mean() for k in range(2)])

    def fitted(self) -> float:
        """Mean square beside the contact, of the gel as the fit bends it."""
        view = self._view
        return float(self._errors(view.renderer.lit(self._place, view.ball_mm, view.pixels, {}))[1])

    def drawn(self, width: float) -> float:
        """Mean square beside the contact, of the renderer's gel, as deep as fits best inside."""
        overlap = fitted_overlap(lambda one: float(self._errors(self._drawn(width, one))[0]))
        return float(self._errors(self._drawn(width, overlap))[1])

    def _drawn(self, width: float, overlap: float) -> FloatArray:
        table, pixels = self._view.renderer.table, self._view.pixels
        level_mm = self._ball_mm(np.asarray(overlap * self._place[2]))
        in_ball = self._distance_mm < overlap * self._place[2]
        rows, columns = (np.flatnonzero(in_ball.any(axis=axis)).tolist() for axis in (1, 0))
        contact = rows[0], rows[-1] + 1, columns[0], columns[-1] + 1
        distance = self._distance_mm[contact[0] : contact[1], contact[2] : contact[3]]
        depth = np.maximum(self._ball_mm(distance) - level_mm, 0.0).astype(np.float32)
        part, window = Deformer(table.mm_per_px, width).deform(depth, contact, table.shape_px)
        height = self._rest_mm.astype(np.float32)
        height[window[0] : window[1], window[2] : window[3]] -= part
        image = np.array(table.background, np.float32)
        lit = grown(window, self._shader.slope_reach_px, table.shape_px)
        self._shader.light(height, lit, image)
        return image[pixels.rows, pixels.columns].astype(np.float64)


def row(name: str, path: Path) -> str:
    """A row of the table, of a sensor's presses."""
    presses = real_presses(name, path)
    order = np.random.default_rng(SEED).permutation(presses.n_experiments)
    fitted = order[presses.experiment] % 2 == 0
    table = with_skirt(fit_lookup(presses.select(fitted)))

    def half(which: BoolArray) -> list[DrawnPress]:
        fit = PressFit(views_of(presses, which, [table], OPTICS), OPTICS)
        places = fit.start({}).places
        return [DrawnPress(*one) for one in zip(fit.views, places, strict=True)]

    chosen = half(fitted)
    sought = min(WIDTHS.tolist(), key=lambda width: sum(one.drawn(width) for one in chosen))
    own, others = skirt_width(table.effects), half(~fitted)
    errors = {width: np.array([p.drawn(width) for p in others]) for width in (1.0, own, sought)}
    rms = {width: math.sqrt(squares.mean()) for width, squares in errors.items()}
    gain = np.sqrt(errors[1.0]) - np.sqrt(errors[own])
    spread = gain.std(ddof=1) / math.sqrt(len(gain))
    return (
        f"| {name}, {len(chosen)} + {len(others)} | {rms[1.0]:.2f} | {rms[own]:.2f} ({own:g}) | "
        f"{rms[sought]:.2f} ({sought:g}) | {gain.mean():.2f} ± {spread:.2f}, "
        f"{(gain > 0).sum()} of {len(gain)} | "
        f"{math.sqrt(np.mean([p.fitted() for p in others])):.2f} |\n"
    )


def main() -> None:
    """Print a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("presses", nargs="+", metavar="NAME=PRESSES")
    sys.stdout.write(
        "| presses, fitted + held out | Taxim's skirt | as wide as the fit's gel | width sought | "
        "fall by the fit's, presses | the fit's own gel |\n|---|---|---|---|---|---|\n"
    )
    for given in parser.parse_args().presses:
        name, _, path = given.partition("=")
        sys.stdout.write(row(name, Path(path)))
        sys.stdout.flush()


if __name__ == "__main__":
    main()

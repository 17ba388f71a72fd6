"""The picture of a ball press as a chain of small physical steps, each switched off at first.

A slope has one colour wherever it is (the plain table, or a table that was calibrated before); the
background is as photographed; the gel follows the ball. Every effect frees what its name says:

    labels → centre, contact radius → slope of the gel (blurred) → colour change by the table
    → cast shadow → illumination → cross-talk → gain and offset → vignetting → the camera clips

The order is the renderer's (``tacgen.optics``), so that what is found can be rendered.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tacgen.calibrate.lookup.smooth_model import exponents, monomials, n_terms, normal_parts
from tacgen.core.arrays import FloatArray
from tacgen.diagnose.optics.pixels import PressPixels
from tacgen.diagnose.optics.surface import Profiles, Skin
from tacgen.optics.table import LookupTable
from tacgen.presses.geometry import MAX_RADIUS_SHARE, rest_slope

DEGREE = 6
"""Of the plain table's polynomial in the surface normal."""

NEAR_DEGREE = 2
"""Terms up to this degree may change with the place: lamps close by turn and dim their light."""


@dataclass(frozen=True, slots=True)
class Optics:
    """Every quantity of the chain; the defaults switch each effect off.

    Attributes
    ----------
    form, sharpness : see ``Skin``
    decay, contact_factor, ball_factor, sigma_mm : (1,) float
        Length of the skirt over the mean contact radius; contact radius over the labelled one;
        ball radius over the stated one; width of the membrane's Gaussian.
    weights : (n_columns, 3) float
        Of a table that is fitted; none of a given one.
    light : (3, 5) float
        What light of each channel gains with u², v², uv, u, v.
    dimming, dimming_all : (1,) float
        Loss of light at the corners, of the change alone or of the background too.
    mixing : (6,) float
        rg, rb, gr, gb, br, bg, as in ``tacgen.optics.effects.cross_talk``.
    shadow : (1,) float
        Share of a light that its shadow takes away.
    shadow_length_mm : float
        Length of the shadow of 1 mm of relief.
    hidden, unlit : (n, 3) and (3,) float
        Share of each channel's light that each pixel misses; colour change where none arrives.
    gain, offset : (3,) float
        What the picture differs from the background's exposure by: share, and grey levels.
    level, knee : (1,) float
        Where the camera clips, and over how much it bends towards that, grey levels.
    shift, growth : (N, 2) and (N, 1) float
        Error of each press's centre, and of its radius, in labelled radii.
    press_gain, press_offset : (N, 3) float
    """

    form: str = "skirt"
    sharpness: float = 20.0
    decay: FloatArray = field(default_factory=partial(np.full, 1, 0.4))
    contact_factor: FloatArray = field(default_factory=partial(np.ones, 1))
    ball_factor: FloatArray = field(default_factory=partial(np.ones, 1))
    sigma_mm: FloatArray = field(default_factory=partial(np.zeros, 1))
    weights: FloatArray = field(default_factory=partial(np.zeros, (0, 3)))
    light: FloatArray = field(default_factory=partial(np.zeros, (3, 5)))
    dimming: FloatArray = field(default_factory=partial(np.zeros, 1))
    dimming_all: FloatArray = field(default_factory=partial(np.zeros, 1))
    mixing: FloatArray = field(default_factory=partial(np.zeros, 6))
    shadow: FloatArray = field(default_factory=partial(np.zeros, 1))
    shadow_length_mm: float = 0.0
    hidden: FloatArray | None = None
    unlit: FloatArray = field(default_factory=partial(np.zeros, 3))
    gain: FloatArray = field(default_factory=partial(np.zeros, 3))
    offset: FloatArray = field(default_factory=partial(np.zeros, 3))
    level: FloatArray = field(default_factory=partial(np.full, 1, np.inf))
    knee: FloatArray = field(default_factory=partial(np.zeros, 1))
    shift: FloatArray = field(default_factory=partial(np.zeros, (0, 2)))
    growth: FloatArray = field(default_factory=partial(np.zeros, (0, 1)))
    press_gain: FloatArray = field(default_factory=partial(np.zeros, (0, 3)))
    press_offset: FloatArray = field(default_factory=partial(np.zeros, (0, 3)))

    def for_presses(self, n_presses: int, hidden: FloatArray | None = None) -> Optics:
        """The same for other presses, of which nothing is known yet."""
        return replace(
            self,
            shift=np.zeros((n_presses, 2)),
            growth=np.zeros((n_presses, 1)),
            press_gain=np.zeros((n_presses, 3)),
            press_offset=np.zeros((n_presses, 3)),
            hidden=hidden,
        )


@dataclass(frozen=True, slots=True)
class PlainTable:
    """A polynomial in the surface normal, fitted to the presses.

    Attributes
    ----------
    near : bool
        Let the terms of low degree change with the place in the image.
    """

    near: bool = False

    @property
    def n_columns(self) -> int:
        """How many weights a channel has."""
        return n_terms(DEGREE) + (5 * len(self.moving()) if self.near else 0)

    @staticmethod
    def moving() -> list[int]:
        """Which terms may change with the place."""
        low = [t for t, (i, j) in enumerate(exponents(DEGREE)) if i + j <= NEAR_DEGREE]
        return [*low, n_terms(DEGREE) - 1]

    def roughness(self) -> NDArray[np.float64]:
        """What the ridge charges for each column: more for steep terms and for wide change."""
        cost = np.array([*(float(i + j) ** 2 for i, j in exponents(DEGREE)), 1.0]) / 16.0
        if not self.near:
            return cost
        place = np.array([16.0, 16.0, 16.0, 4.0, 4.0])
        return np.concatenate([cost, (cost[self.moving()][:, None] * place).ravel()])

    def columns(self, gx: FloatArray, gy: FloatArray, pixels: PressPixels) -> FloatArray:
        """Terms, and those of low degree times every feature of position."""
        terms = monomials(*normal_parts(gx, gy), DEGREE)
        if pixels.dome_radius_mm > 0:
            rest = rest_slope(pixels.x_mm, pixels.y_mm, pixels.dome_radius_mm)
            terms = terms - monomials(*normal_parts(*rest), DEGREE)
        if not self.near:
            return terms
        moving = terms[:, self.moving(), None] * pixels.position[:, None, :5]
        return np.hstack([terms, moving.reshape(len(terms), -1)])

    def change(
        self,
        gx: FloatArray,
        gy: FloatArray,
        pixels: PressPixels,
        columns: FloatArray,
        w: FloatArray,
    ) -> FloatArray:
        """The weighted sum of the columns."""
        return np.asarray(columns @ w)

    def position_weights(self, weights: FloatArray) -> NDArray[np.float64]:
        """The weights as a smooth model has them: (n_terms, 6, 3)."""
        full = np.zeros((n_terms(DEGREE), 6, 3))
        full[:, 5] = weights[: len(full)]
        if self.near:
            full[self.moving(), :5] = weights[len(full) :].reshape(-1, 5, 3)
        return full


@dataclass(frozen=True, slots=True)
class GivenTable:
    """A table that was calibrated before: nothing of it is fitted."""

    table: LookupTable
    n_columns: int = 0

    def columns(self, gx: FloatArray, gy: FloatArray, pixels: PressPixels) -> FloatArray:
        """None."""
        return np.zeros((len(gx), 0))

    def change(
        self,
        gx: FloatArray,
        gy: FloatArray,
        pixels: PressPixels,
        columns: FloatArray,
        w: FloatArray,
    ) -> FloatArray:
        """What the renderer looks up, less what it looks up for the gel at rest."""
        change = self._look_up(gx, gy, pixels)
        if pixels.dome_radius_mm > 0:
            rest = rest_slope(pixels.x_mm, pixels.y_mm, pixels.dome_radius_mm)
            change = change - self._look_up(*rest, pixels)
        return change

    def _look_up(self, gx: FloatArray, gy: FloatArray, pixels: PressPixels) -> FloatArray:
        nodes = self.table.coefficients
        n_slope, n_direction = nodes.shape[:2]
        slope = np.minimum(np.arctan(np.hypot(gx, gy)) / self.table.max_slope_rad, 1.0)
        at = np.minimum(slope * (n_slope - 1), n_slope - 1 - 1e-6)
        turn = (np.arctan2(gy, gx) + np.pi) / (2 * np.pi) * n_direction
        i, j = at.astype(int), turn.astype(int) % n_direction
        up, on = at - i, turn - np.floor(turn)
        if self.table.interpolation == "floor":
            up, on = np.zeros_like(up), np.zeros_like(on)
        after = (j + 1) % n_direction
        change = np.zeros((len(gx), 3))
        corners = (
            (i, j, (1 - up) * (1 - on)),
            (i + 1, j, up * (1 - on)),
            (i, after, (1 - up) * on),
            (i + 1, after, up * on),
        )
        for row, column, share in corners:
            here = np.einsum("ncf,nf->nc", nodes[row, column], pixels.position)
            change += share[:, None] * here
        return change


@dataclass(frozen=True, slots=True)
class Picture:
    """Grey levels (n, 3), the columns behind them, and what a unit of change adds (n, 3)."""

    grey: FloatArray
    columns: FloatArray
    per_change: FloatArray


def geometry_of(state: Optics, pixels: PressPixels) -> NDArray[np.float64]:
    """Centre and contact radius (N, 3) of every press, mm."""
    labels = pixels.labels
    center = labels[:, :2] + state.shift * labels[:, 2:]
    radius = labels[:, 2] * state.contact_factor[0] * (1 + state.growth[:, 0])
    limit = MAX_RADIUS_SHARE * pixels.ball_mm * state.ball_factor[0]
    return np.column_stack([center, np.clip(radius, 0.1 * labels[:, 2], limit)])


def skin_of(state: Optics, pixels: PressPixels) -> Skin:
    """The surface's form, in mm."""
    length = float(state.decay[0] * pixels.labels[:, 2].mean())
    return Skin(state.form, length, state.sharpness, float(state.sigma_mm[0]))


def surface_slopes(
    state: Optics, pixels: PressPixels, profiles: Profiles
) -> tuple[FloatArray, FloatArray]:
    """Slope of the gel (n,) along x and along y."""
    place = geometry_of(state, pixels)[pixels.press]
    dx, dy = pixels.x_mm - place[:, 0], pixels.y_mm - place[:, 1]
    r = np.hypot(dx, dy)
    balls = pixels.ball_mm * state.ball_factor[0]
    slope = profiles.slopes(skin_of(state, pixels), r, place[:, 2], balls[pixels.press])
    per_mm = slope / np.maximum(r, 1e-9)
    rest = rest_slope(pixels.x_mm, pixels.y_mm, pixels.dome_radius_mm)
    return per_mm * dx + rest[0], per_mm * dy + rest[1]


def render(
    state: Optics, pixels: PressPixels, table: PlainTable | GivenTable, profiles: Profiles
) -> Picture:
    """The grey levels that ``state`` gives every pixel."""
    gx, gy = surface_slopes(state, pixels, profiles)
    columns = table.columns(gx, gy, pixels)
    change = table.change(gx, gy, pixels, columns, state.weights)
    per_change: FloatArray = np.ones_like(change)
    if state.hidden is not None and state.shadow[0] != 0:
        lost = state.shadow[0] * state.hidden * (change > state.unlit)
        change, per_change = change - lost * (change - state.unlit), 1 - lost
    brighter = 1 + pixels.position[:, :5] @ state.light.T
    change, per_change = change * brighter, per_change * brighter
    if state.mixing.any():
        change = change + change @ mixing_matrix(state.mixing)
    square = 2 * (pixels.position[:, 0] + pixels.position[:, 1])[:, None]
    dim, dim_all = 1 - state.dimming[0] * square, 1 - state.dimming_all[0] * square
    gain = 1 + state.gain + state.press_gain[pixels.press]
    offset = state.offset + state.press_offset[pixels.press]
    grey = ((pixels.background + change * dim) * gain + offset) * dim_all
    per_change = per_change * dim * gain * dim_all
    if np.isfinite(state.level[0]):
        grey, passed = clipped(grey, float(state.level[0]), float(state.knee[0]))
        per_change = per_change * passed
    return Picture(grey, columns, per_change)


def clipped(grey: FloatArray, level: float, knee: float) -> tuple[FloatArray, FloatArray]:
    """Grey levels below ``level``, bent over ``knee``, and what a grey level more adds to them."""
    if knee < 0.05:
        return np.minimum(grey, level), (grey < level).astype(np.float64)
    under = (level - grey) / knee
    return level - knee * np.logaddexp(0.0, under), 1 / (1 + np.exp(-np.clip(under, -50, 50)))


def mixing_matrix(mixing: FloatArray) -> NDArray[np.float64]:
    """(3, 3): row is the channel that leaks, column the one it shows in."""
    rg, rb, gr, gb, br, bg = mixing
    return np.array([[0.0, gr, br], [rg, 0.0, bg], [rb, gb, 0.0]])

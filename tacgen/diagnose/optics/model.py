"""The picture of a ball press as a chain of small physical steps, each switched off at first.

A slope has one colour wherever it is (the plain table, or a table that was calibrated before); the
background is as photographed; the gel follows the ball. Every optical effect
(``tacgen.optics.effects``) acts at its own place:

    labels → place of the ball → slope of the gel → colour change by the table → image → camera

The order is the renderer's, so that what is found can be rendered.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.calibrate.lookup.smooth_model import (
    exponents,
    monomials,
    normal_parts,
)
from tacgen.core.arrays import FloatArray
from tacgen.diagnose.optics.pixels import PressPixels
from tacgen.diagnose.optics.rules import RULES, SelectionRules
from tacgen.diagnose.optics.surface import Profiles
from tacgen.optics.effects import (
    OpticalEffect,
    Parameter,
    PressScene,
    Relief,
    Stage,
    optical_effect,
    optical_effects,
)
from tacgen.optics.table import LookupTable, contact_at, leds_of_table, response_at
from tacgen.presses.geometry import MAX_RADIUS_SHARE, Membrane, rest_height, rest_slope

Key = tuple[str, str]
"""Name of an effect, and of its parameter."""


@dataclass(frozen=True, slots=True)
class FreeParameter:
    """A parameter that a fit may change: of all presses, or what each press differs by."""

    effect: str
    name: str
    parameter: Parameter
    each_press: bool = False

    @property
    def key(self) -> Key:
        """Where a state keeps it."""
        return self.effect, self.name

    @property
    def identity(self) -> float:
        """Where it does nothing."""
        return 0.0 if self.each_press else self.parameter.identity

    @property
    def is_of_surface(self) -> bool:
        """Whether it changes the slopes of the gel, not their colours alone."""
        return not self.effect or optical_effect(self.effect).stage <= Stage.SURFACE


SKIRT = FreeParameter("", "skirt_per_radius", Parameter(0.0, 0.02, 3.0))
"""Not an effect: how far the gel is drawn in around a ball belongs to every gel. In mean labelled
contact radii."""


@dataclass(frozen=True, slots=True)
class ModelState:
    """Every number of the chain; effects that it does not name do nothing.

    Attributes
    ----------
    form : str
        Of the gel around a ball, see ``tacgen.diagnose.optics.surface``.
    sharpness : float
        Of the joint of ball and tail; a given table may have been calibrated with a rounder one.
    weights : (n_columns, 3) float
        Of a table that is fitted; none of a given one.
    shared : mapping
        (effect, parameter) → its value for all presses.
    own : mapping
        (effect, parameter) → (N,) float, what each press differs by.
    prepared : mapping
        Effect → what its ``before_fit`` gave for these presses.
    """

    form: str = "skirt"
    sharpness: float = RULES.joint_sharpness
    weights: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    shared: Mapping[Key, float] = field(
        default_factory=lambda: MappingProxyType({SKIRT.key: RULES.first_skirt_radii})
    )
    own: Mapping[Key, FloatArray] = field(default_factory=lambda: MappingProxyType({}))
    prepared: Mapping[str, Mapping[str, FloatArray]] = field(
        default_factory=lambda: MappingProxyType({})
    )

    def value(self, free: FreeParameter) -> FloatArray:
        """A parameter's value: one number, or (N,) of each press."""
        if free.each_press:
            return self.own[free.key]
        return np.asarray(self.shared[free.key])

    def active(self, first: Stage, last: Stage) -> list[OpticalEffect]:
        """The effects of some stages that it names, in the order in which they act."""
        names = {name for name, _ in (*self.shared, *self.own)}
        return [effect for effect in optical_effects(first, last) if effect.name in names]

    def values_of(
        self, effect: OpticalEffect, press: NDArray[np.int64] | None = None
    ) -> dict[str, Any]:
        """An effect's parameters: numbers, or arrays by press where presses differ.

        ``press`` (n,) says of which presses; without it each press comes once.
        """
        values: dict[str, Any] = {}
        for name, parameter in effect.parameters.items():
            key = (effect.name, name)
            if key in self.shared:
                values[name] = self.shared[key]
            if key in self.own:
                own = self.own[key] if press is None else self.own[key][press]
                values[name] = values.get(name, parameter.identity) + own
        return values

    def without(self, effect: str) -> ModelState:
        """The same with an effect switched off."""
        return replace(
            self,
            shared={key: value for key, value in self.shared.items() if key[0] != effect},
            own={key: value for key, value in self.own.items() if key[0] != effect},
            prepared={name: kept for name, kept in self.prepared.items() if name != effect},
        )

    def for_presses(self, n_presses: int) -> ModelState:
        """The same for other presses, of which nothing is known yet."""
        return replace(
            self, own={key: np.zeros(n_presses) for key in self.own}, prepared=MappingProxyType({})
        )

    def of_pixels(self, which: NDArray[np.bool_]) -> Mapping[str, Mapping[str, FloatArray]]:
        """What effects prepared, of some of the pixels."""
        return {
            name: {key: values[which] for key, values in kept.items()}
            for name, kept in self.prepared.items()
        }


STEP_SINE = 0.1
"""Sine of the slope at which the step of a plain table is half way up."""


def plain_terms(gx: FloatArray, gy: FloatArray, degree: int) -> FloatArray:
    """Powers of the normal, and a step that tells gel that is touched from gel that is not."""
    nx, ny = normal_parts(gx, gy)
    square = nx * nx + ny * ny
    return np.column_stack([monomials(nx, ny, degree), square / (square + STEP_SINE**2)])


def n_plain_terms(degree: int) -> int:
    """How many terms ``plain_terms`` gives."""
    return len(exponents(degree)) + 1


@dataclass(frozen=True, slots=True)
class PlainTable:
    """A polynomial in the surface normal, fitted to the presses.

    Attributes
    ----------
    degree : int
    place_degree : int
        Let the terms up to this degree, and the step, change with the place in the image; none
        where it is negative.
    """

    degree: int
    place_degree: int = -1

    @property
    def n_columns(self) -> int:
        """How many weights a channel has."""
        return n_plain_terms(self.degree) + 5 * len(self.moving)

    @property
    def moving(self) -> list[int]:
        """Which terms change with the place."""
        if self.place_degree < 0:
            return []
        low = [t for t, (i, j) in enumerate(exponents(self.degree)) if i + j <= self.place_degree]
        return [*low, n_plain_terms(self.degree) - 1]

    def roughness(self) -> NDArray[np.float64]:
        """What the ridge charges for each column: more for steep terms and for wide change."""
        cost = np.array([*(float(i + j) ** 2 for i, j in exponents(self.degree)), 1.0])
        wide = cost[self.moving, None] * np.array([1.0, 1.0, 1.0, 0.25, 0.25])
        return np.concatenate([0.0625 * cost, wide.ravel()])

    def columns(self, gx: FloatArray, gy: FloatArray, pixels: PressPixels) -> FloatArray:
        """Terms, and those of low degree times every feature of position."""
        terms = plain_terms(gx, gy, self.degree)
        if pixels.dome_radius_mm > 0:
            rest = rest_slope(pixels.x_mm, pixels.y_mm, pixels.dome_radius_mm)
            terms = terms - plain_terms(*rest, self.degree)
        if not self.moving:
            return terms
        moving = terms[:, self.moving, None] * pixels.position[:, None, :5]
        return np.hstack([terms, moving.reshape(len(terms), -1)])

    def position_weights(self, weights: FloatArray) -> NDArray[np.float64]:
        """The weights as a smooth model has them: (n_terms, 6, 3)."""
        full = np.zeros((n_plain_terms(self.degree), 6, 3))
        full[:, 5] = weights[: len(full)]
        if self.moving:
            full[self.moving, :5] = weights[len(full) :].reshape(-1, 5, 3)
        return full


@dataclass(frozen=True, slots=True)
class GivenTable:
    """A table that was calibrated before: nothing of it is fitted."""

    table: LookupTable
    n_columns: int = 0

    def change(
        self, gx: FloatArray, gy: FloatArray, depth_mm: FloatArray, pixels: PressPixels
    ) -> FloatArray:
        """What the renderer looks up, less what it looks up for the gel at rest."""
        change = self._look_up(gx, gy, pixels)
        if self.table.contact is not None:
            u, v = pixels.position[:, 3], pixels.position[:, 4]
            change = change + contact_at(self.table, gx, gy, depth_mm, u, v)
        if pixels.dome_radius_mm > 0:
            rest = rest_slope(pixels.x_mm, pixels.y_mm, pixels.dome_radius_mm)
            change = change - self._look_up(*rest, pixels)
        return change

    def _look_up(self, gx: FloatArray, gy: FloatArray, pixels: PressPixels) -> FloatArray:
        if self.table.response is not None:
            return response_at(self.table, gx, gy, pixels.position[:, 3], pixels.position[:, 4])
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
class Problem:
    """What a fit works on: the pixels, the table and the surface's profiles."""

    pixels: PressPixels
    table: PlainTable | GivenTable
    profiles: Profiles
    rules: SelectionRules = RULES


def geometry_of(problem: Problem, state: ModelState) -> tuple[FloatArray, FloatArray]:
    """Centre and contact radius (N, 3) of every press, and its ball's radius (N,), mm."""
    labels, balls = problem.pixels.labels, problem.pixels.ball_mm
    places = labels
    for effect in state.active(Stage.PRESS, Stage.PRESS):
        places, balls = effect.on_press(places, balls, **state.values_of(effect))
    radius = np.clip(
        places[:, 2], problem.rules.least_contact * labels[:, 2], MAX_RADIUS_SHARE * balls
    )
    return np.column_stack([places[:, :2], radius]), balls


def membrane_of(state: ModelState, pixels: PressPixels) -> Membrane:
    """How the gel curves away from a ball, in mm."""
    return Membrane(state.shared[SKIRT.key] * float(pixels.labels[:, 2].mean()), state.sharpness)


def radial_slopes(
    problem: Problem, state: ModelState, r_mm: FloatArray, contact_mm: FloatArray, ball: FloatArray
) -> FloatArray:
    """Slope along the radius and depth (2, n), at distances (n,) from balls in contacts (n,)."""
    surface = state.active(Stage.SURFACE, Stage.SURFACE)
    effects = tuple(
        (effect.name, tuple(sorted(state.values_of(effect).items()))) for effect in surface
    )
    membrane = membrane_of(state, problem.pixels)
    return problem.profiles.slopes(state.form, membrane, r_mm, contact_mm, ball, effects)


def surface_slopes(
    problem: Problem, state: ModelState
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Slope of the gel (n,) along x and along y, and its depth below its rest, mm."""
    pixels = problem.pixels
    places, balls = geometry_of(problem, state)
    place = places[pixels.press]
    dx, dy = pixels.x_mm - place[:, 0], pixels.y_mm - place[:, 1]
    r = np.hypot(dx, dy)
    slope, depth = radial_slopes(problem, state, r, place[:, 2], balls[pixels.press])
    per_mm = slope / np.maximum(r, 1e-9)
    rest = rest_slope(pixels.x_mm, pixels.y_mm, pixels.dome_radius_mm)
    return per_mm * dx + rest[0], per_mm * dy + rest[1], depth


@dataclass(frozen=True, slots=True)
class Colors:
    """What the table says of the gel's slopes: change of grey levels (n, 3), columns behind it."""

    change: FloatArray
    columns: FloatArray


def colors_of(problem: Problem, state: ModelState) -> Colors:
    """The table's answer, before shadows and the camera."""
    gx, gy, depth = surface_slopes(problem, state)
    if isinstance(problem.table, GivenTable):
        return Colors(problem.table.change(gx, gy, depth, problem.pixels), np.zeros((len(gx), 0)))
    columns = problem.table.columns(gx, gy, problem.pixels)
    return Colors(columns @ state.weights, columns)


def photograph(problem: Problem, state: ModelState, change: FloatArray) -> FloatArray:
    """Grey levels (n, 3) that the camera gives of a change of colour."""
    pixels, patch = problem.pixels, problem.pixels.patch
    grey: FloatArray = pixels.background + change
    for effect in state.active(Stage.SHADOW, Stage.CAMERA):
        values = state.values_of(effect, pixels.press)
        grey = effect.on_pixels(grey, patch, **values, **state.prepared.get(effect.name, {}))
    return grey


def render(problem: Problem, state: ModelState) -> FloatArray:
    """The grey levels (n, 3) that ``state`` gives every pixel."""
    return photograph(problem, state, colors_of(problem, state).change)


def prepared(
    problem: Problem, state: ModelState, before: ModelState | None = None, *, only: str = ""
) -> ModelState:
    """``state`` with what its effects, or one of them, need to know of the presses.

    ``before`` is the same model as it was fitted to other presses.
    """
    scene, kept = scene_of(problem, state), dict(state.prepared)
    for effect in state.active(Stage.SHADOW, Stage.CAMERA):
        if only in ("", effect.name):
            earlier = {} if before is None else before.prepared.get(effect.name, {})
            kept[effect.name] = effect.before_fit(scene, earlier, **state.values_of(effect))
    return replace(state, prepared=kept)


def scene_of(problem: Problem, state: ModelState) -> PressScene:
    """What effects may ask about the presses and the model."""
    pixels, rules = problem.pixels, problem.rules

    def rendered(without: str) -> FloatArray:
        return render(problem, state.without(without) if without else state)

    def light_azimuths_rad() -> FloatArray:
        """By the slopes that the table brightens most."""
        if isinstance(problem.table, GivenTable):
            leds = leds_of_table(problem.table.table)
            return np.array([math.atan2(y, x) for (x, y, _), _ in leds])
        return np.asarray(np.arctan2(state.weights[1], state.weights[0]))

    def reliefs(reach_radii: float, cells_per_radius: int) -> Iterator[Relief]:
        expected = state.for_presses(pixels.n_presses)
        places, balls = geometry_of(problem, expected)
        for part, (x, y, radius), ball in zip(pixels.parts, places, balls, strict=True):
            cell_mm = max(pixels.mm_per_px, radius / cells_per_radius)
            half = math.ceil(reach_radii * radius / cell_mm)
            side = np.arange(-half, half + 1) * cell_mm
            r = np.linspace(0.0, rules.profile_reach_radii * radius, rules.relief_points)
            one = np.ones(len(r))
            _, depth = radial_slopes(problem, expected, r, radius * one, ball * one)
            relief = np.interp(np.hypot(side[None, :], side[:, None]), r, -depth)
            across, down = np.meshgrid(x + side, y + side)
            relief = relief + rest_height(across, down, pixels.dome_radius_mm)
            at = [
                (pixels.y_mm[part] - y) / cell_mm + half,
                (pixels.x_mm[part] - x) / cell_mm + half,
            ]
            yield part, relief.astype(np.float32), cell_mm, at

    return PressScene(
        contact_radius_mm=float(pixels.labels[:, 2].mean()),
        ball_radii_mm=pixels.ball_mm,
        has_table=isinstance(problem.table, GivenTable),
        patch=pixels.patch,
        grey=pixels.grey,
        rendered=rendered,
        light_azimuths_rad=light_azimuths_rad,
        reliefs=reliefs,
    )

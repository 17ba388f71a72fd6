"""Which pixels a ball's dent hides from each channel's light."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from tacgen.core.arrays import FloatArray
from tacgen.diagnose.optics.fit import Problem
from tacgen.diagnose.optics.model import GivenTable, Optics, geometry_of, render, skin_of
from tacgen.optics.shadow import cast_shadow, leds_of_table
from tacgen.presses.geometry import rest_height

LENGTHS_MM = (1.0, 2.0, 4.0, 7.0)
"""Shadows of 1 mm of relief that are tried: lights 45° to 8° above the gel."""

_RADII_AROUND = 2.4
_CELLS_PER_RADIUS = 24


def azimuths(problem: Problem, state: Optics) -> NDArray[np.float64]:
    """Direction (3,) from which each channel is lit: the slope that the table brightens most."""
    if isinstance(problem.table, GivenTable):
        leds = leds_of_table(problem.table.table)
        return np.array([math.atan2(y, x) for (x, y, _), _ in leds])
    return np.arctan2(state.weights[1], state.weights[0])


def with_shadow(problem: Problem, state: Optics, length_mm: float) -> Optics:
    """``state`` with the pixels that shadows of this length reach; their strength stays."""
    plain = replace(state, hidden=None)
    change = render(plain, problem.pixels, problem.table, problem.profiles).grey
    unlit = np.quantile(change - problem.pixels.background, 0.002, axis=0)
    found = replace(state, shadow_length_mm=length_mm, unlit=unlit)
    return replace(found, hidden=hidden_light(problem, found, azimuths(problem, state)))


def hidden_light(problem: Problem, state: Optics, azimuth: FloatArray) -> NDArray[np.float64]:
    """Share (n, 3) of each channel's light that each pixel misses.

    The balls are taken where their labels say, so that a held-out press gives nothing away.
    """
    pixels = problem.pixels
    expected = state.for_presses(pixels.n_presses)
    places, skin = geometry_of(expected, pixels), skin_of(state, pixels)
    hidden = np.zeros((len(pixels), 3))
    ends = np.searchsorted(pixels.press, np.arange(pixels.n_presses + 1))
    norm = math.hypot(1, state.shadow_length_mm)
    flat, rise = state.shadow_length_mm / norm, 1 / norm
    for k, (x, y, radius) in enumerate(places):
        part = slice(ends[k], ends[k + 1])
        cell_mm = max(pixels.mm_per_px, radius / _CELLS_PER_RADIUS)
        half = math.ceil(_RADII_AROUND * radius / cell_mm)
        side = np.arange(-half, half + 1) * cell_mm
        r = np.linspace(0.0, 3.0 * radius, 151)
        ball = np.full(len(r), pixels.ball_mm[k] * state.ball_factor[0])
        slope = problem.profiles.slopes(skin, r, np.full(len(r), radius), ball)
        inwards = np.concatenate([[0.0], np.cumsum(0.5 * (slope[1:] + slope[:-1]) * np.diff(r))])
        relief = np.interp(np.hypot(side[None, :], side[:, None]), r, inwards - inwards[-1])
        relief = relief + rest_height(
            x + side[None, :] + 0 * side[:, None],
            y + side[:, None] + 0 * side[None, :],
            pixels.dome_radius_mm,
        )
        at = [
            (pixels.y_mm[part] - y) / cell_mm + half,
            (pixels.x_mm[part] - x) / cell_mm + half,
        ]
        for channel in range(3):
            towards = (
                flat * math.cos(azimuth[channel]), flat * math.sin(azimuth[channel]), -rise
            )  # fmt: skip
            shade = cast_shadow(relief.astype(np.float32), cell_mm, towards)
            hidden[part, channel] = map_coordinates(shade, at, order=1, mode="nearest")
    return hidden


def best_length_mm(problem: Problem, state: Optics) -> float:
    """The length whose shadows explain most of what ``state`` leaves over."""
    grey = render(state, problem.pixels, problem.table, problem.profiles).grey
    error = problem.pixels.grey - grey
    worth = {}
    for length in LENGTHS_MM:
        shaded = with_shadow(problem, state, length)
        if shaded.hidden is None:
            continue
        lit = np.maximum(grey - problem.pixels.background - shaded.unlit, 0)
        column = -shaded.hidden * lit
        square = float((column**2).sum())
        worth[length] = max(float((column * error).sum()), 0.0) ** 2 / max(square, 1e-9)
    return max(worth, key=lambda length: worth[length])

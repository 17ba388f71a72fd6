"""How a response follows the history of what drives it.

A course is (K, N), or (K, N, 2) for a vector: one row a trial, on the clock's fine steps, between
which it is linear.
"""

from __future__ import annotations

import numpy as np

from validation.blind.independent.draws import Floats
from validation.blind.independent.session import Clock


def like(weights: Floats, course: Floats) -> Floats:
    """One weight a step, in a shape that multiplies all columns of a course."""
    return weights.reshape(weights.shape + (1,) * (course.ndim - weights.ndim))


def relaxed(time_s: Floats, course: Floats, tau_s: float, start: Floats | float = 0.0) -> Floats:
    """State x with x' = (course - x) / tau: a Kelvin-Voigt body or a low pass, stepped exactly."""
    steps = np.diff(time_s, axis=1) / tau_s
    kept = np.exp(-steps)
    # Mean of what is kept over a step; its series where the quotient loses digits.
    mean = np.where(steps > 1e-6, (1 - kept) / np.maximum(steps, 1e-6), 1 - steps / 2)
    kept, mean = like(kept, course), like(mean, course)
    state = np.zeros_like(course)
    state[:, 0] = start
    for step in range(steps.shape[1]):
        state[:, step + 1] = (
            kept[:, step] * state[:, step]
            + (mean[:, step] - kept[:, step]) * course[:, step]
            + (1 - mean[:, step]) * course[:, step + 1]
        )
    return state


def kelvin_voigt(clock: Clock, course: Floats, tau_s: float) -> Floats:
    """Creep of a Kelvin-Voigt body; what is left after a pause is there in the next trial."""
    state = relaxed(clock.time_s, course, tau_s)
    pauses_s = np.diff(clock.start_s) - clock.duration_s[:-1]
    for trial, pause_s in enumerate(pauses_s, start=1):
        left = state[trial - 1, -1] * np.exp(-pause_s / tau_s)
        state[trial] += left * like(np.exp(-clock.time_s[trial] / tau_s), state[trial])
    return state


def integral(time_s: Floats, course: Floats) -> Floats:
    """Integral over the time from the start of the trial (a Maxwell body's flow)."""
    areas = 0.5 * (course[:, 1:] + course[:, :-1]) * like(np.diff(time_s, axis=1), course)
    return np.concatenate([np.zeros_like(course[:, :1]), np.cumsum(areas, axis=1)], axis=1)


def play(course: Floats, width: float) -> Floats:
    """Play operator (Prandtl-Ishlinskii): follows once the course is ``width`` away."""
    state = np.zeros_like(course)
    state[:, 0] = np.clip(0, course[:, 0] - width, course[:, 0] + width)
    for step in range(1, course.shape[1]):
        now = course[:, step]
        state[:, step] = np.clip(state[:, step - 1], now - width, now + width)
    return state


def vector_play(course: Floats, width: float) -> Floats:
    """Play operator in the plane: dragged along by a circle of radius ``width``."""
    state = np.zeros_like(course)
    for step in range(1, course.shape[1]):
        away = course[:, step] - state[:, step - 1]
        size = np.hypot(away[:, 0], away[:, 1])
        moved = np.where(size > width, 1 - width / np.maximum(size, 1e-12), 0)
        state[:, step] = state[:, step - 1] + away * moved[:, None]
    return state


def dahl(course: Floats, width: float) -> Floats:
    """Dahl's friction state, at most 1 in size: dz = (dx - |dx| z) / width, stepped exactly."""
    steps = np.diff(course, axis=1)
    sizes = np.abs(steps) if course.ndim == 2 else np.hypot(*np.moveaxis(steps, -1, 0))[..., None]
    kept = np.exp(-sizes / width)
    direction = np.where(sizes > 1e-12, steps / np.maximum(sizes, 1e-12), 0)
    state = np.zeros_like(course)
    for step in range(steps.shape[1]):
        ahead = direction[:, step]
        state[:, step + 1] = ahead + (state[:, step] - ahead) * kept[:, step]
    return state


def delayed(time_s: Floats, course: Floats, delay_s: float) -> Floats:
    """The course a while ago; held before the start and after the end."""
    return np.stack(
        [np.interp(time - delay_s, time, one) for time, one in zip(time_s, course, strict=True)]
    )


def running_mean(time_s: Floats, course: Floats, window_s: float) -> Floats:
    """Mean of the course (K, N) over the window up to each step; held before the start."""
    means = []
    for time, one in zip(time_s, course, strict=True):
        knots_s, knots = np.append(time[0] - window_s, time), np.append(one[0], one)
        areas = integral(knots_s[None], knots[None])[0]
        start_s = np.maximum(time - window_s, knots_s[0])
        before = np.searchsorted(knots_s, start_s, side="right") - 1
        # Exact within a step too. Between knots the area is no straight line: taken for one, the
        # mean comes half a step late however short the window is.
        part = 0.5 * (knots[before] + np.interp(start_s, knots_s, knots))
        start_area = areas[before] + part * (start_s - knots_s[before])
        means.append((areas[1:] - start_area) / window_s)
    return np.stack(means)

"""Fitting the images' chain: Gauss–Newton over whole presses, folds left out, held-out error.

A press's own quantities (its centre, its exposure) are eliminated press by press, so that what is
left is one small system for what all presses share, a sum over presses: leaving a fold out is
leaving its terms out of the sum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tacgen.core.arrays import FloatArray
from tacgen.diagnose.optics.model import GivenTable, Optics, PlainTable, render
from tacgen.diagnose.optics.pixels import PressPixels
from tacgen.diagnose.optics.surface import Profiles

RIDGE = 1e-4
"""Of the plain table, relative to the mean of its normal matrix."""

CORRELATED_PIXELS = 6.0
"""Residuals of neighbouring lattice pixels go together: so many count as one."""

HELDOUT_STEPS = 4

DONE = 1e-4
"""A step that lowers the squared error by less than this share is the last."""


@dataclass(frozen=True, slots=True)
class Knob:
    """A quantity that a fit may turn: an entry of an array of ``Optics``, or one a press.

    ``step`` is for the finite difference, ``prior`` a standard deviation around the value that
    does nothing (0: none).
    """

    key: str
    index: int
    step: float
    lower: float
    upper: float
    prior: float = 0.0
    unit: str = "1"
    name: str = ""
    each_press: bool = False


@dataclass(frozen=True, slots=True)
class Problem:
    """What a fit works on: the pixels, the table and the surface's profiles."""

    pixels: PressPixels
    table: PlainTable | GivenTable
    profiles: Profiles


@dataclass(frozen=True, slots=True)
class System:
    """Normal matrix (N, D, D) and gradient (N, D) of every press, own quantities eliminated."""

    matrices: FloatArray
    gradients: FloatArray
    penalty: FloatArray
    pull: FloatArray

    def step(self, kept: NDArray[np.bool_]) -> NDArray[np.float64]:
        """The Gauss–Newton step of the presses that are kept."""
        matrix = self.matrices[kept].sum(axis=0)
        matrix = matrix + np.diag(self.penalty + 1e-9 * (np.diag(matrix) + 1e-9))
        return np.linalg.solve(matrix, self.gradients[kept].sum(axis=0) + self.pull)

    def stderr(self) -> NDArray[np.float64]:
        """Standard errors (D,), robust to whatever goes together within a press."""
        inverse = np.linalg.pinv(self.matrices.sum(axis=0) + np.diag(self.penalty))
        spread = self.gradients.T @ self.gradients
        return np.sqrt(np.maximum(np.diag(inverse @ spread @ inverse), 0.0))


def turned(state: Optics, knobs: Sequence[Knob], amounts: FloatArray) -> Optics:
    """``state`` with every knob turned by its amount (scalar, or (N,) of one a press)."""
    changed: dict[str, NDArray] = {}
    for knob, amount in zip(knobs, amounts, strict=True):
        values = changed.get(knob.key)
        if values is None:
            values = np.array(getattr(state, knob.key), dtype=np.float64)
        if knob.each_press:
            now = values[:, knob.index]
            values[:, knob.index] = np.clip(now + amount, knob.lower, knob.upper)
        else:
            flat = values.reshape(-1)
            flat[knob.index] = np.clip(flat[knob.index] + amount, knob.lower, knob.upper)
        changed[knob.key] = values
    return replace(state, **changed) if changed else state  # type: ignore[arg-type]


def _value(state: Optics, knob: Knob) -> FloatArray:
    values = getattr(state, knob.key)
    return np.asarray(values[:, knob.index] if knob.each_press else values.reshape(-1)[knob.index])


def _identity(knob: Knob) -> float:
    return float(np.ravel(getattr(Optics(), knob.key))[knob.index]) if not knob.each_press else 0.0


def _slopes(problem: Problem, state: Optics, knobs: Sequence[Knob], grey: FloatArray) -> FloatArray:
    """Derivatives (n, 3, len(knobs)) of the grey levels."""
    columns = [np.zeros((*grey.shape, 0))]
    for knob in knobs:
        step = knob.step if np.all(_value(state, knob) < knob.upper - knob.step) else -knob.step
        amount = np.full(problem.pixels.n_presses, step) if knob.each_press else step
        moved = turned(state, [knob], [amount])  # type: ignore[arg-type]
        picture = render(moved, problem.pixels, problem.table, problem.profiles)
        columns.append(((picture.grey - grey) / step)[..., None])
    return np.concatenate(columns, axis=2)


def linearise(
    problem: Problem,
    state: Optics,
    shared: Sequence[Knob],
    own: Sequence[Knob],
    weight: FloatArray | None = None,
) -> tuple[System, list[tuple[FloatArray, FloatArray]], float]:
    """The system at ``state``, what each press's own step needs, and the mean squared error."""
    pixels, table = problem.pixels, problem.table
    picture = render(state, pixels, table, problem.profiles)
    error = pixels.grey - picture.grey
    mean_square = float((error**2).mean())
    by_shared = _slopes(problem, state, shared, picture.grey)
    by_own = _slopes(problem, state, own, picture.grey)
    n_weights = 3 * table.n_columns
    size, noise = n_weights + len(shared), max(mean_square, 0.05) * CORRELATED_PIXELS
    prior = np.array([noise / knob.prior**2 for knob in own])
    matrices = np.zeros((pixels.n_presses, size, size))
    gradients = np.zeros((pixels.n_presses, size))
    backs: list[tuple[FloatArray, FloatArray]] = []
    ends = np.searchsorted(pixels.press, np.arange(pixels.n_presses + 1))
    for k in range(pixels.n_presses):
        part = slice(ends[k], ends[k + 1])
        mine = by_own[part]
        cross, square = np.zeros((size, len(own))), np.diag(prior)
        pull: FloatArray = np.zeros(len(own))
        for channel in range(3):
            kept = 1.0 if weight is None else weight[part, channel, None]
            scale = picture.per_change[part, channel, None]
            columns = np.hstack([picture.columns[part] * scale, by_shared[part, channel]])
            at = _places(channel, table.n_columns, len(shared))
            residual, beside = error[part, channel], mine[:, channel]
            matrices[k][np.ix_(at, at)] += (columns * kept).T @ columns
            gradients[k][at] += (columns * kept).T @ residual
            cross[at] += (columns * kept).T @ beside
            square = square + (beside * kept).T @ beside
            pull = pull + (beside * kept).T @ residual
        if own:
            now = np.array([float(_value(state, knob)[k]) for knob in own])
            solved = np.linalg.solve(square, np.column_stack([cross.T, pull - prior * now]))
            matrices[k] -= cross @ solved[:, :-1]
            gradients[k] -= cross @ solved[:, -1]
            backs.append((solved[:, -1], solved[:, :-1]))
    penalties = _penalties(problem, state, shared, matrices, noise)
    return System(matrices, gradients, *penalties), backs, mean_square


def _places(channel: int, n_columns: int, n_shared: int) -> NDArray[np.int64]:
    """Where a channel's weights, and what is shared, stand among all unknowns."""
    weights = np.arange(channel * n_columns, (channel + 1) * n_columns)
    return np.concatenate([weights, 3 * n_columns + np.arange(n_shared)])


def _penalties(
    problem: Problem, state: Optics, shared: Sequence[Knob], matrices: FloatArray, noise: float
) -> tuple[FloatArray, FloatArray]:
    """The ridge of the table and the knobs' priors: diagonal, and pull towards doing nothing."""
    penalty = np.array([noise / k.prior**2 if k.prior else 0.0 for k in shared])
    apart = np.array([float(_value(state, k)) - _identity(k) if k.prior else 0.0 for k in shared])
    if not isinstance(problem.table, PlainTable):
        return penalty, -penalty * apart
    n_weights = 3 * problem.table.n_columns
    mean = float(np.einsum("kii->k", matrices[:, :n_weights, :n_weights]).sum()) / n_weights
    ridge = np.tile(RIDGE * mean * problem.table.roughness(), 3)
    both = np.concatenate([ridge, penalty])
    return both, -both * np.concatenate([state.weights.T.ravel(), apart])


def advance(problem: Problem, state: Optics, shared: Sequence[Knob], step: FloatArray) -> Optics:
    """``state`` after a step of the table's weights and the shared knobs."""
    n_weights = 3 * problem.table.n_columns
    moved = turned(state, shared, step[n_weights:])
    if not n_weights:
        return moved
    return replace(moved, weights=state.weights + step[:n_weights].reshape(3, -1).T)


def fit(
    problem: Problem,
    state: Optics,
    shared: Sequence[Knob],
    own: Sequence[Knob],
    *,
    steps: int,
    weight: FloatArray | None = None,
) -> tuple[Optics, System]:
    """Gauss–Newton; a step that makes the fit worse is halved. Returns state and system."""
    kept = np.ones(problem.pixels.n_presses, dtype=bool)
    system, backs, least = linearise(problem, state, shared, own, weight)
    for _ in range(steps):
        step = _bounded(problem, shared, system.step(kept))
        moves = np.array([back[0] - back[1] @ step for back in backs])
        for share in (1.0, 0.4, 0.1):
            moved = advance(problem, state, shared, share * step)
            if own:
                moved = turned(moved, own, share * _own_step(own, moves))
            if weight is not None or mean_square(problem, moved) < least:
                break
        else:
            break
        state = moved
        system, backs, square = linearise(problem, state, shared, own, weight)
        if weight is None and square > (1 - DONE) * least:
            break
        least = square
    return state, system


def _own_step(own: Sequence[Knob], moves: FloatArray) -> NDArray[np.float64]:
    """The step (n_own, N) of each press's quantities: no more than a quarter of their range."""
    limits = np.array([0.25 * (knob.upper - knob.lower) for knob in own])
    return np.asarray(np.clip(moves, -limits, limits).T)


def _bounded(problem: Problem, shared: Sequence[Knob], step: FloatArray) -> FloatArray:
    """No knob goes farther in one step than a third of its range, at most 40 of its nudges."""
    limits = [min(40 * knob.step, (knob.upper - knob.lower) / 3) for knob in shared]
    n_weights = 3 * problem.table.n_columns
    bounded = step.copy()
    bounded[n_weights:] = np.clip(step[n_weights:], -np.array(limits), limits)
    return bounded


def mean_square(problem: Problem, state: Optics) -> float:
    """Mean squared error of a state on the presses it was fitted to."""
    grey = render(state, problem.pixels, problem.table, problem.profiles).grey
    return float(((problem.pixels.grey - grey) ** 2).mean())


def without_fold(
    problem: Problem,
    state: Optics,
    system: System,
    shared: Sequence[Knob],
    kept: NDArray[np.bool_],
) -> Optics:
    """What a fit to the kept presses alone gives: one more step from the fit to all."""
    return advance(problem, state, shared, _bounded(problem, shared, system.step(kept)))


def heldout_errors(
    problem: Problem, state: Optics, own: Sequence[Knob], noise: float
) -> FloatArray:
    """Residuals (n, 3) of presses that had no part in ``state``.

    A press's own quantities are estimated on one colour of the chess board of blocks and scored
    on the other, both ways.
    """
    pixels = problem.pixels
    start = state.for_presses(pixels.n_presses, state.hidden)
    if not own:
        return np.asarray(pixels.grey - render(start, pixels, problem.table, problem.profiles).grey)
    errors = np.zeros_like(pixels.grey)
    for odd in (False, True):
        seen = pixels.odd == odd
        found = own_fit(problem, start, own, seen, noise)
        grey = render(found, pixels, problem.table, problem.profiles).grey
        errors[~seen] = (pixels.grey - grey)[~seen]
    return errors


def own_fit(
    problem: Problem, state: Optics, own: Sequence[Knob], seen: NDArray[np.bool_], noise: float
) -> Optics:
    """Each press's own quantities from the pixels that are ``seen`` (n,)."""
    pixels = problem.pixels
    prior = np.array([noise * CORRELATED_PIXELS / knob.prior**2 for knob in own])
    linear = all(knob.key.startswith("press_") for knob in own)
    for _ in range(2 if linear else HELDOUT_STEPS):
        grey = render(state, pixels, problem.table, problem.profiles).grey
        slopes = _slopes(problem, state, own, grey) * seen[:, None, None]
        error = pixels.grey - grey
        n_own = len(own)
        square = np.zeros((pixels.n_presses, n_own, n_own))
        np.add.at(square, pixels.press, np.einsum("nci,ncj->nij", slopes, slopes))
        pull = np.zeros((pixels.n_presses, n_own))
        np.add.at(pull, pixels.press, np.einsum("nci,nc->ni", slopes, error))
        now = np.stack([_value(state, knob) for knob in own], axis=-1)
        step = np.linalg.solve(square + np.diag(prior), (pull - prior * now)[..., None])[..., 0]
        state = turned(state, own, _own_step(own, step))
    return state

"""Fitting the images' chain: Gauss–Newton over whole presses, folds held out, held-out error.

What a press has of its own (its centre, its exposure) is eliminated press by press, so that one
small system remains for what all presses share, a sum over presses: holding a fold out is leaving
its terms out of the sum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tacgen.core.arrays import FloatArray
from tacgen.diagnose.optics.model import (
    Colors,
    FreeParameter,
    ModelState,
    PlainTable,
    Problem,
    colors_of,
    photograph,
    render,
)


@dataclass(frozen=True, slots=True)
class System:
    """Normal matrix (N, D, D) and gradient (N, D) of every press, own parameters eliminated."""

    matrices: FloatArray
    gradients: FloatArray
    penalty: FloatArray
    pull: FloatArray

    def step(self, kept: NDArray[np.bool_]) -> NDArray[np.float64]:
        """The Gauss–Newton step of the presses that are kept."""
        matrix = self.matrices[kept].sum(axis=0)
        # A parameter that nothing depends on stays where it is.
        matrix = matrix + np.diag(self.penalty + 1e-9 * (np.diag(matrix) + 1e-9))
        return np.linalg.solve(matrix, self.gradients[kept].sum(axis=0) + self.pull)

    def stderr(self) -> NDArray[np.float64]:
        """Standard errors (D,), robust to whatever goes together within a press."""
        inverse = np.linalg.pinv(self.matrices.sum(axis=0) + np.diag(self.penalty))
        spread = self.gradients.T @ self.gradients
        return np.sqrt(np.maximum(np.diag(inverse @ spread @ inverse), 0.0))


def moved(
    state: ModelState, free: Sequence[FreeParameter], amounts: Sequence[FloatArray | float]
) -> ModelState:
    """``state`` with each parameter moved by its amount, as far as its bounds allow."""
    shared, own = dict(state.shared), dict(state.own)
    for one, amount in zip(free, amounts, strict=True):
        value = np.clip(state.value(one) + amount, one.parameter.lower, one.parameter.upper)
        if one.each_press:
            own[one.key] = value
        else:
            shared[one.key] = float(value)
    return replace(state, shared=shared, own=own)


def _derivatives(
    problem: Problem,
    state: ModelState,
    free: Sequence[FreeParameter],
    colors: Colors,
    grey: FloatArray,
) -> FloatArray:
    """Of the grey levels (n, 3), by each parameter: (n, 3, len(free))."""
    columns = np.zeros((*grey.shape, len(free)))
    for k, one in enumerate(free):
        step = one.parameter.step
        if not np.all(state.value(one) < one.parameter.upper - step):
            step = -step
        shifted = moved(state, [one], [step])
        change = colors_of(problem, shifted).change if one.is_of_surface else colors.change
        columns[..., k] = (photograph(problem, shifted, change) - grey) / step
    return columns


def linearize(
    problem: Problem,
    state: ModelState,
    shared: Sequence[FreeParameter],
    own: Sequence[FreeParameter],
    weight: FloatArray | None = None,
) -> tuple[System, list[tuple[FloatArray, FloatArray]], float]:
    """The system at ``state``, what each press's own step needs, and the mean squared error."""
    pixels, rules = problem.pixels, problem.rules
    colors = colors_of(problem, state)
    grey = photograph(problem, state, colors.change)
    nudged = photograph(problem, state, colors.change + rules.derivative_grey)
    per_change = (nudged - grey) / rules.derivative_grey
    error = pixels.grey - grey
    mean_square = float((error**2).mean())
    by_shared = _derivatives(problem, state, shared, colors, grey)
    by_own = _derivatives(problem, state, own, colors, grey)
    n_columns = problem.table.n_columns
    size = 3 * n_columns + len(shared)
    noise = max(mean_square, rules.least_square_grey) * rules.correlated_pixels
    prior = np.array([noise / one.parameter.prior**2 for one in own])
    matrices = np.zeros((pixels.n_presses, size, size))
    gradients = np.zeros((pixels.n_presses, size))
    backs: list[tuple[FloatArray, FloatArray]] = []
    for k, part in enumerate(pixels.parts):
        cross, square = np.zeros((size, len(own))), np.diag(prior)
        pull: FloatArray = np.zeros(len(own))
        for channel in range(3):
            columns = np.hstack(
                [
                    colors.columns[part] * per_change[part, channel, None],
                    by_shared[part, channel],
                ]
            )
            weights = np.arange(channel * n_columns, (channel + 1) * n_columns)
            at = np.concatenate([weights, 3 * n_columns + np.arange(len(shared))])
            residual, beside = error[part, channel], by_own[part, channel]
            kept = 1.0 if weight is None else weight[part, channel, None]
            matrices[k][np.ix_(at, at)] += (columns * kept).T @ columns
            gradients[k][at] += (columns * kept).T @ residual
            cross[at] += (columns * kept).T @ beside
            square = square + (beside * kept).T @ beside
            pull = pull + (beside * kept).T @ residual
        if own:
            now = np.array([float(state.value(one)[k]) for one in own])
            solved = np.linalg.solve(square, np.column_stack([cross.T, pull - prior * now]))
            matrices[k] -= cross @ solved[:, :-1]
            gradients[k] -= cross @ solved[:, -1]
            backs.append((solved[:, -1], solved[:, :-1]))
    penalties = _penalties(problem, state, shared, matrices, noise)
    return System(matrices, gradients, *penalties), backs, mean_square


def _penalties(
    problem: Problem,
    state: ModelState,
    shared: Sequence[FreeParameter],
    matrices: FloatArray,
    noise: float,
) -> tuple[FloatArray, FloatArray]:
    """The table's ridge and the parameters' priors: diagonal, and pull towards doing nothing."""
    held = [one.parameter.prior for one in shared]
    penalty = np.array([noise / prior**2 if prior else 0.0 for prior in held])
    apart = np.array([float(state.value(one)) - one.identity for one in shared])
    if not isinstance(problem.table, PlainTable):
        return penalty, -penalty * apart
    n_weights = 3 * problem.table.n_columns
    mean = float(np.einsum("kii->k", matrices[:, :n_weights, :n_weights]).sum()) / n_weights
    ridge = np.tile(problem.rules.table_ridge * mean * problem.table.roughness(), 3)
    both = np.concatenate([ridge, penalty])
    return both, -both * np.concatenate([state.weights.T.ravel(), apart])


def advance(
    problem: Problem, state: ModelState, shared: Sequence[FreeParameter], step: FloatArray
) -> ModelState:
    """``state`` after a step of the table's weights and the shared parameters."""
    n_weights = 3 * problem.table.n_columns
    after = moved(state, shared, [*step[n_weights:]])
    if not n_weights:
        return after
    return replace(after, weights=state.weights + step[:n_weights].reshape(3, -1).T)


def fit(
    problem: Problem,
    state: ModelState,
    shared: Sequence[FreeParameter],
    own: Sequence[FreeParameter],
    *,
    steps: int,
    weight: FloatArray | None = None,
) -> tuple[ModelState, System]:
    """Gauss–Newton; a step that makes the fit worse is shortened. Returns state and system."""
    rules = problem.rules
    kept = np.ones(problem.pixels.n_presses, dtype=bool)
    system, backs, least = linearize(problem, state, shared, own, weight)
    for _ in range(steps):
        step = _bounded(problem, shared, system.step(kept))
        moves = np.array([back[0] - back[1] @ step for back in backs])
        for share in rules.step_shares:
            after = advance(problem, state, shared, share * step)
            if own:
                after = moved(after, own, [*(share * _own_step(problem, own, moves))])
            if weight is not None or mean_square(problem, after) < least:
                break
        else:
            break
        state = after
        system, backs, square = linearize(problem, state, shared, own, weight)
        if weight is None and square > (1 - rules.converged_share) * least:
            break
        least = square
    return state, system


def _own_step(
    problem: Problem, own: Sequence[FreeParameter], moves: FloatArray
) -> NDArray[np.float64]:
    """The step (n_own, N) of each press's parameters, within a share of their range."""
    share = problem.rules.max_press_step_range
    limits = np.array([share * (one.parameter.upper - one.parameter.lower) for one in own])
    return np.asarray(np.clip(moves, -limits, limits).T)


def _bounded(problem: Problem, shared: Sequence[FreeParameter], step: FloatArray) -> FloatArray:
    """The step, each parameter's within the range in which the linear model holds."""
    rules = problem.rules
    limits = [
        min(
            rules.max_step_differences * one.parameter.step,
            rules.max_step_range * (one.parameter.upper - one.parameter.lower),
        )
        for one in shared
    ]
    n_weights = 3 * problem.table.n_columns
    bounded = step.copy()
    bounded[n_weights:] = np.clip(step[n_weights:], -np.array(limits), limits)
    return bounded


def mean_square(problem: Problem, state: ModelState) -> float:
    """Mean squared error, grey levels."""
    return float(((problem.pixels.grey - render(problem, state)) ** 2).mean())


def without_fold(
    problem: Problem,
    state: ModelState,
    system: System,
    shared: Sequence[FreeParameter],
    kept: NDArray[np.bool_],
) -> ModelState:
    """What a fit to the kept presses alone gives: one more step from the fit to all."""
    return advance(problem, state, shared, _bounded(problem, shared, system.step(kept)))


def heldout_errors(
    problem: Problem, state: ModelState, own: Sequence[FreeParameter], noise: float
) -> FloatArray:
    """Residuals (n, 3) of presses that ``state`` was not fitted to.

    A press's own parameters are estimated on one colour of the chess board of blocks and scored
    on the other, both ways.
    """
    pixels = problem.pixels
    if not own:
        return np.asarray(pixels.grey - render(problem, state))
    errors = np.zeros_like(pixels.grey)
    for odd in (False, True):
        seen = pixels.odd == odd
        grey = render(problem, own_fit(problem, state, own, seen, noise))
        errors[~seen] = (pixels.grey - grey)[~seen]
    return errors


def own_fit(
    problem: Problem,
    state: ModelState,
    own: Sequence[FreeParameter],
    seen: NDArray[np.bool_],
    noise: float,
) -> ModelState:
    """Each press's own parameters from the pixels that are ``seen`` (n,)."""
    pixels, rules = problem.pixels, problem.rules
    scale = noise * rules.correlated_pixels
    prior = np.array([scale / one.parameter.prior**2 for one in own])
    nonlinear = any(one.is_of_surface for one in own)
    for _ in range(rules.press_steps if nonlinear else rules.linear_press_steps):
        colors = colors_of(problem, state)
        grey = photograph(problem, state, colors.change)
        slopes = _derivatives(problem, state, own, colors, grey) * seen[:, None, None]
        square = np.zeros((pixels.n_presses, len(own), len(own)))
        np.add.at(square, pixels.press, np.einsum("nci,ncj->nij", slopes, slopes))
        pull = np.zeros((pixels.n_presses, len(own)))
        np.add.at(pull, pixels.press, np.einsum("nci,nc->ni", slopes, pixels.grey - grey))
        now = np.stack([state.value(one) for one in own], axis=-1)
        step = np.linalg.solve(square + np.diag(prior), (pull - prior * now)[..., None])[..., 0]
        state = moved(state, own, [*_own_step(problem, own, step)])
    return state

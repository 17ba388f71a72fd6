"""Which grasps to make next: those whose outcome is least certain after the ones that were made.

A Gaussian process of the outcome (±1) over the axes of the grid: where its mean is within a few
standard deviations of zero the outcome is open. It is the sign of the slip margin; the margin's own
size gave no better choices: it bends where one kind of slip follows another. The bytes of a dataset
hang on these choices, so they must be the same on every machine: nothing but sums, products,
quotients and square roots in a fixed order, which every processor rounds alike.
"""

import contextlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tacgen.collection.grid import AXES, draw, grown_plan, whole_grid
from tacgen.collection.recipe import Recipe
from tacgen.core.compiled import njit
from tacgen.core.types import BoolArray, FloatArray, IntArray
from tacgen.dataset import Dataset

NOISE = 0.01
"""Variance of an outcome of ±1 that the axes of the grid do not tell, as by ``randomize``."""
SCALES = (0.1, 0.2, 0.4, 0.8, 1.6)
"""Lengths over which outcomes are alike, in parts of an axis; one is fitted for each axis."""
MAX_FITTED = 200
"""Grasps by which they are fitted: more change them little, and cost with their cube."""

MAX_CANDIDATES = 4096  # of a large grid: far closer together than the grasps that are chosen


def next_grasps(recipe: Recipe, data: Path | str, count: int) -> pd.DataFrame:
    """The grasps of a dataset and ``count`` more of each object, as a list for ``grid.file``.

    Those to choose from are all points of the recipe's axes, whatever its ``sample``. They follow
    from the labels of training grasps alone and are training grasps: what test grasps came to would
    leak into the training set, and a test set near the border would be no sample of the grid.

    Raises ``DatasetError`` if there is no finished dataset.
    """
    dense = recipe.model_copy(
        update={
            "grid": recipe.grid.model_copy(update={"sample": None, "file": None}),
            "objects": tuple(
                one.model_copy(update={"grid": one.grid.model_copy(update={"sample": None})})
                if one.grid
                else one
                for one in recipe.objects
            ),
        }
    )
    with contextlib.closing(Dataset(data)) as dataset:
        columns = dataset.columns()
    names = ["object", *AXES, "split"]
    made = pd.DataFrame({name: columns[name] for name in [*names, "label"]})
    listed = [made[names]]
    for grid in grown_plan(dense, ()).grids[0]:
        own = made[made["object"] == grid["object"]]
        taken = set(own[list(AXES)].itertuples(index=False, name=None))
        open_to = [point for point in whole_grid(grid) if point[1:] not in taken]
        # Ties go by the points' own draws, as do those that are looked at in a large grid.
        open_to.sort(key=lambda point: draw(recipe.seed, "sample", point))
        values = np.array([point[1:] for point in open_to[:MAX_CANDIDATES]]).reshape(-1, len(AXES))
        train = own[own["split"] == "train"]
        chosen = choose_near_border(
            _places(grid, train[list(AXES)].to_numpy(float)),
            train["label"].to_numpy(np.int64),
            _places(grid, values),
            count,
        )
        more = pd.DataFrame(values[sorted(chosen)], columns=list(AXES))
        listed.append(more.assign(object=grid["object"], split="train")[names])
    return pd.concat(listed, ignore_index=True)


def _places(grid: Mapping[str, Any], points: FloatArray) -> FloatArray:
    """Where points lie on the axes of a grid, from 0 to 1.

    An axis counts by the places of its values: they lie as close as whoever listed them finds that
    it matters, forces by equal factors.
    """
    axes = (np.unique(grid[axis]) for axis in AXES)
    columns = zip(points.T, axes, strict=True)
    return np.stack([np.interp(x, axis, np.linspace(0, 1, len(axis))) for x, axis in columns], 1)


def choose_near_border(
    made: FloatArray, labels: IntArray, open_to: FloatArray, count: int
) -> list[int]:
    """Which of the grasps that are ``open_to`` choice to make next, by their rows.

    Parameters
    ----------
    made, open_to : (n, d) and (m, d) float
        Places on the axes of the grid, from 0 to 1. Of equal ones of ``open_to`` the first is
        chosen.
    labels : (n,) int
        1, 0, or −1 where the grasp could not be executed: its like are chosen last.
    """
    count = min(count, len(open_to))
    executed = labels >= 0
    if not executed.any():
        return list(range(count))
    x, y = made[executed], np.where(labels[executed] == 1, 1.0, -1.0)
    scales = _fitted_scales(made, np.where(executed, 1.0, -1.0))
    is_poor = np.asarray(~executed[_nearest(made, open_to, scales)], np.bool_)
    chosen = _pick(x, y, open_to, is_poor, _fitted_scales(x, y), count, NOISE)
    return [int(row) for row in chosen]


def _fitted_scales(x: FloatArray, y: FloatArray) -> FloatArray:
    """The length scale of each axis (d,) whose left-out error is least, one axis after another."""
    few = np.linspace(0, len(x) - 1, min(len(x), MAX_FITTED)).astype(np.int64)
    x, y = x[few], y[few]
    scales = np.full(x.shape[1], SCALES[len(SCALES) // 2])
    least = _left_out_error(x, y, scales, NOISE)
    for axis in 2 * [k for k in range(x.shape[1]) if len(np.unique(x[:, k])) > 1]:
        for scale in SCALES:
            other = scales.copy()
            other[axis] = scale
            error = _left_out_error(x, y, other, NOISE)
            if error < least:
                least, scales = error, other
    return scales


@njit(cache=True, nogil=True)
def _nearest(x: FloatArray, z: FloatArray, scales: FloatArray) -> IntArray:
    """The row of ``x`` that is nearest to each row of ``z``."""
    rows = np.zeros(z.shape[0], np.int64)
    for q in range(z.shape[0]):
        most = 0.0
        for i in range(x.shape[0]):
            likeness = _kernel(x[i], z[q], scales)
            if likeness > most:
                most, rows[q] = likeness, i
    return rows


@njit(cache=True, nogil=True)
def _kernel(a: FloatArray, b: FloatArray, scales: FloatArray) -> float:
    """How alike two places (d,) are, from 1 down: the rational quadratic kernel with α = 1."""
    total = 0.0
    for k in range(a.shape[0]):
        d = (a[k] - b[k]) / scales[k]
        total += d * d
    return float(1.0 / (1.0 + 0.5 * total))


@njit(cache=True, nogil=True)
def _left_out_error(x: FloatArray, y: FloatArray, scales: FloatArray, noise: float) -> float:
    """Mean squared error of each value as predicted from all others."""
    n = x.shape[0]
    inverse = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            inverse[i, j] = _kernel(x[i], x[j], scales)
        inverse[i, i] += noise
    # Gauss-Jordan without pivots: the matrix is positive definite.
    for i in range(n):
        pivot = inverse[i, i]
        inverse[i, i] = 1.0
        for k in range(n):
            inverse[i, k] /= pivot
        for j in range(n):
            if j != i:
                factor = inverse[j, i]
                inverse[j, i] = 0.0
                for k in range(n):
                    inverse[j, k] -= factor * inverse[i, k]
    error = 0.0
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += inverse[i, j] * y[j]
        error += (total / inverse[i, i]) ** 2
    return float(error / n)


@njit(cache=True, nogil=True)
def _pick(
    x: FloatArray,
    y: FloatArray,
    z: FloatArray,
    is_poor: BoolArray,
    scales: FloatArray,
    count: int,
    noise: float,
) -> IntArray:
    """Rows of ``z``, one after another: where the mean over the standard deviation is least.

    The grasps are entered one by one: each takes its row of the Cholesky factor off the variance
    of all others. A chosen one is entered as if it turned out as expected: the mean stays, and its
    surroundings are less uncertain, so that a batch spreads along the border.
    """
    n, m = x.shape[0], z.shape[0]
    points = np.concatenate((x, z))
    factors = np.empty((n + count, n + m))
    mean, variance = np.zeros(n + m), np.ones(n + m)
    is_open, chosen = np.ones(m, np.bool_), np.empty(count, np.int64)
    for i in range(n + count):
        at = i
        if i >= n:
            least, poorest = np.inf, True
            for q in range(m):
                score = mean[n + q] * mean[n + q] / max(variance[n + q], noise * noise)
                better = score < least if is_poor[q] == poorest else poorest
                if is_open[q] and better:
                    least, poorest, at = score, is_poor[q], n + q
            is_open[at - n], chosen[i - n] = False, at - n
        spread = np.sqrt(variance[at] + noise)
        row = factors[i]
        for q in range(n + m):
            row[q] = _kernel(points[at], points[q], scales)
        for j in range(i):
            shared = factors[j, at]
            for q in range(n + m):
                row[q] -= shared * factors[j, q]
        step = (y[i] - mean[at]) / spread if i < n else 0.0
        for q in range(n + m):
            row[q] /= spread
            mean[q] += step * row[q]
            variance[q] -= row[q] * row[q]
    return chosen

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

from tacgen.collection.grid import draw, grown_plan, whole_grid
from tacgen.collection.recipe import Recipe
from tacgen.core.records import AXES
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
    nearest = [np.argmax(_likeness(made, place, scales)) for place in open_to]
    return _pick(x, y, open_to, ~executed[nearest], _fitted_scales(x, y), count)


def _fitted_scales(x: FloatArray, y: FloatArray) -> FloatArray:
    """The length scale of each axis (d,) whose left-out error is least, one axis after another."""
    few = np.linspace(0, len(x) - 1, min(len(x), MAX_FITTED)).astype(np.int64)
    x, y = x[few], y[few]
    scales = np.full(x.shape[1], SCALES[len(SCALES) // 2])
    least = _left_out_error(x, y, scales)
    for axis in 2 * [k for k in range(x.shape[1]) if len(np.unique(x[:, k])) > 1]:
        for scale in SCALES:
            other = scales.copy()
            other[axis] = scale
            error = _left_out_error(x, y, other)
            if error < least:
                least, scales = error, other
    return scales


def _likeness(x: FloatArray, place: FloatArray, scales: FloatArray) -> FloatArray:
    """How alike places (n, d) are to one, from 1 down: the rational quadratic kernel with α = 1."""
    total = np.zeros(len(x))
    for k, scale in enumerate(scales):
        total += ((x[:, k] - place[k]) / scale) ** 2
    return np.asarray(1.0 / (1.0 + 0.5 * total))


def _left_out_error(x: FloatArray, y: FloatArray, scales: FloatArray) -> float:
    """Mean squared error of each value as predicted from all others."""
    n = len(x)
    inverse = np.stack([_likeness(x, place, scales) for place in x]) + NOISE * np.eye(n)
    # Gauss-Jordan without pivots: the matrix is positive definite.
    for i in range(n):
        pivot, factors = inverse[i, i], inverse[:, i].copy()
        inverse[i, i] = 1.0
        inverse[i] /= pivot
        factors[i] = 0.0
        inverse[np.arange(n) != i, i] = 0.0
        inverse -= factors[:, None] * inverse[i]
    total = np.zeros(n)
    for column, value in zip(inverse.T, y, strict=True):
        total += column * value
    return float(sum(((total / inverse.diagonal()) ** 2).tolist()) / n)


def _pick(
    x: FloatArray, y: FloatArray, z: FloatArray, is_poor: BoolArray, scales: FloatArray, count: int
) -> list[int]:
    """Rows of ``z``, one after another: where the mean over the standard deviation is least.

    The grasps are entered one by one: each takes its row of the Cholesky factor off the variance
    of all others. A chosen one is entered as if it turned out as expected: the mean stays, and its
    surroundings are less uncertain, so that a batch spreads along the border.
    """
    n, points = len(x), np.concatenate([x, z])
    factors = np.empty((n + count, len(points)))
    mean, variance = np.zeros(len(points)), np.ones(len(points))
    left, chosen = np.arange(n, len(points)), list[int]()
    for i in range(n + count):
        at = i
        if i >= n:
            score = mean[left] ** 2 / np.maximum(variance[left], NOISE**2)
            at = int(left[np.lexsort((score, is_poor[left - n]))[0]])
            left, chosen = left[left != at], [*chosen, at - n]
        row = _likeness(points, points[at], scales)
        for factor in factors[:i]:
            row -= factor[at] * factor
        spread = np.sqrt(variance[at] + NOISE)
        factors[i] = row / spread
        if i < n:
            mean += (y[i] - mean[at]) / spread * factors[i]
        variance -= factors[i] ** 2
    return chosen

"""What residuals still follow, and how sure a gain is, from one number for each held-out unit."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import rankdata

from tacgen.core.types import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Dependence:
    """How strongly a residual follows a covariate.

    ``p_value`` is corrected for the number of covariates; ``gain`` is what predicting by the
    covariate explains: a share of the sum of squares, or an amount in the residual's unit.
    """

    covariate: str
    p_value: float
    gain: float


def followed_by_rank(
    residual: FloatArray,
    covariates: Mapping[str, FloatArray],
    groups: Sequence[IntArray],
    alpha: float,
    n_shuffles: int,
    rng: np.random.Generator,
) -> tuple[Dependence, ...]:
    """Covariates (U,) that residuals (U,) of units follow by rank: up, down, or in the middle.

    Residuals are permuted within ``groups`` of units, which are numbers of rows. ``gain`` is the
    highest correlation in standard deviations of chance; the strongest come first.
    """
    shuffled = np.zeros((n_shuffles, len(residual)))
    centred = np.zeros(len(residual))
    for rows in groups:
        centred[rows] = residual[rows] - residual[rows].mean()
        shuffled[:, rows] = rng.permuted(np.tile(centred[rows], (n_shuffles, 1)), axis=1)
    found = []
    for name, values in covariates.items():
        if np.ptp(values) == 0 or np.ptp(centred) == 0:
            continue
        place = rankdata(values) / len(values) - 0.5
        shapes = np.stack([place, np.abs(place) - np.abs(place).mean()])
        shapes /= np.linalg.norm(shapes, axis=1, keepdims=True)
        seen = np.abs(shapes @ centred).max()
        chance = np.abs(shapes @ shuffled.T).max(axis=0)
        p_value = float((1 + (chance >= seen).sum()) / (1 + n_shuffles))
        corrected = min(1.0, p_value * len(covariates))
        if corrected <= alpha:
            found.append(Dependence(name, corrected, float(seen / chance.std())))
    return tuple(sorted(found, key=lambda one: (-one.gain, one.covariate)))


def resampled_squares(
    before: FloatArray, after: FloatArray, count: int, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Means (count,) of squared errors (U,) over units drawn again, for an interval."""
    drawn = rng.integers(0, len(before), size=(count, len(before)))
    return before[drawn].mean(axis=1), after[drawn].mean(axis=1)


def interval_95(values: FloatArray) -> tuple[float, float]:
    """The middle 95 % of values (count,)."""
    low, high = np.quantile(values, [0.025, 0.975])
    return float(low), float(high)

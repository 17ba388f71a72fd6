"""The coefficient of friction whose simulated outcomes match the real ones best."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tacgen.core.arrays import FloatArray, IntArray

N_BOOTSTRAP = 2000
"""Draws of the bootstrap: each 2.5 % tail has 50; chosen."""


@dataclass(frozen=True, slots=True)
class FrictionFit:
    """The best μ of one object, its 95 % interval, and the whole curve.

    ``bounded`` is what the labels allow: ``both`` sides, only from ``below`` (every real grasp
    succeeded: μ is at least this much), or only from ``above`` (every one failed).
    """

    mu: float
    interval: tuple[float, float]
    mu_values: FloatArray
    mislabels: IntArray
    n_grasps: int
    bounded: str


def fit_friction(
    mu_values: FloatArray, simulated: IntArray, real: IntArray, rng: np.random.Generator
) -> FrictionFit:
    """Choose μ by the fewest mislabels; ties go to the middle of the longest run.

    ``mu_values`` (M,) ascend; ``simulated`` (M, N) is the label of every grasp at every μ, where −1
    (not executed) counts as a mislabel; ``real`` (N,) is 1 for success, 0 for failure.

    Source: Si et al. 2022, Sec. IV: friction by sweeping μ against about 20 real grasps. The
    interval is a percentile bootstrap over grasps.
    """
    wrong = simulated != real[None, :]
    mislabels = wrong.sum(axis=1)
    draws = rng.multinomial(len(real), np.full(len(real), 1 / len(real)), size=N_BOOTSTRAP)
    chosen = [best_mu(mu_values, curve) for curve in draws @ wrong.T.astype(np.int64)]
    low, high = np.percentile(chosen, [2.5, 97.5])
    mu = best_mu(mu_values, mislabels)
    bounded = "both"
    run = best_run(mislabels)
    if (real == 1).all():
        bounded, low, high = "below", float(mu_values[run.start]), float(mu_values[-1])
    elif (real == 0).all():
        bounded, low, high = "above", float(mu_values[0]), float(mu_values[run.stop - 1])
    return FrictionFit(
        mu, (min(float(low), mu), max(float(high), mu)), mu_values, mislabels, len(real), bounded
    )


def best_mu(mu_values: FloatArray, mislabels: IntArray) -> float:
    """The middle of the longest run of μ with the fewest mislabels."""
    run = best_run(mislabels)
    return float((mu_values[run.start] + mu_values[run.stop - 1]) / 2)


def best_run(mislabels: IntArray) -> range:
    """The longest run of indices at the minimum; of equally long ones the first."""
    best = mislabels == mislabels.min()
    edges = np.flatnonzero(np.diff(np.concatenate([[False], best, [False]]).astype(int)))
    starts, stops = edges[::2], edges[1::2]
    longest = int(np.argmax(stops - starts))
    return range(int(starts[longest]), int(stops[longest]))

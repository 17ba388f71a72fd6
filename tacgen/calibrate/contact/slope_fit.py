"""A compliance from noisy loads and responses of presses: robust, unbiased by gauge noise.

response = k · load + noise, where the load is measured with noise too and samples of one press
are correlated. Three things make the interval honest:

* The load's noise would pull a least-squares k towards 0. Each sample's load is therefore paired
  with an instrument: the mean of its neighbours in time, whose noise is not its own.
* Outliers are given little weight (Tukey's bisquare), whole presses among them.
* The standard error comes from the scatter of whole presses (cluster-robust, CR2), with the
  degrees of freedom that so many presses of such unequal weight leave.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import stdtrit

from tacgen.calibrate.contact.rules import RULES
from tacgen.core.types import BoolArray, FloatArray, IntArray

NORMAL_975 = 1.959963984540054  # 97.5 % quantile of the standard normal


@dataclass(frozen=True, slots=True)
class SlopeFit:
    """A compliance (response per load) with its interval.

    ``stderr`` is a 1.96th of half the 95 % interval, so that value ± 1.96 stderr is that interval
    whatever the number of presses; ``dof`` are the degrees of freedom of the scatter between
    presses that it rests on. ``scatter`` is the robust standard deviation of the loaded samples'
    residuals; ``r_squared`` is of the samples that kept some weight, ``outliers`` the number of
    those that kept none, and ``outlying_trials`` are presses most of whose loaded samples did so.
    """

    value: float
    stderr: float
    dof: float
    scatter: float
    r_squared: float
    n_samples: int
    n_trials: int
    outliers: int
    outlying_trials: tuple[int, ...]

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval."""
        half = NORMAL_975 * self.stderr
        return self.value - half, self.value + half

    def summary(self) -> dict[str, Any]:
        """What ``--json`` prints of it; None where there is no error."""
        known = np.isfinite(self.stderr)
        return {
            "value": self.value,
            "stderr": self.stderr if known else None,
            "interval": list(self.interval) if known else None,
            "r_squared": self.r_squared,
            "trials": self.n_trials,
            "samples": self.n_samples,
            "outliers": self.outliers,
        }


def fit_slope(load: FloatArray, response: FloatArray, trial: IntArray) -> SlopeFit:
    """Fit response = k · load over presses.

    ``load`` and ``response`` are (N,) or (N, c), in time order within each trial, trials (N,) in
    blocks; c components share one k. ``stderr`` is NaN where there is one trial only.

    Source: CR2 and its degrees of freedom: Bell & McCaffrey 2002; Pustejovsky & Tipton 2018.
    """
    load, response = (np.asarray(v, np.float64).reshape(len(trial), -1) for v in (load, response))
    numbers, cluster = np.unique(trial, return_inverse=True)
    n_trials = len(numbers)
    x, z, y = load.ravel(), neighbours(load, trial).ravel(), response.ravel()
    groups = np.repeat(cluster, load.shape[1])
    loaded = np.abs(x) >= RULES.loaded_share * np.abs(x).max()

    for widening in RULES.widenings:
        k, scale = _solve_robustly(x, z, y, loaded, widening)
        residual = y - k * x
        weight, slope = _tukey(residual, scale * widening)
        kept = weight > 0
        refused = np.bincount(groups, loaded & ~kept, n_trials) / np.maximum(
            np.bincount(groups, loaded, n_trials), 1
        )
        if (refused > 0.5).mean() <= RULES.max_outlying_share:
            break
    stderr, dof = _clustered_error(x * slope, z, residual * weight, groups, n_trials)
    spread = ((y[kept] - y[kept].mean()) ** 2).sum()
    return SlopeFit(
        value=k,
        stderr=stderr,
        dof=dof,
        scatter=scale,
        r_squared=float(1.0 - (residual[kept] ** 2).sum() / spread) if spread > 0 else np.nan,
        n_samples=len(load),
        n_trials=n_trials,
        outliers=int((~kept).reshape(load.shape).any(axis=1).sum()),
        outlying_trials=tuple(int(number) for number in numbers[refused > 0.5]),
    )


def neighbours(load: FloatArray, trial: IntArray) -> FloatArray:
    """The mean load of the samples two before and two after (one, in short presses).

    Where there are no neighbours, or they are uncorrelated with the load (a force that jumps at
    random), the load itself: its noise then cannot be separated from it.
    """
    bounds = np.r_[0, np.flatnonzero(np.diff(trial)) + 1, len(trial)]
    length = np.repeat(np.diff(bounds), np.diff(bounds))
    start, index = np.repeat(bounds[:-1], np.diff(bounds)), np.arange(len(trial))
    lag = np.select([length >= 20, length >= 3], [2, 1], 0)
    before = np.where(index - lag >= start, index - lag, index + lag)
    after = np.where(index + lag < start + length, index + lag, index - lag)
    mean = 0.5 * (load[before] + load[after])
    relevant = (mean * load).sum() > RULES.min_relevance * (load**2).sum()
    return mean if relevant else load


def _solve_robustly(
    x: FloatArray, z: FloatArray, y: FloatArray, loaded: BoolArray, widening: float
) -> tuple[float, float]:
    """The slope of y on x by the instrument z, and the residuals' scale; from an L1 start."""
    ratio, share = y[loaded] / x[loaded], np.abs(x[loaded])
    order = np.argsort(ratio)
    cumulated = np.cumsum(share[order])
    k = float(ratio[order][np.searchsorted(cumulated, 0.5 * cumulated[-1])])
    scale = 0.0
    for iteration in range(RULES.max_iterations):
        residual = y - k * x
        if iteration < RULES.scale_iterations:
            scale = float(1.4826 * np.median(np.abs(residual[loaded])))
        weighted = z * _tukey(residual, scale * widening)[0]
        before, k = k, float((weighted * y).sum() / (weighted * x).sum())
        if abs(k - before) <= RULES.tolerance * abs(k):
            break
    return k, scale


def _tukey(residual: FloatArray, scale: float) -> tuple[FloatArray, FloatArray]:
    """Bisquare weights, and the derivative of the weighted residual."""
    if scale <= 0.0:
        exact = np.ones_like(residual)
        return exact, exact
    u = (residual / (RULES.tukey * scale)) ** 2
    inside = u < 1.0
    return np.where(inside, (1 - u) ** 2, 0.0), np.where(inside, (1 - u) * (1 - 5 * u), 0.0)


def _clustered_error(
    regressor: FloatArray,
    instrument: FloatArray,
    influence: FloatArray,
    groups: IntArray,
    n_groups: int,
) -> tuple[float, float]:
    """Standard error of the slope, and its degrees of freedom."""
    if n_groups < 2:
        return np.nan, 0.0
    bread: FloatArray = np.bincount(groups, instrument * regressor, n_groups).astype(np.float64)
    score: FloatArray = np.bincount(groups, instrument * influence, n_groups).astype(np.float64)
    variance, _ = clustered(score[:, None], bread[:, None, None])
    dof = _degrees_of_freedom(instrument, influence, groups, n_groups, score)
    return float(np.sqrt(variance[0, 0])) * widened(dof), dof


def clustered(
    scores: FloatArray, breads: FloatArray, prior: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Covariance (P, P) of parameters by the scatter of presses; and degrees of freedom (P,).

    ``scores`` (G, P) are sums over each of G presses of the columns times the residual, ``breads``
    (G, P, P) of the columns' products, ``prior`` (P, P) what else holds the parameters. A press's
    score is enlarged by what the fit took of its own residual.

    Source: CR2 and its degrees of freedom: Bell & McCaffrey 2002; Pustejovsky & Tipton 2018.
    """
    total = breads.sum(axis=0) + (0.0 if prior is None else prior)
    size = np.sqrt(np.abs(np.diag(total)))
    size = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh(total / np.outer(size, size))
    kept = values > 1e-12 * np.abs(values).max()
    root = vectors[:, kept] / np.sqrt(values[kept]) / size[:, None]  # R Rᵀ is the inverse
    taken, axes = np.linalg.eigh(root.T @ breads @ root)
    remaining = np.maximum(1.0 - taken, RULES.min_remaining_leverage)
    own = np.einsum("gij,gi->gj", axes, scores @ root) / np.sqrt(remaining)
    influence = np.einsum("gij,gj->gi", axes, own) @ root.T
    inverse = root @ root.T
    share = np.einsum("pi,gij,jp->gp", inverse, breads, inverse) / np.maximum(
        np.diag(inverse), 1e-300
    )
    share = np.clip(share / np.maximum(share.sum(axis=0), 1e-300), 0.0, 1.0)
    return influence.T @ influence, freedom_of(share)


def freedom_of(share: FloatArray) -> FloatArray:
    """Satterthwaite's degrees of freedom (P,) of sums to which presses give a ``share`` (G, P)."""
    # Residuals of different presses share the fitted numbers: what each lends to the others.
    lent = share**2 / np.maximum(1.0 - share, 1e-3)
    spread = (share**2).sum(axis=0) + lent.sum(axis=0) ** 2 - (lent**2).sum(axis=0)
    most = max(len(share) - 1, 1)
    return np.asarray(np.clip(1.0 / np.maximum(spread, 1e-300), 1.0, most))


def widened(dof: FloatArray | float) -> Any:
    """By how much an error is stated wider, so that 1.96 of it are half of a 95 % interval."""
    return stdtrit(dof, 0.975) / NORMAL_975


def _degrees_of_freedom(
    instrument: FloatArray,
    influence: FloatArray,
    groups: IntArray,
    n_groups: int,
    score: FloatArray,
) -> float:
    """Satterthwaite's, for noise that is partly each sample's own and partly each press's."""
    power = np.bincount(groups, instrument**2, n_groups)
    total = float((score**2).sum())
    own = min(total, float(((instrument * influence) ** 2).sum()))
    if total <= 0.0:
        return float(n_groups - 1)
    share = (own * power / power.sum() + (total - own) * power**2 / (power**2).sum()) / total
    return float(freedom_of(share[:, None])[0])

"""A candidate as a statistical model of labels, and the evidence that labels give for it.

The evidence is the labels' probability under a candidate, averaged over its parameter's prior. Its
logarithm is the sum of the scores of predicting each label from those before it, in any order: a
cross-validation over grasps, averaged over every size of the part left out (Fong & Holmes 2020, On
the marginal likelihood and cross-validation). A parameter that buys nothing lowers it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logsumexp

from tacgen.diagnose.grasps.candidates import Candidate

FloatArray = NDArray[np.float64]

SUCCESS, FAILED, TURNED, SLID = range(4)
"""What is known of a real grasp: a failure may come with its mode or without."""
N_VALUES = 121

_FLIPS = np.array([0.005, 0.03, 0.1])
_WIDTHS = np.array([0.02, 0.1])
_FLIP_WEIGHTS = np.array([0.5, 0.3, 0.2])
_NUISANCE = [(flip, width) for flip in _FLIPS for width in _WIDTHS]
_LOG_NUISANCE = np.log(np.repeat(_FLIP_WEIGHTS, len(_WIDTHS)) / len(_WIDTHS))


@dataclass(frozen=True)
class Hypothesis:
    """A candidate's predictions over its parameter.

    ``coordinate`` (M,) and ``log_prior`` (M,) are the parameter's axis and weights; ``slack``
    (M, N) and ``turning`` (M, N) what the grasps would do; ``log_force`` (M,) the logarithm of
    the delivered over the declared force. The declared world is a hypothesis of one value,
    without a candidate.
    """

    candidate: Candidate | None
    coordinate: FloatArray
    log_prior: FloatArray
    slack: FloatArray
    turning: FloatArray
    log_force: FloatArray

    def log_probability(self) -> FloatArray:
        """Log-probability (M, S, 4, N) of what can be known, for S flip rates and widths."""
        tables = []
        for flip, width in _NUISANCE:
            success = flip + (1 - 2 * flip) * expit(self.slack / width)
            failure = 1 - success
            tables.append(
                np.stack(
                    [success, failure, failure * self.turning, failure * (1 - self.turning)], axis=1
                )
            )
        return np.log(np.stack(tables, axis=1))


def interpolated(
    candidate: Candidate,
    nodes: FloatArray,
    node_slack: FloatArray,
    node_turning: FloatArray,
    log_force: FloatArray | None = None,
) -> Hypothesis:
    """The hypothesis of a candidate from what is known at the values ``nodes`` (K,), (K, N).

    ``log_force`` (K,) as in ``Hypothesis``; None where the force is as declared.
    """
    parameter = candidate.parameter
    places = parameter.coordinate(nodes)
    axis = np.linspace(places[0], places[-1], N_VALUES)
    center = parameter.coordinate(np.array([parameter.declared]))[0]
    log_prior = -0.5 * ((axis - center) / parameter.spread) ** 2
    force = np.zeros(N_VALUES) if log_force is None else np.interp(axis, places, log_force)
    return Hypothesis(
        candidate,
        axis,
        log_prior - logsumexp(log_prior),
        _along(axis, places, node_slack),
        _along(axis, places, node_turning),
        force,
    )


def declared_world(slack: FloatArray, turning: FloatArray) -> Hypothesis:
    """The hypothesis that nothing is wrong, from slack and turning share (N,)."""
    zero = np.zeros(1)
    return Hypothesis(None, zero, zero, slack[None], turning[None], zero)


def on_top(hypothesis: Hypothesis, first: Hypothesis, at: int, declared: Hypothesis) -> Hypothesis:
    """``hypothesis`` in a world where ``first`` holds at its value number ``at``.

    Slack is a sum of logarithms of what each changes, so the changes add.
    """
    shift = first.slack[at] - declared.slack[0]
    turning = np.where(np.abs(shift) > 0, first.turning[at], hypothesis.turning)
    return replace(hypothesis, slack=hypothesis.slack + shift, turning=turning)


def _along(axis: FloatArray, nodes: FloatArray, values: FloatArray) -> FloatArray:
    """Linear interpolation of every column of ``values`` (K, N) at ``axis`` (M,)."""
    upper = np.clip(np.searchsorted(nodes, axis), 1, len(nodes) - 1)
    part = ((axis - nodes[upper - 1]) / (nodes[upper] - nodes[upper - 1]))[:, None]
    return (1 - part) * values[upper - 1] + part * values[upper]


@dataclass(frozen=True, slots=True)
class ForceReading:
    """What images say about the delivered force: log(delivered/declared) and its error."""

    log_scale: float
    stderr: float


NO_READING = ForceReading(0.0, np.inf)


def one_hot(known: NDArray[np.int64], used: NDArray[np.bool_] | None = None) -> FloatArray:
    """What is known of the grasps (B, N) as (B, 4, N) zeros and ones, unused grasps all zero."""
    table = (known[:, None, :] == np.arange(4)[None, :, None]).astype(np.float64)
    return table if used is None else table * used


class Evidence:
    """The log-evidence of hypotheses for labels; tables of probabilities are made once."""

    def __init__(self, hypothesis: Hypothesis) -> None:
        self.hypothesis = hypothesis
        self._table = hypothesis.log_probability()
        values, settings = self._table.shape[:2]
        self._log_prior = hypothesis.log_prior[:, None] + _LOG_NUISANCE[None, :]
        self._flat = self._table.reshape(values * settings, -1)
        self._shape = values, settings

    def joint(self, known: FloatArray, log_scale: FloatArray, stderr: float) -> FloatArray:
        """Log of prior × likelihood (B, M, S) for one-hot labels (B, 4, N) and readings (B,)."""
        fit = (known.reshape(len(known), -1) @ self._flat.T).reshape(-1, *self._shape)
        total = fit + self._log_prior
        if np.isfinite(stderr):
            apart = (log_scale[:, None] - self.hypothesis.log_force) / stderr
            total = total - 0.5 * apart[:, :, None] ** 2
        return total

    def log_evidence(self, known: FloatArray, log_scale: FloatArray, stderr: float) -> FloatArray:
        """Log-evidence (B,)."""
        total: FloatArray = logsumexp(self.joint(known, log_scale, stderr), axis=(1, 2))
        return total

    def best_fit(self, known: FloatArray, log_scale: FloatArray, stderr: float) -> float:
        """The largest log-likelihood over all values, for one set of labels, prior left out."""
        joint = self.joint(known, log_scale, stderr)[0]
        return float((joint - self.hypothesis.log_prior[:, None]).max())

    def posterior(self, known: FloatArray, log_scale: FloatArray, stderr: float) -> FloatArray:
        """Posterior weights (M, S) for one set of labels."""
        joint = self.joint(known, log_scale, stderr)[0]
        weights: FloatArray = np.exp(joint - logsumexp(joint))
        return weights

    def predicted(self, weights: FloatArray) -> FloatArray:
        """Probability (4, N) of what can be known of each grasp, averaged over ``weights``."""
        mean: FloatArray = np.einsum("ms,mscn->cn", weights, np.exp(self._table))
        return mean

    def drawn(
        self, weights: FloatArray, modes: NDArray[np.bool_], count: int, rng: np.random.Generator
    ) -> NDArray[np.int64]:
        """Labels (count, N) drawn from the posterior prediction; ``modes`` (N,) come with one."""
        values, settings = self._shape
        chosen = rng.choice(values * settings, size=count, p=weights.ravel())
        table = np.exp(self._table.reshape(values * settings, 4, -1)[chosen])
        success = rng.uniform(size=table[:, 0].shape) < table[:, SUCCESS]
        turned = rng.uniform(size=success.shape) * table[:, FAILED] < table[:, TURNED]
        failed = np.where(modes[None, :], np.where(turned, TURNED, SLID), FAILED)
        return np.where(success, SUCCESS, failed)

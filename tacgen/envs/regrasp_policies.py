"""Policies of regrasping on tables of simulated grasps: what each lifts, after how many regrasps.

An episode is one object with a drawn centre of mass and friction. A policy grasps, looks, and lifts
the grasp or moves to another of the ``A`` grasps of the recipe; the object then rests as before.
Every episode ends in a lift, after the last regrasp that is allowed whatever the look says.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.special import logit, softmax

from tacgen.core.errors import LearningError

PolicyName = Literal["touch", "random", "blind", "oracle"]
POLICIES: tuple[PolicyName, ...] = get_args(PolicyName)
LOOK_SPREAD = 1.0
"""Standard deviation of a network's log odds between a grasp and its simulation in a world like it.

Chosen on the imagined worlds of ``recipes/regrasp.yaml``, each played as an episode of the others:
from 0.5 to 3 the share of the oracle's gain after three regrasps is 0.84 to 0.87, with 5 it is
0.79.
"""
MIN_PROBABILITY = 0.01
"""Looks are cut to this: a network that errs in one of a hundred may not rule a world out."""


@dataclass(frozen=True, slots=True)
class Costs:
    """Of a drop and of a regrasp, in the same unit; only their ratio counts.

    Raises ``LearningError`` if a drop costs nothing, or a regrasp less.
    """

    drop: float = 1.0
    regrasp: float = 0.1

    def __post_init__(self) -> None:
        if not (0 < self.drop < np.inf and 0 <= self.regrasp < np.inf):
            msg = (
                f"a drop of cost {self.drop:g} and a regrasp of {self.regrasp:g}: give --drop-cost "
                "above 0 and --regrasp-cost of 0 or more"
            )
            raise LearningError(msg)

    def threshold(self, holds: float, left: int) -> float:
        """Probability of success from which lifting costs less than regrasping.

        ``holds`` is the probability that the best other grasp holds, ``left`` how many regrasps
        are left. A lift costs (1 − p) drop on average. A regrasp costs its price and, where the
        other grasp fails too, W of one regrasp less: W₀ = drop and
        Wₙ = min(drop, regrasp + (1 − holds) Wₙ₋₁), as if each look were certain. With none
        left there is no choice, and the threshold is 0.
        """
        if left == 0:
            return 0.0
        failed = self.drop
        for _ in range(left - 1):
            failed = min(self.drop, self.regrasp + (1 - holds) * failed)
        return 1 - (self.regrasp + (1 - holds) * failed) / self.drop


@dataclass(frozen=True, slots=True)
class Belief:
    """What the recipe's own simulation says of A grasps in W worlds that it draws.

    ``holds`` (W, A) is whether the grasp holds, ``look`` (W, A) the probability that the network
    gives it.
    """

    holds: NDArray[np.bool_]
    look: NDArray[np.float64]

    def weights(self, seen: Sequence[tuple[int, float]]) -> NDArray[np.float64]:
        """How likely each world is (W,), after the network's probability of the grasps ``seen``.

        Each world's own log odds are off by ``LOOK_SPREAD`` from those that are seen in it.
        """
        log_weights = np.zeros(len(self.holds))
        for grasp, probability in seen:
            off = _log_odds(self.look[:, grasp]) - _log_odds(probability)
            log_weights -= (off / LOOK_SPREAD) ** 2 / 2
        return np.asarray(softmax(log_weights))

    def rating(self, seen: Sequence[tuple[int, float]] = ()) -> NDArray[np.float64]:
        """Probability that each grasp holds (A,); of those that were seen, that of the network."""
        rating = self.weights(seen) @ self.holds
        for grasp, probability in seen:
            rating[grasp] = probability
        return np.asarray(rating)


@dataclass(frozen=True, slots=True)
class Step:
    """One grasp of an episode: the network's probability, and from which on it would be lifted.

    Policies that do not look have NaN for both.
    """

    grasp: int
    probability: float
    threshold: float


def play(
    policy: PolicyName,
    first: int,
    look: NDArray[np.float64],
    holds: NDArray[np.bool_],
    belief: Belief,
    costs: Costs,
    regrasps: int,
    rng: np.random.Generator,
) -> list[Step]:
    """The grasps of an episode from its ``first`` on; the last one is lifted.

    ``look`` (A,) is what the network says of each grasp where it is tried, ``holds`` (A,) the
    truth, which the oracle alone knows. ``random`` looks and decides like ``touch`` but moves
    anywhere else; ``blind`` moves to the grasp that holds in most worlds, without a look; the
    oracle to one that holds, if any does.
    """
    if policy == "oracle":
        best = first if holds[first] or not holds.any() else int(np.argmax(holds))
    elif policy == "blind":
        best = int(np.argmax(belief.rating()))
    else:
        return _play_by_touch(policy, first, look, belief, costs, regrasps, rng)
    path = [first] if best == first or regrasps == 0 else [first, best]
    return [Step(grasp, np.nan, np.nan) for grasp in path]


def _play_by_touch(
    policy: PolicyName,
    first: int,
    look: NDArray[np.float64],
    belief: Belief,
    costs: Costs,
    regrasps: int,
    rng: np.random.Generator,
) -> list[Step]:
    steps: list[Step] = []
    seen: list[tuple[int, float]] = []
    grasp = first
    for left in range(regrasps, -1, -1):
        probability = float(look[grasp])
        seen.append((grasp, probability))
        rating = belief.rating(seen if policy == "touch" else ())
        others = np.array([k for k in range(len(look)) if k != grasp], np.int64)
        if policy == "random":
            tried = {one for one, _ in seen}
            fresh = [k for k in others if k not in tried] or others
            move, hope = int(rng.choice(fresh)), float(rating[fresh].mean())
        else:
            move = int(others[np.argmax(rating[others])])
            hope = float(rating[move])
        threshold = costs.threshold(hope, left)
        steps.append(Step(grasp, probability, threshold))
        if probability >= threshold:
            break
        grasp = move
    return steps


def _log_odds(probability: NDArray[np.float64] | float) -> NDArray[np.float64]:
    return np.asarray(logit(np.clip(probability, MIN_PROBABILITY, 1 - MIN_PROBABILITY)))


@dataclass(frozen=True, slots=True)
class Rate:
    """A rate with its 95 % interval."""

    value: float
    low: float
    high: float

    @classmethod
    def of(cls, value: float, resampled: NDArray[np.float64]) -> "Rate":
        """The value with the percentiles of its ``resampled`` ones, without those undefined."""
        known = resampled[np.isfinite(resampled)]
        low, high = np.percentile(known, [2.5, 97.5]) if len(known) else (np.nan, np.nan)
        return cls(value, float(low), float(high))

    def as_json(self) -> dict[str, float | list[float] | None]:
        """``value`` and ``interval``; None where it is not defined."""
        bounds = [self.low, self.high]
        value = self.value if np.isfinite(self.value) else None
        return {"value": value, "interval": bounds if np.isfinite(bounds).all() else None}


def resampled_episodes(
    objects: NDArray[np.str_], rng: np.random.Generator, count: int = 2000
) -> NDArray[np.int64]:
    """Rows (count, E) drawn with replacement among the episodes of each object."""
    drawn = np.empty((count, len(objects)), np.int64)
    for name in np.unique(objects):
        rows = np.flatnonzero(objects == name)
        drawn[:, rows] = rng.choice(rows, (count, len(rows)))
    return drawn


def share_of_gain(
    reached: NDArray[np.floating], start: NDArray[np.floating], best: NDArray[np.floating]
) -> NDArray[np.float64]:
    """(reached − start) / (best − start); NaN where nothing is to be gained."""
    gain = np.asarray(best - start, np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(gain > 0, (reached - start) / gain, np.nan)

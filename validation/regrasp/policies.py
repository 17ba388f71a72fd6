"""Policies of regrasping on tables of simulated grasps: the network's, and its controls."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from tacgen.envs.regrasp import Belief, Costs, Step, by_touch

PolicyName = Literal["touch", "random", "blind", "oracle"]
POLICIES: tuple[PolicyName, ...] = get_args(PolicyName)


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
    if policy == "touch":
        return by_touch(first, look, costs, regrasps, belief.best_other)
    if policy == "random":
        rating = belief.rating()

        def other_of(seen: Sequence[tuple[int, float]]) -> tuple[int, float]:
            tried, last = {one for one, _ in seen}, seen[-1][0]
            others = [k for k in range(len(look)) if k != last]
            fresh = [k for k in others if k not in tried] or others
            return int(rng.choice(fresh)), float(rating[fresh].mean())

        return by_touch(first, look, costs, regrasps, other_of)
    if policy == "oracle":
        best = first if holds[first] or not holds.any() else int(np.argmax(holds))
    else:
        best = int(np.argmax(belief.rating()))
    path = [first] if best == first or regrasps == 0 else [first, best]
    return [Step(grasp, np.nan, np.nan) for grasp in path]


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

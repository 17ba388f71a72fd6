"""What the loop says about real grasp labels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom, rankdata

from tacgen.diagnose.contact.result import Verdict
from tacgen.diagnose.grasps.candidates import WHOLE_WORLD
from tacgen.diagnose.grasps.model_comparison import (
    Choice,
    Contest,
    Labels,
    Standing,
    confusable,
    heldout_success,
)
from tacgen.report.formatting import decimals_for

FEW = 10
MAX_FOLDS = 100
"""Up to so many grasps each is left out alone, for few of them say anything about a value."""
USUAL_FLIPS = 0.05
"""Share of real labels that disagree for no reason, whatever the model; more is unexplained."""
SURE, LIKELY = 0.01, 0.05
N_SHUFFLES = 1999


@dataclass(frozen=True, slots=True)
class Dependence:
    """A covariate that the labels left unexplained follow.

    ``p_value`` is corrected for the number of covariates; ``strength`` is how many standard
    deviations of shuffled labels the relation amounts to.
    """

    covariate: str
    p_value: float
    strength: float


@dataclass(frozen=True)
class GraspDiagnosis:
    """What the mislabels were traced to.

    ``real`` (N,) are the labels; ``simulated_before`` those of the declared world (−1 where it
    could not execute a grasp); ``heldout`` the probability of success that a choice and fit
    without a grasp's own fold gave it; ``final`` that of everything that was found.
    """

    steps: tuple[Choice, ...]
    real: NDArray[np.int64]
    simulated_before: NDArray[np.int64]
    heldout: NDArray[np.float64]
    final: NDArray[np.float64]
    dependences: tuple[Dependence, ...]
    notes: tuple[str, ...]
    reading: str = ""

    @property
    def found(self) -> tuple[Standing, ...]:
        """What was named, in the order in which it was added."""
        return tuple(step.standings[0] for step in self.steps if step.taken)

    @property
    def rate_before(self) -> float:
        """Mislabel rate of the declared world."""
        return float((self.simulated_before != self.real).mean())

    @property
    def rate_after(self) -> float:
        """Mislabel rate on grasps that had no part in choosing or fitting."""
        if not self.found:
            return self.rate_before
        return float(((self.heldout > 0.5) != (self.real == 1)).mean())

    @property
    def n_left(self) -> int:
        """Mislabels that are left with everything that was found."""
        if not self.found:
            return int((self.simulated_before != self.real).sum())
        return int(((self.final > 0.5) != (self.real == 1)).sum())

    @property
    def too_many_left(self) -> bool:
        """Whether more labels disagree than flips alone would make."""
        return bool(binom.sf(self.n_left - 1, len(self.real), USUAL_FLIPS) < SURE)

    @property
    def verdict(self) -> Verdict:
        """``unexplained`` if more mislabels are left than happen by themselves."""
        if self.too_many_left:
            return "unexplained"
        return "effect_found" if self.found else "sufficient"

    @property
    def sentence(self) -> str:
        """The verdict in plain words."""
        n = len(self.real)
        before, after = round(n * self.rate_before), round(n * self.rate_after)
        if self.verdict == "sufficient":
            few = " With so few grasps, an effect could hardly be detected." if n < FEW else ""
            count = f"{n - before} of {n}" if before else f"all {n}"
            return f"The simulation reproduces {count} labels.{few}"
        left = ", ".join(d.covariate for d in self.dependences)
        follows = f" follows {left}" if left else " follows none of the known columns"
        if not self.found:
            return (
                f"{before} of {n} simulated grasps end otherwise than the real ones; no listed "
                f"effect explains it, and what is left{follows}."
            )
        names = " and ".join(describe(standing) for standing in self.found)
        text = (
            f"What the declared world gets wrong: {names}. As declared, {before} of {n} grasps end "
            f"otherwise than the real ones; predicted from the other grasps, {after} do."
        )
        text += "".join(_other_value(standing) for standing in self.found)
        unsure = confusable(self.steps[0].standings)
        if unsure:
            text += (
                f" These labels cannot tell {self.found[0].name} from {', '.join(unsure)}; which "
                "error is more usual decided."
            )
        if self.too_many_left:
            text += (
                f" {self.n_left} mislabels are left, too many for chance; what is left{follows}."
            )
        return text


def describe(standing: Standing) -> str:
    """A finding in words, such as ``grip_force at 0.80 ± 0.03 times the declared``."""
    candidate = standing.hypothesis.candidate
    if candidate is None:
        return standing.name
    parameter = candidate.parameter
    whose = "" if candidate.name in WHOLE_WORLD else f" of {', '.join(candidate.objects)}"
    digits = decimals_for(standing.stderr)
    error = f"{standing.stderr:.{digits}f}"
    if parameter.is_factor:
        return f"{standing.name}{whose} at {standing.value:.{digits}f} ± {error} times the declared"
    axis = parameter.key.removeprefix(f"{standing.name}_").split("_")[0]
    along = f" along {axis}" if standing.name == "center_of_mass" else ""
    value = f"{standing.value:+.{digits}f}"
    return f"{standing.name}{whose}{along} off by {value} ± {error} {parameter.unit}"


def _other_value(standing: Standing) -> str:
    candidate = standing.hypothesis.candidate
    if standing.elsewhere is None or candidate is None:
        return ""
    value = f"{standing.elsewhere:.{decimals_for(standing.stderr)}f}"
    unit = "times the declared" if candidate.parameter.is_factor else candidate.parameter.unit
    return f" {standing.name} at {value} {unit} explains these labels nearly as well."


def diagnose_labels(
    contest: Contest,
    labels: Labels,
    steps: Sequence[Choice],
    simulated: NDArray[np.int64],
    covariates: Mapping[str, NDArray[np.float64]],
    notes: Sequence[str],
    rng: np.random.Generator,
    *,
    reading: str = "",
) -> GraspDiagnosis:
    """Hold out, and look at what is left.

    Parameters
    ----------
    steps : sequence of Choice
        What was chosen from all labels.
    simulated : (N,) int
        Labels of the declared world.
    covariates : mapping of str to (N,) float
        What leftover mislabels may follow.
    """
    real = labels.success.astype(np.int64)
    folds = _folds(real, rng)
    heldout = heldout_success(contest, labels, [step for step in steps if step.taken], folds)
    final = contest
    for step in steps:
        if step.taken:
            final = final.after(step.standings[0])
    probability = final.success_probability(labels)
    if not any(step.taken for step in steps):
        probability = np.clip(simulated, 0, 1).astype(np.float64)
    left = _dependences(real, probability, covariates, rng)
    return GraspDiagnosis(
        tuple(steps), real, simulated, heldout, probability, left, tuple(notes), reading
    )


def _folds(real: NDArray[np.int64], rng: np.random.Generator) -> NDArray[np.int64]:
    """Folds with the same share of successes, as nearly as can be."""
    order = np.lexsort((rng.uniform(size=len(real)), real))
    folds = np.empty(len(real), dtype=np.int64)
    folds[order] = np.arange(len(real)) % min(MAX_FOLDS, len(real))
    return folds


def _dependences(
    real: NDArray[np.int64],
    probability: NDArray[np.float64],
    covariates: Mapping[str, NDArray[np.float64]],
    rng: np.random.Generator,
) -> tuple[Dependence, ...]:
    """Covariates that mislabels follow by rank: upwards, downwards, or in the middle.

    Predicted successes and failures are looked at apart: only one of the two can be wrong where
    a covariate itself decides the prediction.
    """
    sides = [np.flatnonzero(probability > 0.5), np.flatnonzero(probability <= 0.5)]
    residual = np.zeros(len(real))
    shuffled = np.zeros((N_SHUFFLES, len(real)))
    for side in sides:
        if len(side):
            residual[side] = real[side] - real[side].mean()
            shuffled[:, side] = rng.permuted(np.tile(residual[side], (N_SHUFFLES, 1)), axis=1)
    found = []
    for name, values in covariates.items():
        if np.ptp(values) == 0 or np.ptp(residual) == 0:
            continue
        place = rankdata(values) / len(values) - 0.5
        shapes = np.stack([place, np.abs(place) - np.abs(place).mean()])
        shapes /= np.linalg.norm(shapes, axis=1, keepdims=True)
        seen = np.abs(shapes @ residual).max()
        chance = np.abs(shapes @ shuffled.T).max(axis=0)
        p_value = float((1 + (chance >= seen).sum()) / (1 + N_SHUFFLES))
        corrected = min(1.0, p_value * len(covariates))
        if corrected <= LIKELY:
            found.append(Dependence(name, corrected, float(seen / chance.std())))
    return tuple(sorted(found, key=lambda one: -one.strength))

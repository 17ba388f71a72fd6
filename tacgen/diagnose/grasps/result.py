"""The diagnosis of real grasp labels, and how it stands in ``diagnosis.json``."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import binom

from tacgen.core.records import GraspObject
from tacgen.core.types import FloatArray, IntArray
from tacgen.diagnose import record
from tacgen.diagnose.evidence import Dependence, followed_by_rank
from tacgen.diagnose.grasps.hypotheses import advice
from tacgen.diagnose.grasps.model_comparison import (
    AS_DECLARED,
    Cause,
    Explanation,
    Labels,
    ModelComparison,
    Posterior,
    Shared,
)
from tacgen.diagnose.record import Verdict, finite, verdict_of
from tacgen.diagnose.rules import GRASPS
from tacgen.report.formatting import decimals_for


@dataclass(frozen=True)
class GraspDiagnosis:
    """What the mislabels were traced to.

    ``real`` (N,) are the labels; ``simulated_before`` those as declared (−1 where a grasp could
    not be executed); ``heldout`` those predicted by a choice and fit without a grasp's own fold;
    ``final`` those with everything that was found. ``dependences`` are the covariates that the
    mislabels follow, strongest first.
    """

    posterior: Posterior
    real: IntArray
    simulated_before: IntArray
    heldout: IntArray
    final: IntArray
    dependences: tuple[Dependence, ...]
    notes: tuple[str, ...] = ()
    reading: str = ""

    @property
    def found(self) -> tuple[Cause, ...]:
        """What was named."""
        return self.posterior.found

    @property
    def rate_before(self) -> float:
        """Mislabel rate of the simulation as declared."""
        return float((self.simulated_before != self.real).mean())

    @property
    def rate_after(self) -> float:
        """Mislabel rate on grasps that had no part in choosing or fitting."""
        return float((self.heldout != self.real).mean())

    @property
    def n_remaining(self) -> int:
        """Remaining mislabels with everything that was found."""
        return int((self.final != self.real).sum())

    @property
    def too_many_remaining(self) -> bool:
        """Whether more labels disagree than flips alone would make."""
        return bool(
            binom.sf(self.n_remaining - 1, len(self.real), GRASPS.usual_flips) < GRASPS.too_many_p
        )

    @property
    def verdict(self) -> Verdict:
        """``unexplained`` if more mislabels remain than flipped labels explain."""
        return verdict_of(self.found, self.too_many_remaining)

    @property
    def undecided(self) -> bool:
        """Whether labels differ from the simulation, but too few to accept a cause."""
        return self.verdict == "sufficient" and self.rate_before > 0

    @property
    def products(self) -> tuple[Cause, ...]:
        """Factors that the labels determine in products with others alone, if none is accepted."""
        return self.posterior.products if self.undecided else ()

    @property
    def sentence(self) -> str:
        """The verdict in a sentence or two."""
        n = len(self.real)
        before, after = round(n * self.rate_before), round(n * self.rate_after)
        if self.verdict == "sufficient":
            small = n < GRASPS.few_grasps
            few = " With so few grasps, an effect could hardly be detected." if small else ""
            if not self.undecided:
                return f"The simulation reproduces all {n} labels.{few}"
            possible = self._listed(
                one
                for one in self.posterior.with_declared[: GRASPS.sentence_explanations]
                if self.posterior.share(one) >= GRASPS.sentence_least_share
            )
            return (
                f"Of {n} labels, {before} {'differs' if before == 1 else 'differ'} from the "
                "simulation, too few to accept a cause: with every value right, some cause seems "
                f"as likely as this in {100 * self.posterior.p_value:.1f} % of cases. "
                f"Most probable: {possible}.{self._compensating()}{few}"
            )
        followed = ", ".join(one.covariate for one in self.dependences)
        follow = f" follow {followed}" if followed else " follow none of the known columns"
        if not self.found:
            return (
                f"{before} of {n} grasps are mislabelled by the simulation; no listed effect "
                f"explains it, and the mislabels{follow}."
            )
        names = " and ".join(self._described(cause) for cause in self.found)
        text = (
            f"Declared wrongly: {names}. As declared, {before} of {n} grasps are mislabelled; "
            f"predicted from the other grasps, {after} are."
        )
        for cause in self.found:
            if cause.second_mode is not None:
                parameter = cause.candidate.parameter
                value = f"{cause.second_mode:.{decimals_for(cause.stderr)}f}"
                unit = "times the declared" if parameter.is_factor else parameter.unit
                text += f" {cause.name} at {value} {unit} explains these labels nearly as well."
            text += self._confounded(cause)
        text += self._probability()
        if any(map(self.posterior.confusable_with, self.found)):
            changed = " and ".join(cause.name for cause in self.found)
            text += f" The recipe is changed in {changed}."
        if self.too_many_remaining:
            text += f" {self.n_remaining} mislabels remain, too many for chance; they{follow}."
        return text

    def _probability(self) -> str:
        """How probable it is, by which factors of a product, and what else is possible."""
        posterior, most = self.posterior, GRASPS.sentence_explanations
        text, share_of = "", posterior.share
        same = [one for one in posterior.same if share_of(one) >= GRASPS.sentence_least_share]
        if len(posterior.same) > 1 and same:
            text = f": {self._listed(same[:most])}"
        if posterior.alternatives:
            text += f"; also possible: {self._listed(posterior.alternatives[:most])}"
            more = len(posterior.alternatives) - most
            text += f", and {more} more in the report" if more > 0 else ""
        share = 100 * posterior.found_probability
        return f" This explanation is {share:.0f} % probable{text}." if text else ""

    def _compensating(self) -> str:
        """The products that the labels determine where no cause is accepted, in words."""
        return "".join(
            f" These labels determine only {self._described(cause)}; its parts may be wrong "
            "together, where they compensate."
            for cause in self.products
        )

    def ridge(self, cause: Cause) -> str:
        """The product of factors that the labels determine, such as ``grip_force ÷ mass of cup``.

        Empty where the cause is no factor, or shares what is known with none.
        """
        text = ""
        for one in sorted(self._product(cause).values(), key=lambda one: one.exponent < 0):
            power = f"{abs(one.exponent):.1f}"
            power = "" if power == "1.0" else f"^{power}"
            text += f" {'×' if one.exponent > 0 else '÷'} {one.other.candidate.title}{power}"
        return cause.candidate.title + text if text else ""

    def _product(self, cause: Cause) -> dict[str, Shared]:
        """By name, the factors of which the labels determine a product with a found ``cause``."""
        found: dict[str, Shared] = {}
        for one in self.posterior.shared(cause):
            if one.is_product:
                found.setdefault(one.other.name, one)  # on one object, or on all
        return found

    def _listed(self, explanations: Iterable[Explanation]) -> str:
        """Explanations with their probabilities, in words."""
        return ", or ".join(
            f"{' with '.join(map(describe, one.causes)) or 'flipped labels alone'} "
            f"({100 * self.posterior.share(one):.0f} %)"
            for one in explanations
        )

    def _described(self, cause: Cause) -> str:
        text = describe(cause)
        return text.replace(cause.candidate.title, self.ridge(cause) or cause.candidate.title, 1)

    def _confounded(self, cause: Cause) -> str:
        """What these labels cannot separate from a finding, in words."""
        product = self._product(cause)
        text = f" Only this product is known, not {cause.name} alone." if product else ""
        others = [
            one.other for one in self.posterior.shared(cause) if one.other.name not in product
        ]
        beside = dict.fromkeys(other.candidate.title for other in others)
        if beside:
            text += f" In addition to {cause.name}, {' or '.join(beside)} may be wrong."
        return text


def describe(cause: Cause) -> str:
    """A finding in words, such as ``grip_force at 0.80 ± 0.03 times the declared``."""
    digits = decimals_for(cause.stderr)
    sign = "" if cause.candidate.parameter.is_factor else "+"
    value, error = f"{cause.value:{sign}.{digits}f}", f"{cause.stderr:.{digits}f}"
    return cause.candidate.reported(value, error)


def diagnose_labels(
    comparison: ModelComparison,
    labels: Labels,
    posterior: Posterior,
    simulated: IntArray,
    covariates: Mapping[str, FloatArray],
    rng: np.random.Generator,
) -> GraspDiagnosis:
    """Predict held-out grasps, and look for what the remaining mislabels follow.

    ``posterior`` is that of all labels, ``simulated`` (N,) are labels as declared, and
    ``covariates`` (N,) what remaining mislabels may follow.
    """
    real = labels.success.astype(np.int64)
    folds, heldout, final = _folds(real, rng), simulated, simulated
    probability: FloatArray = np.clip(simulated, 0, 1).astype(np.float64)
    if posterior.found:
        least = posterior.best.gain - GRASPS.leading_gain
        leading = [one for one in posterior.explanations if one.gain > least]
        by_others = comparison.success_probability(labels, [AS_DECLARED, *leading], folds)
        heldout = (by_others > 0.5).astype(np.int64)
        probability = comparison.success_probability(labels, [posterior.best])
        final = (probability > 0.5).astype(np.int64)
    # Only one of the two predictions can be wrong where a covariate itself decides it.
    sides = [np.flatnonzero(side) for side in (probability > 0.5, probability <= 0.5) if side.any()]
    dependences = followed_by_rank(
        real.astype(np.float64), covariates, sides, GRASPS.dependence_p, GRASPS.shuffles, rng
    )
    return GraspDiagnosis(posterior, real, simulated, heldout, final, dependences)


def _folds(real: IntArray, rng: np.random.Generator) -> IntArray:
    """Folds with the same share of successes, as nearly as can be."""
    order = np.lexsort((rng.uniform(size=len(real)), real))
    folds = np.empty(len(real), dtype=np.int64)
    folds[order] = np.arange(len(real)) % min(GRASPS.max_folds, len(real))
    return folds


def diagnosis_record(
    diagnosis: GraspDiagnosis, declared: Mapping[str, GraspObject]
) -> dict[str, Any]:
    """The content of ``diagnosis.json``.

    ``declared`` are the objects as the recipe has them: a factor on one of their figures is also
    given as the figure.
    """
    n, posterior = len(diagnosis.real), diagnosis.posterior
    remaining = diagnosis.dependences if diagnosis.too_many_remaining else ()
    channel = record.channel_record(
        diagnosis,
        effects=[_effect(diagnosis, cause, declared) for cause in diagnosis.found],
        unexplained=[{"covariate": d.covariate, "p_value": d.p_value} for d in remaining],
        errors=(_error(diagnosis.rate_before, n), _error(diagnosis.rate_after, n)),
        noise_floor=(
            diagnosis.n_remaining / n,
            "labels that the simulation does not reproduce with the values found",
        ),
        trials=(n, n),
        held_out=f"{min(GRASPS.max_folds, n)} folds of {n} grasps; the explanations weighed "
        "anew without each",
        false_alarm_rate=GRASPS.false_alarm,
        force_from_images=diagnosis.reading,
        ranking=[
            {
                "candidate": one.name,
                "description": describe(one.causes[0]),
                "log_evidence_gain": finite(one.gain),
                "log_likelihood_gain": finite(one.fit),
                "parameters": _parameters(one.causes[0], declared),
                "objects": list(one.causes[0].candidate.objects),
            }
            for one in posterior.by_hypothesis()
        ],
        p_value=posterior.p_value,
        critical_gain=finite(posterior.critical_gain),
        probability=posterior.found_probability,
        products=[
            {"ridge": diagnosis.ridge(cause), "value": cause.value, "stderr": cause.stderr}
            for cause in diagnosis.products
        ],
        alternatives=[
            {
                "causes": [
                    {
                        "name": cause.name,
                        "objects": list(cause.candidate.objects),
                        "parameters": _parameters(cause, declared),
                    }
                    for cause in one.causes
                ],
                "probability": posterior.share(one),
            }
            for one in posterior.alternatives
        ],
        explanations=[
            {
                "causes": [describe(cause) for cause in one.causes],
                "probability": posterior.share(one),
                "log_evidence_gain": finite(one.gain),
            }
            for one in posterior.with_declared[: GRASPS.explanations_reported]
        ],
    )
    return record.diagnosis_record({"grasp": channel}, diagnosis.notes)


def _effect(
    diagnosis: GraspDiagnosis, cause: Cause, declared: Mapping[str, GraspObject]
) -> dict[str, Any]:
    posterior = diagnosis.posterior
    shared = posterior.shared(cause)
    confusable = posterior.confusable_with(cause)
    others = [one for one in posterior.explanations if cause.name not in one.name.split(" and ")]
    without = others[0].gain if others else 0.0
    return {
        "name": cause.name,
        "description": describe(cause),
        "parameters": _parameters(cause, declared),
        "objects": list(cause.candidate.objects),
        "probability": posterior.probability({cause.candidate}),
        "heldout_gain": diagnosis.rate_before - diagnosis.rate_after,
        "runner_up": others[0].name if others else "",
        "runner_up_log_evidence_behind": posterior.best.gain - without,
        "log_evidence_gain": posterior.best.gain,
        "p_value": posterior.p_value,
        "or_value": cause.second_mode,
        "ridge": diagnosis.ridge(cause),
        "confusable_with": list(confusable),
        "shared_with": [
            {
                "name": one.other.name,
                "description": f"{describe(one.cause)} beside {describe(one.other)}",
                "objects": list(one.other.candidate.objects),
                "exponent": one.exponent,
                "parameters": _parameters(one.other, declared),
                "beside": _parameters(one.cause, declared),
            }
            for one in shared
        ],
        "what_would_tell": list(dict.fromkeys(advice(cause.name, name) for name in confusable)),
    }


def _parameters(cause: Cause, declared: Mapping[str, GraspObject]) -> dict[str, dict[str, Any]]:
    """The parameter, and for one object the figure that its factor amounts to."""
    objects, parameter = cause.candidate.objects, cause.candidate.parameter
    found = {parameter.key: _estimate(cause, 1.0, parameter.unit)}
    if parameter.figure is not None and len(objects) == 1:
        name, unit = parameter.figure
        found[name] = _estimate(cause, getattr(declared[objects[0]], name), unit)
    return found


def _estimate(cause: Cause, factor: float, unit: str) -> dict[str, Any]:
    return record.estimate(factor * cause.value, factor * cause.stderr, unit)


def _error(rate: float, n: int) -> dict[str, Any]:
    return record.error(rate, 1.0, "mislabel_rate", mislabels=round(rate * n))

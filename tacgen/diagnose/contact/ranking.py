"""Fit sets of candidates and judge them on held-out trials: what selection is made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tacgen.contact.effects import Effect, lead_in_se
from tacgen.core.arrays import FloatArray
from tacgen.diagnose.contact import candidates as cand
from tacgen.diagnose.contact import scores
from tacgen.diagnose.contact.candidates import Candidate
from tacgen.diagnose.contact.channel import MIN_TRIALS_AS_UNITS, ChannelData
from tacgen.diagnose.contact.covariates import Nuisance
from tacgen.diagnose.contact.model import Fit, Model, Term, fit_model, start_term
from tacgen.diagnose.contact.oscillation import find_waves

ALPHA = 0.01
"""Chance of a first false effect, over all candidates together."""
MIN_GAIN = 0.02
"""Least share of the held-out sum of squares that an effect must take: one of a seventh of the
noise is not worth a parameter, and below it the noise of the force is no longer negligible."""
FEW_ALPHA, FEW_MIN_GAIN = 0.05, 0.2
"""With too few trials to shuffle: parts of trials are not independent, so that p-values say
little, and only what takes a fifth of the sum of squares from parts left out is believed."""
PARAMETER_PRICE, FEW_PARAMETER_PRICE = 0.002, 0.02
"""Share of the held-out sum of squares by which a form with one parameter more must be better,
where trials are many and where they are few."""
N_SHUFFLES = 1999
N_WAVE_SHUFFLES = 40
N_FOLDS = 10
MAX_MEMBERS = 5
TRIALS_PER_MEMBER_IF_FEW = 4
SINGLES_FITTED = 6
PAIRS_FITTED = 8
FORM_SHARE, OTHER_SHARE = 0.06, 0.02
"""An effect worth less than this share of another of the same kind, a quarter in amplitude, is not
told from that other one's true form being a little different; less for one of another kind."""
THIRD_MEMORY_SHARE = 0.15
"""The same for one of these beside both others: what follows the course of the load in three ways
at once is, more often, two whose true forms are others."""
COVARIATE_SHARE = 0.08
"""The same where an oscillation, or what no effect explains, is one of the two: one frequency of a
thousand follows anything, and no smooth function of a covariate is its true form."""
EFFECT_SLACK = 0.06
"""Part of what a covariate takes that an effect in its place may leave: another formula's share."""
CLEAR_SHARE, CLEAR_GAIN, CLEAR_ALPHA = 0.5, 0.2, 0.02
"""What takes half of the structure that is left, and a fifth of the held-out sum of squares, is
believed at a p of 0.02 before correction: shuffles of a dozen trials cannot say less."""
COEFFICIENTS_PER_TRIAL = 1 / 3
"""Most coefficients of a candidate that has one number a trial, for each trial."""
TIE_IN_SE = 2.5
PAIRS_SCORED = 60
PAIR_SHARE = 0.85
SINGLE_SHARE = 0.5
"""Candidates whose linearised gain is below this share of the best one's are not fitted."""
PAIR_POOL = 44


@dataclass(frozen=True)
class Ranked:
    """A set of candidates that was fitted, and how well it predicts trials it did not see."""

    members: tuple[Candidate, ...]
    fit: Fit
    unit_losses: FloatArray

    @property
    def loss(self) -> float:
        """Held-out sum of squares."""
        return float(self.unit_losses.sum())

    @property
    def key(self) -> frozenset[str]:
        """Names of the members."""
        return frozenset(member.name for member in self.members)

    def lead_in_se(self, other: Ranked) -> float:
        """By how many standard errors over units it predicts better than ``other``."""
        return lead_in_se(self.unit_losses, other.unit_losses)


class Ranker:
    """Fits on one channel's fit trials, kept by their members, and what they are worth."""

    def __init__(
        self,
        data: ChannelData,
        rng: np.random.Generator,
        skip: Sequence[str] = (),
        *,
        session_clock: bool = True,
    ) -> None:
        self.data = data
        self.effects: list[Effect] = [
            e for e in cand.usable_effects(data) if session_clock or not e.needs_session_clock
        ]
        self.nuisances: list[Nuisance] = cand.covariate_nuisances(data, skip)
        self.session_clock = session_clock
        self.few = data.history.n_trials < MIN_TRIALS_AS_UNITS
        most = data.history.n_trials // TRIALS_PER_MEMBER_IF_FEW
        self.max_members = max(1, most) if self.few else MAX_MEMBERS
        self.alpha = FEW_ALPHA if self.few else ALPHA
        self.min_gain = FEW_MIN_GAIN if self.few else MIN_GAIN
        self.folds = data.folds(N_FOLDS)
        self.shuffled = scores.shuffles(data.n_units, N_SHUFFLES, rng)
        self._fits: dict[tuple[str, ...], Ranked] = {}
        self._waves: list[Nuisance] = []

    def _rough_compliance(self) -> float:
        history, target = self.data.history, self.data.target
        load = history.force_normal_n[:, None]
        if self.data.channel == "shear":
            load = history.force_shear_n
        return float((load * target).sum() / max(float((load**2).sum()), 1e-12)) or 1e-6

    def rank(self, members: tuple[Candidate, ...], start: Model) -> Ranked:
        """Fit ``members`` from ``start`` and cross-validate around the fit."""
        key = tuple(sorted(member.label for member in members))
        if key not in self._fits:
            fit = fit_model(self.data, start)
            design = np.column_stack([fit.jacobian, fit.residual])
            grams = scores.unit_grams(self.data, design)
            columns = range(fit.jacobian.shape[1])
            losses = scores.cv_losses(grams, self.folds, [list(columns)])
            losses = scores.believable(losses, grams[:, -1, -1], self.data.noise_loss)[0]
            if not _is_converged(fit):
                losses = np.maximum(grams[:, -1, -1], losses)
            self._fits[key] = Ranked(members, fit, losses)
        return replace(self._fits[key], members=members)

    def _pool(
        self, current: Ranked, *, new_waves: bool = False
    ) -> tuple[list[Candidate], FloatArray]:
        """Candidates beside ``current`` and the losses they leave on held-out units."""
        fit, taken = current.fit, current.key
        effects = [e for e in self.effects if e.name not in taken]
        pool = cand.effect_candidates(self.data, fit.model, effects)
        others = [n for n in self.nuisances if n.covariate not in taken]
        pool += cand.nuisance_candidates(self.data, fit, others)
        if "time_s" not in taken and self.session_clock:
            if new_waves or not self._waves:
                self._waves = find_waves(self.data, fit, self.shuffled.signs[1:N_WAVE_SHUFFLES])
            pool += cand.nuisance_candidates(self.data, fit, self._waves)
        pool = [c for c in pool if _is_within(c) or self._is_determined(c, *current.members)]
        grams, groups, base = self._grams(fit, pool)
        losses = scores.losses_of_groups(grams, self.folds, base, groups)
        return pool, scores.believable(losses, current.unit_losses, self.data.noise_loss)

    def _is_determined(self, *members: Candidate) -> bool:
        """Whether there are trials enough for the members that have one number a trial."""
        widths = [
            0 if _is_within(member) else member.columns.shape[1]
            for member in members
            if member.name != "time_s"
        ]
        most = COEFFICIENTS_PER_TRIAL * self.data.history.n_trials
        return sum(widths) <= max(1.0, most)

    def _is_clear(self, without: Ranked, loss: float, p_value: float) -> bool:
        """Whether ``loss`` is so much less than ``without`` it that a weak p will do."""
        gain = without.loss - loss
        least = max(CLEAR_SHARE * without.loss, CLEAR_GAIN * self._total(without))
        return not self.few and p_value <= CLEAR_ALPHA and gain > least

    def _p_values(self, current: Ranked, pool: Sequence[Candidate]) -> FloatArray:
        """Return the p of each candidate, corrected for the number of names looked at."""
        constant = Candidate("", self.data.reduce(np.ones_like(self.data.target))[:, None])
        grams, groups, base = self._grams(current.fit, [*pool, constant])
        statistics = scores.shuffle_statistics(
            grams, base, groups[:-1], self.shuffled, groups[-1][0]
        )
        search = [c.nuisance.p_search if c.nuisance is not None else 0.0 for c in pool]
        n_names = 1 if self.few else len({candidate.name for candidate in pool})
        by_shuffle = np.maximum(scores.shuffle_p_values(statistics), search)
        return np.minimum(by_shuffle * n_names, 1.0)

    def _grams(
        self, fit: Fit, pool: Sequence[Candidate]
    ) -> tuple[FloatArray, list[list[int]], list[int]]:
        base = list(range(fit.jacobian.shape[1]))
        groups, position = [], len(base)
        for candidate in pool:
            width = candidate.columns.shape[1]
            groups.append(list(range(position, position + width)))
            position += width
        design = np.column_stack([fit.jacobian, *(c.columns for c in pool), fit.residual])
        return scores.unit_grams(self.data, design), groups, base

    def add(self, current: Ranked, more: Sequence[Candidate]) -> Ranked:
        """``current`` with ``more`` members, fitted from the linear solution."""
        members = (*current.members, *more)
        fit = current.fit
        grams, groups, base = self._grams(fit, more)
        share = scores.coefficients(
            grams.sum(axis=0), [*base, *(i for group in groups for i in group)]
        )[len(base) :]
        model, position = fit.model, 0
        for candidate in more:
            width = candidate.columns.shape[1]
            part = share[position : position + width]
            position += width
            if candidate.effect is not None and candidate.variant is not None:
                scales = part if candidate.variant.scales else np.ones(len(part))
                term = start_term(candidate.effect, candidate.variant, self.data, list(scales))
                model = replace(model, terms=(*model.terms, term))
            elif candidate.nuisance is not None:
                model = replace(
                    model,
                    nuisances=(*model.nuisances, candidate.nuisance),
                    coefficients=(*model.coefficients, *(float(v) for v in part)),
                )
        return self.rank(members, model)

    def _is_worth(self, smaller: Ranked, larger: Ranked) -> bool:
        """Whether the larger model's gain on held-out units is large and above its own error."""
        difference = smaller.unit_losses - larger.unit_losses
        error = float(difference.std() * np.sqrt(difference.size))
        gain = float(difference.sum())
        if self.few and any(_is_at_bound(term) for term in larger.fit.model.terms):
            return False
        if self.few and gain < CLEAR_SHARE * smaller.loss:
            return False
        return gain > self.min_gain * self._total(larger) and gain > error

    def _score(self, ranked: Ranked) -> float:
        """Loss for comparing rivals: a covariate, and a further parameter, must pay for itself."""
        n_covariates = sum(not member.is_effect for member in ranked.members)
        n_parameters = sum(member.n_parameters for member in ranked.members)
        each = FEW_PARAMETER_PRICE if self.few else PARAMETER_PRICE
        price = MIN_GAIN * n_covariates + each * n_parameters
        return ranked.loss + price * self._total(ranked)

    def _total(self, ranked: Ranked) -> float:
        """Held-out sum of squares, the noise included."""
        return max(self.data.noise_loss + ranked.loss, 0.5 * self.data.noise_loss)

    def _is_needed(self, full: Ranked, member: Candidate, alpha: float | None = None) -> bool:
        """Whether ``member`` is missed: by held-out trials, by shuffles, and beside its rivals."""
        less = self._less(full, member)
        if not self._is_worth(less, full):
            return False
        alpha = 0.1 * self.alpha if member.name == "time_s" else alpha or self.alpha
        p_value = self._p_value(full, member)
        if p_value > alpha and not self._is_clear(less, full.loss, p_value):
            return False
        worth = self._worth(full, member)
        rivals = [m for m in full.members if m.label != member.label]
        third = sum(_has_memory(m) for m in full.members) > 2 and _has_memory(member)
        return all(
            worth >= _least_share(member, rival, third) * self._worth_of_rival(full, rival)
            for rival in rivals
        )

    def _worth(self, full: Ranked, member: Candidate) -> float:
        """What ``full`` gains by ``member`` over the others in whatever forms were fitted."""
        less = self._less(full, member)
        return min(less.loss, self._least_loss(less.key)) - full.loss

    def _worth_of_rival(self, full: Ranked, rival: Candidate) -> float:
        """What ``rival`` is worth in ``full``, or alone where others can imitate it."""
        alone = self._least_loss(frozenset()) - self._least_loss(frozenset({rival.name}))
        return max(self._worth(full, rival), alone)

    def _least_loss(self, names: frozenset[str]) -> float:
        """Least loss of the sets of these names that were fitted; infinite if there are none."""
        return min((r.loss for r in self._fits.values() if r.key == names), default=np.inf)

    def _less(self, full: Ranked, member: Candidate) -> Ranked:
        """``full`` without ``member``, refitted."""
        members = tuple(m for m in full.members if m.label != member.label)
        return self.rank(members, _model_without(full.fit.model, member))

    def _p_value(self, full: Ranked, member: Candidate) -> float:
        """Return the p of the member's columns beside the others, not corrected for a choice."""
        less = self._less(full, member)
        fresh = self._fresh(less, member)
        return 1.0 if fresh is None else float(self._p_values(less, [fresh])[0])

    def _fresh(self, ranked: Ranked, member: Candidate) -> Candidate | None:
        """``member`` with columns linearised at another fit."""
        fit = ranked.fit
        if member.nuisance is not None:
            return cand.nuisance_candidates(self.data, fit, [member.nuisance])[0]
        if member.effect is None or member.variant is None:
            return None
        for found in cand.effect_candidates(self.data, fit.model, [member.effect]):
            if found.variant is not None and found.variant.label == member.variant.label:
                return found
        return None


def _is_at_bound(term: Term) -> bool:
    """Whether a fitted amount ended where its bound stopped it: then it is no measurement."""
    for name in term.variant.free:
        parameter = term.effect.parameter(name)
        if parameter is not None and parameter.role == "amount":
            value = term.values[name]
            if value != parameter.identity and not parameter.low < value < parameter.high:
                return True
    return False


def _is_converged(fit: Fit) -> bool:
    """Whether one more linear step would change little, so that it may stand for a refit."""
    predicted = fit.jacobian @ np.linalg.lstsq(fit.jacobian, fit.residual, rcond=1e-9)[0]
    return float(predicted @ predicted) < 0.01 * fit.loss


def _is_within(member: Candidate) -> bool:
    """Whether it is an effect that acts within each trial."""
    return member.effect is not None and not _is_between(member)


def _is_between(member: Candidate) -> bool:
    """Whether it is an effect that differs from trial to trial."""
    return member.effect is not None and member.effect.kind == "between trials"


def _has_memory(member: Candidate) -> bool:
    return member.effect is not None and member.effect.kind == "memory"


def _least_share(member: Candidate, rival: Candidate, third: bool) -> float:
    """Share of what ``rival`` is worth that ``member`` must be, ``third`` of one kind of memory."""
    if third and _has_memory(rival):
        return THIRD_MEMORY_SHARE
    if member.name == "time_s" or not rival.is_effect:
        return COVARIATE_SHARE
    return FORM_SHARE if _is_between(member) == _is_between(rival) else OTHER_SHARE


def _model_without(model: Model, member: Candidate) -> Model:
    if member.nuisance is None:
        return model.without(member.name)
    nuisances: list[Nuisance] = []
    coefficients: list[float] = []
    position = 0
    for nuisance in model.nuisances:
        share = model.coefficients[position : position + nuisance.n_columns]
        position += nuisance.n_columns
        if nuisance != member.nuisance:
            nuisances.append(nuisance)
            coefficients += share
    return replace(model, nuisances=tuple(nuisances), coefficients=tuple(coefficients))

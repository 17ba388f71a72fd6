"""Sets of candidates that could explain a residual: their fits, losses and tests.

The search among them is in `selection`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from tacgen.contact.effects import Effect, all_effects
from tacgen.contact.effects.base import Parameters
from tacgen.core.arrays import FloatArray
from tacgen.diagnose.contact import candidates as cand
from tacgen.diagnose.contact import scores
from tacgen.diagnose.contact.candidates import Candidate
from tacgen.diagnose.contact.channel import ChannelData, linear_compliance
from tacgen.diagnose.contact.covariates import Covariate
from tacgen.diagnose.contact.localised import best_local, local_effects, local_p_value, parts_of
from tacgen.diagnose.contact.model import (
    CovariateTerm,
    Fit,
    Model,
    Term,
    as_it_is,
    fit_model,
    start_term,
)
from tacgen.diagnose.contact.oscillation import find_oscillations

FLIPS_PER_SEARCH = 5  # the more shuffles: how high the highest peak of a search is needs fewer
PAIRS_FITTED = 8  # of those that promise most
_N_KINDS = 3  # of tests: by flips, by permutations, and of frequencies that were searched for
_PROBE = 0.01  # of a free amount, where its effect on the response is asked


@dataclass(frozen=True)
class FittedSet:
    """A set of candidates that was fitted, and its losses on held-out units (U,)."""

    members: tuple[Candidate, ...]
    fit: Fit
    unit_losses: FloatArray

    @property
    def loss(self) -> float:
        """Held-out sum of squares."""
        return float(self.unit_losses.sum())

    @property
    def names(self) -> frozenset[str]:
        """Names of the members."""
        return frozenset(member.name for member in self.members)

    @property
    def effect_names(self) -> tuple[str, ...]:
        """Effects of the list among them, in the order in which they were added."""
        return tuple(member.name for member in self.members if member.is_effect)

    def lead_in_se(self, other: "FittedSet") -> float:
        """By how many standard errors over units it predicts better than ``other``."""
        return _sum_in_se(other.unit_losses - self.unit_losses)


Pool = list[tuple[Candidate, float]]
"""Candidates beside a fitted set and what each explains of its loss, best first."""


class CandidateSets:
    """Fits and cross-validates sets of candidates on one channel, and tests their members.

    ``rng`` is for the shuffles of its tests; ``session_clock`` says whether ``time_s`` runs on
    from trial to trial.
    """

    def __init__(
        self, data: ChannelData, rng: np.random.Generator, *, session_clock: bool = True
    ) -> None:
        self.data, self.rules = data, data.rules
        rules, few = self.rules, data.few_trials
        self.effects: list[Effect] = [
            e
            for e in all_effects()
            if e.channel == data.channel
            and e.can_act_on(data.history)
            and (session_clock or not e.needs_session_clock)
        ]
        self._local_effects = local_effects(data, self.effects)
        self._min_gain = rules.few_min_gain if few else rules.min_gain
        self._covariates = cand.log_covariates(data)
        rough_k = linear_compliance(data.history.load(data.channel), data.target)
        self.linear = Model(rough_k or 1e-6)
        self._confounded = cand.confounded(data, self.linear, self.effects, self._covariates)
        self._session_clock = session_clock
        self._oscillations: list[Covariate] = []
        self._folds = data.folds()
        n_shuffles = rules.few_shuffles if few else rules.n_shuffles
        shuffled = scores.shuffles(data.unit_trial, n_shuffles, rng)
        self._shuffled = shuffled if few else shuffled.of_trials
        self._fits: dict[tuple[str, ...], FittedSet] = {}
        self._p_values: dict[tuple[tuple[str, ...], str, int], float] = {}
        self._parts = [] if few else parts_of(data)

    def fitted(self, members: tuple[Candidate, ...], start: Model) -> FittedSet:
        """Fit ``members`` from ``start``, once, and cross-validate around the fit."""
        key = tuple(sorted(member.label for member in members))
        if key not in self._fits:
            fit = fit_model(self.data, start)
            design = np.column_stack([fit.jacobian, fit.residual])
            grams = scores.unit_grams(self.data, design)
            columns, plain = range(fit.jacobian.shape[1]), grams[:, -1, -1]
            training, ridge = None, self.rules.ridge_at_fit
            if fit.prior.any():
                # Many similar columns: between neighbours they are nearly singular.
                training = scores.unit_grams(self.data, design, of_neighbours=False)
                prior = 0.5 * fit.prior.T @ fit.prior
                training, ridge = np.concatenate([training, prior[None]]), scores.RIDGE
            losses = scores.cv_losses(grams, self._folds, [columns], ridge, training)
            losses = scores.believable(losses, plain, self.data.least_loss)
            self._fits[key] = FittedSet(members, fit, losses[0])
        return replace(self._fits[key], members=members)

    def _cv_losses(
        self, grams: FloatArray, sets: Sequence[Sequence[int]], without: FloatArray
    ) -> FloatArray:
        """Held-out losses (S, U) of sets of columns; of those that cannot be, ``without`` (U,)."""
        losses = scores.cv_losses(grams, self._folds, sets, scores.RIDGE)
        return scores.believable(losses, without, self.data.least_loss)

    def add(self, current: FittedSet, more: Sequence[Candidate]) -> FittedSet:
        """``current`` with ``more`` members, fitted from the linear solution."""
        fit = current.fit
        grams, groups, base = self._grams(fit, more)
        columns = [*base, *(i for group in groups for i in group)]
        weights = scores.coefficients(grams.sum(axis=0), columns, scores.RIDGE)
        model = fit.model
        for candidate, group in zip(more, groups, strict=True):
            part = weights[group]
            if candidate.effect is not None and candidate.variant is not None:
                scales = part if candidate.variant.scales else np.ones(len(part))
                term = start_term(candidate.effect, candidate.variant, self.data, list(scales))
                model = replace(model, terms=(*model.terms, term))
            elif candidate.covariate is not None:
                added = CovariateTerm(candidate.covariate, tuple(float(v) for v in part))
                model = replace(model, covariates=(*model.covariates, added))
        return self.fitted((*current.members, *more), model)

    def without(self, full: FittedSet, member: Candidate) -> FittedSet:
        """``full`` without ``member``, refitted."""
        members = tuple(m for m in full.members if m.label != member.label)
        model = full.fit.model
        return self.fitted(members, model.without(member.name, member.covariate))

    def corrected(self, full: FittedSet, effect: Effect) -> FittedSet:
        """``full`` with the effect's free amounts added to its form, fitted from 0.

        Together they are expected to change the response by as much as the effect does.
        """
        data, model = self.data, full.fit.model
        (term,) = (one for one in model.terms if one.name == effect.name)

        def with_term(new: Term) -> Model:
            return replace(model, terms=tuple(new if t is term else t for t in model.terms))

        def change(values: Parameters) -> FloatArray:
            changed = with_term(replace(term, values=values))
            return data.reduce(changed.law_response(data) - plain)

        plain = model.law_response(data)
        size = np.linalg.norm(change(effect.complete({})))
        if size == 0.0:
            return full  # at an amount of 0 there is no form to correct
        probed = [change({**term.values, name: _PROBE}) / _PROBE for name in effect.free_amounts]
        prior_sd = float(size / np.linalg.norm(probed))
        form = effect.corrected(term.variant, prior_sd)
        members = tuple(
            replace(m, variant=form) if m.name == effect.name else m for m in full.members
        )
        return self.fitted(members, with_term(replace(term, variant=form)))

    def pool(self, current: FittedSet, *, new_oscillations: bool = False) -> Pool:
        """Candidates beside ``current`` and the losses that each leaves on held-out units."""
        fit, taken = current.fit, current.names
        covariates = [c for c in self._covariates if c.column not in taken]
        if "time_s" not in taken and self._session_clock:
            if new_oscillations or not self._oscillations:
                flips = self._shuffled.of_trials.signs[
                    1 : 1 + self.rules.n_shuffles // FLIPS_PER_SEARCH
                ]
                self._oscillations = find_oscillations(self.data, fit, flips)
            covariates += self._oscillations
        found = self._effects_beside(current)
        return self._by_gain(current, found + cand.covariate_candidates(self.data, fit, covariates))

    def _effects_beside(self, current: FittedSet) -> list[Candidate]:
        effects = [e for e in self.effects if e.name not in current.names]
        return cand.effect_candidates(self.data, current.fit.model, effects)

    def _by_gain(self, current: FittedSet, found: Sequence[Candidate]) -> Pool:
        """Those of ``found`` that fit beside ``current``, and what each explains, best first."""
        found = [one for one in found if all(self._fit_beside(one, m) for m in current.members)]
        grams, groups, base = self._grams(current.fit, found)
        sets = [[*base, *group] for group in groups]
        gains = self._gains(current, self._cv_losses(grams, sets, current.unit_losses))
        order = np.argsort(-gains, kind="stable")
        return [(found[i], float(gains[i])) for i in order]

    def pairs(self, current: FittedSet, pool: Pool) -> list[tuple[Candidate, Candidate]]:
        """The pairs of candidates beside ``current`` that are worth a fit, best first."""
        rules, found = self.rules, [candidate for candidate, _ in pool]
        grams, groups, base = self._grams(current.fit, found)
        pairs = [
            (a, b)
            for a, b in combinations(self._pair_members(found), 2)
            if found[a].name != found[b].name and self._fit_beside(found[a], found[b])
        ]
        sets = [[*base, *groups[a], *groups[b]] for a, b in pairs]
        sums = scores.training_losses(grams.sum(axis=0), sets, scores.RIDGE)
        least = min(current.loss, self.data.least_loss)
        short = [k for k in np.argsort(sums, kind="stable") if sums[k] >= least]
        short = short[: rules.pair_pool]
        losses = self._cv_losses(grams, [sets[k] for k in short], current.unit_losses)
        gains = self._gains(current, losses)
        best: dict[frozenset[str], tuple[Candidate, Candidate]] = {}
        for index in np.argsort(-gains, kind="stable"):
            if gains[index] >= rules.fitted_share * gains.max():
                a, b = (found[i] for i in pairs[short[index]])
                best.setdefault(frozenset((a.name, b.name)), (a, b))
        return list(best.values())[:PAIRS_FITTED]

    def _gains(self, current: FittedSet, losses: FloatArray) -> FloatArray:
        """What sets that leave ``losses`` (S, U) explain, of the loss that there is: (S,)."""
        return np.asarray(current.loss - np.maximum(losses.sum(axis=1), min(current.loss, 0.0)))

    def _fit_beside(self, one: Candidate, other: Candidate) -> bool:
        """Whether both can be in a model: not an effect and a covariate that can do the same."""
        labels = {(one.label, other.label), (other.label, one.label)}
        # In a part of the log an effect has other columns.
        return one.is_local or other.is_local or labels.isdisjoint(self._confounded)

    def _pair_members(self, candidates: Sequence[Candidate]) -> list[int]:
        """About ``pair_pool`` candidates, every name with its best few."""
        by_name: dict[str, list[int]] = {}
        for index, candidate in enumerate(candidates):
            by_name.setdefault(candidate.name, []).append(index)
        kept: set[int] = set()
        for depth in range(1, 8):
            kept = {index for found in by_name.values() for index in found[:depth]}
            if len(kept) >= self.rules.pair_pool:
                break
        return sorted(kept)

    def _grams(
        self, fit: Fit, candidates: Sequence[Candidate]
    ) -> tuple[FloatArray, list[list[int]], list[int]]:
        return scores.fit_grams(self.data, fit, [candidate.columns for candidate in candidates])

    def p_values(self, fit: Fit, candidates: Sequence[Candidate]) -> FloatArray:
        """The p (candidates,) that any of them beside a fit scores as high as each does.

        Where trials are few, signs of their parts say how high any of the same name scores.
        """
        names = [candidate.name for candidate in candidates]
        few, n_names = self.data.few_trials, len(set(names))
        families = names if few else [""] * len(names)
        found = self._shuffle_p_values(fit, candidates, families)
        p_values = found.corrected(1, n_names) if few else found.corrected(_N_KINDS, _N_KINDS)
        return np.maximum(p_values, _search_p_values(candidates))

    def _shuffle_p_values(
        self,
        fit: Fit,
        candidates: Sequence[Candidate],
        families: Sequence[str],
        shuffled: scores.Shuffles | None = None,
    ) -> scores.PValues:
        ones = Candidate("", self.data.ones)
        grams, groups, base = self._grams(fit, [*candidates, ones])
        return scores.shuffle_p_values(
            grams,
            base,
            groups[:-1],
            shuffled or self._shuffled,
            groups[-1],
            self.rules,
            families,
            parts_of_trials=self.data.few_trials,
        )

    def p_value(self, full: FittedSet, member: Candidate, n_names: int = 1) -> float:
        """The p of a member, one of ``n_names``, beside the others."""
        labels = tuple(sorted(one.label for one in full.members))
        key = labels, member.label, n_names
        if key not in self._p_values:
            self._p_values[key] = self._p_value(full, member, n_names)
        return self._p_values[key]

    def _p_value(self, full: FittedSet, member: Candidate, n_names: int) -> float:
        """As `p_value` gives it, worked out.

        The others are as they are beside it, since refitted without it they would bend towards
        it; or refitted, where to be linear they would have to bend too far: a second chance, so
        that its p is doubled.
        """
        rest = as_it_is(self.data, full.fit.model.without(member.name, member.covariate))
        found = self._p_beside(rest, full, member, n_names)
        if found <= self.rules.alpha:
            return found
        refitted = self._p_beside(self.without(full, member).fit, full, member, n_names)
        return min(found, 2.0 * refitted, 1.0)

    def _p_beside(self, rest: Fit, full: FittedSet, member: Candidate, n_names: int) -> float:
        """The p of ``member`` beside ``rest``, one of ``n_names``.

        Parts of trials count as one for as long as the residual of the whole set correlates. Where
        trials are few, only what is of trials is corrected for the choice.
        """
        shuffled = self._shuffled
        if member.effect is not None and member.is_local:
            p_local = local_p_value(
                self.data, rest, member.effect, member.label, self._parts, shuffled
            )
            return min(p_local * len(self._local_effects), 1.0)
        few = self.data.few_trials
        if few:
            shuffled = shuffled.of_blocks(self.data.memory_units(full.fit.residual))
        if member.covariate is not None:
            fresh = cand.covariate_candidates(self.data, rest, [member.covariate])
        else:
            effects = [member.effect] if member.effect is not None else []
            same = cand.effect_candidates(self.data, rest.model, effects)
            fresh = [one for one in same if one.label == member.label]
        if not fresh:
            return 1.0
        found = self._shuffle_p_values(rest, fresh, [""], shuffled)
        p_values = found.corrected(1 if few else n_names, n_names)
        return float(max(*p_values, *_search_p_values(fresh)))

    def worst_trials(self, fitted: FittedSet) -> NDArray[np.int64]:
        """The trials with most of the residual, too few to tell an effect from chance."""
        losses = np.bincount(self.data.unit_trial, fitted.unit_losses)
        return np.argsort(-losses)[: self.rules.min_trials_of_part - 1]

    def is_more_than_gains(self, rest: FittedSet, full: FittedSet) -> bool:
        """Whether ``full`` explains more than a gain of each of the worst trials of ``rest`` would.

        A press that is merely off is no effect.
        """
        unit_trial = self.data.unit_trial
        grams, _, base = scores.fit_grams(self.data, rest.fit, [])
        left = scores.without_gains(grams, base[0], unit_trial, self.rules)[:, -1, -1]
        is_worst = np.isin(unit_trial, self.worst_trials(rest))
        return full.loss < float(np.where(is_worst, left, rest.unit_losses).sum())

    def others_gain(self, rest: FittedSet, full: FittedSet) -> bool:
        """Whether, fitted without the worst trials of ``rest``, ``full`` explains enough more."""
        others = ~np.isin(self.data.unit_trial, self.worst_trials(rest))
        losses = []
        for one in (rest, full):
            grams, _, base = scores.fit_grams(self.data, one.fit, [])
            losses += [*scores.training_losses(grams[others].sum(axis=0), [base], scores.RIDGE)]
        return bool(losses[0] - losses[1] > self._min_gain * self.total(full))

    def local(self, rest: FittedSet, most: float) -> list[FittedSet]:
        """``rest`` with the best effects that act in one part of the log, each in its best part.

        Only those that, linearised, leave less than ``most``.
        """
        effects = [e for e in self._local_effects if e.name not in rest.names]
        if not self._parts or not effects:
            return []
        found = best_local(self.data, rest.fit, effects, self._parts, most)
        return [self.add(rest, [one]) for one in found]

    def total(self, fitted: FittedSet) -> float:
        """Held-out sum of squares, the noise included."""
        noise_loss = self.data.noise_loss
        return max(noise_loss + fitted.loss, 0.5 * noise_loss)

    def score(self, fitted: FittedSet) -> float:
        """Loss that compares sets: a covariate, a part of the log, a parameter has its price."""
        members, rules = fitted.members, self.rules
        price = rules.parameter_price * sum(member.n_parameters for member in members)
        price += rules.min_gain * sum(not member.is_effect for member in members)
        price += rules.local_price * sum(member.is_local for member in members)
        return fitted.loss + price * self.total(fitted)

    def is_worth(self, smaller: FittedSet, larger: FittedSet) -> bool:
        """Whether the larger set's gain on held-out units is large.

        Where trials are few, it is also of most of the remaining structure, or of nearly every
        trial.
        """
        rules, gain = self.rules, smaller.loss - larger.loss
        if gain <= self._min_gain * self.total(larger):
            return False
        is_most = gain >= rules.clear_share * smaller.loss
        return (
            not self.data.few_trials or is_most or self.p_of_gains(smaller, larger) <= rules.alpha
        )

    def p_of_gains(self, smaller: FittedSet, larger: FittedSet) -> float:
        """The p, by a sign for each trial, of what ``larger`` gains when trials are held out."""
        sums = self._shuffled.of_trials.signs @ (smaller.unit_losses - larger.unit_losses)
        return float((sums >= sums[0] * (1.0 - 1e-9)).mean())

    def is_accepted(self, full: FittedSet, member: Candidate, n_names: int = 1) -> bool:
        """Whether held-out trials, shuffles and the other members' worth call for ``member``.

        ``n_names`` is how many names it was chosen from.
        """
        rest = self.without(full, member)
        if not self.is_worth(rest, full):
            return False
        shown = self.data.few_trials or self.is_more_than_gains(rest, full)
        if not shown and not self.others_gain(rest, full):
            return False
        worth = self.worth(full, member)
        # Several that were chosen together would all have to be due to chance.
        together = n_names > 1 and len(full.members) > 1
        alpha = self.rules.joint_alpha if together else self.rules.alpha
        if self.p_value(full, member, n_names) > alpha:
            return False
        return worth >= self.rules.least_share_of_all * self.explained(full)

    def worth(self, full: FittedSet, member: Candidate) -> float:
        """What ``member`` explains beside the others."""
        return self.without(full, member).loss - full.loss

    def explained(self, full: FittedSet) -> float:
        """What all members together explain.

        What one explains beside the others may be little of it: each may do what another does.
        """
        return self.fitted((), self.linear).loss - full.loss


def _sum_in_se(values: FloatArray) -> float:
    """The sum of ``values`` (U,) of units in its standard errors."""
    return float(values.sum()) / (float(values.std() * np.sqrt(values.size)) + 1e-300)


def _search_p_values(candidates: Sequence[Candidate]) -> FloatArray:
    """The p (candidates,) of an oscillation by chance in any of the searches; 0 of others."""
    found = (c.covariate.p_search if c.covariate is not None else 0.0 for c in candidates)
    return np.array([min(_N_KINDS * p_search, 1.0) for p_search in found])

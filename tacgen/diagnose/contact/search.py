"""Which effects does the residual of a press log come from: a problem of the one search.

Candidates are first compared as linear columns (`scores`), by cross-validation over whole trials;
the best few are then fitted in full. Members are accepted by the sign-flip test, corrected for
everything that was looked at, and a least gain on held-out trials. Columns that no effect explains
(an operator, an oscillation) compete on the same terms, so that they are not taken for an effect.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tacgen.contact.effects import Effect, all_effects
from tacgen.contact.effects.base import Parameters
from tacgen.core.types import FloatArray
from tacgen.diagnose.contact import candidates as cand
from tacgen.diagnose.contact import scores
from tacgen.diagnose.contact.candidates import Candidate
from tacgen.diagnose.contact.channel import ChannelData, linear_compliance
from tacgen.diagnose.contact.localised import best_local, local_effects, local_p_value, parts_of
from tacgen.diagnose.contact.model import (
    Covariate,
    CovariateTerm,
    Fit,
    Model,
    Term,
    fit_model,
    standard_errors,
    start_term,
)
from tacgen.diagnose.contact.oscillation import find_oscillations
from tacgen.diagnose.engine import (
    Problem,
    first_accepted,
    pruned,
    reached,
    search,
    swapped,
    worth_a_fit,
)
from tacgen.diagnose.rules import ContactRules

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
    def key(self) -> tuple[str, ...]:
        """Labels of the members, whatever their order."""
        return tuple(sorted(member.label for member in self.members))

    @property
    def effect_names(self) -> tuple[str, ...]:
        """Effects of the list among them, in the order in which they were added."""
        return tuple(member.name for member in self.members if member.is_effect)

    def lead_in_se(self, other: "FittedSet") -> float:
        """By how many standard errors over units it predicts better than ``other``."""
        lead = other.unit_losses - self.unit_losses
        return float(lead.sum()) / (float(lead.std() * np.sqrt(lead.size)) + 1e-300)


Pool = list[tuple[Candidate, float]]
"""Candidates beside a fitted set and what each explains of its loss, best first."""


@dataclass(frozen=True)
class Chosen:
    """A member of the final model, what it is worth, and what explains nearly the same."""

    candidate: Candidate
    gain: float
    p_value: float
    confusable: tuple[str, ...]
    runner_up: str = ""
    runner_up_margin: float = np.inf
    margin_in_se: float = np.inf


@dataclass(frozen=True)
class Attribution:
    """What a channel's residual was traced to.

    ``base``, ``accepted`` and ``final`` are fits to the trials that were given: without effects,
    with those that were accepted, and with their corrected forms where these predict better;
    ``chosen`` is in the order in which the members were added; ``ranking`` lists the single
    candidates at the start (label, gain of the held-out RMSE, p).
    """

    base: FittedSet
    accepted: FittedSet
    final: FittedSet
    chosen: tuple[Chosen, ...] = ()
    ranking: tuple[tuple[str, float, float], ...] = ()


class ContactProblem(Problem[Candidate, FittedSet]):
    """Fits and cross-validates sets of candidates on one channel, and tests their members.

    ``rng`` is for the sign flips of its tests; ``session_clock`` says whether ``time_s`` runs on
    from trial to trial.
    """

    rules: ContactRules

    def __init__(
        self, data: ChannelData, rng: np.random.Generator, *, session_clock: bool = True
    ) -> None:
        self.data, self.rules, self._rng = data, data.rules, rng
        self.effects: list[Effect] = [
            e
            for e in all_effects()
            if e.channel == data.channel
            and e.can_act_on(data.history)
            and (session_clock or not e.needs_session_clock)
        ]
        self._covariates = cand.log_covariates(data)
        rough_k = linear_compliance(data.history.load(data.channel), data.target)
        self.linear = Model(rough_k or 1e-6)
        self._confounded = cand.confounded(data, self.linear, self.effects, self._covariates)
        self._session_clock = session_clock
        self._oscillations: dict[str, Covariate] = {}
        self._folds = data.folds()
        self._shuffled = scores.shuffles(
            data.unit_trial, self.rules.n_shuffles, rng, data.unit_rows
        )
        self._parts = [] if data.few_trials else parts_of(data)
        self._local_effects = local_effects(data, self.effects) if self._parts else []
        n_flips = self.rules.local_flips if self._parts else 0
        self._local_signs = scores.sign_flips(data.n_units, n_flips, rng)
        self._fits: dict[tuple[str, ...], FittedSet] = {}
        self._pools: dict[tuple[str, ...], Pool] = {}
        self._p_values: dict[tuple[tuple[str, ...], float], dict[str, float]] = {}

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

    def add(self, current: FittedSet, more: Sequence[Candidate]) -> FittedSet:
        """``current`` with ``more`` members, fitted from the linear solution."""
        grams, groups, base = self._grams(current.fit, more)
        columns = [*base, *(i for group in groups for i in group)]
        weights = scores.coefficients(grams.sum(axis=0), columns, scores.RIDGE)
        model = current.fit.model
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
        """Candidates beside ``current`` and what each explains of its loss, best first."""
        has_clock = self._session_clock and "time_s" not in current.names
        if has_clock and (new_oscillations or not self._oscillations):
            found = find_oscillations(self.data, current.fit, self._rng)
            self._oscillations |= {one.label: one for one in found}
            self._pools.clear()
            self._p_values.clear()
        if current.key not in self._pools:
            self._pools[current.key] = self._pool(current)
        return self._pools[current.key]

    def _pool(self, current: FittedSet) -> Pool:
        covariates = [*self._covariates, *self._oscillations.values()]
        covariates = [one for one in covariates if one.column not in current.names]
        effects = [one for one in self.effects if one.name not in current.names]
        found = cand.effect_candidates(self.data, current.fit.model, effects)
        found += cand.covariate_candidates(self.data, current.fit, covariates)
        found = [one for one in found if all(self._fit_beside(one, m) for m in current.members)]
        grams, groups, base = self._grams(current.fit, found)
        gains = self._gains(current, grams, [[*base, *group] for group in groups])
        order = np.argsort(-gains, kind="stable")
        return [(found[i], float(gains[i])) for i in order]

    def _gains(
        self, current: FittedSet, grams: FloatArray, sets: Sequence[Sequence[int]]
    ) -> FloatArray:
        """What sets of columns explain on held-out units, of the loss that there is: (S,)."""
        losses = scores.cv_losses(grams, self._folds, sets, scores.RIDGE)
        losses = scores.believable(losses, current.unit_losses, self.data.least_loss)
        return np.asarray(current.loss - np.maximum(losses.sum(axis=1), min(current.loss, 0.0)))

    def _fit_beside(self, one: Candidate, other: Candidate) -> bool:
        """Whether both can be in a model: not an effect and a covariate that can do the same."""
        labels = {(one.label, other.label), (other.label, one.label)}
        # In a part of the log an effect has other columns.
        return one.is_local or other.is_local or labels.isdisjoint(self._confounded)

    def _grams(
        self, fit: Fit, candidates: Sequence[Candidate]
    ) -> tuple[FloatArray, list[list[int]], list[int]]:
        return scores.fit_grams(self.data, fit, [candidate.columns for candidate in candidates])

    def p_values(self, rest: FittedSet, memory_rows: float = 0.0) -> dict[str, float]:
        """The p of each name beside ``rest``: of its most significant form, corrected for all.

        ``memory_rows`` is over how many rows the residual correlates: units in them share a sign.
        """
        key = rest.key, memory_rows
        pool = self.pool(rest)
        if key not in self._p_values:
            found = [candidate for candidate, _ in pool]
            ones = Candidate("", self.data.ones)
            grams, (*groups, own), base = self._grams(rest.fit, [*found, ones])
            shuffled = self._shuffled.of_blocks(memory_rows)
            p = scores.p_values(
                grams, base, groups, shuffled, own, parts_of_trials=self.data.few_trials
            )
            searched = [one.covariate.p_search if one.covariate else 0.0 for one in found]
            by_name: dict[str, float] = {}
            for one, p_value in zip(found, np.maximum(p, searched).tolist(), strict=True):
                by_name[one.name] = min(p_value, by_name.get(one.name, 1.0))
            self._p_values[key] = by_name
        return self._p_values[key]

    def p_value(self, full: FittedSet, member: Candidate) -> float:
        """The p of a member beside the others."""
        rest = self.without(full, member)
        if member.effect is not None and member.is_local:
            p_local = local_p_value(
                self.data, rest.fit, member.effect, member.label, self._parts, self._local_signs
            )
            return min(p_local * len(self._local_effects), 1.0)
        memory_rows = self.data.memory_rows(full.fit.residual)
        return self.p_values(rest, memory_rows).get(member.name, 1.0)

    def local(self, rest: FittedSet, most: float) -> list[FittedSet]:
        """``rest`` with the best effects that act in one part of the log, each in its best part.

        Only those that, linearised, leave less than ``most``.
        """
        effects = [e for e in self._local_effects if e.name not in rest.names]
        found = best_local(self.data, rest.fit, effects, self._parts, most) if effects else []
        return [self.add(rest, [one]) for one in found]

    def total(self, fitted: FittedSet) -> float:
        """Held-out sum of squares, the noise included."""
        noise_loss = self.data.noise_loss
        return max(noise_loss + fitted.loss, 0.5 * noise_loss)

    def admits(self, found: FittedSet) -> bool:
        """Whether the log fixes the compliance and every time that was fitted."""
        model, errors = found.fit.model, standard_errors(self.data, found.fit)
        if errors.compliance > self.rules.max_error_of_compliance * model.compliance:
            return False
        return all(
            error <= self.rules.max_error_of_time * term.values[name]
            for term in model.terms
            for name, error in errors.effects[term.name].items()
            if term.effect.parameter(name).is_logarithmic
        )

    def score(self, fitted: FittedSet) -> float:
        """Loss that compares sets: a covariate, a part of the log, a parameter has its price."""
        members, rules = fitted.members, self.rules
        price = rules.parameter_price * sum(member.n_parameters for member in members)
        price += rules.min_gain * sum(not member.is_effect for member in members)
        price += rules.local_price * sum(member.is_local for member in members)
        return fitted.loss + price * self.total(fitted)

    def is_worth(self, smaller: FittedSet, larger: FittedSet) -> bool:
        """Whether the larger set's gain on held-out units is large."""
        return smaller.loss - larger.loss > self.data.min_gain * self.total(larger)

    def accepts(self, full: FittedSet, member: Candidate) -> bool:
        """Whether held-out trials, the test and the other members' worth call for ``member``."""
        rest = self.without(full, member)
        if not self.is_worth(rest, full):
            return False
        if self.p_value(full, member) > self.rules.alpha and not self._explains_all(rest, full):
            return False
        # What one explains beside the others may be little of what all explain.
        all_explain = self.fitted((), self.linear).loss - full.loss
        return rest.loss - full.loss >= self.rules.least_share_of_all * all_explain

    def _explains_all(self, rest: FittedSet, full: FittedSet) -> bool:
        """Whether a member explains nearly all where parts are too few for any to be significant.

        What the member leaves goes on for so many rows that the parts, though all agree in sign,
        would do so by chance too often.
        """
        shuffled = self._shuffled.of_blocks(self.data.memory_rows(full.fit.residual))
        parts = len(np.unique(shuffled.signs, axis=1).T)
        least = self.rules.few_parts_gain * self.total(rest)
        return 0.5 ** (parts - 1) > self.rules.alpha and rest.loss - full.loss > least

    def form(self, candidate: Candidate) -> object:
        """Name and function."""
        return candidate.name, candidate.form

    def least_gain(self, current: FittedSet) -> float:
        """A share of all that is held out."""
        return self.rules.min_gain * self.total(current)

    def least_lead(self, current: FittedSet) -> float:
        """The price of a parameter."""
        return self.rules.parameter_price * self.total(current)

    def opens(self, current: FittedSet) -> bool:
        """Whether an effect can explain as much; what oscillates beside it is looked for anew."""
        if self.score(current) < self.least_gain(current):
            return False
        if current.members:
            self.pool(current, new_oscillations=True)
        return True

    def elsewhere(self, current: FittedSet) -> FittedSet | None:
        """A better set with an effect that acts in one part of the log only; None if none is.

        It comes beside ``current``, in the place of one of its members, or of all.
        """
        least = self.score(current)
        if least < self.rules.local_price * self.total(current):
            return None  # the price of a part alone is more
        if len(current.members) >= self.rules.max_members:
            return None
        rests = [current, *(self.without(current, m) for m in current.members)]
        if len(current.members) > 1:
            rests.append(self.fitted((), self.linear))
        found = [local for rest in rests for local in self.local(rest, least)]
        for local in sorted(found, key=self.score):
            if self.score(local) < least and self.accepts(local, local.members[-1]):
                return first_accepted(self, [local, swapped(self, local)], least)
        return None

    def run(self) -> Attribution:
        """Choose, and describe each member and its runners-up."""
        found = self.choose()
        return replace(found, chosen=self._described(found.accepted))

    def choose(self) -> Attribution:
        """Search, and correct the forms of what was accepted."""
        base = self.fitted((), self.linear)
        pool = self.pool(base, new_oscillations=True)
        ranking = self._ranked(base, pool)
        accepted = self._without_mismatch(reached(search(self, base)))
        return Attribution(base, accepted, self._refined(accepted), ranking=ranking)

    def _without_mismatch(self, fitted: FittedSet) -> FittedSet:
        """``fitted`` less members that corrections of the others' forms replace, best first."""
        if len(fitted.members) < 2:
            return fitted
        corrected = self._refined(fitted)
        found = []
        for member in fitted.members:
            rest = self.without(fitted, member)
            instead = self._refined(rest)
            if instead.loss < fitted.loss and not self.is_worth(instead, corrected):
                found.append((instead.loss, rest))
        if not found:
            return fitted
        _, rest = min(found, key=lambda one: one[0])
        return self._without_mismatch(pruned(self, swapped(self, pruned(self, rest))))

    def _refined(self, fitted: FittedSet) -> FittedSet:
        """``fitted`` with the forms of members corrected where held-out trials gain, most first."""
        effects = [one.effect for one in fitted.members]
        left = [e for e in effects if e is not None and e.free_amounts and not self.data.few_trials]
        while left:
            tried = [self.corrected(fitted, effect) for effect in left]
            tried = [one if self.admits(one) else fitted for one in tried]
            best = int(np.argmin([one.loss for one in tried]))
            gain = (fitted.loss - tried[best].loss) / self.total(fitted)
            if gain <= self.rules.parameter_price:
                return fitted
            fitted = tried[best]
            del left[best]
        return fitted

    def _ranked(self, current: FittedSet, pool: Pool) -> tuple[tuple[str, float, float], ...]:
        """(label, gain of held-out RMSE, p) of the best variant of each name, best first."""
        p_values = self.p_values(current)
        rows: dict[str, tuple[str, float, float]] = {}
        for candidate, explained in pool:
            after = max(self.data.noise_loss + current.loss - explained, 0.0)
            gain = 1.0 - float(np.sqrt(after / self.total(current)))
            row = candidate.label, gain, p_values[candidate.name]
            rows.setdefault(candidate.name, row)
        return tuple(rows.values())

    def _described(self, accepted: FittedSet) -> tuple[Chosen, ...]:
        described, least_lead = list[Chosen](), self.rules.confusable_in_se
        final = self.fitted(accepted.members, accepted.fit.model)
        for member in accepted.members:
            rest = self.without(final, member)
            others = [one for one in self.pool(rest) if one[0].name not in final.names]
            # A linearised gain says little here: fitted, another may predict as well as the member.
            others_fitted = [self.add(rest, [other]) for other in worth_a_fit(self, others, 0.0)]
            others_fitted.sort(key=lambda one: one.loss)
            close = [r.members[-1].name for r in others_fitted if final.lead_in_se(r) < least_lead]
            chosen = Chosen(
                member,
                gain=1.0 - float(np.sqrt(self.total(final) / self.total(rest))),
                p_value=self.p_value(final, member),
                confusable=tuple(dict.fromkeys(close)),
            )
            if others_fitted:
                margin = float(np.sqrt(self.total(others_fitted[0]) / self.total(final))) - 1.0
                lead, name = final.lead_in_se(others_fitted[0]), others_fitted[0].members[-1].name
                chosen = replace(chosen, runner_up=name, runner_up_margin=margin, margin_in_se=lead)
            described.append(chosen)
        return tuple(described)

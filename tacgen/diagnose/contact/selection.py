"""Which effects does a residual come from: forward and backward selection.

Candidates are first compared as linear columns (`scores`), all singles and pairs, by
cross-validation over whole trials; the best few are then fitted in full. An effect is kept if a
sign-flip test over trials, corrected for everything that was looked at, and a least gain on
held-out trials both allow it. Columns that no effect explains (an operator, an oscillation)
compete on the same terms, so that they are not taken for an effect.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from tacgen.core.arrays import FloatArray
from tacgen.diagnose.contact.candidate_sets import CandidateSets, FittedSet, Pool
from tacgen.diagnose.contact.candidates import Candidate
from tacgen.diagnose.contact.channel import ChannelData
from tacgen.diagnose.contact.rules import SelectionRules


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


class Selection:
    """The search for the effects of one channel; arguments as ``CandidateSets`` has them."""

    def __init__(
        self, data: ChannelData, rng: np.random.Generator, *, session_clock: bool = True
    ) -> None:
        self.data, self.rules = data, data.rules
        self._rng, self._session_clock = rng, session_clock
        self.sets = CandidateSets(data, rng, session_clock=session_clock)
        self._ranking: tuple[tuple[str, float, float], ...] = ()

    def run(self) -> Attribution:
        """Choose, and describe each member and its runners-up."""
        found = self.choose()
        return replace(found, chosen=self._described(found.accepted))

    def choose(self) -> Attribution:
        """Search, and correct the forms of what was accepted."""
        base = self.sets.fitted((), self.sets.linear)
        accepted = self._without_mismatch(self._searched(base))
        return Attribution(base, accepted, self._refined(accepted), ranking=self._ranking)

    def _searched(self, current: FittedSet) -> FittedSet:
        """Select forward, swap and drop; where nothing is significant, look deeper."""
        sets = self.sets
        base = sets.fitted((), sets.linear)
        while len(current.members) < self.rules.max_members:
            pool = sets.pool(current, new_oscillations=True)
            p_values = sets.p_values(current.fit, [candidate for candidate, _ in pool])
            self._ranking = self._ranking or self._ranked(current, pool, p_values)
            pairs = self._with_pair(current, pool)
            found = self._extended(current, pool, pairs, p_values)
            if found is not None:
                found = self._pruned(self._swapped(found))
            if found is None or sets.score(found) >= sets.score(current):
                found = self._deeper(current, pool, pairs) or self._localised(base, current)
            if found is None:
                break
            current = found
        return self._pruned(current)

    def _extended(
        self,
        current: FittedSet,
        pool: Pool,
        pairs: list[FittedSet],
        p_values: FloatArray,
    ) -> FittedSet | None:
        """The best set with one or two members more; None if nothing is significant."""
        sets, rules = self.sets, self.rules
        n_names = len({candidate.name for candidate, _ in pool})
        significant = {
            candidate.name
            for (candidate, _), p in zip(pool, p_values, strict=True)
            if p <= rules.alpha
        }
        singles = list[FittedSet]()
        for promise, best in _in_turn([one for one in pool if one[0].name in significant], rules):
            if any(promise < current.loss - single.loss for single in singles):
                break  # the rest promises less than what was found explains
            tried = [sets.add(current, [candidate]) for candidate in best]
            singles += [one for one in tried if sets.is_accepted(one, one.members[-1])]
        best_single = min(singles, key=sets.score, default=None)
        for pair in sorted(pairs, key=sets.score):
            added = pair.members[len(current.members) :]
            if sets.is_worth(best_single or current, pair) and all(
                sets.is_accepted(pair, member, n_names) for member in added
            ):
                return pair
        return best_single

    def _deeper(self, current: FittedSet, pool: Pool, pairs: list[FittedSet]) -> FittedSet | None:
        """A better set than ``current`` that no tested step leads to; None if none is found.

        It is searched by its score alone, beside ``current`` and with a pair in the place of each
        member, and then pruned of what its own tests do not call for.
        """
        sets, rules = self.sets, self.rules
        if sets.score(current) < rules.min_gain * sets.total(current):
            return None
        ends = self._grown(current, pool, pairs)
        ends += [self._swapped(end, tested=False) for end in ends[-1:]]
        ends += pairs
        for rest in (sets.without(current, member) for member in current.members):
            ends += self._with_pair(rest, sets.pool(rest))
        n_names = len({candidate.name for candidate, _ in pool})
        least = rules.parameter_price * sets.total(current)
        for end in sorted(ends, key=sets.score):
            if sets.score(end) < sets.score(current) - least:
                pruned = self._pruned(end, n_names)
                if sets.score(pruned) < sets.score(current) - least:
                    return pruned
        return None

    def _grown(self, current: FittedSet, pool: Pool, pairs: list[FittedSet]) -> list[FittedSet]:
        """``current`` with ever more members, those that make the score best, untested."""
        sets, rules, path = self.sets, self.rules, list[FittedSet]()
        while len(current.members) < rules.max_members:
            most = sets.score(current) - rules.min_gain * sets.total(current)
            promising = [one for one in pool if one[1] > rules.min_gain * sets.total(current)]
            tried = list(pairs)
            for _, best in _in_turn(promising, rules):
                tried += [sets.add(current, [candidate]) for candidate in best]
                if min(map(sets.score, tried)) <= most:
                    break
            larger = min(tried, key=sets.score, default=current)
            if sets.score(larger) > most:
                break
            path.append(current := larger)
            pool = sets.pool(current)
            pairs = self._with_pair(current, pool)
        return path

    def _with_pair(self, current: FittedSet, pool: Pool) -> list[FittedSet]:
        """``current`` with each of the pairs that promise most beside it."""
        if len(current.members) + 2 > self.rules.max_members:
            return []
        return [self.sets.add(current, pair) for pair in self.sets.pairs(current, pool)]

    def _localised(self, base: FittedSet, current: FittedSet) -> FittedSet | None:
        """A better set with an effect that acts in one part of the log only; None if none is.

        It comes beside ``current``, in the place of one of its members, or of all.
        """
        sets, rules = self.sets, self.rules
        if sets.score(current) < rules.local_price * sets.total(current):
            return None  # the price of a part alone is more
        rests = [current, *(sets.without(current, m) for m in current.members)]
        if len(current.members) > 1:
            rests.append(base)
        found = [local for rest in rests for local in sets.local(rest, sets.score(current))]
        for local in sorted(found, key=sets.score):
            if sets.score(local) < sets.score(current) and sets.is_accepted(
                local, local.members[-1]
            ):
                ends = (self._pruned(local), self._pruned(self._swapped(local)))
                best = min(ends, key=sets.score)
                return best if sets.score(best) < sets.score(current) else None
        return None

    def _swapped(self, fitted: FittedSet, *, tested: bool = True) -> FittedSet:
        """Exchange members, and their variants, for others as long as held-out trials gain.

        If ``tested``, only for those that are accepted.
        """
        sets = self.sets
        for _ in range(4):
            best = fitted
            for member in fitted.members:
                rest = sets.without(fitted, member)
                for other in _worth_a_fit(sets.pool(rest), self.rules.fitted_share):
                    trial = sets.add(rest, [other])
                    least = self.rules.parameter_price * sets.total(best)
                    is_better = sets.score(trial) < sets.score(best) - least
                    if is_better and (not tested or sets.is_accepted(trial, other)):
                        best = trial
            if best is fitted:
                return fitted
            fitted = best
        return fitted

    def _without_mismatch(self, fitted: FittedSet) -> FittedSet:
        """``fitted`` less members that corrections of the others' forms replace, best first."""
        sets = self.sets
        if len(fitted.members) < 2:
            return fitted
        corrected = self._refined(fitted)
        found = []
        for member in fitted.members:
            rest = sets.without(fitted, member)
            instead = self._refined(rest)
            if instead.loss < fitted.loss and not sets.is_worth(instead, corrected):
                found.append((instead.loss, rest))
        if not found:
            return fitted
        _, rest = min(found, key=lambda one: one[0])
        return self._without_mismatch(self._swapped(self._pruned(rest)))

    def _refined(self, fitted: FittedSet) -> FittedSet:
        """``fitted`` with the forms of members corrected where held-out trials gain, most first."""
        sets, effects = self.sets, [one.effect for one in fitted.members]
        left = [effect for effect in effects if effect is not None and effect.free_amounts]
        while left:
            tried = [sets.corrected(fitted, effect) for effect in left]
            best = int(np.argmin([one.loss for one in tried]))
            gain = (fitted.loss - tried[best].loss) / sets.total(fitted)
            if gain <= self.rules.parameter_price:
                return fitted
            fitted = tried[best]
            del left[best]
        return fitted

    def _pruned(self, fitted: FittedSet, n_names: int = 1) -> FittedSet:
        """Drop members that are not accepted beside the others, the least useful first."""
        sets = self.sets
        while idle := [m for m in fitted.members if not sets.is_accepted(fitted, m, n_names)]:
            rests = [sets.without(fitted, member) for member in idle]
            fitted = min(rests, key=lambda rest: rest.loss)
        return fitted

    def _ranked(
        self, current: FittedSet, pool: Pool, p_values: FloatArray
    ) -> tuple[tuple[str, float, float], ...]:
        """(label, gain of held-out RMSE, p) of the best variant of each name, best first."""
        rows: dict[str, tuple[str, float, float]] = {}
        for (candidate, explained), p in zip(pool, p_values, strict=True):
            after = max(self.data.noise_loss + current.loss - explained, 0.0)
            gain = 1.0 - float(np.sqrt(after / self.sets.total(current)))
            rows.setdefault(candidate.name, (candidate.label, gain, float(p)))
        return tuple(rows.values())

    def _described(self, accepted: FittedSet) -> tuple[Chosen, ...]:
        sets, described, least_lead = self.sets, [], self.rules.confusable_in_se
        final = sets.fitted(accepted.members, accepted.fit.model)
        for member in accepted.members:
            rest = sets.without(final, member)
            others = [one for one in sets.pool(rest) if one[0].name not in final.names]
            # A linearised gain says little here: fitted, another may predict as well as the member.
            others_fitted = [sets.add(rest, [other]) for other in _worth_a_fit(others, 0.0)]
            others_fitted.sort(key=lambda one: one.loss)
            close = [r.members[-1].name for r in others_fitted if final.lead_in_se(r) < least_lead]
            chosen = Chosen(
                member,
                gain=1.0 - float(np.sqrt(sets.total(final) / sets.total(rest))),
                p_value=sets.p_value(final, member),
                confusable=tuple(dict.fromkeys(close)),
            )
            if others_fitted:
                margin = float(np.sqrt(sets.total(others_fitted[0]) / sets.total(final))) - 1.0
                lead, name = final.lead_in_se(others_fitted[0]), others_fitted[0].members[-1].name
                chosen = replace(chosen, runner_up=name, runner_up_margin=margin, margin_in_se=lead)
            described.append(chosen)
        return tuple(described)


def _in_turn(pool: Pool, rules: SelectionRules) -> Iterator[tuple[float, list[Candidate]]]:
    """The most that is promised, and what is worth a fit; then the same of the rest, and so on.

    A form that promises most may fail when it is fitted: linear, it knows no bounds.
    """
    while best := _worth_a_fit(pool, rules.fitted_share):
        yield max(gain for _, gain in pool), best
        tried = {(candidate.name, candidate.form) for candidate in best}
        pool = [one for one in pool if (one[0].name, one[0].form) not in tried]


def _worth_a_fit(pool: Pool, share: float) -> list[Candidate]:
    """The best start of each form that promises at least ``share`` of what the best one does."""
    best: dict[tuple[str, object], Candidate] = {}
    least = share * max((gain for _, gain in pool), default=0.0)
    for candidate, gain in pool:
        if gain >= least:
            best.setdefault((candidate.name, candidate.form), candidate)
    return list(best.values())

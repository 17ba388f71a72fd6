"""Exchange members of a set of effects for others that explain the same better, or more simply."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from tacgen.contact.effects import FittedForm, Tie
from tacgen.core.arrays import FloatArray
from tacgen.diagnose.contact.candidates import Candidate
from tacgen.diagnose.contact.ranking import (
    EFFECT_SLACK,
    SINGLE_SHARE,
    SINGLES_FITTED,
    TIE_IN_SE,
    Ranked,
    Ranker,
)


class Exchanger(Ranker):
    """Judges members of a set by what could stand in their place."""

    def _swap(self, ranked: Ranked) -> Ranked:
        """Exchange members, and their variants, as long as held-out trials gain."""
        for _ in range(4):
            best = ranked
            for member in ranked.members:
                rest = self._less(ranked, member)
                for other in self._alternatives(rest, ranked):
                    trial = self.add(rest, [other])
                    if self._score(trial) < self._score(best) - 1e-3 * self._total(best):
                        best = trial
            if best is ranked:
                return ranked
            ranked = best
        return ranked

    def _alternatives(self, rest: Ranked, full: Ranked) -> list[Candidate]:
        """The few best candidates beside ``rest``, the same name in other variants included."""
        pool, losses = self._pool(rest)
        order = np.argsort(losses.sum(axis=1))
        same = [i for i in order if pool[i].name in full.key]
        others = [i for i in order if pool[i].name not in full.key]
        gains = rest.loss - losses.sum(axis=1)
        picked = best_of_each(pool, same, 3, gains) + best_of_each(pool, others, 2, gains)
        return [pool[i] for i in picked]

    def _prefer_effects(self, ranked: Ranked) -> Ranked:
        """Exchange a covariate for an effect that does nearly all that it does.

        Levels or a parabola bend to whatever is near them; what a listed effect explains with
        its own few numbers needs no further column.
        """
        for member in ranked.members:
            if member.is_effect:
                continue
            rest = self._less(ranked, member)
            least = (1.0 - EFFECT_SLACK) * (rest.loss - ranked.loss)
            for other in self._alternatives(rest, ranked):
                trial = self.add(rest, [other]) if other.is_effect else rest
                if rest.loss - trial.loss >= least and self._is_needed(trial, other):
                    return self._prefer_effects(trial)
        return ranked

    def _break_ties(self, ranked: Ranked) -> Ranked:
        """Where two effects predict equally well, let the rule that one declares decide."""
        for effect in self.effects:
            for rival, decide in effect.tie_breaks.items():
                found = {effect.name, rival} & ranked.key
                if len(found) == 1:
                    ranked = self._break_tie(ranked, found.pop(), decide)
        return ranked

    def _break_tie(self, ranked: Ranked, name: str, decide: Callable[[Tie], FittedForm]) -> Ranked:
        rest = self._less(ranked, next(m for m in ranked.members if m.name == name))
        sets = {id(ranked): ranked}

        def form_of(fitted: Ranked, name: str) -> FittedForm:
            term = next(t for t in fitted.fit.model.terms if t.name == name)
            form = FittedForm(name, term.values, term.variant.free, fitted.unit_losses)
            sets[id(form)] = fitted
            return form

        def forms(name: str) -> list[FittedForm]:
            pool, losses = self._pool(rest)
            order = [i for i in np.argsort(losses.sum(axis=1)) if pool[i].name == name]
            return [form_of(self.add(rest, [pool[i]]), name) for i in order]

        found = form_of(ranked, name)
        tie = Tie(found, self.data.history, TIE_IN_SE, forms)
        return sets[id(decide(tie))]


def best_of_each(
    pool: Sequence[Candidate],
    order: Sequence[int] | NDArray[np.int64],
    variants: int,
    gains: FloatArray,
) -> list[int]:
    """The best ``variants`` of each of the ``SINGLES_FITTED`` best names; ``order`` best first."""
    if not len(order):
        return []
    enough = SINGLE_SHARE * gains[order[0]]
    by_name: dict[str, list[int]] = {}
    for index in order:
        if gains[index] >= enough:
            by_name.setdefault(pool[index].name, []).append(int(index))
    return [i for members in list(by_name.values())[:SINGLES_FITTED] for i in members[:variants]]

"""Which effects does a residual come from: forward, pairwise and backward selection.

Candidates are first compared as linear columns (`scores`), all singles and all pairs, by
cross-validation over whole trials; the best few are then fitted in full. An effect is kept if a
sign-flip test over trials, corrected for everything that was looked at, and a least gain on
held-out trials both say so. Columns that no effect explains (an operator, an oscillation) compete
on the same terms, so that they are not taken for an effect.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from tacgen.core.arrays import FloatArray
from tacgen.diagnose.contact import scores
from tacgen.diagnose.contact.candidates import Candidate
from tacgen.diagnose.contact.exchanges import Exchanger, best_of_each
from tacgen.diagnose.contact.model import Model
from tacgen.diagnose.contact.ranking import (
    ALPHA,
    PAIR_POOL,
    PAIR_SHARE,
    PAIRS_FITTED,
    PAIRS_SCORED,
    Ranked,
)

__all__ = ["ALPHA", "Attribution", "Chosen", "Ranked", "Tracer"]


@dataclass(frozen=True)
class Chosen:
    """A member of the final model, with what it is worth and what else might do its work."""

    candidate: Candidate
    gain: float
    p_value: float
    runner_up: str
    runner_up_margin: float
    margin_in_se: float
    confusable: tuple[str, ...]


@dataclass(frozen=True)
class Attribution:
    """What a channel's residual was traced to.

    ``base`` and ``final`` are fits to the trials that were given; ``chosen`` is in the order in
    which the members were added; ``ranking`` lists the single candidates at the start;
    ``best_covariate`` is what no effect explains that would take most of what is left, and its
    share of the held-out sum of squares, whether or not it stands out.
    """

    base: Ranked
    final: Ranked
    chosen: tuple[Chosen, ...]
    ranking: tuple[tuple[str, float, float], ...] = field(default=())
    best_covariate: tuple[str, float] = ("", 0.0)


class Tracer(Exchanger):
    """Selection on one channel's fit trials."""

    def run(self) -> Attribution:
        """Select forward by singles and pairs, then drop, swap and name the runners-up."""
        base = self.rank((), Model(self._rough_compliance()))
        current, ranking, left = base, None, ("", 0.0)
        visited = {base.key}
        while len(current.members) < self.max_members:
            pool, losses = self._pool(current, new_waves=True)
            p_values = self._p_values(current, pool)
            left = self._best_covariate(current, pool, losses)
            if ranking is None:
                ranking = self._ranking(current, pool, p_values, losses)
            extended = self._extend(current, pool, p_values, losses)
            if extended is None:
                break
            current = self._prune(self._prefer_effects(self._swap(extended)))
            if current.key in visited:
                break
            visited.add(current.key)
        current = self._break_ties(self._prune(current))
        return Attribution(base, current, self._describe(current), ranking or (), left)

    def _extend(
        self,
        current: Ranked,
        pool: list[Candidate],
        p_values: FloatArray,
        losses: FloatArray,
    ) -> Ranked | None:
        """The best model with one or two members more; None if nothing is significant."""
        order = np.argsort(losses.sum(axis=1))
        gains = current.loss - losses.sum(axis=1)
        n_names = len({candidate.name for candidate in pool})
        significant = [
            i
            for i in order
            if p_values[i] <= self.alpha
            or self._is_clear(current, current.loss - gains[i], p_values[i] / n_names)
        ]
        singles = [self.add(current, [pool[i]]) for i in best_of_each(pool, significant, 2, gains)]
        singles = [s for s in singles if self._is_worth(current, s)]
        best_single = min(singles, key=self._score, default=None)
        if len(current.members) + 2 > self.max_members:
            return best_single
        pairs = [self.add(current, pair) for pair in self._best_pairs(current, pool, order)]
        pairs.sort(key=self._score)
        for pair in pairs:
            gains_more = self._is_worth(best_single or current, pair)
            if gains_more and self._both_needed(current, pair):
                return pair
        return best_single

    def _best_pairs(
        self, current: Ranked, pool: list[Candidate], order: NDArray[np.int64]
    ) -> list[tuple[Candidate, Candidate]]:
        grams, groups, base = self._grams(current.fit, pool)
        total = grams.sum(axis=0)
        usable = self._pair_pool(pool, order)
        by_size: dict[int, list[tuple[int, int]]] = {}
        for a, b in combinations(usable, 2):
            both = (pool[a], pool[b], *current.members)
            if pool[a].name != pool[b].name and self._is_determined(*both):
                by_size.setdefault(len(groups[a]) + len(groups[b]), []).append((a, b))
        ranked: list[tuple[float, tuple[int, int]]] = []
        least = min(current.loss, 0.0) - scores.IMPOSSIBLE * self.data.noise_loss
        for pairs in by_size.values():
            sets = [[*base, *groups[a], *groups[b]] for a, b in pairs]
            ranked += zip(scores.training_losses(total, sets), pairs, strict=True)
        ranked = [item for item in ranked if item[0] >= least]
        ranked.sort(key=lambda item: item[0])
        short = [pair for _, pair in ranked[:PAIRS_SCORED]]
        losses = scores.losses_of_groups(
            grams, self.folds, base, [[*groups[a], *groups[b]] for a, b in short]
        )
        losses = scores.believable(losses, current.unit_losses, self.data.noise_loss).sum(axis=1)
        gains = current.loss - losses
        seen: set[frozenset[str]] = set()
        result = []
        for index in np.argsort(losses):
            a, b = short[index]
            key = frozenset((pool[a].name, pool[b].name))
            if key not in seen and gains[index] >= PAIR_SHARE * gains.max():
                seen.add(key)
                result.append((pool[a], pool[b]))
        return result[:PAIRS_FITTED]

    @staticmethod
    def _pair_pool(pool: list[Candidate], order: NDArray[np.int64]) -> list[int]:
        """At most ``PAIR_POOL`` candidates, every name with its best few."""
        kept: list[int] = []
        for depth in range(1, 8):
            counts: dict[str, int] = {}
            kept = []
            for index in order:
                name = pool[index].name
                counts[name] = counts.get(name, 0) + 1
                if counts[name] <= depth:
                    kept.append(int(index))
            if len(kept) >= PAIR_POOL:
                break
        return kept

    def _both_needed(self, current: Ranked, pair: Ranked) -> bool:
        """Whether either of the last two members is missed when it is left out."""
        known = current.key
        new = [member for member in pair.members if member.name not in known]
        return all(self._is_needed(pair, member, 0.1 * self.alpha) for member in new)

    def _prune(self, ranked: Ranked) -> Ranked:
        """Drop members that are not needed beside the others: covariates, then the least needed."""
        while ranked.members:
            idle = [
                (m.is_effect, self._less(ranked, m).loss, i)
                for i, m in enumerate(ranked.members)
                if not self._is_needed(ranked, m)
            ]
            if not idle:
                break
            ranked = self._less(ranked, ranked.members[min(idle)[-1]])
        return ranked

    def _best_covariate(
        self, current: Ranked, pool: list[Candidate], losses: FloatArray
    ) -> tuple[str, float]:
        """Name and share of the best candidate that is no effect."""
        gains = (current.loss - losses.sum(axis=1)) / self._total(current)
        found = [(float(g), c.name) for g, c in zip(gains, pool, strict=True) if not c.is_effect]
        gain, name = max(found, default=(0.0, ""))
        return name, gain

    def _ranking(
        self,
        current: Ranked,
        pool: list[Candidate],
        p_values: FloatArray,
        losses: FloatArray,
    ) -> tuple[tuple[str, float, float], ...]:
        """(label, gain of held-out RMSE, p) of the best variant of each name, best first."""
        seen: set[str] = set()
        rows = []
        for index in np.argsort(losses.sum(axis=1)):
            if pool[index].name not in seen:
                seen.add(pool[index].name)
                after = max(self.data.noise_loss + float(losses[index].sum()), 0.0)
                gain = 1.0 - float(np.sqrt(after / self._total(current)))
                rows.append((pool[index].label, gain, float(p_values[index])))
        return tuple(rows)

    def _describe(self, final: Ranked) -> tuple[Chosen, ...]:
        described = []
        for member in final.members:
            less = self._less(final, member)
            rivals = [
                self.add(less, [other])
                for other in self._alternatives(less, final)
                if other.name != member.name and other.name not in final.key
            ]
            rivals.sort(key=lambda r: r.loss)
            runner = rivals[0] if rivals else None
            close = [r.members[-1].name for r in rivals if final.lead_in_se(r) < 2.0]
            confusable = tuple(dict.fromkeys(close))
            described.append(
                Chosen(
                    member,
                    gain=1.0 - float(np.sqrt(self._total(final) / self._total(less))),
                    p_value=self._p_value(final, member),
                    runner_up=runner.members[-1].name if runner else "",
                    runner_up_margin=(
                        float(np.sqrt(self._total(runner) / self._total(final))) - 1.0
                        if runner
                        else np.inf
                    ),
                    margin_in_se=final.lead_in_se(runner) if runner else np.inf,
                    confusable=confusable,
                )
            )
        return tuple(described)

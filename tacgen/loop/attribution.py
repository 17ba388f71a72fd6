"""Which effects does a residual come from: forward, pairwise and backward selection.

Candidates are first compared as linear columns (`scores`), all singles and all pairs, by
cross-validation over whole trials; the best few are then fitted in full. An effect is kept if a
sign-flip test over trials, corrected for everything that was looked at, and a least gain on
held-out trials both say so. Columns that no effect explains (an operator, an oscillation) compete
on the same terms, so that they are not taken for an effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from tacgen.contact.effects import Effect
from tacgen.loop import candidates as cand
from tacgen.loop import scores
from tacgen.loop.candidates import Candidate
from tacgen.loop.channel import MIN_TRIALS_AS_UNITS, ChannelData
from tacgen.loop.model import Fit, Model, Term, fit_model, start_term
from tacgen.loop.nuisance import Nuisance
from tacgen.loop.waves import find_waves

ALPHA = 0.01
"""Chance of a first false effect, over all candidates together."""
MIN_GAIN = 0.01
"""Least share of the held-out sum of squares that an effect must take: one of a tenth of the
noise is not worth a parameter, and below it the noise of the force is no longer negligible."""
FEW_ALPHA, FEW_MIN_GAIN = 0.05, 0.2
"""With too few trials to shuffle: parts of trials are not independent, so that p-values say
little, and only what takes a fifth of the sum of squares from parts left out is believed."""
N_SHUFFLES = 1999
N_WAVE_SHUFFLES = 40
N_FOLDS = 10
MAX_MEMBERS = 5
SINGLES_FITTED = 6
PAIRS_FITTED = 8
FORM_SHARE = 0.04
"""An effect worth less than this share of another of the same kind, a fifth in amplitude, is not
told from that other one's true form being a little different."""
WAVE_SHARE = 0.08
"""The same for an oscillation beside any effect: one frequency of a thousand follows anything."""
BETWEEN_TRIALS = frozenset(
    {"drift", "conditioning", "temperature", "position", "geometry", "time_s"}
)
LIMIT_EXPONENT = 1.5
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
    unit_losses: NDArray[np.float64]

    @property
    def loss(self) -> float:
        """Held-out sum of squares."""
        return float(self.unit_losses.sum())

    @property
    def key(self) -> frozenset[str]:
        """Names of the members."""
        return frozenset(member.name for member in self.members)


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
    which the members were added; ``ranking`` lists the single candidates at the start.
    """

    base: Ranked
    final: Ranked
    chosen: tuple[Chosen, ...]
    ranking: tuple[tuple[str, float, float], ...] = field(default=())


class Tracer:
    """Selection on one channel's fit trials."""

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
            e for e in cand.usable_effects(data) if session_clock or e.name != "drift"
        ]
        self.nuisances: list[Nuisance] = cand.covariate_nuisances(data, skip)
        self.session_clock = session_clock
        self.few = data.history.n_trials < MIN_TRIALS_AS_UNITS
        self.max_members = min(MAX_MEMBERS, data.history.n_trials)
        self.alpha = FEW_ALPHA if self.few else ALPHA
        self.min_gain = FEW_MIN_GAIN if self.few else MIN_GAIN
        self.folds = scores.fold_of_units(data.n_units, N_FOLDS)
        self.shuffled = scores.shuffles(data.n_units, N_SHUFFLES, rng)
        self._fits: dict[tuple[str, ...], Ranked] = {}
        self._waves: list[Nuisance] = []

    def run(self) -> Attribution:
        """Select forward by singles and pairs, then drop, swap and name the runners-up."""
        base = self.rank((), Model(self._rough_compliance()))
        current, ranking = base, None
        visited = {base.key}
        while len(current.members) < self.max_members:
            pool, losses = self._pool(current, new_waves=True)
            p_values = self._p_values(current, pool)
            if ranking is None:
                ranking = self._ranking(current, pool, p_values, losses)
            extended = self._extend(current, pool, p_values, losses)
            if extended is None:
                break
            current = self._prune(self._swap(extended))
            if current.key in visited:
                break
            visited.add(current.key)
        current = self._first_presses(self._bend_or_limit(self._prune(current)))
        return Attribution(base, current, self._describe(current), ranking or ())

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
            losses = scores.cv_losses(grams, self.folds, [list(columns)])[0]
            if not _is_converged(fit):
                losses = np.maximum(grams[:, -1, -1], losses)
            self._fits[key] = Ranked(members, fit, losses)
        return self._fits[key]

    def _pool(
        self, current: Ranked, *, new_waves: bool = False
    ) -> tuple[list[Candidate], NDArray[np.float64]]:
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
        grams, groups, base = self._grams(fit, pool)
        return pool, scores.losses_of_groups(grams, self.folds, base, groups)

    def _p_values(self, current: Ranked, pool: Sequence[Candidate]) -> NDArray[np.float64]:
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
    ) -> tuple[NDArray[np.float64], list[list[int]], list[int]]:
        base = list(range(fit.jacobian.shape[1]))
        groups, position = [], len(base)
        for candidate in pool:
            width = candidate.columns.shape[1]
            groups.append(list(range(position, position + width)))
            position += width
        design = np.column_stack([fit.jacobian, *(c.columns for c in pool), fit.residual])
        return scores.unit_grams(self.data, design), groups, base

    def _extend(
        self,
        current: Ranked,
        pool: list[Candidate],
        p_values: NDArray[np.float64],
        losses: NDArray[np.float64],
    ) -> Ranked | None:
        """The best model with one or two members more; None if nothing is significant."""
        order = np.argsort(losses.sum(axis=1))
        significant = {pool[i].name for i in np.flatnonzero(p_values <= self.alpha)}
        gains = current.loss - losses.sum(axis=1)
        singles = [
            self.add(current, [pool[i]])
            for i in _best_of_each(pool, order, 2, gains)
            if pool[i].name in significant
        ]
        singles = [s for s in singles if self._is_worth(current, s)]
        best_single = min(singles, key=lambda r: r.loss, default=None)
        if len(current.members) + 2 > self.max_members:
            return best_single
        pairs = [self.add(current, pair) for pair in self._best_pairs(current, pool, order)]
        pairs.sort(key=lambda r: r.loss)
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
            if pool[a].name != pool[b].name:
                by_size.setdefault(len(groups[a]) + len(groups[b]), []).append((a, b))
        ranked: list[tuple[float, tuple[int, int]]] = []
        for pairs in by_size.values():
            sets = [[*base, *groups[a], *groups[b]] for a, b in pairs]
            ranked += zip(scores.training_losses(total, sets), pairs, strict=True)
        ranked.sort(key=lambda item: item[0])
        short = [pair for _, pair in ranked[:PAIRS_SCORED]]
        losses = scores.losses_of_groups(
            grams, self.folds, base, [[*groups[a], *groups[b]] for a, b in short]
        ).sum(axis=1)
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
        return gain > self.min_gain * self._total(larger) and gain > error

    def _total(self, ranked: Ranked) -> float:
        """Held-out sum of squares, the noise included."""
        return max(self.data.noise_loss + ranked.loss, 0.5 * self.data.noise_loss)

    def _both_needed(self, current: Ranked, pair: Ranked) -> bool:
        """Whether either of the last two members is missed when it is left out."""
        known = current.key
        new = [member for member in pair.members if member.name not in known]
        return all(self._is_needed(pair, member, 0.1 * self.alpha) for member in new)

    def _is_needed(self, full: Ranked, member: Candidate, alpha: float | None = None) -> bool:
        less = self._less(full, member)
        if not self._is_worth(less, full) or self._p_value(full, member) > (
            0.1 * self.alpha if member.name == "time_s" else alpha or self.alpha
        ):
            return False
        worth = less.loss - full.loss
        kind = _kind_of(member.name)
        is_wave = member.name == "time_s"
        rivals = [m for m in full.members if m.label != member.label]
        share = WAVE_SHARE if is_wave else FORM_SHARE
        return all(
            worth >= share * (self._less(full, rival).loss - full.loss)
            for rival in rivals
            if is_wave or _kind_of(rival.name) == kind
        )

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

    def _prune(self, ranked: Ranked) -> Ranked:
        """Drop members that are not needed beside the others, the least needed first."""
        while ranked.members:
            idle = [
                (self._less(ranked, m).loss, i)
                for i, m in enumerate(ranked.members)
                if not self._is_needed(ranked, m)
            ]
            if not idle:
                break
            ranked = self._less(ranked, ranked.members[min(idle)[1]])
        return ranked

    def _swap(self, ranked: Ranked) -> Ranked:
        """Exchange members, and their variants, as long as held-out trials gain."""
        for _ in range(4):
            best = ranked
            for member in ranked.members:
                rest = self._less(ranked, member)
                for other in self._alternatives(rest, ranked):
                    trial = self.add(rest, [other])
                    if trial.loss < best.loss - 1e-3 * self._total(best):
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
        picked = _best_of_each(pool, same, 3, gains) + _best_of_each(pool, others, 2, gains)
        return [pool[i] for i in picked]

    def _bend_or_limit(self, ranked: Ranked) -> Ranked:
        """Where stiffening and saturation do equally well, decide by where the bend sits.

        A limit bends the curve at its end: as a change of compliance it goes with a higher power
        of the load than ``LIMIT_EXPONENT``; a softening that is spread over the range does not.
        """
        names = {"stiffening", "saturation"}
        if len(names & ranked.key) != 1:
            return ranked
        member = next(m for m in ranked.members if m.name in names)
        rest = self._less(ranked, member)
        pool, losses = self._pool(rest)
        order = [i for i in np.argsort(losses.sum(axis=1)) if pool[i].name in names]
        fits = [self.add(rest, [pool[i]]) for i in order]
        powers = [f for f in fits if "exponent" in f.members[-1].fitted]
        limits = [f for f in fits if f.members[-1].name == "saturation"]
        if not powers or not limits:
            return ranked
        power, limit = (min(f, key=lambda r: r.loss) for f in (powers, limits))
        bends = [f for f in fits if f.members[-1].name == "stiffening"]
        bend = min(bends, key=lambda r: r.loss)
        if abs(_lead_in_se(limit, bend)) > TIE_IN_SE:
            return ranked
        term = power.fit.model.terms[-1]
        is_limit = term.values["amount"] < 0 and term.values["exponent"] > LIMIT_EXPONENT
        return limit if is_limit else bend

    def _first_presses(self, ranked: Ranked) -> Ranked:
        """Where a bent drift does no better than a change of the first presses, take the latter.

        A drift of one sign needs no second or third power; conditioning that fits as well and is
        over early in the session explains the bend.
        """
        drift = next((m for m in ranked.members if m.name == "drift"), None)
        if drift is None or len(drift.fitted) < 2 or "conditioning" in ranked.key:
            return ranked
        rest = self._less(ranked, drift)
        pool, losses = self._pool(rest)
        order = [i for i in np.argsort(losses.sum(axis=1)) if pool[i].name == "conditioning"]
        fits = [self.add(rest, [pool[i]]) for i in order]
        if not fits:
            return ranked
        early = min(fits, key=lambda r: r.loss)
        over = early.fit.model.terms[-1].values["trials"] < 0.12 * self.data.history.n_trials
        return early if over and _lead_in_se(ranked, early) < 1.0 else ranked

    def _ranking(
        self,
        current: Ranked,
        pool: list[Candidate],
        p_values: NDArray[np.float64],
        losses: NDArray[np.float64],
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
            close = [r.members[-1].name for r in rivals if _lead_in_se(final, r) < 2.0]
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
                    margin_in_se=_lead_in_se(final, runner) if runner else np.inf,
                    confusable=confusable,
                )
            )
        return tuple(described)


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


def _kind_of(name: str) -> str:
    """Whether an effect tells trials apart or acts within each of them."""
    return "between trials" if name in BETWEEN_TRIALS else "within trials"


def _best_of_each(
    pool: Sequence[Candidate],
    order: Sequence[int] | NDArray[np.int64],
    variants: int,
    gains: NDArray[np.float64],
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


def _lead_in_se(best: Ranked, other: Ranked) -> float:
    """By how many standard errors over units ``best`` predicts better than ``other``."""
    difference = other.unit_losses - best.unit_losses
    error = float(difference.std() * np.sqrt(difference.size)) + 1e-300
    return float(difference.sum()) / error


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

"""Exchange members of a set of effects for others that explain the same better, or more simply."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tacgen.diagnose.contact.candidates import Candidate
from tacgen.diagnose.contact.model import Term, session_trials
from tacgen.diagnose.contact.ranking import (
    EFFECT_SLACK,
    LIMIT_EXPONENT,
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
        if abs(lead_in_se(limit, bend)) > TIE_IN_SE:
            return ranked
        term = _term(power, "stiffening")
        is_limit = term.values["amount"] < 0 and term.values["exponent"] > LIMIT_EXPONENT
        return limit if is_limit else bend

    def _first_presses(self, ranked: Ranked) -> Ranked:
        """Where a bent drift does no better than a change of the first presses, take the latter.

        A drift of one sign needs no second or third power; conditioning that fits as well and is
        over early in the session, or beside a drift that would have to turn back, explains the
        bend.
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
        over = _term(early, "conditioning").values["trials"] < 0.12 * session_trials(self.data)
        turns = _turns_back(_term(ranked, "drift"))
        lead = lead_in_se(ranked, early)
        return early if (over and lead < 1.0) or (turns and lead < TIE_IN_SE) else ranked


def best_of_each(
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


def _term(ranked: Ranked, name: str) -> Term:
    """The fitted term of that name; a set that was fitted before keeps the order it had then."""
    return next(term for term in ranked.fit.model.terms if term.name == name)


def _turns_back(drift: Term) -> bool:
    """Whether a drift takes back more than a tenth of its way within the session."""
    tau = np.linspace(-0.5, 0.5, 41)
    gain = tau * (
        drift.values["linear"] + tau * (drift.values["quadratic"] + tau * drift.values["cubic"])
    )
    back = np.abs(np.diff(gain)).sum() - abs(gain[-1] - gain[0])
    return bool(back > 0.2 * np.ptp(gain))


def lead_in_se(best: Ranked, other: Ranked) -> float:
    """By how many standard errors over units ``best`` predicts better than ``other``."""
    difference = other.unit_losses - best.unit_losses
    error = float(difference.std() * np.sqrt(difference.size)) + 1e-300
    return float(difference.sum()) / error

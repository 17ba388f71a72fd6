"""Optical effects of ball presses as a problem of the one search, one kind after the other."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.stats import t as student

from tacgen.core.types import FloatArray
from tacgen.diagnose.engine import Problem, Step, reached, search
from tacgen.diagnose.optics.fit import Known, Model, PressFit, known_for, typical
from tacgen.diagnose.rules import OpticsRules
from tacgen.optics.effects import OpticalCandidate, PressScene, optical_effect, optical_effects

Kind = tuple[Known, bool, bool]
"""What must be taken as stated; if each press has its own value; if it grows over a session."""

ORDER: tuple[Kind, ...] = (
    (Known.EXPOSURE, False, True),
    (Known.NOTHING, False, False),
    (Known.EXPOSURE, False, False),
    (Known.PLACE, False, False),
    (Known.EXPOSURE, True, False),
    (Known.PLACE, True, False),
)
"""Kinds of candidates in the order of the search. What grows over a session comes first: no other
effect looks like it. What needs a picture's exposure or place as stated is judged on what the
effects on the image leave, and a value of each press's own last."""


def _kind(candidate: OpticalCandidate) -> Kind:
    stage = optical_effect(candidate.effect).stage
    return known_for(stage), bool(candidate.each), candidate.over_session


def log_gain(before: FloatArray, after: FloatArray) -> tuple[float, float]:
    """Mean over presses of the fall of the logarithm of squared errors (E,), and its error."""
    gain = np.log(before + 1e-6) - np.log(after + 1e-6)
    return float(gain.mean()), float(gain.std(ddof=1) / math.sqrt(len(gain)) + 1e-12)


@dataclass(frozen=True, slots=True)
class Scored:
    """A model, its squared errors (E,) on held-out presses, and what its last candidate gains.

    ``known`` is what was taken as stated, ``among`` how many candidates were tried beside it;
    those of ``as_good`` it leads by no more than chance.
    """

    model: Model
    squares: FloatArray
    known: Known
    gain: float = 0.0
    gain_stderr: float = 0.0
    p_value: float = 1.0
    among: int = 1
    as_good: tuple[str, ...] = ()

    @property
    def members(self) -> tuple[OpticalCandidate, ...]:
        """What was added."""
        return self.model.candidates

    @property
    def loss(self) -> float:
        """Mean logarithm of the squared errors."""
        return float(np.log(self.squares + 1e-6).mean())

    @property
    def candidate(self) -> OpticalCandidate:
        """What was added last."""
        return self.model.candidates[-1]

    @property
    def name(self) -> str:
        """The effect that was added last."""
        return self.candidate.effect

    @property
    def rmse(self) -> float:
        """Error of a typical press, grey levels."""
        return math.sqrt(typical(self.squares))


@dataclass(frozen=True, slots=True)
class Selection:
    """The table alone, and the steps with one effect more each; the last of a kind found none."""

    start: Model
    steps: tuple[Step[Scored], ...]

    @property
    def added(self) -> list[tuple[Scored, Scored, Scored | None]]:
        """Before and after each effect that was found, and the best one of another effect.

        Of a pair the first comes before the second.
        """
        added = list[tuple[Scored, Scored, Scored | None]]()
        for step in self.steps:
            if step.found is None:
                continue
            n_pending = len(step.found.members) - len(step.current.members)
            first = [one for one in step.tried if one.members == step.found.members[:-1]]
            path = [step.current, *first[: n_pending - 1], step.found]
            names = [one.name for one in path[1:]]
            second = next((one for one in step.tried if one.name not in names), None)
            added += [(*pair, second) for pair in pairwise(path)]
        return added

    @property
    def chosen(self) -> Model:
        """The model with all effects that were found."""
        return self.added[-1][1].model if self.added else self.start


def select(fit: PressFit, start: Model, scene: PressScene, without: set[str]) -> Selection:
    """Add the effect that lowers the held-out error most, until none lowers it clearly.

    Effects whose names are in ``without`` are not tried.
    """
    model, steps = start, list[Step[Scored]]()
    for kind in ORDER:
        problem = PressProblem(fit, scene, kind, without)
        if problem.listed:
            found = search(problem, problem.unchanged(model))
            steps += [step for step in found if step.tried]
            model = reached(found).model
    return Selection(start, tuple(steps))


class PressProblem(Problem[OpticalCandidate, Scored]):
    """Candidates of one ``kind`` beside those of the kinds before it, which stay."""

    rules: OpticsRules

    def __init__(self, fit: PressFit, scene: PressScene, kind: Kind, without: set[str]) -> None:
        self.rules, self._fit, self._known = fit.rules, fit, kind[0]
        self._kind = kind
        self.listed = [
            candidate
            for effect in optical_effects()
            if effect.name not in without
            for candidate in effect.candidates(scene)
            if _kind(candidate) == kind
        ]
        self._fitted: dict[tuple[int, ...], Scored] = {}
        self._n_accepted = 0
        self._before: tuple[Model, list[FloatArray]] | None = None

    def unchanged(self, model: Model) -> Scored:
        """A model whose errors are compared with."""
        self._n_accepted = len(model.candidates)
        start = Scored(model, self._fit.mean_squares(self._residuals(model)), self._known)
        self._fitted = {_key(start): start}
        return start

    def _residuals(self, model: Model) -> list[FloatArray]:
        if self._before is None or self._before[0] is not model:
            self._before = model, self._fit.residuals(model, self._known)
        return self._before[1]

    def pool(self, current: Scored) -> list[tuple[OpticalCandidate, float]]:
        """Those of effects that the model has not got of this kind.

        Beside one that is not accepted yet, only rigid ones if that is rigid: those hide each
        other.
        """
        taken = {one.effect for one in current.members if _kind(one) == self._kind}
        listed = [(one, math.inf) for one in self.listed if one.effect not in taken]
        if pending := current.members[self._n_accepted :]:
            listed = [one for one in listed if one[0].rigid and pending[-1].rigid]
        return listed

    def add(self, current: Scored, more: Sequence[OpticalCandidate]) -> Scored:
        """Fit one candidate more, from the start that fits best."""
        (candidate,), fit, known, model = more, self._fit, self._known, current.model
        self._residuals(model)
        starts = [_with(model, candidate, start) for start in candidate.starts]
        if len(starts) > 1:
            starts = [min(starts, key=lambda one: typical(fit.squares(one, known)))]
        scored = self._beside(model, fit.fitted(starts[0], known), candidate)
        self._fitted[_key(scored)] = scored
        return scored

    def _beside(self, model: Model, fitted: Model, candidate: OpticalCandidate) -> Scored:
        """A fitted model with what ``candidate`` gains beside ``model``, which is without it."""
        fit, known = self._fit, self._known
        before, after = self._residuals(model), fit.residuals(fitted, known)
        if known == Known.PLACE and candidate.each:
            places = fit.own_values(model, known)
            apart = ((places - places.mean(axis=0)) ** 2).mean(axis=1)
            evidence = np.log(apart / fit.rules.usual_scatter_radii**2)
        else:
            evidence = correlations(before, [b - a for b, a in zip(before, after, strict=True)])
        squares = fit.mean_squares(after)
        gain, error = log_gain(fit.mean_squares(before), squares)
        chance = _chance(fit.by_press(evidence), fit.rules.table_presses)
        has = {member.effect for member in model.candidates}
        among = sum(one is candidate or one.effect not in has for one in self.listed)
        return Scored(fitted, squares, known, gain, error, chance, among)

    def without(self, full: Scored, member: OpticalCandidate) -> Scored:
        """The model less one of those that this step tries: the others were accepted before."""
        rest = tuple(id(one) for one in full.members if one is not member)
        if rest not in self._fitted:
            msg = f"{member.effect} was accepted in a step before and stays"
            raise ValueError(msg)
        return self._fitted[rest]

    def accepts(self, full: Scored, member: OpticalCandidate) -> bool:
        """Whether a candidate's gain beside the others is large, clear, and not of chance."""
        if not any(one is member for one in full.members[self._n_accepted :]):
            return True  # of a step before
        if member is not full.candidate:
            rest, fitted = self.without(full, member), self._fitted[_key(full)]
            full = self._beside(rest.model, fitted.model, member)
        if member.evident:
            return full.gain > 0
        rules = self.rules
        least = rules.least_gain + rules.least_gain_per_parameter * len(member.shared)
        if member.rigid:
            least = rules.least_gain_of_rigid
            if math.expm1(0.5 * full.gain) * full.rmse < rules.least_gain_grey:
                return False
        if member.each:
            place = self._known == Known.PLACE
            least = rules.least_gain_of_places if place else rules.least_gain_of_exposures
        least = max(least, rules.clear_gain_in_se * full.gain_stderr)
        return full.gain >= least and full.p_value <= rules.false_alarm / full.among

    def ordered(self, ends: Sequence[Scored]) -> list[Scored]:
        """Of those that are not clearly worse than the best, the one with fewest parameters."""
        worth = sorted((e for e in ends if self.accepts(e, e.candidate)), key=self.score)
        if not worth:
            return []
        leads = [log_gain(one.squares, worth[0].squares) for one in worth[1:]]
        close = [
            one
            for one, (lead, error) in zip(worth[1:], leads, strict=True)
            if lead < self.rules.clear_lead_in_se * error
        ]
        chosen = min([worth[0], *close], key=lambda one: len(one.model.free))
        as_good = {one.name for one in (worth[0], *close)} - {chosen.name}
        model = chosen.model
        if self._known == Known.NOTHING:
            # How bright the presses are in the mean is the effect's too.
            model = self._fit.fitted(self._fit.placed(model), Known.EXPOSURE)
        return [replace(chosen, model=model, as_good=tuple(sorted(as_good)))]

    def settled(self, found: Scored) -> Scored:
        """Its errors as the next step compares them."""
        return self.unchanged(found.model)


def _key(scored: Scored) -> tuple[int, ...]:
    return tuple(id(one) for one in scored.members)


def correlations(residuals: list[FloatArray], changes: list[FloatArray]) -> FloatArray:
    """Correlations of residuals (n, 3) with what other presses' parameters change in them."""
    pairs = [(r / np.linalg.norm(r), c) for r, c in zip(residuals, changes, strict=True)]
    return np.array([np.vdot(r, c) / (np.linalg.norm(c) + 1e-9) for r, c in pairs])


def _chance(evidence: FloatArray, table_presses: float) -> float:
    """The chance of a mean over presses (E,) as high as this where there is no effect.

    The table is off by the mean of its own presses, which scatter as these do.
    """
    n = len(evidence)
    error = evidence.std(ddof=1) * math.sqrt(1 / n + 1 / table_presses) + 1e-12
    return float(student.sf(evidence.mean() / error, n - 1))


def _with(model: Model, candidate: OpticalCandidate, start: Mapping[str, float]) -> Model:
    """The model and one candidate more; what the table has of its effect is where it starts."""
    shared, name = dict(model.shared), candidate.effect
    table = model.fixed.get(name, {})
    for key, parameter in candidate.shared.items():
        shared.setdefault((name, key), table.get(key, parameter.identity))
    for key, value in start.items():
        if key not in table:
            shared[name, key] = value
    return replace(model, candidates=(*model.candidates, candidate), shared=shared)

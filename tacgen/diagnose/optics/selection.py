"""Forward selection of optical effects by the error on held-out presses."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import t as student

from tacgen.core.types import FloatArray
from tacgen.diagnose.optics.fit import Known, Model, PressFit, known_for, typical
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
    """A model with one candidate more, and its squared errors (E,) on held-out presses."""

    model: Model
    squares: FloatArray
    gain: float
    gain_stderr: float
    p_value: float

    @property
    def candidate(self) -> OpticalCandidate:
        """What was added."""
        return self.model.candidates[-1]

    @property
    def name(self) -> str:
        """The effect that was added."""
        return self.candidate.effect

    @property
    def rmse(self) -> float:
        """Error of a typical press, grey levels."""
        return math.sqrt(typical(self.squares))


@dataclass(frozen=True, slots=True)
class Step:
    """One step: squared errors (E,) before it, every candidate, and which was chosen."""

    known: Known
    squares: FloatArray
    tried: tuple[Scored, ...]
    chosen: Scored | None
    as_good: tuple[str, ...] = ()

    @property
    def before(self) -> float:
        """RMSE of a typical press, grey levels."""
        return math.sqrt(typical(self.squares))

    @property
    def runner_up(self) -> Scored | None:
        """The best one of another effect."""
        name = self.chosen.name if self.chosen else ""
        others = [one for one in self.tried if one.name != name]
        return others[0] if others else None


@dataclass(frozen=True, slots=True)
class Selection:
    """The table alone, and the steps with one effect more each; the last of a kind chose none."""

    start: Model
    steps: tuple[Step, ...]

    @property
    def added(self) -> list[Step]:
        """The steps that chose an effect."""
        return [step for step in self.steps if step.chosen is not None]

    @property
    def chosen(self) -> Model:
        """The model with all effects that were chosen."""
        models = [step.chosen.model for step in self.steps if step.chosen is not None]
        return models[-1] if models else self.start


def select(fit: PressFit, start: Model, scene: PressScene, without: set[str]) -> Selection:
    """Add the effect that lowers the held-out error most, until none lowers it clearly.

    Effects whose names are in ``without`` are not tried.
    """
    model, steps = start, []
    for kind in ORDER:
        while len(model.candidates) < fit.rules.max_effects:
            step = _step(fit, model, scene, kind, without)
            if step is None:
                break
            steps.append(step)
            if step.chosen is None:
                break
            model = step.chosen.model
    return Selection(start, tuple(steps))


def _step(
    fit: PressFit, model: Model, scene: PressScene, kind: Kind, without: set[str]
) -> Step | None:
    known, taken = kind[0], {c.effect for c in model.candidates if _kind(c) == kind}
    listed = [
        candidate
        for effect in optical_effects()
        if effect.name not in without | taken
        for candidate in effect.candidates(scene)
        if _kind(candidate) == kind
    ]
    if not listed:
        return None
    residuals = fit.residuals(model, known)
    before = fit.mean_squares(residuals)
    tried = sorted(
        (_scored(fit, model, candidate, known, residuals) for candidate in listed),
        key=lambda one: -one.gain,
    )
    worth = [one for one in tried if _is_worth(fit, one, len(tried))]
    if not worth:
        return Step(known, before, tuple(tried), None)
    # Of those that are not clearly worse than the best one, the one with the fewest parameters.
    close = [one for one in worth if _is_as_good(fit, one, worth[0])]
    chosen = min(close, key=lambda one: len(one.candidate.shared))
    as_good = sorted({one.name for one in close} - {chosen.name})
    if known == Known.NOTHING:
        # How bright the presses are in the mean is the effect's too.
        moved = fit.fitted(fit.placed(chosen.model), Known.EXPOSURE)
        chosen = replace(chosen, model=moved)
    return Step(known, before, tuple(tried), chosen, tuple(as_good))


def _scored(
    fit: PressFit, model: Model, candidate: OpticalCandidate, known: Known, before: list[FloatArray]
) -> Scored:
    starts = [_with(model, candidate, start) for start in candidate.starts]
    if len(starts) > 1:
        starts = [min(starts, key=lambda one: typical(fit.squares(one, known)))]
    fitted = fit.fitted(starts[0], known)
    after = fit.residuals(fitted, known)
    if known == Known.PLACE and candidate.each:
        places = fit.own_values(model, known)
        apart = ((places - places.mean(axis=0)) ** 2).mean(axis=1)
        evidence = np.log(apart / fit.rules.usual_scatter_radii**2)
    else:
        evidence = correlations(before, [b - a for b, a in zip(before, after, strict=True)])
    squares = fit.mean_squares(after)
    gain, error = log_gain(fit.mean_squares(before), squares)
    chance = _chance(fit.by_press(evidence), fit.rules.table_presses)
    return Scored(fitted, squares, gain, error, chance)


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


def _is_worth(fit: PressFit, one: Scored, n_tried: int) -> bool:
    rules, candidate = fit.rules, one.candidate
    if candidate.evident:
        return one.gain > 0
    least = rules.least_gain + rules.least_gain_per_parameter * len(candidate.shared)
    if candidate.rigid:
        least = rules.least_gain_of_rigid
        before_grey = one.rmse * math.exp(0.5 * one.gain)
        if before_grey - one.rmse < rules.least_gain_grey:
            return False
    if candidate.each:
        place = _kind(candidate)[0] == Known.PLACE
        least = rules.least_gain_of_places if place else rules.least_gain_of_exposures
    least = max(least, rules.clear_gain_in_se * one.gain_stderr)
    return one.gain >= least and one.p_value <= rules.false_alarm / n_tried


def _is_as_good(fit: PressFit, one: Scored, best: Scored) -> bool:
    """Whether the best one's lead is no clearer than chance."""
    lead, error = log_gain(one.squares, best.squares)
    return one is best or lead < fit.rules.clear_lead_in_se * error

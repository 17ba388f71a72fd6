"""Optical effects against one another: forward selection by the error on held-out presses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tacgen.calibrate.lookup.model_choice import fold_of
from tacgen.core.arrays import FloatArray
from tacgen.diagnose.optics.fit import (
    System,
    fit,
    heldout_errors,
    mean_square,
    own_fit,
    without_fold,
)
from tacgen.diagnose.optics.model import (
    SKIRT,
    FreeParameter,
    GivenTable,
    ModelState,
    PlainTable,
    Problem,
    geometry_of,
    prepared,
    render,
    scene_of,
)
from tacgen.diagnose.optics.pixels import PressPixels
from tacgen.diagnose.optics.residuals import (
    Dependence,
    Residuals,
    gain_p_value,
    is_as_good,
    typical_rmse,
)
from tacgen.diagnose.optics.surface import FORMS
from tacgen.optics.effects import Candidate, optical_effect, optical_effects


@dataclass(frozen=True, slots=True)
class FittedModel:
    """A model: which candidates it holds, its fit, and its errors on held-out presses.

    Attributes
    ----------
    candidates : tuple of Candidate
    problem, state, system : what was fitted, and to what
    errors : (n, 3) float
        Residuals, each press by a fit to the other folds.
    squares : (N,) float
        Mean squared error of each press.
    """

    candidates: tuple[Candidate, ...]
    problem: Problem
    state: ModelState
    system: System
    errors: FloatArray
    squares: FloatArray

    @property
    def rmse(self) -> float:
        """Cross-validated, grey levels, of a typical press."""
        return typical_rmse(self.squares)

    @property
    def shared(self) -> tuple[FreeParameter, ...]:
        """Free parameters of all presses."""
        return shared_parameters(self.candidates, self.state)

    @property
    def own(self) -> tuple[FreeParameter, ...]:
        """Free parameters of each press."""
        return own_parameters(self.candidates)

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of its effects."""
        return tuple(candidate.effect for candidate in self.candidates)

    @property
    def noise(self) -> float:
        """Mean squared error of the fit, which sets what a press's own parameters weigh."""
        return max(mean_square(self.problem, self.state), self.problem.rules.least_square_grey)

    def complexity(self) -> float:
        """How many parameters its effects free; one of each press counts half, for its prior."""
        n_presses = self.problem.pixels.n_presses
        table, rules = self.problem.table, self.problem.rules
        by_place = (
            rules.place_complexity * len(table.moving) if isinstance(table, PlainTable) else 0
        )
        return by_place + sum(len(c.shared) + 0.5 * n_presses * len(c.own) for c in self.candidates)

    def on_presses(self, pixels: PressPixels) -> tuple[Problem, ModelState]:
        """The model on other presses, of which nothing is known yet."""
        problem = replace(self.problem, pixels=pixels)
        state = self.state.for_presses(pixels.n_presses)
        return problem, prepared(problem, state, before=self.state)

    def errors_on(self, pixels: PressPixels) -> FloatArray:
        """Residuals (n, 3) on presses that it was not fitted to."""
        return heldout_errors(*self.on_presses(pixels), self.own, self.noise)

    def state_of(self, pixels: PressPixels) -> ModelState:
        """Its state with other presses' own parameters, estimated on all of their pixels."""
        problem, state = self.on_presses(pixels)
        everywhere = np.ones(len(pixels), dtype=bool)
        return own_fit(problem, state, self.own, everywhere, self.noise) if self.own else state


def shared_parameters(
    candidates: Sequence[Candidate], state: ModelState
) -> tuple[FreeParameter, ...]:
    """Every shared parameter once; the skirt's length too where the gel has one."""
    free = [FreeParameter(c.effect, name, p) for c in candidates for name, p in c.shared.items()]
    return (SKIRT, *free) if state.form == "skirt" else tuple(free)


def own_parameters(candidates: Sequence[Candidate]) -> tuple[FreeParameter, ...]:
    """Every parameter of each press once."""
    return tuple(
        FreeParameter(c.effect, name, p, each_press=True)
        for c in candidates
        for name, p in c.own.items()
    )


@dataclass(frozen=True, slots=True)
class Step:
    """One step of the selection: the error before it and with each effect's best candidate."""

    before: float
    rmse: dict[str, float]
    p_value: dict[str, float]
    selected: str
    equals: tuple[str, ...]
    runner_up: str


@dataclass(frozen=True, slots=True)
class Selection:
    """What was selected: the models from the plain one on, one effect more each."""

    path: tuple[FittedModel, ...]
    steps: tuple[Step, ...]

    @property
    def plain(self) -> FittedModel:
        """The model without any effect."""
        return self.path[0]

    @property
    def chosen(self) -> FittedModel:
        """The model with all effects that were selected."""
        return self.path[-1]

    def step_of(self, effect: str) -> Step:
        """The step at which an effect was selected."""
        return next(step for step in self.steps if step.selected == effect)


class ModelComparison:
    """Fits and scores candidates on one set of presses.

    Parameters
    ----------
    problem : Problem
    order : (N,) float
        Place of each press in the session.
    noise_grey : float
        Standard deviation of the camera's noise.
    """

    def __init__(self, problem: Problem, order: FloatArray, noise_grey: float) -> None:
        self.problem = problem
        self.rules = problem.rules
        self._order = order
        self._noise_grey = noise_grey
        n_presses = problem.pixels.n_presses
        self._folds = np.empty(n_presses, dtype=np.int64)
        by_depth = np.argsort(problem.pixels.labels[:, 2], kind="stable")
        self._folds[by_depth] = fold_of(n_presses, self.rules.folds)

    def select(self, start: ModelState) -> Selection:
        """Add the effect that lowers the held-out error most, until none lowers it enough.

        A mark on the gel, or a change with the session's time, that explains more than any effect
        ends the selection: effects would be bent to follow it.
        """
        plain = current = self._plain(start)
        path, steps, dropped = [plain], [], set[str]()
        while len(current.candidates) < self.rules.max_effects:
            tried = [
                self._add(current, candidate)
                for candidate in self._candidates(current)
                if candidate.effect not in dropped and candidate.effect not in current.effects
            ]
            if not tried:
                break
            tried.sort(key=lambda model: model.rmse)
            n_final = self.rules.finalists
            tried[:n_final] = [self._fitted_on(model) for model in tried[:n_final]]
            step, best = self._judge(current, tried)
            followed = self.dependences(current, self.rules.decisive_covariates)
            if followed and followed[0].gain_grey > current.rmse - best.rmse:
                step = replace(step, selected="")
            steps.append(step)
            if not step.selected:
                break
            current = self._best_form(best)
            path.append(current)
            for effect in current.effects[:-1]:
                shorter = self._without(current, effect)
                if not self._is_worth(shorter, current, len(tried)):
                    current = shorter
                    dropped.add(effect)
                    path = self._path_to(plain, current)
        return Selection(tuple(path), tuple(steps))

    def dependences(self, model: FittedModel, only: tuple[str, ...] = ()) -> list[Dependence]:
        """What the held-out residuals of a model follow, the strongest first."""
        pixels = model.problem.pixels
        return Residuals(
            pixels=pixels,
            errors=model.errors,
            change=render(model.problem, model.state) - pixels.background,
            places_mm=geometry_of(model.problem, model.state)[0],
            folds=self._folds,
            order=self._order,
            noise_grey=self._noise_grey,
            rules=self.rules,
        ).dependences(only)

    def _plain(self, state: ModelState) -> FittedModel:
        """The model without effects, with the form of the gel that fits held-out presses best."""
        problem, rules = self.problem, self.rules
        fits = []
        for form in FORMS:
            first = prepared(problem, replace(state, form=form))
            if isinstance(problem.table, PlainTable):
                weights = np.zeros((problem.table.n_columns, 3))
                first = replace(first, weights=weights)
                first, _ = fit(problem, first, (), (), steps=rules.start_steps)
            fits.append(self._fit((), problem, first, rules.first_steps))
        return min(fits, key=lambda model: model.rmse)

    def _candidates(self, model: FittedModel) -> list[Candidate]:
        """Every candidate of every effect; where it may hide the gel's form, with each form."""
        scene = scene_of(model.problem, model.state)
        listed = []
        for effect in optical_effects():
            for candidate in effect.candidates(scene):
                tries_forms = candidate.hides_form and not scene.has_table
                forms = FORMS if tries_forms else ("",)
                listed += [replace(candidate, form=form) for form in forms]
        return listed

    def _fit(
        self,
        candidates: tuple[Candidate, ...],
        problem: Problem,
        state: ModelState,
        steps: int,
        weight: FloatArray | None = None,
    ) -> FittedModel:
        """Fit a model that starts at ``state``, and score it on held-out presses."""
        shared, own = shared_parameters(candidates, state), own_parameters(candidates)
        if weight is not None:
            trusted = self.rules.trusted_steps
            state, _ = fit(problem, state, shared, own, steps=trusted, weight=weight)
        state, system = fit(problem, state, shared, own, steps=steps)
        pixels = problem.pixels
        errors = np.zeros_like(pixels.grey)
        model = FittedModel(candidates, problem, state, system, errors, np.zeros(pixels.n_presses))
        noise = model.noise if own else 1.0
        for fold in np.unique(self._folds):
            out = self._folds == fold
            mine = out[pixels.press]
            fitted = without_fold(problem, state, system, shared, ~out)
            part = replace(problem, pixels=pixels.of_presses(out))
            there = replace(fitted.for_presses(int(out.sum())), prepared=state.of_pixels(mine))
            errors[mine] = heldout_errors(part, there, own, noise)
        return replace(model, squares=pixels.mean_by_press((errors**2).mean(axis=1)))

    def _add(self, model: FittedModel, candidate: Candidate) -> FittedModel:
        """The model and one candidate more."""
        problem, state = model.problem, model.state
        if candidate.color_by_place and isinstance(problem.table, PlainTable):
            table = replace(problem.table, place_degree=self.rules.place_degree)
            more = np.zeros((table.n_columns - len(state.weights), 3))
            problem = replace(problem, table=table)
            state = replace(state, weights=np.vstack([state.weights, more]))
        if candidate.form:
            state = replace(state, form=candidate.form)
        state = self._start(problem, state, candidate)
        trusted = candidate.first_weight
        weight = None if trusted is None else trusted(problem.pixels.grey)
        return self._fit((*model.candidates, candidate), problem, state, self.rules.steps, weight)

    def _start(self, problem: Problem, state: ModelState, candidate: Candidate) -> ModelState:
        """Where the fit of a candidate begins."""
        name = candidate.effect
        shared = {(name, key): parameter.identity for key, parameter in candidate.shared.items()}
        n_presses = problem.pixels.n_presses
        own = {(name, key): np.zeros(n_presses) for key in candidate.own}
        # Values that a given table has of the effect are kept as the start.
        state = replace(state, shared={**shared, **state.shared}, own={**state.own, **own})
        starts = []
        for values in candidate.starts(scene_of(problem, state)):
            given = {(name, key): value for key, value in values.items()}
            started = replace(state, shared={**state.shared, **given})
            starts.append(prepared(problem, started, only=name))
        if len(starts) == 1:
            return starts[0]
        skirt = shared_parameters((), state)
        tried = [fit(problem, s, skirt, (), steps=self.rules.start_steps)[0] for s in starts]
        return min(tried, key=lambda start: mean_square(problem, start))

    def _fitted_on(self, model: FittedModel) -> FittedModel:
        """The same model after more steps."""
        return self._fit(model.candidates, model.problem, model.state, self.rules.more_steps)

    def _best_form(self, model: FittedModel) -> FittedModel:
        """The same model with the form of the gel that now fits best."""
        if isinstance(model.problem.table, GivenTable):
            return model
        others = [
            self._fit(
                model.candidates,
                model.problem,
                replace(model.state, form=form),
                self.rules.steps,
            )
            for form in FORMS
            if form != model.state.form
        ]
        return min([model, *others], key=lambda other: other.rmse)

    def _without(self, model: FittedModel, effect: str) -> FittedModel:
        """The model less one effect."""
        candidates = tuple(c for c in model.candidates if c.effect != effect)
        problem, state = model.problem, model.state.without(effect)
        if isinstance(problem.table, PlainTable) and not any(c.color_by_place for c in candidates):
            problem = replace(problem, table=replace(problem.table, place_degree=-1))
            state = replace(state, weights=state.weights[: problem.table.n_columns])
        return self._fit(candidates, problem, state, self.rules.steps)

    def _path_to(self, plain: FittedModel, chosen: FittedModel) -> list[FittedModel]:
        """The models on the way to ``chosen``, after an effect has been dropped."""
        path = [plain]
        for candidate in chosen.candidates[:-1]:
            path.append(self._add(path[-1], candidate))
        return [*path, chosen]

    def _judge(self, current: FittedModel, tried: list[FittedModel]) -> tuple[Step, FittedModel]:
        """Of the models that hardly differ from the best one, the simplest."""
        worth = [m for m in tried if self._is_worth(current, m, len(tried))] or tried
        leader = min(worth, key=lambda model: model.rmse)
        most = self.rules.most_of_gain
        equals = [m for m in worth if is_as_good(m.squares, leader.squares, current.squares, most)]
        best = min(equals, key=lambda model: (model.complexity(), model.rmse))
        name = best.effects[-1]
        by_name: dict[str, FittedModel] = {}
        for model in sorted(tried, key=lambda model: model.rmse):
            by_name.setdefault(model.effects[-1], model)
        others = [other for other in by_name if other != name]
        step = Step(
            before=current.rmse,
            rmse={other: model.rmse for other, model in by_name.items()},
            p_value={o: gain_p_value(current.squares, m.squares) for o, m in by_name.items()},
            selected=name if self._is_worth(current, best, len(tried)) else "",
            equals=tuple(dict.fromkeys(m.effects[-1] for m in equals if m.effects[-1] != name)),
            runner_up=others[0] if others else "",
        )
        return step, best

    def _is_worth(self, shorter: FittedModel, longer: FittedModel, n_tried: int) -> bool:
        """Whether the longer model's gain is both sure and large enough."""
        rules = self.rules
        if gain_p_value(shorter.squares, longer.squares) > rules.false_alarm / n_tried:
            return False
        added = [optical_effect(name) for name in set(longer.effects) - set(shorter.effects)]
        if all(effect.is_evident for effect in added):
            return longer.rmse <= (1 - rules.least_gain_evident) * shorter.rmse
        follows_form = all(effect.follows_form_errors for effect in added)
        share = rules.least_noise_share_of_form if follows_form else rules.least_noise_share
        stands_out = shorter.rmse**2 - longer.rmse**2 >= (share * self._noise_grey) ** 2
        return stands_out and longer.rmse <= (1 - rules.least_gain) * shorter.rmse

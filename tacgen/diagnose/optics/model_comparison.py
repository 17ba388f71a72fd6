"""Candidates against one another: each fitted beside what was found, scored on presses left out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from tacgen.calibrate.lookup.model_choice import fold_of
from tacgen.core.arrays import FloatArray
from tacgen.diagnose.optics.candidates import DECAY, Candidate
from tacgen.diagnose.optics.fit import (
    Knob,
    Problem,
    System,
    fit,
    heldout_errors,
    mean_square,
    own_fit,
    without_fold,
)
from tacgen.diagnose.optics.model import Optics, PlainTable
from tacgen.diagnose.optics.occlusion import with_shadow
from tacgen.diagnose.optics.pixels import PressPixels
from tacgen.diagnose.optics.surface import FORMS

FOLDS = 4
MOST_OF_GAIN = 0.8
"""A simpler candidate that reaches this share of the best one's gain is preferred to it."""

FIRST_STEPS = 6
STEPS = 3
MORE_STEPS = 3


@dataclass(frozen=True, slots=True)
class Entry:
    """A model: which candidates it holds, its fit, and what it leaves of presses left out.

    Attributes
    ----------
    taken : tuple of Candidate
    problem, state, system : what was fitted, and to what
    errors : (n, 3) float
        Residuals, each press by a fit to the other folds.
    squares : (N,) float
        Mean squared error of each press.
    """

    taken: tuple[Candidate, ...]
    problem: Problem
    state: Optics
    system: System
    errors: FloatArray
    squares: FloatArray

    @property
    def rmse(self) -> float:
        """Cross-validated, grey levels, of a typical press."""
        return typical_rmse(self.squares)

    @property
    def shared(self) -> tuple[Knob, ...]:
        """Knobs of all presses."""
        return shared_knobs(self.taken, self.state)

    @property
    def own(self) -> tuple[Knob, ...]:
        """Knobs of each press."""
        return own_knobs(self.taken)

    @property
    def names(self) -> tuple[str, ...]:
        """The effects."""
        return tuple(candidate.name for candidate in self.taken)

    def complexity(self) -> float:
        """How many quantities all of its effects free."""
        return sum(c.complexity(self.problem.pixels.n_presses) for c in self.taken)


def shared_knobs(taken: Sequence[Candidate], state: Optics) -> tuple[Knob, ...]:
    """Every shared knob once; the skirt's length too where the gel has one that is not given."""
    knobs = {(k.key, k.index): k for candidate in taken for k in candidate.shared}
    skirt = (DECAY,) if state.form == "skirt" else ()
    return (*skirt, *knobs.values())


def own_knobs(taken: Sequence[Candidate]) -> tuple[Knob, ...]:
    """Every knob of each press once."""
    return tuple({(k.key, k.index): k for c in taken for k in c.own}.values())


@dataclass(frozen=True, slots=True)
class Contest:
    """Fits and scores candidates on one set of presses."""

    problem: Problem
    folds: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    @classmethod
    def on(cls, problem: Problem) -> Contest:
        """With whole presses in each fold, of every depth: no table reaches beyond its slopes."""
        folds = np.empty(problem.pixels.n_presses, dtype=np.int64)
        folds[np.argsort(problem.pixels.labels[:, 2], kind="stable")] = fold_of(len(folds), FOLDS)
        return cls(problem, folds)

    def start(self, state: Optics) -> Entry:
        """The plain model, with the form of skin that the presses speak for."""
        state = state.for_presses(self.problem.pixels.n_presses)
        if not isinstance(self.problem.table, PlainTable) and state.form == "given":
            return self.enter((), self.problem, replace(state, form="skirt"), FIRST_STEPS)
        forms = [
            self.enter((), self.problem, self._first(replace(state, form=form)), FIRST_STEPS)
            for form in FORMS
        ]
        return min(forms, key=lambda entry: entry.rmse)

    def _first(self, state: Optics) -> Optics:
        table = self.problem.table
        if not isinstance(table, PlainTable):
            return state
        state = replace(state, weights=np.zeros((table.n_columns, 3)))
        return fit(self.problem, state, (), (), steps=1)[0]

    def enter(
        self,
        taken: tuple[Candidate, ...],
        problem: Problem,
        state: Optics,
        steps: int,
        weight: FloatArray | None = None,
    ) -> Entry:
        """Fit a model that starts at ``state`` and score it on the presses it leaves out."""
        shared, own = shared_knobs(taken, state), own_knobs(taken)
        if weight is not None:
            state, _ = fit(problem, state, shared, own, steps=2, weight=weight)
        state, system = fit(problem, state, shared, own, steps=steps)
        errors = self._left_out(problem, state, system, shared, own)
        squares = problem.pixels.mean_by_press((errors**2).mean(axis=1))
        return Entry(taken, problem, state, system, errors, squares)

    def add(self, entry: Entry, candidate: Candidate) -> Entry:
        """The model of ``entry`` and one candidate more."""
        taken = (*entry.taken, candidate)
        problem, state = entry.problem, entry.state
        if candidate.near and isinstance(problem.table, PlainTable):
            problem = replace(problem, table=PlainTable(near=True))
            more = problem.table.n_columns - len(state.weights)
            state = replace(state, weights=np.vstack([state.weights, np.zeros((more, 3))]))
        if candidate.form:
            state = replace(state, form=candidate.form)
        state = candidate.prepare(problem, state)
        weight = None
        if candidate.name == "saturation":
            weight = (problem.pixels.grey < state.level[0] - 2).astype(np.float64)
        return self.enter(taken, problem, state, STEPS, weight)

    def further(self, entry: Entry) -> Entry:
        """The same model, fitted on."""
        return self.enter(entry.taken, entry.problem, entry.state, MORE_STEPS)

    def reformed(self, entry: Entry) -> Entry:
        """The same model with the form of skin that the presses now speak for."""
        if not isinstance(entry.problem.table, PlainTable):
            return entry
        others = [
            self.enter(entry.taken, entry.problem, replace(entry.state, form=form), STEPS)
            for form in FORMS
            if form != entry.state.form
        ]
        return min([entry, *others], key=lambda other: other.rmse)

    def without(self, entry: Entry, name: str) -> Entry:
        """The model of ``entry`` less one effect."""
        gone = [c for c in entry.taken if c.name == name]
        taken = tuple(c for c in entry.taken if c.name != name)
        problem, state, plain = entry.problem, entry.state, Optics()
        fresh = plain.for_presses(problem.pixels.n_presses)
        kept = {(k.key, k.index) for c in taken for k in (*c.shared, *c.own)}
        for candidate in gone:
            for knob in (*candidate.shared, *candidate.own):
                if (knob.key, knob.index) in kept:
                    continue
                values = np.array(getattr(state, knob.key), dtype=np.float64)
                place = np.s_[:, knob.index] if knob.each_press else np.s_[...]
                values[place] = getattr(fresh, knob.key)[place]
                state = replace(state, **{knob.key: values})  # type: ignore[arg-type]
            if candidate.near:
                problem = replace(problem, table=PlainTable())
                state = replace(state, weights=state.weights[: problem.table.n_columns])
        if name == "shadow":
            state = replace(state, hidden=None)
        return self.enter(taken, problem, state, STEPS)

    def _left_out(
        self,
        problem: Problem,
        state: Optics,
        system: System,
        shared: Sequence[Knob],
        own: Sequence[Knob],
    ) -> FloatArray:
        pixels = problem.pixels
        errors = np.zeros_like(pixels.grey)
        noise = _noise(problem, state) if own else 1.0
        for fold in np.unique(self.folds):
            out = self.folds == fold
            fitted = without_fold(problem, state, system, shared, ~out)
            mine = out[pixels.press]
            part = replace(problem, pixels=pixels.of_presses(out))
            hidden = None if state.hidden is None else state.hidden[mine]
            errors[mine] = heldout_errors(part, replace(fitted, hidden=hidden), own, noise)
        return errors


def _noise(problem: Problem, state: Optics) -> float:
    """Mean squared error of the fit itself, which sets what a press's own quantities weigh."""
    return max(mean_square(problem, state), 0.05)


def on_others(entry: Entry, pixels: PressPixels) -> FloatArray:
    """Residuals (n, 3) of a model on presses that had no part in it."""
    problem = replace(entry.problem, pixels=pixels)
    state = with_shade_of(entry, problem, entry.state.for_presses(pixels.n_presses))
    return heldout_errors(problem, state, entry.own, _noise(entry.problem, entry.state))


def with_shade_of(entry: Entry, problem: Problem, state: Optics) -> Optics:
    """``state`` with the shade that a model casts on other presses, if it casts any."""
    if entry.state.shadow[0] <= 0:
        return replace(state, hidden=None)
    shaded = with_shadow(problem, state, entry.state.shadow_length_mm)
    return replace(shaded, unlit=entry.state.unlit)


def own_of_others(entry: Entry, pixels: PressPixels) -> Optics:
    """A model with the own quantities of other presses, estimated on all of their pixels."""
    problem = replace(entry.problem, pixels=pixels)
    state = with_shade_of(entry, problem, entry.state.for_presses(pixels.n_presses))
    everywhere = np.ones(len(pixels), dtype=bool)
    noise = _noise(entry.problem, entry.state)
    return own_fit(problem, state, entry.own, everywhere, noise) if entry.own else state


def typical_rmse(squares: FloatArray) -> float:
    """Geometric mean over presses of their RMSE, grey levels.

    One press beyond the slopes of all others, where a left-out fit goes astray, does not decide.
    """
    return float(np.exp(0.5 * np.log(squares + 1e-6).mean()))


def gain_p_value(before: FloatArray, after: FloatArray) -> float:
    """One-sided paired t-test over presses of the logarithm of the squared error.

    Logarithms, so that one press with a large error does not decide.
    """
    gain = np.log(before + 1e-6) - np.log(after + 1e-6)
    error = gain.std(ddof=1) / math.sqrt(len(gain)) + 1e-12
    return float(student.sf(gain.mean() / error, len(gain) - 1))


def is_as_good(entry: Entry, best: Entry, before: Entry) -> bool:
    """Whether the presses hardly tell an entry from the best that came after ``before``.

    It is within one standard error of it, or has most of its gain.
    """
    logs = [np.log(e.squares + 1e-6) for e in (before, entry, best)]
    apart = logs[1] - logs[2]
    if apart.mean() <= apart.std(ddof=1) / math.sqrt(len(apart)):
        return True
    return bool((logs[0] - logs[1]).mean() >= MOST_OF_GAIN * (logs[0] - logs[2]).mean())

"""Fits of optical effects on top of a table's rendering, and their errors on held-out presses."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntFlag

import numpy as np

from tacgen.calibrate.lookup.model_choice import fold_of
from tacgen.core.types import BoolArray, FloatArray, IntArray
from tacgen.diagnose.optics.rendering import PressView
from tacgen.diagnose.rules import OpticsRules
from tacgen.optics.effects import OpticalCandidate, OpticalParameter, Stage, optical_effect
from tacgen.optics.render import Effects
from tacgen.presses.experiments import per_experiment

Key = tuple[str, str]
"""An effect and one of its parameters."""


class Known(IntFlag):
    """What of a press is taken as stated; the rest is estimated from its picture."""

    NOTHING = 0
    PLACE = 1
    """Centre and radius are those of the label."""
    EXPOSURE = 2
    """The picture is as bright as the table says."""
    ALL = 3


def known_for(stage: Stage) -> Known:
    """What must be taken as stated for effects of a stage to show."""
    return {Stage.PRESS: Known.PLACE, Stage.EXPOSURE: Known.EXPOSURE}.get(stage, Known.NOTHING)


@dataclass(frozen=True, slots=True)
class Model:
    """Effects with their values, and where each press is.

    Attributes
    ----------
    candidates : tuple of OpticalCandidate
    fixed : mapping
        Effects that the table has, as it has them.
    shared : mapping
        OpticalParameter → its value for all presses.
    places : (N, 3) float
        Estimated centre and contact radius, mm.
    """

    candidates: tuple[OpticalCandidate, ...]
    fixed: Effects
    shared: Mapping[Key, float]
    places: FloatArray

    @property
    def free(self) -> dict[Key, OpticalParameter]:
        """The shared parameters that a fit frees."""
        return {(c.effect, name): p for c in self.candidates for name, p in c.shared.items()}

    def effects(self, key: Key | None = None, step: float = 0.0) -> dict[str, dict[str, float]]:
        """The effects as a table has them; with one parameter a step farther."""
        found = {name: dict(values) for name, values in self.fixed.items()}
        for (name, parameter), value in self.shared.items():
            size = step if (name, parameter) == key else 0.0
            found.setdefault(name, {})[parameter] = value + size
        return found

    def still(self, known: Known) -> Known:
        """``known`` less what a candidate of this model gives every press its own value of."""
        for candidate in self.candidates:
            if candidate.each:
                known &= ~known_for(optical_effect(candidate.effect).stage)
        return known


@dataclass(frozen=True, slots=True)
class Linearised:
    """One press near a model: residuals (m,), columns of shared (m, q) and own (m, p) parameters.

    ``held`` (p,) is the prior precision of the own parameters, ``off`` (p,) how far they are from
    what it expects.
    """

    residual: FloatArray
    shared: FloatArray
    own: FloatArray
    held: FloatArray
    off: FloatArray
    odd: BoolArray

    def own_step(self, residual: FloatArray, rows: BoolArray | slice = slice(None)) -> FloatArray:
        """The own parameters' step (p,) that explains a residual best, on some of the rows."""
        own = self.own[rows]
        gram = own.T @ own + np.diag(self.held)
        return np.linalg.solve(gram, own.T @ residual[rows] - self.held * self.off)

    def reduced(self) -> tuple[FloatArray, FloatArray]:
        """Normal matrix (q, q) and moment (q,) of the shared ones, the own ones eliminated."""
        cross = self.shared.T @ self.own
        solved = np.linalg.solve(self.own.T @ self.own + np.diag(self.held), cross.T)
        gram = self.shared.T @ self.shared - cross @ solved
        moment = self.shared.T @ self.residual
        moment -= solved.T @ (self.own.T @ self.residual - self.held * self.off)
        return gram, moment

    def heldout_residual(self, step: FloatArray) -> FloatArray:
        """Residuals after a step of the shared ones; the own ones are estimated on the other half.

        The halves are the two colours of a chess board of 8 × 8 pixels.
        """
        residual = self.residual - self.shared @ step
        after = residual.copy()
        for half in (self.odd, ~self.odd):
            after[half] -= self.own[half] @ self.own_step(residual, ~half)
        return after


class PressFit:
    """Fits models to a set of presses and scores them on held-out ones."""

    def __init__(
        self, views: Sequence[PressView], rules: OpticsRules, experiment: IntArray | None = None
    ) -> None:
        self.views, self.rules = views, rules
        self.experiment = np.arange(len(views)) if experiment is None else experiment
        self.folds = fold_of(self.experiment, rules.folds)
        self._lit: dict[tuple[int, str, bytes], FloatArray] = {}
        self._latest: list[tuple[Model, Known, list[Linearised]]] = []

    def start(self, fixed: Effects) -> Model:
        """The table alone, every press placed as it fits best around its label."""
        places = np.array([view.place_by_label(fixed)[0] for view in self.views])
        return self.placed(Model((), fixed, {}, places))

    def placed(self, model: Model, *, shared: bool = True) -> Model:
        """The model with places, and with ``shared`` its parameters, where they fit best."""
        candidates = model.candidates if shared else ()
        still = replace(model, candidates=candidates)
        still = self._descend(still, Known.NOTHING, self.rules.place_steps, move=True)
        return replace(still, candidates=model.candidates)

    def fitted(self, model: Model, known: Known = Known.NOTHING) -> Model:
        """The model with its parameters where they fit best; places move along linearly."""
        return self._descend(model, known, self.rules.steps, move=False)

    def _descend(self, model: Model, known: Known, steps: int, *, move: bool) -> Model:
        best, lowest = model, np.inf
        for _ in range(steps):
            parts = self.linearised(model, known)
            error = typical(self.squares(model, known, heldout=False))
            if error > lowest * (1 - self.rules.converged_share):
                break
            best, lowest = model, error
            model = self._stepped(model, parts, move=move)
        return best

    def _stepped(self, model: Model, parts: Sequence[Linearised], *, move: bool) -> Model:
        step = self.solved(model, parts)
        shared = dict(model.shared)
        for (key, p), size in zip(model.free.items(), step, strict=True):
            longest = (p.upper - p.lower) * self.rules.longest_step
            moved = shared[key] + float(np.clip(size, -longest, longest))
            shared[key] = min(max(moved, p.lower), p.upper)
        places = model.places.copy()
        for k, part in enumerate(parts) if move else ():
            own = part.own_step(part.residual - part.shared @ step)
            longest = self.rules.longest_step * self.views[k].radius_mm
            places[k] += np.clip(own[:3], -longest, longest)
        return replace(model, shared=shared, places=places)

    def solved(self, model: Model, parts: Sequence[Linearised]) -> FloatArray:
        """Step (q,) of the shared parameters over presses."""
        free = model.free
        if not free:
            return np.zeros(0)
        reduced = [part.reduced() for part in parts]
        gram, moment = (np.sum([one[i] for one in reduced], axis=0) for i in (0, 1))
        held = np.array([self.variance / p.prior**2 if p.prior else 0.0 for p in free.values()])
        off = np.array([model.shared[key] - p.identity for key, p in free.items()])
        gram += np.diag(held + 1e-9 * np.trace(gram) + 1e-6)
        return np.asarray(np.linalg.solve(gram, moment - held * off))

    @property
    def variance(self) -> float:
        """Variance of a residual, times how many neighbours count as one."""
        return self.rules.residual_grey**2 * self.rules.correlated_pixels

    def squares(
        self, model: Model, known: Known = Known.NOTHING, *, heldout: bool = True
    ) -> FloatArray:
        """Mean squared error (E,) of each press; ``heldout`` by the other folds' parameters."""
        return self.mean_squares(self.residuals(model, known, heldout=heldout))

    def mean_squares(self, residuals: Sequence[FloatArray]) -> FloatArray:
        """Mean squares of the residuals (n, 3) of each picture, by press (E,)."""
        by_picture = np.array([(residual**2).mean() for residual in residuals])
        return self.by_press(by_picture)

    def by_press(self, values: FloatArray) -> FloatArray:
        """Means (E, …) over the pictures of each press of values (N, …)."""
        return per_experiment(values, self.experiment)

    @property
    def n_presses(self) -> int:
        """How many presses the pictures are of."""
        return len(np.unique(self.experiment))

    def residuals(
        self, model: Model, known: Known = Known.NOTHING, *, heldout: bool = True
    ) -> list[FloatArray]:
        """Residuals (n, 3) of each picture, as ``squares`` takes them."""
        parts, still = self.linearised(model, known), np.zeros(len(model.free))
        steps = self.fold_steps(model, parts) if heldout else None
        return [
            part.heldout_residual(still if steps is None else steps[fold]).reshape(-1, 3)
            for part, fold in zip(parts, self.folds, strict=True)
        ]

    def fold_steps(self, model: Model, parts: Sequence[Linearised]) -> FloatArray:
        """Steps (n_folds, q) of the shared parameters where a fold's presses are omitted."""
        return np.array(
            [
                self.solved(model, [p for p, f in zip(parts, self.folds, strict=True) if f != fold])
                for fold in range(int(self.folds.max()) + 1)
            ]
        )

    def stderr(self, model: Model, known: Known) -> dict[Key, float]:
        """Standard errors of the shared parameters: a jackknife over the folds of presses."""
        steps = self.fold_steps(model, self.linearised(model, known))
        errors = np.sqrt((len(steps) - 1) * steps.var(axis=0))
        return dict(zip(model.free, errors.tolist(), strict=True))

    def own_values(self, model: Model, known: Known) -> FloatArray:
        """What each picture (N, 3) differs by in what else is ``known``: radii, shares of gain."""
        parts = self.linearised(model)
        own = np.array([part.off + part.own_step(part.residual) for part in parts])
        radii = np.array([[view.radius_mm] for view in self.views])
        return own[:, :3] / radii if known == Known.PLACE else own[:, 3:]

    def linearised(self, model: Model, known: Known = Known.NOTHING) -> list[Linearised]:
        """Every press near the model."""
        known = model.still(known)
        for one, what, parts in self._latest:
            if one is model and what == known:
                return parts
        parts = [self._linearised(model, k, known) for k in range(len(self.views))]
        self._latest = [*self._latest[-1:], (model, known, parts)]
        return parts

    def _linearised(self, model: Model, k: int, known: Known) -> Linearised:
        view, rules, effects = self.views[k], self.rules, model.effects()
        place = None if known & Known.PLACE else model.places[k]
        here = self.grey(k, effects, place)
        shared = [
            (self.grey(k, model.effects(key, p.step), place) - here).ravel() / p.step
            for key, p in model.free.items()
        ]
        own, scatter, off = [], [], []
        if place is not None:
            nudge = rules.nudge_radii * view.radius_mm
            for axis in np.eye(3):
                moved = self.grey(k, effects, place + nudge * axis)
                own.append((moved - here).ravel() / nudge)
            scatter += [share * view.radius_mm for share in rules.label_scatter_radii]
            off += (place - view.place_by_label(effects)[0]).tolist()
        if not known & Known.EXPOSURE:
            own += [(here * channel).ravel() for channel in np.eye(3)]
            scatter += [rules.exposure_scatter] * 3
            off += [0.0] * 3
        return Linearised(
            (view.pixels.grey - here).ravel(),
            np.reshape(shared, (-1, here.size)).T,
            np.reshape(own, (-1, here.size)).T,
            self.variance / np.array(scatter) ** 2,
            np.array(off),
            np.repeat(view.pixels.odd_block, 3),
        )

    def grey(self, k: int, effects: Effects, place: FloatArray | None) -> FloatArray:
        """Grey levels (n, 3) of press ``k``, at a place or at that of its label."""
        view = self.views[k]
        early = {
            name: values
            for name, values in effects.items()
            if optical_effect(name).stage <= Stage.FOCUS
        }
        labelled = (k, repr(early), b"")
        key = (k, repr(early), b"" if place is None else place.tobytes())
        if labelled not in self._lit:
            self._lit[labelled] = view.lit(effects)
        if key not in self._lit:
            near = view.lit(effects, place)
            self._lit[key] = np.vstack([near, self._lit[labelled][len(near) :]])
        return view.finished(self._lit[key], effects)


def typical(squares: FloatArray) -> float:
    """Geometric mean over the presses (E,): one that is off does not decide."""
    return float(np.exp(np.log(squares + 1e-6).mean()))

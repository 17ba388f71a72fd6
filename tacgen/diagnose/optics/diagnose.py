"""Which optical effects ball presses show: forward selection over whole presses, held-out error."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.calibrate.lookup.smooth_model import position_terms
from tacgen.calibrate.lookup.table_fit import camera_noise_grey
from tacgen.core.arrays import FloatArray
from tacgen.core.errors import PressError
from tacgen.diagnose.optics.extended_table import first_state, reference_of
from tacgen.diagnose.optics.model import GivenTable, PlainTable, Problem, scene_of
from tacgen.diagnose.optics.model_comparison import FittedModel, ModelComparison, Selection
from tacgen.diagnose.optics.pixels import gather_pixels
from tacgen.diagnose.optics.residuals import Dependence
from tacgen.diagnose.optics.rules import RULES, SelectionRules
from tacgen.diagnose.optics.surface import Profiles
from tacgen.optics.effects import Candidate, optical_effect, optical_effects
from tacgen.optics.table import LookupTable
from tacgen.presses.press_images import PressImages


@dataclass(frozen=True, slots=True)
class FoundEffect:
    """An effect that was added, what it is worth and what came second."""

    name: str
    label: str
    parameters: dict[str, dict[str, Any]]
    cv_gain: float
    heldout_gain: float
    p_value: float
    runner_up: str
    runner_up_gain: float
    equals: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class OpticsDiagnosis:
    """The outcome, with everything that the report shows.

    Attributes
    ----------
    before_squares, after_squares : (n_test,) float
        Mean squared error of each test press, in and around its contact.
    tests : (n_test,) int
        Which presses they are.
    inside_before, inside_after : float
        RMSE within the labelled circles alone.
    """

    effects: tuple[FoundEffect, ...]
    unexplained: tuple[Dependence, ...]
    cannot_tell: tuple[str, ...]
    selection: Selection
    reference: NDArray[np.float32]
    given: LookupTable | None
    before_squares: FloatArray
    after_squares: FloatArray
    inside_before: float
    inside_after: float
    noise_floor: float
    n_fit: int
    tests: NDArray[np.int64]
    mean_grey: float

    @property
    def verdict(self) -> str:
        """``unexplained`` if structure is left, whatever was found."""
        if self.unexplained:
            return "unexplained"
        return "effect_found" if self.effects else "sufficient"

    @property
    def rmse_before(self) -> float:
        """On test presses, grey levels."""
        return float(np.sqrt(self.before_squares.mean()))

    @property
    def rmse_after(self) -> float:
        """On test presses, grey levels."""
        return float(np.sqrt(self.after_squares.mean()))

    @property
    def gain_interval(self) -> tuple[float, float]:
        """95 % interval of the gain in RMSE, by bootstrap over the test presses."""
        before, after = self.before_squares, self.after_squares
        rng = np.random.default_rng(np.random.SeedSequence(0, spawn_key=(len(before),)))
        drawn = rng.integers(0, len(before), (2000, len(before)))
        gains = np.sqrt(before[drawn].mean(axis=1)) - np.sqrt(after[drawn].mean(axis=1))
        low, high = np.quantile(gains, [0.025, 0.975])
        return float(low), float(high)

    @property
    def sentence(self) -> str:
        """The verdict in one plain sentence."""
        rest = ""
        if self.unexplained:
            covariates = ", ".join(d.covariate for d in self.unexplained)
            rest = f" The residual still depends on {covariates}; no listed effect explains that."
        if self.effects:
            names = ", ".join(f"{e.name} ({e.heldout_gain:.2f} grey levels)" for e in self.effects)
            return (
                f"Found {names}: the error on held-out presses falls from {self.rmse_before:.2f} "
                f"to {self.rmse_after:.2f} grey levels.{rest}"
            )
        if rest:
            return (
                f"No listed effect lowers the error of {self.rmse_before:.2f} grey levels on "
                f"held-out presses.{rest}"
            )
        return (
            f"The table suffices: {self.rmse_before:.2f} grey levels on held-out presses, and no "
            "effect lowers that reliably."
        )

    def as_dict(self) -> dict[str, Any]:
        """The content of ``diagnosis.json``."""
        effects = [
            {
                "name": effect.name,
                "how": effect.label,
                "parameters": effect.parameters,
                "heldout_gain": effect.heldout_gain,
                "cv_gain": effect.cv_gain,
                "p_value": effect.p_value,
                "runner_up": effect.runner_up,
                "runner_up_gain": effect.runner_up_gain,
                "as_good": list(effect.equals),
            }
            for effect in self.effects
        ]
        channel = {
            "verdict": self.verdict,
            "sentence": self.sentence,
            "effects": effects,
            "unexplained": [dependence.as_dict() for dependence in self.unexplained],
            "cannot_tell": list(self.cannot_tell),
            "error_before": self._error(self.rmse_before, self.inside_before),
            "error_after": self._error(self.rmse_after, self.inside_after),
            "gain_interval_95": list(self.gain_interval),
            "noise_floor": {
                "rmse": self.noise_floor,
                "how": "second differences of neighbouring pixels: the camera's noise alone",
            },
            "trials": {"fit": self.n_fit, "test": len(self.tests)},
            "steps": [
                {"error_before": step.before, "chosen": step.selected, "rmse": step.rmse}
                for step in self.selection.steps
            ],
        }
        return {"schema": 1, "channels": {"rgb": channel}}

    def _error(self, rmse: float, inside: float) -> dict[str, Any]:
        return {
            "rmse": rmse, "nrmse": rmse / self.mean_grey, "unit": "grey", "inside_circle": inside
        }  # fmt: skip


def diagnose_optics(
    presses: PressImages, table: LookupTable | None = None, rules: SelectionRules = RULES
) -> OpticsDiagnosis:
    """Trace the residuals of a table on ball presses to optical effects.

    Without ``table`` a plain one, which gives a slope the same colour wherever it is, is fitted to
    the presses themselves, each scored by a fit to others.

    Raises
    ------
    PressError
        If there are too few presses to hold any out, or the table is of another resolution.
    """
    if len(presses) < rules.min_presses:
        msg = (
            f"{len(presses)} usable presses are too few to hold any out; take at least "
            f"{rules.min_presses}, better 30, spread over the gel"
        )
        raise PressError(msg)
    reference = reference_of(presses, table, rules)
    pixels = gather_pixels(presses, reference, rules=rules)
    start, labels = first_state(table, pixels.labels)
    pixels = replace(pixels, labels=labels)
    testing = np.arange(len(presses)) % rules.test_every == rules.test_every - 1
    problem = Problem(
        pixels.of_presses(~testing),
        PlainTable(rules.table_degree) if table is None else GivenTable(table),
        Profiles(pixels.labels[:, 2], pixels.dome_radius_mm, rules),
        rules,
    )
    noise_grey = camera_noise_grey(presses)
    comparison = ModelComparison(problem, np.nonzero(~testing)[0].astype(float), noise_grey)
    selection = comparison.select(start)
    tests = pixels.of_presses(testing)
    errors = [model.errors_on(tests) for model in selection.path]
    squares = [tests.mean_by_press((error**2).mean(axis=1)) for error in errors]
    return OpticsDiagnosis(
        effects=_effects(selection, squares),
        unexplained=tuple(comparison.dependences(selection.chosen)),
        cannot_tell=_cannot_tell(replace(problem, pixels=pixels), selection),
        selection=selection,
        reference=reference,
        given=table,
        before_squares=squares[0],
        after_squares=squares[-1],
        inside_before=_rmse(errors[0][tests.inside]),
        inside_after=_rmse(errors[-1][tests.inside]),
        noise_floor=noise_grey,
        n_fit=int((~testing).sum()),
        tests=np.nonzero(testing)[0],
        mean_grey=float(presses.images.mean()),
    )


def _rmse(errors: FloatArray) -> float:
    return float(np.sqrt((errors**2).mean()))


def _effects(selection: Selection, squares: Sequence[FloatArray]) -> tuple[FoundEffect, ...]:
    rmse = [float(np.sqrt(square.mean())) for square in squares]
    found = []
    for k, candidate in enumerate(selection.chosen.candidates):
        step = selection.step_of(candidate.effect)
        found.append(
            FoundEffect(
                name=candidate.effect,
                label=candidate.label,
                parameters=_parameters(selection.chosen, candidate),
                cv_gain=selection.path[k].rmse - selection.path[k + 1].rmse,
                heldout_gain=rmse[k] - rmse[k + 1],
                p_value=step.p_value[candidate.effect],
                runner_up=step.runner_up,
                runner_up_gain=step.before - step.rmse.get(step.runner_up, step.before),
                equals=step.equals,
            )
        )
    return tuple(found)


def _parameters(model: FittedModel, candidate: Candidate) -> dict[str, dict[str, Any]]:
    """The fitted parameters of an effect, with standard errors over the presses."""
    state, effect = model.state, optical_effect(candidate.effect)
    errors = model.system.stderr()[3 * model.problem.table.n_columns :]
    stderr = {one.key: float(e) for one, e in zip(model.shared, errors, strict=True)}
    found = {}
    for name, parameter in candidate.shared.items():
        key = (effect.name, name)
        found[name] = _number(state.shared[key], stderr[key], parameter.unit)
    n_presses = model.problem.pixels.n_presses
    for name, parameter in candidate.own.items():
        values = state.own[effect.name, name]
        # A parameter that all presses share has its own entry.
        shown = f"press_{name}" if name in candidate.shared else name
        spread = float(values.std(ddof=1))
        found[f"{shown}_mean"] = _number(
            float(values.mean()), spread / math.sqrt(n_presses), parameter.unit
        )
        found[f"{shown}_scatter"] = _number(
            spread, spread / math.sqrt(2 * n_presses - 2), parameter.unit
        )
    for name, relative in candidate.chosen.items():
        value = state.shared[effect.name, name]
        found[name] = _number(value, relative * value, effect.parameters[name].unit)
    if candidate.color_by_place:
        found["change_over_image"] = _number(light_by_place(model), None, "1")
    return found


def _number(value: float, stderr: float | None, unit: str) -> dict[str, Any]:
    return {"value": value, "stderr": stderr, "unit": unit}


def light_by_place(model: FittedModel) -> float:
    """RMS over the gel of what the place changes a slope's colour by, as a share of that colour."""
    table = model.problem.table
    if not isinstance(table, PlainTable):
        return 0.0
    weights = table.position_weights(model.state.weights)[table.moving]
    side = np.linspace(-0.5, 0.5, 9)
    u, v = (grid.ravel() for grid in np.meshgrid(side, side))
    moved = np.einsum("pf,tfc->ptc", position_terms(u, v)[:, :5], weights[:, :5])
    return float(np.sqrt((moved**2).mean() / (weights[:, 5] ** 2).mean()))


def _cannot_tell(problem: Problem, selection: Selection) -> tuple[str, ...]:
    """What these presses cannot tell apart, and what measurement would."""
    scene, found = scene_of(problem, selection.chosen.state), selection.chosen.candidates
    lines = [
        line
        for effect in optical_effects()
        if (line := effect.cannot_tell(scene, [c for c in found if c.effect == effect.name]))
    ]
    for step in selection.steps:
        if step.selected and step.equals:
            lines.append(
                f"{step.selected} was selected; the presses hardly tell it from "
                f"{', '.join(step.equals)}: more presses, over the whole gel, would."
            )
    return tuple(lines)

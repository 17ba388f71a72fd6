"""Which optical effects ball presses show: forward selection over whole presses, held-out error."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.calibrate.lookup.table_fit import camera_noise_grey
from tacgen.core.arrays import FloatArray
from tacgen.core.errors import PressError
from tacgen.diagnose.optics.extended_table import first_state, reference_of
from tacgen.diagnose.optics.fit import Problem
from tacgen.diagnose.optics.model import GivenTable, PlainTable
from tacgen.diagnose.optics.model_comparison import Contest, Entry, on_others
from tacgen.diagnose.optics.pixels import gather_pixels
from tacgen.diagnose.optics.residuals import Dependence, left_over
from tacgen.diagnose.optics.selection import Selection, select
from tacgen.diagnose.optics.surface import Profiles
from tacgen.optics.table import LookupTable
from tacgen.presses.press_images import PressImages

TEST_EVERY = 4
"""Every fourth press is kept from fitting and choosing."""

MIN_PRESSES = 8


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
        Mean squared error of each test press, all that is within 1.6 contact radii.
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
    n_test: int
    mean_grey: float
    test_names: tuple[str, ...]

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
            "trials": {"fit": self.n_fit, "test": self.n_test},
            "steps": [
                {"error_before": step.before, "chosen": step.taken, "rmse": step.rmse}
                for step in self.selection.steps
            ],
        }
        return {"schema": 1, "channels": {"rgb": channel}}

    def _error(self, rmse: float, inside: float) -> dict[str, Any]:
        return {
            "rmse": rmse, "nrmse": rmse / self.mean_grey, "unit": "grey", "inside_circle": inside
        }  # fmt: skip


def diagnose_optics(presses: PressImages, table: LookupTable | None = None) -> OpticsDiagnosis:
    """Trace what a table leaves over on ball presses to optical effects.

    Without ``table`` a plain one, which gives a slope the same colour wherever it is, is fitted to
    the presses themselves, each scored by a fit that it had no part in.

    Raises
    ------
    PressError
        If there are too few presses to hold any out, or the table is of another resolution.
    """
    if len(presses) < MIN_PRESSES:
        msg = (
            f"{len(presses)} usable presses are too few to hold any out; take at least "
            f"{MIN_PRESSES}, better 30, spread over the gel"
        )
        raise PressError(msg)
    reference = reference_of(presses, table)
    pixels = gather_pixels(presses, reference)
    start, labels = first_state(table, pixels.labels)
    pixels = replace(pixels, labels=labels)
    testing = np.arange(len(presses)) % TEST_EVERY == TEST_EVERY - 1
    problem = Problem(
        pixels.of_presses(~testing),
        PlainTable() if table is None else GivenTable(table),
        Profiles(pixels.labels[:, 2], pixels.dome_radius_mm),
    )
    order = np.nonzero(~testing)[0].astype(float)
    noise_grey = camera_noise_grey(presses)
    selection = select(problem, start, order, noise_grey)
    tests = pixels.of_presses(testing)
    errors = [on_others(entry, tests) for entry in selection.path]
    squares = [tests.mean_by_press((error**2).mean(axis=1)) for error in errors]
    contest = Contest.on(problem)
    unexplained = left_over(selection.chosen, contest.folds, order, noise_grey)
    return OpticsDiagnosis(
        effects=_effects(selection, squares),
        unexplained=tuple(unexplained),
        cannot_tell=_cannot_tell(presses, table is not None, selection),
        selection=selection,
        reference=reference,
        given=table,
        before_squares=squares[0],
        after_squares=squares[-1],
        inside_before=_rmse(errors[0][tests.inside]),
        inside_after=_rmse(errors[-1][tests.inside]),
        noise_floor=noise_grey,
        n_fit=int((~testing).sum()),
        n_test=int(testing.sum()),
        mean_grey=float(presses.images.mean()),
        test_names=tuple(np.array(presses.names, dtype=object)[testing]),
    )


def _rmse(errors: FloatArray) -> float:
    return float(np.sqrt((errors**2).mean()))


def _effects(selection: Selection, squares: Sequence[FloatArray]) -> tuple[FoundEffect, ...]:
    rmse = [float(np.sqrt(square.mean())) for square in squares]
    found = []
    for k, candidate in enumerate(selection.chosen.taken):
        step = selection.step_of(candidate.name)
        found.append(
            FoundEffect(
                name=candidate.name,
                label=candidate.label,
                parameters=_parameters(selection.chosen, candidate.name),
                cv_gain=selection.path[k].rmse - selection.path[k + 1].rmse,
                heldout_gain=rmse[k] - rmse[k + 1],
                p_value=step.p_value[candidate.name],
                runner_up=step.runner_up,
                runner_up_gain=step.before - step.rmse.get(step.runner_up, step.before),
                equals=step.equals,
            )
        )
    return tuple(found)


def _parameters(entry: Entry, name: str) -> dict[str, dict[str, Any]]:
    """The fitted parameters of an effect, with standard errors over the presses."""
    candidate = next(c for c in entry.taken if c.name == name)
    state, shared = entry.state, entry.shared
    errors = entry.system.stderr()[3 * entry.problem.table.n_columns :]
    stderr = {(k.key, k.index): float(e) for k, e in zip(shared, errors, strict=True)}
    found = {
        knob.name: {
            "value": float(getattr(state, knob.key).reshape(-1)[knob.index]),
            "stderr": stderr[knob.key, knob.index],
            "unit": knob.unit,
        }
        for knob in candidate.shared
    }
    count = entry.problem.pixels.n_presses
    for knob in candidate.own:
        values = getattr(state, knob.key)[:, knob.index]
        spread = float(values.std(ddof=1))
        found[f"{knob.name}_mean"] = {
            "value": float(values.mean()), "stderr": spread / math.sqrt(count), "unit": knob.unit
        }  # fmt: skip
        found[f"{knob.name}_scatter"] = {
            "value": spread, "stderr": spread / math.sqrt(2 * count - 2), "unit": knob.unit
        }  # fmt: skip
    if name == "shadow":
        length = float(state.shadow_length_mm)
        found["length_mm"] = {"value": length, "stderr": 0.5 * length, "unit": "mm"}
    if candidate.near:
        found["change_over_image"] = {
            "value": light_by_place(entry), "stderr": None, "unit": "1"
        }  # fmt: skip
    return found


def light_by_place(entry: Entry) -> float:
    """RMS over the gel of what the place changes a slope's colour by, as a share of that colour."""
    state, table = entry.state, entry.problem.table
    if not isinstance(table, PlainTable) or not table.near:
        return 0.0
    weights = table.position_weights(state.weights)[table.moving()]
    side = np.linspace(-0.5, 0.5, 9)
    u, v = (grid.ravel() for grid in np.meshgrid(side, side))
    place = np.stack([u * u, v * v, u * v, u, v], axis=-1)
    moved = np.einsum("pf,tfc->ptc", place, weights[:, :5])
    return float(np.sqrt((moved**2).mean() / (weights[:, 5] ** 2).mean()))


def _cannot_tell(presses: PressImages, is_given: bool, selection: Selection) -> tuple[str, ...]:
    """What these presses cannot tell apart, and what measurement would."""
    lines = []
    if not is_given:
        lines.append(
            "cross_talk: a table fitted to the same presses has its own colours, which hold any "
            "mixing of the channels; give the table from before (--table), or photograph the gel "
            "with one lamp on at a time."
        )
    if len(np.unique(presses.ball_radius_mm)) == 1:
        lines.append(
            "scale: with one ball a wrong size of a pixel or of the ball stretches the table's "
            "slopes and leaves little; press a second ball of another size."
        )
    if any(candidate.near for candidate in selection.chosen.taken):
        lines.append(
            "illumination: lamps close by belong to the sensor, and a table of `tacgen calibrate "
            "lookup` holds them in its terms of position. Only against --table is it a change."
        )
    for step in selection.steps:
        if step.taken and step.equals:
            lines.append(
                f"{step.taken} was taken; the presses hardly tell it from "
                f"{', '.join(step.equals)}: more presses, over the whole gel, would."
            )
    return tuple(lines)

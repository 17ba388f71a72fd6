"""Which optical effects ball presses show: forward selection over whole presses, held-out error."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from tacgen.calibration.lookup import camera_noise_grey
from tacgen.calibration.lookup_choice import fold_of
from tacgen.calibration.press_images import PressImages
from tacgen.errors import PressError
from tacgen.loop.optics_model import OpticsFit, fit_optics, heldout_squares

FloatArray = NDArray[np.floating]

CANDIDATES = (
    "press_center",
    "scale",
    "background_gain",
    "shadow",
    "saturation",
)
"""Effects that presses can tell apart from the table itself."""

IN_THE_TABLE = {
    "illumination": "a quadratic in image position for every slope is part of every table",
    "vignetting": "the same quadratic holds a loss of light towards the corners",
    "blur": "the shape of the gel's rim is fitted with every table",
    "cross_talk": "a table has its own coefficients for each channel, which hold any mixing of "
    "the channels' changes",
}
"""Effects that a table takes up by its nature, so that nothing is left of them to find."""

FALSE_ALARM = 0.01
"""Chance, over all candidates, of taking an effect on presses that have none."""

LEAST_GAIN = 0.03
"""And an effect must lower the error by this share, or it is not worth having."""

TEST_EVERY = 4
"""Every fourth press is kept from fitting and choosing."""

MIN_PRESSES = 8


@dataclass(frozen=True, slots=True)
class FoundEffect:
    """An effect that was added, what it is worth and what came second."""

    name: str
    parameters: dict[str, dict[str, Any]]
    cv_gain: float
    heldout_gain: float
    p_value: float
    runner_up: str
    runner_up_gain: float


@dataclass(frozen=True, slots=True)
class Step:
    """Cross-validated RMSE, grey levels, of every candidate at one step."""

    before: float
    rmse: dict[str, float]
    p_value: dict[str, float]


@dataclass(frozen=True, slots=True)
class OpticsDiagnosis:
    """The outcome, with everything that the report shows."""

    effects: tuple[FoundEffect, ...]
    steps: tuple[Step, ...]
    rmse_before: float
    rmse_after: float
    gain_interval: tuple[float, float]
    noise_floor: float
    worth_in_table: dict[str, float]
    n_fit: int
    n_test: int
    mean_grey: float
    before: OpticsFit
    after: OpticsFit
    unexplained: tuple[dict[str, Any], ...] = field(default=())

    @property
    def verdict(self) -> str:
        """``sufficient``, ``effect_found`` or ``unexplained``."""
        if self.unexplained:
            return "unexplained"
        return "effect_found" if self.effects else "sufficient"

    def as_dict(self) -> dict[str, Any]:
        """The content of ``diagnosis.json``."""
        effects = [
            {
                "name": effect.name,
                "parameters": effect.parameters,
                "heldout_gain": effect.heldout_gain,
                "cv_gain": effect.cv_gain,
                "p_value": effect.p_value,
                "runner_up": effect.runner_up,
                "runner_up_gain": effect.runner_up_gain,
            }
            for effect in self.effects
        ]
        channel = {
            "verdict": self.verdict,
            "effects": effects,
            "unexplained": list(self.unexplained),
            "error_before": self._error(self.rmse_before),
            "error_after": self._error(self.rmse_after),
            "gain_interval_95": list(self.gain_interval),
            "noise_floor": {
                "rmse": self.noise_floor,
                "how": "second differences of neighbouring pixels: the camera's noise alone",
            },
            "in_the_table": {
                name: {"why": why, "worth_grey": self.worth_in_table.get(name)}
                for name, why in IN_THE_TABLE.items()
            },
            "trials": {"fit": self.n_fit, "test": self.n_test},
        }
        return {"schema": 1, "channels": {"rgb": channel}}

    def _error(self, rmse: float) -> dict[str, Any]:
        return {"rmse": rmse, "nrmse": rmse / self.mean_grey, "unit": "grey"}


def diagnose_optics(presses: PressImages) -> OpticsDiagnosis:
    """Trace what a table leaves over on ball presses to optical effects.

    Raises
    ------
    PressError
        If there are too few presses to hold any out.
    """
    if len(presses) < MIN_PRESSES:
        msg = (
            f"{len(presses)} usable presses are too few to hold any out; take at least "
            f"{MIN_PRESSES}, better 30, spread over the gel"
        )
        raise PressError(msg)
    testing = np.arange(len(presses)) % TEST_EVERY == TEST_EVERY - 1
    fitting, tests = presses.select(~testing), presses.select(testing)
    chosen: frozenset[str] = frozenset()
    current = left_out_squares(fitting, chosen)
    start = current
    steps, taken = [], []
    while len(chosen) < len(CANDIDATES):
        squares = {
            name: left_out_squares(fitting, chosen | {name})
            for name in CANDIDATES
            if name not in chosen
        }
        step = _step(current, squares)
        steps.append(step)
        ranked = sorted(squares, key=lambda name: step.rmse[name])
        best, second = ranked[0], ranked[1] if len(ranked) > 1 else ""
        gain = step.before - step.rmse[best]
        if step.p_value[best] > FALSE_ALARM / len(CANDIDATES) or gain < LEAST_GAIN * step.before:
            break
        runner_gain = step.before - step.rmse[second] if second else 0.0
        taken.append((best, gain, step.p_value[best], second, runner_gain))
        chosen, current = chosen | {best}, squares[best]
    before, after = fit_optics(fitting, frozenset()), fit_optics(fitting, chosen)
    first, counts = heldout_squares(before, tests)
    last, _ = heldout_squares(after, tests)
    effects = tuple(
        FoundEffect(name, _parameters(name, after), gain, worth, p, second, runner)
        for (name, gain, p, second, runner), worth in zip(
            taken, _worth_on_tests([entry[0] for entry in taken], fitting, tests), strict=True
        )
    )
    base = float(np.sqrt(start.mean()))
    worth_in_table = {
        name: float(np.sqrt(left_out_squares(fitting, frozenset({f"no_{name}"})).mean())) - base
        for name in ("illumination", "blur")
    }
    return OpticsDiagnosis(
        effects=effects,
        steps=tuple(steps),
        rmse_before=_rmse(first, counts),
        rmse_after=_rmse(last, counts),
        gain_interval=_gain_interval(first, last),
        noise_floor=camera_noise_grey(presses),
        worth_in_table=worth_in_table,
        n_fit=int((~testing).sum()),
        n_test=int(testing.sum()),
        mean_grey=float(presses.images.mean()),
        before=before,
        after=after,
    )


def left_out_squares(presses: PressImages, effects: frozenset[str]) -> FloatArray:
    """Mean squared error (N,) of each press by a fit to the other folds' presses."""
    folds = fold_of(len(presses), 4)
    squares = np.zeros(len(presses))
    for fold in np.unique(folds):
        fit = fit_optics(presses.select(folds != fold), effects)
        squares[folds == fold], _ = heldout_squares(fit, presses.select(folds == fold))
    return squares


def _step(current: FloatArray, squares: dict[str, FloatArray]) -> Step:
    """Error and one-sided paired t-test over the presses for every candidate.

    The test looks at logarithms, so that one press with a large error does not decide.
    """
    p_value = {}
    for name, square in squares.items():
        gain = np.log(current) - np.log(square)
        error = gain.std(ddof=1) / math.sqrt(len(gain)) + 1e-12
        p_value[name] = float(student.sf(gain.mean() / error, len(gain) - 1))
    rmse = {name: float(np.sqrt(square.mean())) for name, square in squares.items()}
    return Step(float(np.sqrt(current.mean())), rmse, p_value)


def _worth_on_tests(names: list[str], fitting: PressImages, tests: PressImages) -> list[float]:
    """What each effect, added in this order, lowers the error on the test presses by."""
    worth, chosen = [], frozenset[str]()
    before = _rmse(*heldout_squares(fit_optics(fitting, chosen), tests))
    for name in names:
        chosen = chosen | {name}
        after = _rmse(*heldout_squares(fit_optics(fitting, chosen), tests))
        worth.append(before - after)
        before = after
    return worth


def _rmse(squares: FloatArray, counts: FloatArray) -> float:
    return float(np.sqrt((squares * counts).sum() / counts.sum()))


def _gain_interval(before: FloatArray, after: FloatArray) -> tuple[float, float]:
    """95 % interval of the gain in RMSE, by bootstrap over the test presses."""
    rng = np.random.default_rng(np.random.SeedSequence(0, spawn_key=(len(before),)))
    drawn = rng.integers(0, len(before), (2000, len(before)))
    gains = np.sqrt(before[drawn].mean(axis=1)) - np.sqrt(after[drawn].mean(axis=1))
    low, high = np.quantile(gains, [0.025, 0.975])
    return float(low), float(high)


def _parameters(name: str, fit: OpticsFit) -> dict[str, dict[str, Any]]:
    """The fitted parameters of an effect, with standard errors over the presses where known."""
    apart = fit.geometry - fit.labels
    count = math.sqrt(len(apart))

    def entry(value: float, stderr: float, unit: str) -> dict[str, Any]:
        return {"value": float(value), "stderr": float(stderr), "unit": unit}

    if name == "press_center":
        return {
            "shift_x_mm": entry(apart[:, 0].mean(), apart[:, 0].std(ddof=1) / count, "mm"),
            "shift_y_mm": entry(apart[:, 1].mean(), apart[:, 1].std(ddof=1) / count, "mm"),
            "scatter_mm": entry(apart[:, :2].std(), apart[:, :2].std() / (2 * count), "mm"),
        }
    if name == "scale":
        ratio = fit.geometry[:, 2] / fit.labels[:, 2]
        return {"contact_per_label": entry(ratio.mean(), ratio.std(ddof=1) / count, "1")}
    unknown = float("nan")
    return {
        "background_gain": {"drift_share": entry(fit.drift_share, unknown, "1")},
        "saturation": {"level_grey": entry(fit.level_grey, unknown, "grey")},
        "shadow": {
            "darkest_grey": entry(0.0 if fit.shadow is None else fit.shadow.min(), unknown, "grey")
        },
    }[name]

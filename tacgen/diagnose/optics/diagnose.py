"""Which optical effects ball presses show beside a calibrated table."""

import math
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.calibrate.lookup.gel_skirt import with_skirt
from tacgen.calibrate.lookup.press_fit import PressModel, learn_labels
from tacgen.calibrate.lookup.score import check_resolution
from tacgen.calibrate.lookup.table_fit import calibrate, camera_noise_grey
from tacgen.core.errors import PressError
from tacgen.core.resources import __version__
from tacgen.core.types import FloatArray
from tacgen.diagnose import record
from tacgen.diagnose.evidence import Dependence, gain_interval_95
from tacgen.diagnose.optics.fit import Known, Model, PressFit, typical
from tacgen.diagnose.optics.rendering import views_of
from tacgen.diagnose.optics.residuals import PRESS, dependences
from tacgen.diagnose.optics.selection import Scored, Selection, log_gain, select
from tacgen.diagnose.optics.sharpness import LostNoise, lost_noise
from tacgen.diagnose.record import estimate
from tacgen.diagnose.rules import OPTICS, OpticsRules
from tacgen.optics.effects import (
    OpticalCandidate,
    PressScene,
    Stage,
    optical_effect,
    optical_effects,
)
from tacgen.optics.effects.skirt import SKIRT, SLOPES
from tacgen.optics.table import LookupTable
from tacgen.presses.experiments import ranked
from tacgen.presses.press_images import PressImages, label_mm


@dataclass(frozen=True, slots=True)
class FoundEffect:
    """An effect that was added, what it is worth and what came second.

    ``heldout_gain`` and its standard error, grey levels, are over all presses, each by parameters
    that it had no part in; what the effect does not concern of a press's place and exposure is
    estimated from its picture. Of pictures out of focus they are of the test presses' noise.
    """

    name: str
    how: str
    parameters: dict[str, dict[str, Any]]
    cv_gain: float
    heldout_gain: float
    heldout_gain_stderr: float
    p_value: float
    runner_up: str = ""
    runner_up_gain: float = 0.0
    as_good: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class PressErrors:
    """RMSE on the test presses, grey levels.

    Attributes
    ----------
    squares : (E,) float
        Mean squared error of each press, with place and exposure as stated.
    inside : float
        Within the labelled circles alone.
    refined : float
        With place and exposure of each press estimated from one half of its pixels and scored on
        the other.
    """

    squares: FloatArray
    inside: float
    refined: float

    @property
    def rmse(self) -> float:
        """With place and exposure as stated."""
        return float(np.sqrt(self.squares.mean()))


@dataclass(frozen=True, slots=True)
class OpticsDiagnosis(record.Summarised):
    """The outcome, with everything that the report shows.

    ``table`` is the table that was compared, with the effects that were found; ``fit`` holds the
    presses that were fitted to, ``test_fit`` the others.
    """

    effects: tuple[FoundEffect, ...]
    unexplained: tuple[Dependence, ...]
    cannot_tell: tuple[str, ...]
    selection: Selection
    table: LookupTable
    tests: NDArray[np.int64]
    fit: PressFit
    test_fit: PressFit
    test_start: Model
    before: PressErrors
    after: PressErrors
    noise_floor: float
    n_fit: int
    mean_grey: float

    @property
    def rmse_before(self) -> float:
        """On test presses, grey levels."""
        return self.before.rmse

    @property
    def rmse_after(self) -> float:
        """On test presses, grey levels."""
        return self.after.rmse

    @property
    def gain_interval(self) -> tuple[float, float]:
        """95 % interval of the gain in RMSE, by bootstrap over the test presses."""
        before, after = self.before.squares, self.after.squares
        rng = np.random.default_rng(np.random.SeedSequence(0, spawn_key=(len(before),)))
        return gain_interval_95(before, after, np.subtract, self.test_fit.rules.resamplings, rng)

    @property
    def summary(self) -> record.Summary:
        """Verdict and sentence."""
        return record.Summary(
            "The table",
            [f"{one.name} ({one.heldout_gain:.2f} grey levels)" for one in self.effects],
            [
                "each press (a pattern of its own)" if one.covariate == PRESS else one.covariate
                for one in self.unexplained
            ],
            before=self.before.rmse,
            after=self.after.rmse,
            floor=self.noise_floor,
            unit="grey",
            held="held-out presses",
        )

    def as_dict(self) -> dict[str, Any]:
        """The content of ``diagnosis.json``."""
        channel = record.channel_record(
            self,
            effects=[asdict(effect) for effect in self.effects],
            unexplained=[
                {"covariate": one.covariate, "p_value": one.p_value, "gain_grey": one.gain}
                for one in self.unexplained
            ],
            errors=(self._error(self.before), self._error(self.after)),
            noise_floor=(
                self.noise_floor,
                "second differences of neighbouring pixels: the camera's noise alone",
            ),
            trials=(self.n_fit, self.test_fit.n_presses),
            cannot_tell=list(self.cannot_tell),
            gain_interval_95=list(self.gain_interval),
            steps=[
                {
                    "error_before": step.current.rmse,
                    "chosen": step.found.name if step.found else "",
                    "rmse": {one.name: one.rmse for one in reversed(step.tried)},
                }
                for step in self.selection.steps
            ],
        )
        return record.diagnosis_record({"rgb": channel})

    def _error(self, errors: PressErrors) -> dict[str, Any]:
        return record.error(
            errors.rmse,
            self.mean_grey,
            "grey",
            inside_circle=errors.inside,
            refined=errors.refined,
        )


def diagnose_optics(
    presses: PressImages, table: LookupTable | None = None, rules: OpticsRules = OPTICS
) -> OpticsDiagnosis:
    """Trace to optical effects what a calibrated table does not explain of ball presses.

    ``table`` was fitted to other presses: what has changed since is diagnosed. Without it a table
    is fitted to these presses as ``tacgen calibrate lookup`` does, and each press is compared with
    one that it was held out of: only what the table cannot express is found.

    Raises
    ------
    PressError
        If there are too few presses to hold any out, or the table is of another resolution.
    """
    n_presses = presses.n_experiments
    if n_presses < rules.min_presses:
        pictures = f" in {len(presses)} pictures" if len(presses) > n_presses else ""
        msg = (
            f"{n_presses} usable presses{pictures} are too few to hold any out; take at least "
            f"{rules.min_presses}, better 30, spread over the gel"
        )
        raise PressError(msg)
    if table is not None:
        check_resolution(table, presses)
    known = table.provenance if table else {}
    scatter = max(known.get("label_scatter_radii", 0.0), rules.usual_scatter_radii)
    count = known.get("n_presses", rules.table_presses)
    rules = replace(rules, usual_scatter_radii=scatter, table_presses=count)
    testing = ranked(presses.experiment) % rules.test_every == rules.test_every - 1
    shown, tests = presses.select(~testing), presses.select(testing)
    folds = None
    if table is None:
        calibration = calibrate(shown)
        whole, tables, folds = calibration.table, calibration.fold_tables, calibration.folds
    else:
        whole, tables = table, (table,)
    views = views_of(presses, ~testing, tables, rules, folds)
    fit = PressFit(views, rules, shown.experiment)
    test_fit = PressFit(views_of(presses, testing, [whole], rules), rules, tests.experiment)
    noise = camera_noise_grey(presses)
    scene = PressScene(
        contact_radius_mm=float(np.mean([view.radius_mm for view in fit.views])),
        ball_radii_mm=np.asarray(shown.ball_radius_mm),
        mm_per_px=shown.mm_per_px,
        has_table=table is not None,
        grey=np.concatenate([view.pixels.grey for view in fit.views]),
    )
    known_effects = _effects_of(whole)
    start, test_start = fit.start(known_effects), test_fit.start(known_effects)
    focus = lost_noise(shown, tests, table, rules)
    without: set[str] = set()
    if focus is not None:
        fixed = {**start.fixed, focus.effect.name: {"sigma_mm": focus.sigma_mm}}
        start, without = replace(start, fixed=fixed), {focus.effect.reported_name}
    while True:
        selection = select(fit, start, scene, without)
        gains = [_gain(test_fit, test_start, selection, k) for k in range(len(selection.added))]
        weak = [
            found.name
            for (_, found, _), (gain, error, objected) in zip(selection.added, gains, strict=True)
            if objected or gain <= rules.clear_lead_in_se * error
        ]
        if not weak:
            break
        without.add(weak[0])
    model = selection.chosen
    extended = _extended(whole, model, noise, label_mm(shown))
    after_fit = PressFit(views_of(presses, testing, [extended], rules), rules, tests.experiment)
    return OpticsDiagnosis(
        effects=(
            *([_out_of_focus(focus)] if focus else []),
            *(
                _found(fit, model, *step, gain)
                for step, gain in zip(selection.added, gains, strict=True)
            ),
        ),
        unexplained=dependences(fit, model),
        cannot_tell=_cannot_tell(scene, selection),
        selection=selection,
        table=extended,
        tests=np.nonzero(testing)[0],
        fit=fit,
        test_fit=test_fit,
        test_start=test_start,
        before=_errors(test_fit, test_start),
        after=_errors(after_fit, on_presses(after_fit, after_fit.start(known_effects), model)),
        noise_floor=noise,
        n_fit=shown.n_experiments,
        mean_grey=float(presses.images.mean()),
    )


def _effects_of(table: LookupTable) -> dict[str, dict[str, float]]:
    """What the table renders, and the gel's shape beside a press as it was found before."""
    factors = table.provenance.get("press_model", {}).get("slope_factors") or ()
    known = {name: dict(values) for name, values in table.effects.items()}
    if factors:
        pairs = zip(SLOPES, factors, strict=True)
        known[SKIRT.name] = {name: float(factor) for name, (_, factor) in pairs}
    return known


def on_presses(fit: PressFit, start: Model, found: Model) -> Model:
    """A model that was found, on other presses, which are placed anew."""
    return fit.placed(replace(found, places=start.places), shared=False)


def _gain(fit: PressFit, start: Model, selection: Selection, k: int) -> tuple[float, float, bool]:
    """What added step ``k`` lowers the error by, its standard error, and whether tests object.

    In grey levels, over all presses, those of ``fit``, which are the test presses, too; each by
    parameters that it had no part in.
    """
    current, found, _ = selection.added[k]
    before = selection.start if k == 0 else selection.added[k - 1][1].model
    pairs = [
        fit.squares(on_presses(fit, start, model), found.known, heldout=False)
        for model in (before, found.model)
    ]
    objected = fit.n_presses >= fit.rules.min_objecting and log_gain(*pairs)[0] <= 0
    before_squares = np.append(current.squares, pairs[0])
    gain, error = log_gain(before_squares, np.append(found.squares, pairs[1]))
    rmse = math.sqrt(typical(before_squares))
    return rmse * (1 - math.exp(-0.5 * gain)), 0.5 * rmse * error, objected


def _errors(fit: PressFit, model: Model) -> PressErrors:
    stated = fit.residuals(model, Known.ALL, heldout=False)
    inside = [r[view.pixels.inside] for r, view in zip(stated, fit.views, strict=True)]
    refined = fit.squares(model, heldout=False)
    return PressErrors(
        fit.mean_squares(stated),
        float(np.sqrt((np.concatenate(inside) ** 2).mean())),
        float(np.sqrt(refined.mean())),
    )


def _out_of_focus(focus: LostNoise) -> FoundEffect:
    sigma = estimate(focus.sigma_mm, focus.sigma_stderr_mm, "mm")
    return FoundEffect(
        name=focus.effect.reported_name,
        how="Gaussian over the whole picture, by its noise",
        parameters={"sigma_mm": sigma},
        cv_gain=focus.gain,
        heldout_gain=focus.gain,
        heldout_gain_stderr=focus.gain_stderr,
        p_value=focus.p_value,
    )


def _found(
    fit: PressFit,
    model: Model,
    before: Scored,
    found: Scored,
    second: Scored | None,
    gain: tuple[float, float, bool],
) -> FoundEffect:
    return FoundEffect(
        name=found.name,
        how=found.candidate.label,
        parameters=_parameters(fit, model, found.candidate, found.known),
        cv_gain=before.rmse - found.rmse,
        heldout_gain=gain[0],
        heldout_gain_stderr=gain[1],
        p_value=found.p_value,
        runner_up=second.name if second else "",
        runner_up_gain=before.rmse - second.rmse if second else 0.0,
        as_good=found.as_good,
    )


def _parameters(
    fit: PressFit, model: Model, candidate: OpticalCandidate, known: Known
) -> dict[str, dict[str, Any]]:
    """The fitted parameters of an effect, with standard errors over the presses."""
    effect, errors = optical_effect(candidate.effect), fit.stderr(model, known)
    found = {
        name: estimate(model.shared[effect.name, name], errors[effect.name, name], parameter.unit)
        for name, parameter in candidate.shared.items()
    }
    chosen = {
        name: value
        for (owner, name), value in model.shared.items()
        if owner == effect.name and name not in found
    }
    for name, value in chosen.items():
        found[name] = estimate(value, None, effect.parameters[name].unit)
    own = fit.by_press(fit.own_values(model, known)) if candidate.each else np.zeros((0, 3))
    for name, values in zip(candidate.each, own.T, strict=False):
        unit, count = effect.parameters[name].unit, len(values)
        mean, scatter = float(values.mean()), float(values.std(ddof=1))
        identity = effect.parameters[name].identity
        found[f"{name}_mean"] = estimate(identity + mean, scatter / math.sqrt(count), unit)
        found[f"{name}_scatter"] = estimate(scatter, scatter / math.sqrt(2 * count - 2), unit)
    return found


def _extended(
    table: LookupTable, found: Model, noise_grey: float, labels_mm: FloatArray
) -> LookupTable:
    """The table with the effects that were found, which the renderer applies.

    What belongs to the presses (labels, the scatter of exposures) stays out; the camera's noise is
    theirs. A gel of another shape beside a contact goes into how a press is drawn and how wide the
    skirt around any object is, and what the labels ``labels_mm`` (N, 3) say of a place is learnt
    with it anew.
    """
    kept = {effect.name for effect in optical_effects(Stage.SURFACE)} | table.effects.keys()
    effects = {name: v for name, v in found.effects().items() if name in kept}
    provenance = {**table.provenance, "diagnosed_by": f"tacgen {__version__} diagnose optics"}
    factors = SKIRT.slope_factors(**found.effects().get(SKIRT.name, {}))
    is_drawn = bool(factors) and "press_model" in provenance
    if is_drawn:
        drawn = PressModel.from_dict(provenance["press_model"])
        membrane = replace(drawn.membrane, slope_factors=factors)
        drawn = replace(drawn, membrane=membrane, labels=learn_labels(labels_mm, found.places))
        provenance["press_model"] = drawn.as_dict()
    extended = replace(table, effects=effects, noise_grey=noise_grey, provenance=provenance)
    return with_skirt(extended) if is_drawn else extended


def _cannot_tell(scene: PressScene, selection: Selection) -> tuple[str, ...]:
    """What these presses cannot separate, and what measurement would."""
    found = selection.chosen.candidates
    lines = [
        line
        for effect in optical_effects()
        if (line := effect.cannot_tell(scene, [c for c in found if c.effect == effect.name]))
    ]
    lines += [
        f"{one.name} was selected; the presses hardly separate it from {', '.join(one.as_good)}: "
        "more presses, over the whole gel, would."
        for _, one, _ in selection.added
        if one.as_good
    ]
    return tuple(lines)

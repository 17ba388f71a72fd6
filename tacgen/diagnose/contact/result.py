"""The result of diagnosing a press log, the content of ``diagnosis.json``, notes on the data."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from tacgen.calibrate.contact.slope_fit import SlopeFit
from tacgen.contact.effects import Where, separating_measurement
from tacgen.contact.law import PLAIN_UNITS, ContactLaw
from tacgen.core.records import Estimate
from tacgen.diagnose import record
from tacgen.diagnose.contact.candidates import follows_load, known_columns, max_levels
from tacgen.diagnose.contact.channel import OUTLIER_SIGMAS, ChannelData
from tacgen.diagnose.contact.heldout import Errors
from tacgen.diagnose.contact.model import Fit, StandardErrors, Term
from tacgen.diagnose.contact.residuals import COURSE, EACH_PRESS
from tacgen.diagnose.contact.search import Attribution, Chosen
from tacgen.diagnose.evidence import Dependence
from tacgen.diagnose.markers.diagnose import MarkerDiagnosis
from tacgen.diagnose.record import finite
from tacgen.presses.press_log import PressLog


@dataclass(frozen=True)
class ChannelDiagnosis(record.Summarised):
    """What one channel's residual was traced to.

    ``base`` and ``final`` are fits to all trials, of which the effects are chosen. ``before`` and
    ``after`` are errors on held-out trials: of a law that was chosen and fitted without them, with
    the ``scored_effects``; ``scale`` is the RMS of what is measured. ``how`` says how the trials
    were held out; ``floor`` is the standard deviation of one sample's noise. ``linear`` is the law
    without effects, as a calibration has it; ``own_of_press`` says which of a gain and a zero each
    press has for itself in the residual.
    """

    data: ChannelData
    attribution: Attribution
    scored_effects: tuple[str, ...]
    base: Fit
    final: Fit
    linear: SlopeFit
    volume_stderr_share: float
    final_errors: StandardErrors
    before: Errors
    after: Errors
    scale: float
    gain_interval: tuple[float, float]
    floor: float
    n_spikes: int
    n_fit: int
    n_test: int
    how: str
    dependences_before: tuple[Dependence, ...]
    dependences_after: tuple[Dependence, ...]
    unexplained: tuple[Dependence, ...]
    own_of_press: str

    @property
    def compliance(self) -> Estimate:
        """K of the extended law, its error of the joint fit; the linear law's if nothing is added.

        Both errors hold one that all volumes share.
        """
        model, unit = self.final.model, PLAIN_UNITS[self.data.channel][1]
        if not model.terms and not model.covariates:
            return Estimate(self.linear.value, self.linear.stderr, unit)
        of_volumes = self.volume_stderr_share * model.compliance
        stderr = math.hypot(self.final_errors.compliance, of_volumes)
        return Estimate(model.compliance, stderr, unit)

    @property
    def effect_names(self) -> tuple[str, ...]:
        """Effects of the list, in the order in which they were added."""
        return self.attribution.accepted.effect_names

    @property
    def is_scored_otherwise(self) -> bool:
        """Whether choices without held-out trials, whose errors are given, name other effects."""
        return set(self.scored_effects) != set(self.effect_names)

    def p_value(self, p_value: float) -> float | None:
        """``p_value``, but no less than the trials allow, however many samples they have.

        Under the null each trial's sign is a coin's; n trials have 2^(n − 1) different outcomes.
        """
        return finite(max(p_value, 0.5 ** (self.data.history.n_trials - 1)))

    @property
    def summary(self) -> record.Summary:
        """Verdict and sentence."""
        wheres = {
            term.name: f" (only {term.effect.where})" if term.effect.where else ""
            for term in self.final.model.terms
        }
        if self.data.history.is_relaxing(self.data.channel):
            wheres["creep"] = " (the force relaxes at a held displacement)"
        of_presses = {
            EACH_PRESS: f"each press ({self.own_of_press} of its own)",
            COURSE: "the course of each press",
        }
        return record.Summary(
            _LAW_WORDS[self.data.channel],
            [name.replace("_", " ") + wheres[name] for name in self.effect_names],
            [of_presses.get(one.covariate, one.covariate) for one in self.unexplained],
            before=self.before.rmse,
            after=self.after.rmse,
            floor=self.floor,
            unit=PLAIN_UNITS[self.data.channel][0],
            held="held-out trials" if self.n_test else "the fitted trials",
            instead=[name.replace("_", " ") for name in self.scored_effects]
            if self.is_scored_otherwise
            else None,
        )


_PRESS_NEXT = {
    "gain": "log what differs between presses as columns: place, tilt, temperature, sample",
    "zero": "record a second of rest before each press, or count depths from first contact",
}
"""What to measure where a press has a gain or a zero of its own."""
_LAW_WORDS = {"normal": "V = k_n F_n", "shear": "D = k_s F_s"}


@dataclass(frozen=True)
class Diagnosis:
    """All channels of a log, the law that came of it, and what the reader should know.

    ``session_clock``: whether the log's ``time_s`` runs on from trial to trial. ``markers`` is of
    the field of marker tracks, if they were given.
    """

    channels: Mapping[str, ChannelDiagnosis]
    law: ContactLaw
    notes: tuple[str, ...]
    session_clock: bool = True
    markers: MarkerDiagnosis | None = None

    @property
    def linear_law(self) -> ContactLaw:
        """The law without effects, fitted to the same trials: what ``law`` is compared with."""
        compliance = {name: found.linear.value for name, found in self.channels.items()}
        k_n = compliance.get("normal", self.law.k_n_mm3_per_n.value)
        return ContactLaw.linear(k_n, compliance.get("shear", float("nan")))


def diagnosis_record(diagnosis: Diagnosis) -> dict[str, Any]:
    """The content of ``diagnosis.json``: the contract's keys and further ones."""
    channels = {name: _channel(d) for name, d in diagnosis.channels.items()}
    if diagnosis.markers is not None:
        channels["markers"] = diagnosis.markers.record()
    return record.diagnosis_record(channels, diagnosis.notes)


def _channel(found: ChannelDiagnosis) -> dict[str, Any]:
    unit, per_newton = PLAIN_UNITS[found.data.channel]
    terms = {term.name: term for term in found.final.model.terms}
    return record.channel_record(
        found,
        effects=[
            _effect(found, one, terms[one.candidate.name])
            for one in found.attribution.chosen
            if one.candidate.is_effect
        ],
        unexplained=[_unexplained(found, d) for d in found.unexplained],
        errors=(
            record.error(found.before.rmse, found.scale, unit),
            record.error(found.after.rmse, found.scale, unit),
        ),
        noise_floor=(
            found.floor,
            "second differences, over 1 to 8 samples of a trial, of the law's residual",
        ),
        trials=(found.n_fit, found.n_test),
        gain_interval_95=[finite(v) for v in found.gain_interval],
        held_out=found.how,
        scored_effects=list(found.scored_effects),
        compliance={
            when: record.estimate(one.value, one.stderr, per_newton)
            for when, one in (("before", found.linear), ("after", found.compliance))
        },
        ranking=[
            {"candidate": label, "heldout_gain": finite(gain), "p_value": found.p_value(p)}
            for label, gain, p in found.attribution.ranking[:12]
        ],
        residual_before=[_dependence(found, d) for d in found.dependences_before],
        residual_after=[_dependence(found, d) for d in found.dependences_after],
    )


def _effect(found: ChannelDiagnosis, chosen: Chosen, term: Term) -> dict[str, Any]:
    errors = found.final_errors.effects[term.name]
    return {
        "name": term.name,
        "parameters": {
            name: record.estimate(value, errors.get(name, 0.0), term.effect.parameter(name).unit)
            for name, value in shown_parameters(term).items()
        },
        "heldout_gain": finite(chosen.gain),
        "runner_up": chosen.runner_up,
        "runner_up_margin": finite(chosen.runner_up_margin),
        "runner_up_margin_in_se": finite(chosen.margin_in_se),
        "confusable_with": list(chosen.confusable),
        "separating_measurements": [advice(term.name, other) for other in chosen.confusable],
        "p_value": found.p_value(chosen.p_value),
        "form": f"{term.name}: {term.variant.label}",
        **({"where": term.effect.where.given} if term.effect.where else {}),
    }


def _unexplained(found: ChannelDiagnosis, dependence: Dependence) -> dict[str, Any]:
    """What the residual depends on; with what else explains it, if it was chosen as effects are."""
    reported = _dependence(found, dependence)
    if dependence.covariate == EACH_PRESS:
        reported["separating_measurements"] = [
            words for what, words in _PRESS_NEXT.items() if what in found.own_of_press
        ]
    for chosen in found.attribution.chosen:
        name = chosen.candidate.name
        if name == dependence.covariate and not chosen.candidate.is_effect:
            reported["runner_up"] = chosen.runner_up
            reported["runner_up_margin"] = finite(chosen.runner_up_margin)
            reported["separating_measurements"] = [
                advice(name, other) for other in chosen.confusable
            ]
    return reported


def shown_parameters(term: Term) -> dict[str, float]:
    """Parameters that matter for a term: fitted ones, references, and shapes that are in use."""
    shown = {*term.variant.free, *term.variant.shapes}
    return {
        name: value
        for name, value in term.values.items()
        if name in shown or term.effect.parameter(name).role == "reference"
    }


def advice(name: str, other: str) -> str:
    """Which measurement would separate two effects."""
    known = separating_measurement(name, other)
    words = known or "more trials in which the one varies while the other does not"
    return f"{name} or {other}: {words}"


def _dependence(found: ChannelDiagnosis, d: Dependence) -> dict[str, Any]:
    return {"covariate": d.covariate, "p_value": found.p_value(d.p_value), "share": finite(d.gain)}


def log_notes(log: PressLog) -> list[str]:
    """Warnings and dropped presses of the log."""
    return [*log.warnings, *(str(dropped) for dropped in log.dropped)]


def channel_notes(found: ChannelDiagnosis) -> list[str]:
    """What a channel cannot show, and why."""
    data, name = found.data, found.data.channel
    notes = [note for column in data.columns if (note := _column_note(data, column))]
    notes += _equal_columns(data)
    for term in found.final.model.terms:
        if term.effect.where and term.effect.in_simulation:
            what = f"{name} channel: {term.name.replace('_', ' ')} acts only {term.effect.where};"
            notes.append(f"{what} {_in_simulation(term.effect.where)}")
    if (trial := _trial_that_is_off(found)) is not None:
        notes.append(
            f"{name} channel: most of the law's residual is in trial {trial}; look whether "
            "something went wrong there, or press more often like that"
        )
    tried = found.scored_effects or found.effect_names
    if tried and found.n_test > 0 and found.after.rmse > found.before.rmse:
        effects = " and ".join(tried).replace("_", " ")
        notes.append(
            f"{name} channel: the held-out trials do not confirm {effects}: their error grows from "
            f"{found.before.rmse:.3g} to {found.after.rmse:.3g}. Press more often before you use "
            "the extended law"
        )
    if found.n_test == 0:
        trials = "one trial only" if found.n_fit == 1 else "hardly any trial has load"
        notes.append(
            f"{name} channel: {trials}; the errors are those on what was fitted. "
            f"Press at least twice, better {data.rules.min_trials_as_units} times"
        )
    elif data.few_trials:
        notes.append(
            f"{name} channel: {data.history.n_trials} trials are few; the tests use parts of "
            "trials in place of trials, so that their p-values mean little. "
            f"Press at least {data.rules.min_trials_as_units} times"
        )
    if found.n_spikes:
        notes.append(
            f"{name} channel: {found.n_spikes} samples stick out of their neighbours by more than "
            f"{OUTLIER_SIGMAS:g} times the noise; neither the fit nor the errors count "
            "them"
        )
    return notes


def _trial_that_is_off(found: ChannelDiagnosis) -> int | None:
    """The one trial that holds most of the law's residual, if that is much; no effect shows it."""
    data, losses, rules = found.data, found.attribution.final.unit_losses, found.data.rules
    left = float(losses.sum())
    is_much = left >= rules.few_min_gain * (data.noise_loss + left)
    if data.few_trials or not is_much:
        return None
    worst = int(np.argmax(losses))
    if losses[worst] < rules.share_of_one_trial * left:
        return None
    return int(data.history.trial[data.history.starts[data.unit_trial[worst]]])


def _column_note(data: ChannelData, column: str) -> str:
    """Why a column is not taken as a covariate; empty where it is."""
    if column in known_columns():
        return ""
    array = np.asarray(data.columns[column])
    levels = np.unique(array)
    if levels.size == 1:
        return f"column {column!r} is constant: whether anything follows it cannot be seen"
    if np.issubdtype(array.dtype, np.number):
        return (
            f"column {column!r} follows load and time within each trial: it is taken for "
            "another reading of the press, not for a condition that may change the law"
            if follows_load(data, column)
            else ""
        )
    if levels.size <= max_levels(data):
        return ""
    per_trial = np.unique(data.history.text(column)[data.history.starts[:-1]])
    return (
        f"column {column!r} has {levels.size} values for {data.history.n_trials} trials "
        f"({per_trial.size} at their starts): too many to compare"
    )


def _in_simulation(where: Where) -> str:
    """Whether an effect that acts in a part of the log acts on simulated grasps."""
    if not where.is_stretch:
        return (
            f"grasps of `tacgen collect` have no column {where.column}, so simulated images are "
            "made without it; to have it in them, calibrate with presses only at the places, and "
            "with the shapes, that you will grasp"
        )
    how = "it acts on none of them" if where.is_over else "it acts on all of them"
    return f"simulated grasps come after the session's end: {how}"


def _equal_columns(data: ChannelData) -> list[str]:
    names = [n for n, v in data.columns.items() if np.issubdtype(np.asarray(v).dtype, np.number)]
    values = {n: np.nan_to_num(data.history.column(n)) for n in names}
    return [
        f"columns {a!r} and {b!r} are equal: what follows one follows the other"
        for a, b in combinations(names, 2)
        if b not in known_columns() and np.array_equal(values[a], values[b])
    ]

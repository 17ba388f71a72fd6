"""Diagnose a press log: fit, trace, score on held-out trials, and extend the contact law."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from tacgen.calibrate.contact.align import align, without_zero
from tacgen.calibrate.contact.command import LogSource
from tacgen.calibrate.contact.law_fit import linear_slope
from tacgen.calibrate.contact.marker_fit import load_tracks
from tacgen.contact.effects import CHANNELS, Channel
from tacgen.contact.law import ContactLaw, FittedEffect, save_law
from tacgen.core.errors import PressError
from tacgen.core.files import refuse_other_page
from tacgen.core.processes import map_in_processes
from tacgen.core.records import Estimate
from tacgen.core.resources import versions
from tacgen.core.types import FloatArray
from tacgen.diagnose.contact import heldout, result
from tacgen.diagnose.contact.channel import TARGETS, ChannelData, ChannelSamples, noise_floor
from tacgen.diagnose.contact.heldout import Errors
from tacgen.diagnose.contact.model import Fit, Model, fit_model, standard_errors, without_noise_bias
from tacgen.diagnose.contact.residuals import COURSE, EACH_PRESS, dependences, of_each_press
from tacgen.diagnose.contact.search import Attribution, ContactProblem
from tacgen.diagnose.evidence import Dependence, gain_interval_95
from tacgen.diagnose.markers.diagnose import diagnose_markers
from tacgen.diagnose.record import write_record
from tacgen.diagnose.rules import CONTACT, ContactRules
from tacgen.presses.press_log import SHEAR_FORCES, Columns

SEED = 20220804  # any; results are repeatable
FORCES: dict[Channel, tuple[str, ...]] = {"normal": ("force_normal_n",), "shear": SHEAR_FORCES}
HELD_OUT = "a quarter of the trials, spread over the session, selection repeated without them"


def diagnose_log(source: LogSource, out: Path) -> result.Diagnosis:
    """Diagnose a press log; write diagnosis.json, contact.yaml and report.html.

    All that ``calibrate_contact`` reads is read; the field of marker tracks is a channel of its
    own.

    Raises ``PressError`` if the log cannot be used; the message says what and where.
    """
    from tacgen.diagnose.contact.report import write_report

    for page in ("report.html", "grasp.html"):
        refuse_other_page(out / page, "diagnose contact")
    path = source.path
    log, _ = align(source.read(out / "press_log.csv"))
    # A depth that the volume was computed from is no condition that it may follow.
    columns = {name: values for name, values in log.columns.items() if name != "depth_mm"}
    diagnosis = diagnose(
        columns,
        notes=result.log_notes(log),
        session_clock=log.session_clock,
        volume_stderr_share=log.volume_stderr_share,
    )
    provenance = {"data_sha256": {path.name: log.sha256}, **diagnosis.law.provenance}
    law = replace(diagnosis.law, marker_pitch_mm=log.marker_pitch_mm, provenance=provenance)
    if source.markers is not None:
        known, tracks = load_tracks(source.markers, source.sensor, without_zero(log))
        found = diagnose_markers(tracks, known, law.k_n_mm3_per_n.value)
        notes = (*diagnosis.notes, *tracks.warnings)
        diagnosis = replace(diagnosis, notes=notes, markers=found)
        law = found.extended(law)
    diagnosis = replace(diagnosis, law=law)
    save_law(law, out / "contact.yaml")
    write_report(diagnosis, out / "report.html", title=f"Diagnosis of {path.name}")
    write_record(result.diagnosis_record(diagnosis), out)
    return diagnosis


def diagnose(
    columns: Columns,
    *,
    notes: Sequence[str] = (),
    session_clock: bool = True,
    volume_stderr_share: float = 0.0,
    rules: ContactRules = CONTACT,
) -> result.Diagnosis:
    """Diagnose the columns (N,) of a press log, as ``PressLog.columns`` has them.

    The required ones are finite, shear is NaN where it was not measured; ``session_clock`` says
    whether ``time_s`` runs on from trial to trial. Raises ``PressError`` if no channel has enough
    samples to fit.
    """
    notes = list(notes)
    columns = _numbered_in_order(columns, session_clock=session_clock)
    loaded: dict[str, _Channel] = {}
    # Thousands of products of small matrices: threads would only wait for each other.
    with threadpool_limits(limits=1):
        for channel in CHANNELS:
            usable, note = _usable_columns(columns, channel, rules)
            if note:
                notes.append(note)
            if usable is None:
                continue
            share = volume_stderr_share if channel == "normal" else 0.0
            own = _Channel(usable, channel, session_clock, rules, share)
            if own.every.thinned().is_loaded:
                loaded[channel] = own
            else:
                notes.append(
                    f"{channel} channel: not diagnosed, its force does not stand out from noise"
                )
        if "normal" not in loaded:
            raise PressError.from_problems(notes)
        chosen = _choices(list(loaded.values()))
        channels = {
            name: own.diagnosis(choices)
            for (name, own), choices in zip(loaded.items(), chosen, strict=True)
        }
    notes += [note for one in channels.values() for note in result.channel_notes(one)]
    law, notes_once = _law_of(channels), tuple(dict.fromkeys(notes))
    return result.Diagnosis(channels, law, notes_once, session_clock)


def _choices(channels: Sequence["_Channel"]) -> list[list[Attribution]]:
    """The choice of each channel on all trials, then on those to fit; in processes."""
    tasks = [(own, own.every) for own in channels]
    tasks += [(own, own.split[0]) for own in channels if own.split]

    def choice(number: int) -> Attribution:
        own, samples = tasks[number]
        return own.choice(samples)

    found = map_in_processes(choice, range(len(tasks)))
    return [
        [one for one, (own, _) in zip(found, tasks, strict=True) if own is channel]
        for channel in channels
    ]


class _Channel:
    """The steps of one channel's diagnosis, on columns that are finite where it needs them."""

    def __init__(
        self,
        columns: Columns,
        channel: Channel,
        session_clock: bool,
        rules: ContactRules,
        response_stderr_share: float,
    ) -> None:
        self._columns, self._channel, self._rules = columns, channel, rules
        self._session_clock = session_clock
        self._rng = np.random.default_rng(SEED)
        square = sum(np.asarray(columns[name], np.float64) ** 2 for name in TARGETS[channel])
        self._rms = float(np.sqrt(np.mean(square) / len(TARGETS[channel]))) or 1.0
        self._share = response_stderr_share
        load, response = (
            np.stack([columns[name] for name in names], axis=1)
            for names in (FORCES[channel], TARGETS[channel])
        )
        self._linear = linear_slope(load, response, columns["trial"], response_stderr_share)
        self.every = ChannelSamples(columns, channel, rules)

    @cached_property
    def split(self) -> tuple[ChannelSamples, ChannelSamples] | None:
        """Samples to fit and of the test trials; None where the load is in so few that none fit."""
        for _ in range(self._rules.max_draws if self.every.history.n_trials > 1 else 0):
            chosen = heldout.test_trials(self._columns, self._rng, self._rules)
            out = np.isin(self._columns["trial"], chosen)
            fitted, test = (
                ChannelSamples(
                    heldout.select(self._columns, rows), self._channel, self._rules, self.every
                )
                for rows in (~out, out)
            )
            if fitted.thinned().is_loaded:
                return fitted, test
        return None

    def choice(self, samples: ChannelSamples) -> Attribution:
        """The choice on all trials, described, or on those to fit."""
        rng = np.random.default_rng(SEED)
        selection = ContactProblem(samples.thinned(), rng, session_clock=self._session_clock)
        return selection.run() if samples is self.every else selection.choose()

    def diagnosis(self, choices: Sequence[Attribution]) -> result.ChannelDiagnosis:
        """The diagnosis by the choice on all trials and, if there is one, on those to fit."""
        rules, rng, every = self._rules, self._rng, self.every
        attribution, without = choices[0], choices[-1]
        n_trials = every.history.n_trials
        why = "there is one trial" if n_trials == 1 else "only noise is left without them"
        fitted, test, how, n_test = every, every, f"none could be: {why}", 0
        if self.split:
            fitted, test = self.split
            how, n_test = HELD_OUT, test.history.n_trials
        before, after = self._test_errors(fitted, test, without)
        data = every.thinned(self._rules.refit_rows_per_trial)
        base = _refitted(data, Model(attribution.base.fit.model.compliance))
        final = _refitted(data, attribution.final.fit.model)
        samples = every.every_sample()
        left = samples.target - final.model.response(samples)
        skip = () if self._session_clock else ("time_s",)
        before_structure = dependences(data, base, rng, skip)
        after_structure = dependences(data, final, rng, skip)
        floor = noise_floor(left, samples.history.starts)
        found = _unexplained(attribution, data, base, final, after_structure)
        least = max(rules.clearly_more * floor, rules.exact_share * self._rms)
        rest = float(np.sqrt((left[samples.weight > 0] ** 2).mean()))
        share, own_of_press = of_each_press(data, final)
        if not found and rest > least:
            name = EACH_PRESS if share > rules.share_of_presses else COURSE
            found = (Dependence(name, float("nan"), share if name == EACH_PRESS else 1.0 - share),)
        return result.ChannelDiagnosis(
            data=data,
            attribution=attribution,
            scored_effects=without.accepted.effect_names,
            base=base,
            final=final,
            linear=self._linear,
            volume_stderr_share=self._share,
            final_errors=standard_errors(data, final, of_presses=True),
            before=before,
            after=after,
            scale=self._rms,
            gain_interval=gain_interval_95(
                before.squares, after.squares, _reduction, rules.n_shuffles, rng
            ),
            floor=floor,
            n_spikes=int((every.precision == 0).sum()),
            n_fit=fitted.history.n_trials,
            n_test=n_test,
            how=how,
            dependences_before=before_structure,
            dependences_after=after_structure,
            unexplained=found,
            own_of_press=own_of_press,
        )

    def _test_errors(
        self, fitted: ChannelSamples, test: ChannelSamples, attribution: Attribution
    ) -> tuple[Errors, Errors]:
        """Errors on whole test trials, before and after; spikes do not count.

        The extended law is scored with the columns of the log that it was fitted beside: an effect
        that a column shares is not to be judged without it.
        """
        rows = test.every_sample()
        kept = rows.weight > 0
        data = fitted.thinned(self._rules.refit_rows_per_trial)

        def scored(start: Model) -> Errors:
            residual = rows.target - _refitted(data, start).model.response(rows)
            return heldout.errors(residual[kept], rows.history.trial[kept])

        model = attribution.final.fit.model
        before = scored(attribution.base.fit.model)
        after = scored(model) if model.terms else before
        return before, after


def _reduction(before: FloatArray, after: FloatArray) -> FloatArray:
    return np.asarray(1.0 - after / before)


def _refitted(data: ChannelData, start: Model) -> Fit:
    return without_noise_bias(data, fit_model(data, start))


def _unexplained(
    attribution: Attribution,
    data: ChannelData,
    base: Fit,
    final: Fit,
    structure: tuple[Dependence, ...],
) -> tuple[Dependence, ...]:
    """Covariates that compete as well as effects, and what else the residual clearly follows."""
    rules = data.rules
    found = [
        Dependence(c.candidate.name, c.p_value, c.gain)
        for c in attribution.chosen
        if not c.candidate.is_effect
    ]
    explained = max(base.loss - final.loss, 0.0) / max(base.loss, 1e-300)
    of_form = rules.form_share_left * explained * base.loss / (2 * data.noise_loss)
    least = max(data.min_gain, of_form)
    left = [d for d in structure if d.p_value <= rules.alpha and d.gain > least]
    if not found and left:
        found.append(max(left, key=lambda d: d.gain))
    return tuple(found)


def _law_of(channels: dict[str, result.ChannelDiagnosis]) -> ContactLaw:
    effects = []
    compliance = {"normal": Estimate(1.0), "shear": Estimate(float("nan"), float("nan"), "mm/N")}
    for name, found in channels.items():
        model, errors = found.final.model, found.final_errors
        compliance[name] = found.compliance
        for term in model.terms:
            parameters = {
                key: Estimate(
                    value, errors.effects[term.name].get(key, 0.0), term.effect.parameter(key).unit
                )
                for key, value in result.shown_parameters(term).items()
            }
            effects.append(FittedEffect(term.name, name, parameters, term.effect.where))
    provenance: dict[str, Any] = {
        "versions": versions("numpy"),
        "trials": {n: {"fit": f.n_fit, "test": f.n_test} for n, f in channels.items()},
        "heldout_rmse": {n: f.after.rmse for n, f in channels.items()},
        "held_out": {n: f.how for n, f in channels.items()},
    }
    return ContactLaw(
        "volume_linear",
        compliance["normal"],
        compliance["shear"],
        effects=tuple(effects),
        provenance=provenance,
    )


def _numbered_in_order(columns: Columns, *, session_clock: bool) -> dict[str, NDArray[Any]]:
    """The columns (N,) with trials numbered one by one and sorted, in the order of pressing.

    Effects that follow the number of presses, and what is held out, are then of any numbering.
    """
    trial = np.asarray(columns["trial"])
    numbers, first, place = np.unique(trial, return_index=True, return_inverse=True)
    start = np.asarray(columns["time_s"])[first] if session_clock else np.zeros(numbers.size)
    rank = np.empty(numbers.size, dtype=trial.dtype)
    rank[np.lexsort((numbers, start))] = np.arange(numbers.size)
    order = np.argsort(rank[place], kind="stable")
    numbered = {**columns, "trial": numbers.min() + rank[place]}
    return {name: np.asarray(values)[order] for name, values in numbered.items()}


def _usable_columns(
    columns: Columns, channel: Channel, rules: ContactRules
) -> tuple[dict[str, NDArray[Any]] | None, str]:
    """Rows in which the channel was measured, and how many are not; or None and why."""
    forces, targets = FORCES[channel], TARGETS[channel]
    refusal = f"{channel} channel: not diagnosed,"
    lacking = [name for name in (*targets, *forces) if name not in columns]
    if lacking:
        return None, f"{refusal} the log has no {', '.join(lacking)}"
    names = (*targets, *forces, "force_normal_n", "time_s")
    known = np.logical_and.reduce([np.isfinite(columns[name]) for name in names])
    numbers, counts = np.unique(np.asarray(columns["trial"])[known], return_counts=True)
    long_enough = np.isin(columns["trial"], numbers[counts >= rules.min_samples])
    kept = heldout.select(columns, known & long_enough)
    load = kept[forces[0]]
    if not np.any(load != 0):
        return None, f"{refusal} no trial has {rules.min_samples} samples under load"
    pairs = zip(forces, targets, strict=True)
    if sum(float((kept[force] * kept[name]).sum()) for force, name in pairs) <= 0:
        return None, (
            f"{refusal} {', '.join(targets)} falls as the force grows; check the signs of both"
        )
    dropped = int((~known).sum())
    note = f"{channel} channel: {dropped} rows without a finite value are not used"
    return kept, note if dropped else ""

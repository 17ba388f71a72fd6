"""Diagnose a press log: fit, trace, score on held-out trials, and extend the contact law."""

from __future__ import annotations

import json
import platform
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from tacgen.contact.effects import CHANNELS, Channel
from tacgen.contact.law import ContactLaw, FittedEffect, save_law
from tacgen.core.errors import PressError
from tacgen.core.files import write_text
from tacgen.core.records import Estimate
from tacgen.diagnose.contact import heldout
from tacgen.diagnose.contact.attribution import ALPHA, Attribution, Tracer
from tacgen.diagnose.contact.channel import TARGETS, ChannelData, Columns, channel_data
from tacgen.diagnose.contact.gp_baseline import gp_rmse
from tacgen.diagnose.contact.heldout import Errors
from tacgen.diagnose.contact.model import Fit, Model, fit_model, standard_errors, without_noise_bias
from tacgen.diagnose.contact.notes import channel_notes, log_notes
from tacgen.diagnose.contact.residuals import Dependence, dependences, noise_floor
from tacgen.diagnose.contact.result import (
    ChannelDiagnosis,
    Diagnosis,
    diagnosis_record,
    shown_parameters,
    unit_of,
)
from tacgen.presses.press_log import read_press_log

SEED = 20220804
WHOLE = 1_000_000
"""Rows a trial: all of them."""
MIN_SHARE_LEFT = 0.04
"""Part of the held-out sum of squares, noise included, below which what is left is not named."""
FORM_SHARE_LEFT = 0.06
"""Part of what the effects explain that may be left by their formula being a little different."""
UNFIT, UNFIT_FORM = 1.0, 0.5
"""Structure as large as the noise, and half of what there was before, is no law that fits."""
FULL_FIT_ROWS = 250


def diagnose_log(path: Path, out: Path, *, marker_pitch_mm: float = float("nan")) -> Diagnosis:
    """Diagnose the press log at ``path``; write diagnosis.json, contact.yaml and report.html.

    Raises
    ------
    PressError
        If the log cannot be used; the message says what and where.
    """
    from tacgen.diagnose.contact.report import write_report

    log = read_press_log(path)
    diagnosis = diagnose(log.columns, notes=log_notes(log), session_clock=log.session_clock)
    law = diagnosis.law
    provenance = {"data_sha256": {path.name: log.sha256}, **law.provenance}
    law = ContactLaw(
        law.law,
        law.k_n_mm3_per_n,
        law.k_s_mm_per_n,
        marker_pitch_mm,
        law.effects,
        provenance=MappingProxyType(provenance),
    )
    diagnosis = Diagnosis(diagnosis.channels, law, diagnosis.notes)
    save_law(law, out / "contact.yaml")
    write_report(diagnosis, out / "report.html", title=f"Diagnosis of {path.name}")
    record = diagnosis_record(diagnosis)
    write_text(out / "diagnosis.json", json.dumps(record, indent=1, ensure_ascii=False) + "\n")
    return diagnosis


def diagnose(
    columns: Columns, *, notes: Sequence[str] = (), session_clock: bool = True
) -> Diagnosis:
    """Diagnose the columns of a press log.

    Parameters
    ----------
    columns : mapping of name to (N,) array
        As ``PressLog.columns``: the required ones finite, shear NaN where it was not measured.
    session_clock : bool
        Whether ``time_s`` runs on from trial to trial.

    Raises
    ------
    PressError
        If no channel has enough samples to fit.
    """
    said = list(notes)
    channels: dict[str, ChannelDiagnosis] = {}
    # Thousands of products of small matrices: threads would only wait for each other.
    with threadpool_limits(limits=1):
        for channel in CHANNELS:
            usable, words = _usable_columns(columns, channel)
            if words:
                said.append(words)
            if usable is not None:
                channels[channel] = _diagnose_channel(usable, channel, session_clock)
                said += channel_notes(channels[channel])
    if "normal" not in channels:
        raise PressError.from_problems(said)
    return Diagnosis(MappingProxyType(channels), _law_of(channels), tuple(dict.fromkeys(said)))


def _diagnose_channel(columns: Columns, channel: Channel, session_clock: bool) -> ChannelDiagnosis:
    rng = np.random.default_rng(SEED)
    n_trials = np.unique(columns["trial"]).size
    scale = _scale(columns, channel)
    gp = float("nan")
    if n_trials >= heldout.MIN_TRIALS_TO_SPLIT:
        out = np.isin(columns["trial"], heldout.test_trials(columns, rng))
        fit_columns, test_columns = (heldout.select(columns, m) for m in (~out, out))
        attribution = _trace(fit_columns, channel, session_clock)
        fits = (attribution.base.fit, attribution.final.fit)
        before, after = _test_errors(fit_columns, test_columns, channel, fits, scale)
        gp = _yardstick(fit_columns, test_columns, channel, attribution, rng)
        n_fit, n_test = np.unique(fit_columns["trial"]).size, before.squares.size
        how = "a quarter of the trials, spread over the session"
    elif n_trials >= 2:
        attribution = _trace(columns, channel, session_clock)
        before, after = _leave_one_out(columns, channel, session_clock, scale)
        n_fit, n_test, how = n_trials - 1, 1, "each trial in turn, all of the choice repeated"
    else:
        attribution = _trace(columns, channel, session_clock)
        fits = (attribution.base.fit, attribution.final.fit)
        before, after = _test_errors(columns, columns, channel, fits, scale)
        n_fit, n_test, how = n_trials, 0, "none could be: there is one trial"
    data = channel_data(columns, channel, rows_per_trial=FULL_FIT_ROWS)
    base = _final_fit(data, Model(attribution.base.fit.model.compliance))
    final = _final_fit(data, attribution.final.fit.model)
    every = channel_data(columns, channel, rows_per_trial=WHOLE)
    floor = noise_floor(every.target - final.model.response(every), every.history.starts)
    skip = () if session_clock else ("time_s",)
    before_structure = dependences(data, base, rng, skip)
    after_structure = dependences(data, final, rng, skip)
    return ChannelDiagnosis(
        data=data,
        attribution=attribution,
        base=base,
        final=final,
        base_errors=standard_errors(data, base),
        final_errors=standard_errors(data, final),
        before=before,
        after=after,
        gain_interval=heldout.gain_interval(before, after, rng),
        floor=floor,
        n_spikes=int((every.weight == 0).sum()),
        gp_rmse=gp,
        n_fit=n_fit,
        n_test=n_test,
        how=how,
        dependences_before=before_structure,
        dependences_after=after_structure,
        unexplained=_unexplained(attribution, data, base, final, after_structure),
    )


def _trace(columns: Columns, channel: Channel, session_clock: bool) -> Attribution:
    data = channel_data(columns, channel)
    return Tracer(data, np.random.default_rng(SEED), session_clock=session_clock).run()


def _final_fit(data: ChannelData, start: Model) -> Fit:
    return without_noise_bias(data, fit_model(data, start))


def _test_errors(
    fit_columns: Columns,
    test_columns: Columns,
    channel: Channel,
    fits: tuple[Fit, Fit],
    scale: float,
) -> tuple[Errors, Errors]:
    """Errors of the law alone on whole test trials, before and after; spikes do not count."""
    data = channel_data(fit_columns, channel)
    test = channel_data(test_columns, channel, rows_per_trial=WHOLE)
    found = []
    for fit in fits:
        model = without_noise_bias(data, fit).model
        residual = test.target - model.law_response(test)
        kept = test.weight > 0
        found.append(heldout.errors(residual[kept], test.history.trial[kept], scale))
    return found[0], found[1]


def _leave_one_out(
    columns: Columns, channel: Channel, session_clock: bool, scale: float
) -> tuple[Errors, Errors]:
    before, after = [], []
    for trial in np.unique(columns["trial"]):
        out = np.asarray(columns["trial"]) == trial
        fit_columns, test_columns = (heldout.select(columns, m) for m in (~out, out))
        attribution = _trace(fit_columns, channel, session_clock)
        fits = (attribution.base.fit, attribution.final.fit)
        one, other = _test_errors(fit_columns, test_columns, channel, fits, scale)
        before.append(one)
        after.append(other)
    return heldout.pooled(before), heldout.pooled(after)


def _yardstick(
    fit_columns: Columns,
    test_columns: Columns,
    channel: Channel,
    attribution: Attribution,
    rng: np.random.Generator,
) -> float:
    base = attribution.base.fit.model
    data = channel_data(fit_columns, channel, rows_per_trial=30)
    test = channel_data(test_columns, channel, rows_per_trial=WHOLE)
    left, test_left = (d.target - base.law_response(d) for d in (data, test))
    return gp_rmse(data, left, test, test_left, rng)


def _unexplained(
    attribution: Attribution,
    data: ChannelData,
    base: Fit,
    final: Fit,
    structure: tuple[Dependence, ...],
) -> tuple[Dependence, ...]:
    """Covariates that compete as well as effects, and what else the residual clearly follows."""
    found = [
        Dependence(c.candidate.name, c.p_value, c.gain)
        for c in attribution.chosen
        if not c.candidate.is_effect
    ]
    explained = max(base.loss - final.loss, 0.0) / max(base.loss, 1e-300)
    least = max(MIN_SHARE_LEFT, FORM_SHARE_LEFT * explained * base.loss / (2 * data.noise_loss))
    left = [d for d in structure if d.p_value <= ALPHA and d.share > least]
    if not found and left:
        found.append(max(left, key=lambda d: d.share))
    if not found and structure and _is_far_from_noise(attribution, data):
        found.append(max(structure, key=lambda d: d.share))
        name, share = attribution.best_covariate
        if share > found[0].share:
            found[0] = next((d for d in structure if d.covariate == name), found[0])
    return tuple(found)


def _is_far_from_noise(attribution: Attribution, data: ChannelData) -> bool:
    """Whether held-out trials keep so much structure that no law that fits was found."""
    left, start = attribution.final.unit_losses, attribution.base.loss
    least = max(UNFIT * data.noise_loss * left.size / data.n_units, UNFIT_FORM * start)
    error = float(left.std() * np.sqrt(left.size))
    return float(left.sum()) > least and float(left.sum()) > 2.0 * error


def _law_of(channels: dict[str, ChannelDiagnosis]) -> ContactLaw:
    effects = []
    compliance = {"normal": Estimate(1.0), "shear": Estimate(float("nan"), float("nan"), "mm/N")}
    units = {"normal": "mm3/N", "shear": "mm/N"}
    for name, found in channels.items():
        compliance[name] = Estimate(
            found.final.model.compliance, found.final_errors.compliance, units[name]
        )
        for term in found.final.model.terms:
            errors = found.final_errors.effects[term.name]
            parameters = {
                key: Estimate(value, errors.get(key, 0.0), unit_of(term.effect, key))
                for key, value in shown_parameters(term).items()
            }
            effects.append(FittedEffect(term.name, name, MappingProxyType(parameters)))
    provenance: dict[str, Any] = {
        "versions": {
            "tacgen": version("tacgen"),
            "numpy": version("numpy"),
            "python": platform.python_version(),
        },
        "trials": {n: {"fit": f.n_fit, "test": f.n_test} for n, f in channels.items()},
        "heldout_rmse": {n: f.after.rmse for n, f in channels.items()},
        "refitted_to": "all trials, after the choice was made and scored on held-out ones",
    }
    return ContactLaw(
        "volume_linear",
        compliance["normal"],
        compliance["shear"],
        effects=tuple(effects),
        provenance=MappingProxyType(provenance),
    )


def _usable_columns(
    columns: Columns, channel: Channel
) -> tuple[dict[str, NDArray[Any]] | None, str]:
    """Rows in which the channel was measured, or None and why it cannot be diagnosed."""
    names = (*TARGETS[channel],)
    if channel == "shear":
        names += ("force_shear_x_n", "force_shear_y_n")
    lacking = [name for name in names if name not in columns]
    if lacking:
        return None, f"{channel} channel: not diagnosed, the log has no {', '.join(lacking)}"
    known = np.logical_and.reduce([np.isfinite(columns[name]) for name in names])
    known &= np.isfinite(columns["force_normal_n"]) & np.isfinite(columns["time_s"])
    numbers, counts = np.unique(np.asarray(columns["trial"])[known], return_counts=True)
    long_enough = np.isin(columns["trial"], numbers[counts >= 4])
    kept = heldout.select(columns, known & long_enough)
    load = kept["force_normal_n"] if channel == "normal" else kept["force_shear_x_n"]
    if load.size < 12 or not np.any(load != 0):
        return None, f"{channel} channel: not diagnosed, fewer than 12 samples under load"
    if _response(kept, channel) <= 0:
        signs = "volume_mm3" if channel == "normal" else "shear_x_mm, shear_y_mm"
        words = f"{signs} falls as the force grows; check the signs of both"
        return None, f"{channel} channel: not diagnosed, {words}"
    dropped = int((~known).sum())
    words = f"{channel} channel: {dropped} rows without a finite value left out" if dropped else ""
    return kept, words


def _response(columns: Columns, channel: Channel) -> float:
    """Sum of products of load and response: its sign is the compliance's."""
    forces = ("force_normal_n",) if channel == "normal" else ("force_shear_x_n", "force_shear_y_n")
    pairs = zip(forces, TARGETS[channel], strict=True)
    return float(sum(np.nansum(columns[force] * columns[name]) for force, name in pairs))


def _scale(columns: Columns, channel: Channel) -> float:
    """RMS of what is measured, which ``nrmse`` is relative to."""
    square = sum(np.asarray(columns[name], dtype=np.float64) ** 2 for name in TARGETS[channel])
    return float(np.sqrt(np.mean(square) / len(TARGETS[channel]))) or 1.0

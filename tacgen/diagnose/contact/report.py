"""The page of a contact diagnosis: residual before and after, what it was traced to, ranking."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from tacgen.core.types import FloatArray
from tacgen.diagnose.contact.model import Fit
from tacgen.diagnose.contact.residuals import covariates_of
from tacgen.diagnose.contact.result import ChannelDiagnosis, Diagnosis, diagnosis_record
from tacgen.diagnose.record import VERDICTS
from tacgen.report import figures as plots
from tacgen.report.formatting import unit_text
from tacgen.report.page import write_page

ALWAYS_DRAWN = ("load", "time_in_trial_s", "time_s")
MAX_DRAWN = 4  # covariates that the residual is drawn over


def write_report(diagnosis: Diagnosis, path: Path, *, title: str) -> None:
    """Write the self-contained page."""
    record = diagnosis_record(diagnosis)
    channels = record["channels"]
    verdicts = [channel["verdict"] for channel in channels.values()]
    write_page(
        path,
        title,
        summary=" ".join(f"{name.capitalize()}: {c['sentence']}" for name, c in channels.items()),
        verdict=next(one for one in VERDICTS if one in verdicts),
        template="contact_diagnosis.html",
        made_by="diagnose contact",
        record=record,
        errors=error_bars(channels),
        correcting={
            name: {term.name: term.effect.free_amounts for term in found.final.model.terms}
            for name, found in diagnosis.channels.items()
        },
        residuals={
            name: residual_figure(channels[name], found)
            for name, found in diagnosis.channels.items()
        },
        arrows=None
        if diagnosis.markers is None
        else [diagnosis.markers.figure(extended=one) for one in (False, True)],
    )


def error_bars(channels: Mapping[str, Mapping[str, Any]]) -> Figure:
    """Errors before and after, and the noise floor, of each channel as its name has it."""
    bars = [
        (name, 100 * c["error_before"]["nrmse"], 100 * c["error_after"]["nrmse"], _floor(c))
        for name, c in channels.items()
    ]
    return plots.before_after(bars, "RMSE on held-out presses, % of the RMS signal")


def _floor(channel: Mapping[str, Any]) -> float | None:
    """The noise floor in per cent of the RMS signal, as ``nrmse`` is."""
    error, floor = channel["error_before"], channel["noise_floor"]["rmse"]
    return 100 * floor * error["nrmse"] / error["rmse"] if floor and error["rmse"] else None


def residual_figure(channel: Mapping[str, Any], found: ChannelDiagnosis) -> Figure:
    """Residuals before and after over numeric covariates and those with names for levels."""
    covariates = {
        name: values
        for name, values in covariates_of(found.data).items()
        if np.issubdtype(values.dtype, np.number) or values.dtype.kind == "U"
    }
    terms = {term.name: term.effect for term in found.final.model.terms}
    effects = [terms[effect["name"]] for effect in channel["effects"]]
    wanted: list[str] = [one.where.column for one in effects if one.where]
    wanted += [one.shown_against for one in effects]
    wanted += [one["covariate"] for one in channel["unexplained"]]
    wanted += ALWAYS_DRAWN
    shown = [one for one in dict.fromkeys(wanted) if one in covariates][:MAX_DRAWN]
    height_in = 2.6 * len(shown)
    figure, grid = plots.new_figure(9.0, height_in, len(shown), 2, sharey=True)
    figure.set_layout_engine(None)  # one for any labels costs as much time as drawing does
    top, bottom = 1.0 - 0.3 / height_in, 0.5 / height_in
    figure.subplots_adjust(0.095, bottom, 0.975, top, wspace=0.06, hspace=0.42)
    noise = channel["noise_floor"]["rmse"] or 0.0
    for column, fit in enumerate((found.base, found.final)):
        residual = _residual(found, fit)
        for row, covariate in zip(grid, shown, strict=True):
            plots.draw_residual(row[column], covariates[covariate], residual, noise)
            row[column].set_title(("before", "after")[column], fontsize=9)
            row[column].set_xlabel(covariate)
    for row in grid:
        row[0].set_ylabel(f"residual, {unit_text(channel['error_before']['unit'])}")
    return figure


def _residual(found: ChannelDiagnosis, fit: Fit) -> FloatArray:
    """Residual of the law (N,): of the volume, or of the motion along the shear force."""
    data = found.data
    residual = data.target - fit.model.law_response(data)
    if data.channel == "normal":
        return residual[:, 0]
    force = data.history.force_shear_n
    return np.asarray(
        (residual * force).sum(axis=1) / np.maximum(np.linalg.norm(force, axis=1), 1e-9)
    )

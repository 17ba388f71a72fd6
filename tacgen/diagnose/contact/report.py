"""The page of a contact diagnosis: residual before and after, what it was traced to, ranking."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tacgen.contact.effects import find_effect
from tacgen.core.arrays import FloatArray
from tacgen.diagnose.contact.model import Fit
from tacgen.diagnose.contact.residuals import covariates_of
from tacgen.diagnose.contact.result import ChannelDiagnosis, Diagnosis, diagnosis_record
from tacgen.report import (
    Section,
    facts_section,
    figure_section,
    table_section,
    text_section,
    write_page,
)
from tacgen.report import figures as plots
from tacgen.report.formatting import estimate, number, p_value, percent, unit_text

_ALWAYS_DRAWN = ("load", "time_in_trial_s", "time_s")
_MAX_DRAWN = 4
_MAX_RANKED = 10


@dataclass(frozen=True, slots=True)
class ResidualPictures:
    """A channel's residual before and after (N,), and the covariates (N,) it is drawn over."""

    covariates: Mapping[str, NDArray[Any]]
    before: FloatArray
    after: FloatArray


def write_report(diagnosis: Diagnosis, path: Path, *, title: str) -> None:
    """Write the self-contained page."""
    pictures = {name: residual_pictures(found) for name, found in diagnosis.channels.items()}
    write_diagnosis_page(diagnosis_record(diagnosis), pictures, path, title=title)


def residual_pictures(found: ChannelDiagnosis) -> ResidualPictures:
    """What the page draws of a channel: numeric covariates and those with names for levels."""
    covariates = {
        name: values
        for name, values in covariates_of(found.data).items()
        if np.issubdtype(values.dtype, np.number) or values.dtype.kind == "U"
    }
    return ResidualPictures(covariates, _residual(found, found.base), _residual(found, found.final))


def write_diagnosis_page(
    record: Mapping[str, Any], pictures: Mapping[str, ResidualPictures], path: Path, *, title: str
) -> None:
    """Write the page of the content of ``diagnosis.json``."""
    channels = record["channels"]
    bars = [
        (name, 100 * c["error_before"]["nrmse"], 100 * c["error_after"]["nrmse"], _floor(c))
        for name, c in channels.items()
    ]
    sections = [
        figure_section(
            "Error before and after",
            plots.before_after(bars, "RMSE on held-out trials, % of the RMS signal"),
        )
    ]
    for name, channel in channels.items():
        sections += _channel_sections(name, channel, pictures[name])
    if record["notes"]:
        sections.append(text_section("About the data", *record["notes"]))
    summary = " ".join(f"{name.capitalize()}: {c['sentence']}" for name, c in channels.items())
    verdicts = [channel["verdict"] for channel in channels.values()]
    worst = next((v for v in ("unexplained", "effect_found") if v in verdicts), "sufficient")
    write_page(path, title, sections, summary=summary, verdict=worst)


def _floor(channel: Mapping[str, Any]) -> float | None:
    """The noise floor in per cent of the RMS signal, as ``nrmse`` is."""
    error, floor = channel["error_before"], channel["noise_floor"]["rmse"]
    return 100 * floor * error["nrmse"] / error["rmse"] if floor and error["rmse"] else None


def _channel_sections(
    name: str, channel: Mapping[str, Any], pictures: ResidualPictures
) -> list[Section]:
    heading = f"{name.capitalize()} channel"
    sections = [
        figure_section(
            f"{heading}: residual before and after",
            _residual_figure(name, channel, pictures),
            "Dots: the residual of every row; lines: means in bins of equal count; band: the noise "
            "floor. Left the linear law, right the law with the effects that were found.",
        ),
        _errors(heading, channel),
    ]
    if channel["effects"] or channel["unexplained"]:
        sections.append(_found_table(heading, channel))
    sections += [_ranking_table(heading, channel), _structure_table(heading, channel)]
    return sections


def _errors(heading: str, channel: Mapping[str, Any]) -> Section:
    before, after = channel["error_before"], channel["error_after"]
    unit = unit_text(before["unit"])
    low, high = channel["gain_interval_95"]
    facts = [
        (f"error {when}", f"{number(e['rmse'])} {unit}, {percent(e['nrmse'], 2)} of the RMS signal")
        for when, e in (("before", before), ("after", after))
    ]
    facts += [
        ("reduction, 95 % interval", f"{percent(low)} to {percent(high)}"),
        ("noise floor", f"{number(channel['noise_floor']['rmse'])} {unit}"),
        ("Gaussian process (baseline)", f"{number(channel['gp_baseline']['rmse'])} {unit}"),
        ("compliance before", estimate(channel["compliance"]["before"])),
        ("compliance after", estimate(channel["compliance"]["after"])),
        ("trials fitted, held out", f"{channel['trials']['fit']}, {channel['trials']['test']}"),
        ("how they were held out", channel["held_out"]),
    ]
    return facts_section(f"{heading}: errors", facts)


def _found_table(heading: str, channel: Mapping[str, Any]) -> Section:
    rows = [
        (
            effect["name"],
            effect["form"],
            "; ".join(f"{key} {estimate(value)}" for key, value in effect["parameters"].items()),
            percent(effect["heldout_gain"]),
            p_value(effect["p_value"]),
            effect["runner_up"],
            percent(effect["runner_up_margin"]),
            "; ".join(effect["what_would_tell"]) or "clearly separated",
        )
        for effect in channel["effects"]
    ]
    rows += [
        (
            f"unexplained: {one['covariate']}",
            "",
            "",
            percent(one["share"]),
            p_value(one["p_value"]),
            one.get("runner_up", ""),
            percent(one.get("runner_up_margin")),
            "; ".join(one.get("what_would_tell", ())),
        )
        for one in channel["unexplained"]
    ]
    header = (
        *("what", "form", "parameters", "gain", "p", "runner-up", "behind by"),
        "not separated from",
    )
    note = (
        "Gain and margin are in the error on trials held out in turn during the choice; of an "
        "unexplained covariate, the share of the residual's sum of squares."
    )
    return table_section(f"{heading}: what the residual was traced to", header, rows, note)


def _ranking_table(heading: str, channel: Mapping[str, Any]) -> Section:
    rows = [
        (one["candidate"], percent(one["heldout_gain"], 2), p_value(one["p_value"]))
        for one in channel["ranking"][:_MAX_RANKED]
    ]
    note = (
        "Every candidate alone, linearised, against the linear law. p is from permutations of "
        "whole trials, corrected for the number of candidates."
    )
    return table_section(
        f"{heading}: ranking of candidates", ("candidate", "gain", "p"), rows, note
    )


def _structure_table(heading: str, channel: Mapping[str, Any]) -> Section:
    after = {one["covariate"]: one for one in channel["residual_after"]}
    rows = [
        (
            one["covariate"],
            *(
                text
                for entry in (one, after.get(one["covariate"], {}))
                for text in (percent(entry.get("share"), 2), p_value(entry.get("p_value")))
            ),
        )
        for one in channel["residual_before"]
    ]
    note = (
        "Share of the held-out sum of squares, noise included, that a cubic in the covariate (or "
        "its levels) explains. Below zero: nothing to explain."
    )
    header = ("covariate", "share before", "p before", "share after", "p after")
    return table_section(f"{heading}: what the residual depends on", header, rows, note)


def _residual_figure(name: str, channel: Mapping[str, Any], pictures: ResidualPictures) -> Figure:
    wanted = [find_effect(name, effect["name"]).shown_against for effect in channel["effects"]]
    wanted += [one["covariate"] for one in channel["unexplained"]]
    wanted += _ALWAYS_DRAWN
    shown = [one for one in dict.fromkeys(wanted) if one in pictures.covariates][:_MAX_DRAWN]
    figure, grid = plots.new_figure(9.0, 2.6 * len(shown), len(shown), 2, sharey=True)
    unit = unit_text(channel["error_before"]["unit"])
    for row, covariate in zip(grid, shown, strict=True):
        for axes, residual, when in zip(
            row, (pictures.before, pictures.after), ("before", "after"), strict=True
        ):
            noise = channel["noise_floor"]["rmse"] or 0.0
            plots.draw_residual(axes, pictures.covariates[covariate], residual, noise)
            axes.set_title(when, fontsize=9)
            axes.set_xlabel(covariate)
        row[0].set_ylabel(f"residual, {unit}")
    return figure


def _residual(found: ChannelDiagnosis, fit: Fit) -> FloatArray:
    """Residual of the law (N,): of the volume, or of the motion along the shear force."""
    data = found.data
    residual = data.target - fit.model.law_response(data)
    if data.channel == "normal":
        return residual[:, 0]
    force = data.history.force_shear_n
    return (residual * force).sum(axis=1) / np.maximum(np.linalg.norm(force, axis=1), 1e-9)

"""The diagnosis as a page: residual before and after, ranking, confusions, one sentence each."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tacgen.core.arrays import FloatArray
from tacgen.diagnose.contact.channel import UNITS
from tacgen.diagnose.contact.model import Fit
from tacgen.diagnose.contact.residuals import covariates_of
from tacgen.diagnose.contact.result import ChannelDiagnosis, Diagnosis, advice
from tacgen.report import Section, figure_section, table_section, text_section, write_page

_BINS = 14


def write_report(diagnosis: Diagnosis, path: Path, *, title: str) -> None:
    """Write the self-contained page."""
    sections: list[Section] = []
    if diagnosis.notes:
        sections.append(text_section("About the data", *diagnosis.notes))
    for name, found in diagnosis.channels.items():
        sections += _channel_sections(name, found)
    summary = " ".join(f"{n.capitalize()}: {d.sentence}" for n, d in diagnosis.channels.items())
    write_page(path, title, sections, summary=summary)


def _channel_sections(name: str, found: ChannelDiagnosis) -> list[Section]:
    heading = f"{name.capitalize()} channel"
    sections = [_error_table(heading, found)]
    sections.append(
        figure_section(
            f"{heading}: residual before and after",
            _residual_figure(found),
            "Dots: every row's residual; lines: means in bins of equal count. Left of each pair "
            "the plain law, right the law with the effects that were found.",
        )
    )
    if found.attribution.chosen:
        sections.append(_chosen_table(heading, found))
    sections.append(_ranking_table(heading, found))
    sections.append(_structure_table(heading, found))
    return sections


def _error_table(heading: str, found: ChannelDiagnosis) -> Section:
    unit = UNITS[found.data.channel]
    low, high = found.gain_interval
    rows: list[list[object]] = [
        ["error before", f"{found.before.rmse:.4g} {unit}", f"{100 * found.before.nrmse:.2f} %"],
        ["error after", f"{found.after.rmse:.4g} {unit}", f"{100 * found.after.nrmse:.2f} %"],
        ["noise floor", f"{found.floor:.4g} {unit}", ""],
        ["Gaussian process (baseline)", f"{found.gp_rmse:.4g} {unit}", ""],
        ["gain, 95 % interval", f"{100 * low:.1f} to {100 * high:.1f} %", ""],
        [
            "compliance before",
            f"{found.base.model.compliance:.4g} ± {found.base_errors.compliance:.2g} {unit}/N",
            "",
        ],
        [
            "compliance after",
            f"{found.final.model.compliance:.4g} ± {found.final_errors.compliance:.2g} {unit}/N",
            "",
        ],
        ["trials fitted / held out", f"{found.n_fit} / {found.n_test}", found.how],
    ]
    return table_section(heading, ["", "", "of the RMS signal"], rows, found.sentence)


def _chosen_table(heading: str, found: ChannelDiagnosis) -> Section:
    values = {term.name: term for term in found.final.model.terms}
    rows = []
    for chosen in found.attribution.chosen:
        name = chosen.candidate.name
        if chosen.candidate.is_effect:
            term, errors = values[name], found.final_errors.effects[name]
            text = ", ".join(
                f"{p} {term.values[p]:.3g} ± {errors.get(p, 0.0):.2g}" for p in term.variant.free
            )
        else:
            text = chosen.candidate.label
        told = "; ".join(advice(name, other) for other in chosen.confusable) or "clearly apart"
        rows.append(
            [
                name if chosen.candidate.is_effect else f"unexplained: {name}",
                text,
                f"{100 * chosen.gain:.1f} %",
                chosen.runner_up,
                f"{100 * chosen.runner_up_margin:.1f} %",
                told,
            ]
        )
    header = ["what", "parameters", "gain", "runner-up", "loses by", "cannot be told from"]
    note = "Gain and margin are of the error on trials that were left out in turn while choosing."
    return table_section(f"{heading}: what it was traced to", header, rows, note)


def _ranking_table(heading: str, found: ChannelDiagnosis) -> Section:
    rows = [
        [label, f"{100 * gain:.2f} %", f"{p:.2g}"]
        for label, gain, p in found.attribution.ranking[:10]
    ]
    note = (
        "Every candidate alone, linearised, beside the plain law. p is from shuffles of whole "
        "trials, corrected for the number of candidates."
    )
    return table_section(f"{heading}: ranking at the start", ["candidate", "gain", "p"], rows, note)


def _structure_table(heading: str, found: ChannelDiagnosis) -> Section:
    after = {d.covariate: d for d in found.dependences_after}
    rows = [
        [d.covariate, f"{100 * d.share:.2f} %", f"{d.p_value:.2g}"]
        + (
            [f"{100 * after[d.covariate].share:.2f} %", f"{after[d.covariate].p_value:.2g}"]
            if d.covariate in after
            else ["", ""]
        )
        for d in found.dependences_before
    ]
    header = ["covariate", "share before", "p before", "share after", "p after"]
    note = (
        "Share of the held-out sum of squares (noise included) that a cubic in the covariate, or "
        "its levels, would take from the residual. Below nought: nothing to take."
    )
    return table_section(f"{heading}: what the residual follows", header, rows, note)


def _residual_figure(found: ChannelDiagnosis) -> Figure:
    covariates = {
        name: values
        for name, values in covariates_of(found.data).items()
        if np.issubdtype(values.dtype, np.number) or name == "indenter" or values.dtype.kind == "U"
    }
    wanted = [
        c.candidate.effect.shown_against for c in found.attribution.chosen if c.candidate.effect
    ]
    wanted += [d.covariate for d in found.unexplained]
    wanted += ["load", "time_in_trial_s", "time_s"]
    shown = [name for name in dict.fromkeys(wanted) if name in covariates][:4]
    figure = Figure(figsize=(9.0, 2.6 * len(shown)), layout="constrained")
    axes = figure.subplots(len(shown), 2, sharey=True, squeeze=False)
    for row, name in zip(axes, shown, strict=True):
        for axis, fit, label in zip(
            row, (found.base, found.final), ("before", "after"), strict=True
        ):
            _draw(axis, covariates[name], _residual(found, fit), found.floor)
            axis.set_title(f"{label}", fontsize=9)
            axis.set_xlabel(name)
        row[0].set_ylabel(f"residual, {UNITS[found.data.channel]}")
    return figure


def _residual(found: ChannelDiagnosis, fit: Fit) -> FloatArray:
    """Residual of the law (N,): of the volume, or of the motion along the shear force."""
    data = found.data
    left = data.target - fit.model.law_response(data)
    if data.channel == "normal":
        return left[:, 0]
    force = data.history.force_shear_n
    return (left * force).sum(axis=1) / np.maximum(np.linalg.norm(force, axis=1), 1e-9)


def _draw(axis: Axes, covariate: NDArray, residual: FloatArray, noise: float) -> None:
    axis.axhspan(-noise, noise, color="0.92")
    axis.axhline(0.0, color="0.5", linewidth=0.8)
    if covariate.dtype.kind == "U":
        levels, position = np.unique(covariate, return_inverse=True)
        axis.plot(position + 0.0, residual, ".", markersize=1.5, alpha=0.35, color="tab:gray")
        by_level = [residual[position == k].mean() for k in range(levels.size)]
        axis.plot(range(levels.size), by_level, "o-", color="tab:red")
        axis.set_xticks(range(levels.size), [str(level)[:10] for level in levels], fontsize=8)
        return
    finite = np.isfinite(covariate)
    x, y = covariate[finite], residual[finite]
    axis.plot(x, y, ".", markersize=1.5, alpha=0.35, color="tab:gray")
    edges = np.unique(np.quantile(x, np.linspace(0, 1, _BINS + 1)))
    inside = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, max(edges.size - 2, 0))
    count = np.bincount(inside)
    kept = count > 0
    centers = np.bincount(inside, x)[kept] / count[kept]
    means = np.bincount(inside, y)[kept] / count[kept]
    axis.plot(centers, means, "o-", color="tab:red", markersize=3)

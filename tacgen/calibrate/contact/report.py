"""The page of a contact calibration."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from tacgen.calibrate.contact.law_fit import (
    SYMBOLS,
    ContactFit,
    agreement_text,
    channel_arrays,
    half_width,
    summary_dict,
)
from tacgen.calibrate.contact.marker_fit import FieldData, FieldFit, arrow_figure
from tacgen.calibrate.contact.rules import RULES
from tacgen.presses.press_log import PressLog
from tacgen.report import figures as plots
from tacgen.report.formatting import percent, unit_text, with_error
from tacgen.report.page import write_page

RESPONSES = {"normal": "V", "shear": "D"}


def write_report(
    fit: ContactFit,
    folder: Path,
    field: FieldFit | None = None,
    data: FieldData | None = None,
) -> Path:
    """Write ``index.html`` into ``folder``, with the shear field of marker tracks if there is."""
    result = summary_dict(fit)
    figures, worst, verdicts = {}, {}, []
    for name, channel in result["channels"].items():
        log = fit.log.with_shear() if name == "shear" else fit.log
        pooled, held = channel[SYMBOLS[name]], channel["held_out"]
        figures[name] = _figures(name, channel, log)
        worst[name] = [
            (trial, int(log.rows[log["trial"] == int(trial)][0]), error)
            for trial, error in sorted(held["by_trial"].items(), key=lambda item: -item[1])
        ][: RULES.max_worst]
        value = with_error(pooled["value"], half_width(pooled), channel["unit"])
        error = percent(held["nrmse"], 2)
        verdicts.append(f"{SYMBOLS[name]} = {value} (95 %), error on held-out presses {error}")
    limits = zip(result["cannot_tell"], result["press_next"], strict=True)
    path = Path(folder) / "index.html"
    write_page(
        path,
        "Contact calibration",
        summary=f"{fit.log.path.name}: {'; '.join(verdicts)}.",
        template="contact_calibration.html",
        made_by="calibrate contact",
        result=result,
        symbols=SYMBOLS,
        figures=figures,
        worst=worst,
        warnings=[text.replace(f"{fit.log.path}: ", "") for text in result["warnings"]],
        advice=[f"{cannot_tell}; {press_next}" for cannot_tell, press_next in limits],
        agreement_text=agreement_text,
        half_width=half_width,
        field=field,
        arrows=arrow_figure(data, field.grip, field.linear) if field and data else None,
    )
    return path


def _figures(name: str, channel: Mapping[str, Any], log: PressLog) -> dict[str, Figure]:
    """Fit and residual (components one after the other), groups, and held-out errors."""
    load, response = channel_arrays(log, name)
    symbol, held = SYMBOLS[name], channel["held_out"]
    k, unit = channel[symbol]["value"], unit_text(held["unit"])
    labels = ("force, N", f"{RESPONSES[name]}, {unit}", f"{RESPONSES[name]} − {symbol} F, {unit}")
    group = np.tile(log[channel["by"]].astype(str), load.shape[1])
    halves = {g: (fit["value"], half_width(fit) or 0.0) for g, fit in channel["groups"].items()}
    pooled = k, half_width(channel[symbol]) or 0.0
    return {
        "fit": plots.fit_and_residual(load.T.ravel(), response.T.ravel(), group, k, labels),
        "groups": plots.intervals(halves, pooled, f"{symbol}, {unit_text(channel['unit'])}"),
        "held_out": plots.columns(held["by_trial"], held["rmse"], ("press", f"RMSE, {unit}")),
    }

"""``tacgen calibrate contact``: a press log, or curves of force against depth, to a contact law."""

import contextlib
import json
import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.calibrate.contact import depth_curves
from tacgen.calibrate.contact.contact_point import free_contact_points
from tacgen.calibrate.contact.law_fit import ContactFit, fit_contact, summary_dict, summary_text
from tacgen.calibrate.contact.marker_fit import FieldFit, field_data, fit_field, load_tracks
from tacgen.calibrate.lookup.table_fit import fit_lookup
from tacgen.contact.law import ContactLaw, save_law
from tacgen.core.errors import PressError
from tacgen.core.files import atomic_path, refuse_other_page, sha256_of
from tacgen.core.version import __version__
from tacgen.optics.table import load_table
from tacgen.presses.lab_table import LogFormat, LogTable, read_log_table
from tacgen.presses.press_folder import WITH_FORCES, read_press_folder, read_presses
from tacgen.presses.press_forces import MeasuredLog, measure_presses
from tacgen.presses.press_log import PLAIN, PressLog, compliance_doubts, press_log_of
from tacgen.presses.screening import usable_presses

MIN_FOR_OWN_TABLE, MIN_PRESSES_FOR_OWN_TABLE = 10, 6
"""Pictures, and presses that they are of, that a table has to be fitted to before volumes by it are
better than by the circle."""

CONTACT_POINTS = {"auto": None, "free": True, "fixed": False}


@dataclass(frozen=True, slots=True)
class ContactCalibration:
    """What was fitted, the law that was written, and warnings."""

    fit: ContactFit | depth_curves.DepthReport
    law: ContactLaw
    warnings: tuple[str, ...]
    field: FieldFit | None = None


def calibrate_contact(
    log: Path,
    out: Path,
    report: Path | None = None,
    *,
    by: str | None = None,
    contact_point: str = "auto",
    log_format: LogFormat = PLAIN,
    marker_pitch_mm: float = np.nan,
    radius_mm: float | None = None,
    table: Path | None = None,
    markers: Path | None = None,
    sensor: str | None = None,
) -> ContactCalibration:
    """Fit ``log``, write the law to ``out`` and, where asked for, a page into ``report``.

    ``log`` is a press log, a table of force–depth curves, or a folder of press images with
    forces; of the last, ``table`` turns pictures into volumes, and the log is kept beside the law.
    ``markers`` are tracks of the dots of ``sensor``, a CSV file or such a folder: they give k_s,
    friction and decay of the shear field.

    Raises ``PressError`` if the log cannot be used or an option is not known.
    """
    if contact_point not in CONTACT_POINTS:
        known = ", ".join(CONTACT_POINTS)
        msg = f"--contact-point {contact_point!r} is not known; use one of {known}"
        raise PressError(msg)
    if report is not None:
        refuse_other_page(Path(report) / "contact.html", "calibrate contact")
    measured: tuple[str, ...] = ()
    volume_share = 0.0
    if Path(log).is_dir():
        log, found = _measure_images(Path(log), table, Path(out).with_suffix(".csv"))
        measured, volume_share = found.warnings, found.volume_stderr_share
        if np.isnan(marker_pitch_mm):
            marker_pitch_mm = found.marker_pitch_mm
    table_read = read_log_table(Path(log), log_format)
    if depth_curves.holds_depths(table_read):
        if markers is not None:
            msg = f"{log}: --markers needs a log with volume_mm3 and shear forces, not of depths"
            raise PressError(msg)
        return _explain_depths(table_read, Path(out), report, radius_mm)
    fit = fit_contact(
        press_log_of(table_read),
        by=by,
        free_contact_point=CONTACT_POINTS[contact_point],
        marker_pitch_mm=marker_pitch_mm,
    )
    # A table's error is alike in all presses, so that their scatter does not show it.
    k_n = fit.normal.pooled
    k_n = replace(k_n, stderr=math.hypot(k_n.stderr, volume_share * k_n.value))
    warnings = (*measured, *fit.warnings)
    field = data = None
    if markers is not None:
        gel, tracks = load_tracks(markers, sensor, fit.log)
        data = field_data(tracks, gel, k_n.value)
        field = fit_field(data, fit.law.k_s_mm_per_n if fit.shear else None)
        warnings = (*warnings, *tracks.warnings)
    fit = replace(fit, normal=replace(fit.normal, pooled=k_n), warnings=warnings)
    law = fit.law
    if field is not None and data is not None:
        law = replace(
            law,
            k_s_mm_per_n=field.k_s,
            marker_pitch_mm=data.tracks.pitch_mm,
            friction=field.friction,
            decay_mm=field.decay,
            provenance={
                **law.provenance,
                "markers": {data.tracks.path.name: sha256_of(data.tracks.path)},
            },
        )
    save_law(law, out)
    if report is not None:
        from tacgen.calibrate.contact.report import write_report

        write_report(fit, report, field, data)
    return ContactCalibration(fit, law, fit.warnings, field)


def read_contact_log(
    log: Path,
    log_format: LogFormat,
    *,
    radius_mm: float | None = None,
    table: Path | None = None,
    save_log: Path,
) -> tuple[PressLog, float]:
    """What ``calibrate_contact`` reads, as a press log, and the markers' pitch, NaN if unknown.

    Depths become the volumes of their ball, with the contact point of each press found; a ball of
    unknown radius is that which explains the curves. Pictures are measured into ``save_log``.
    """
    if Path(log).is_dir():
        path, found = _measure_images(Path(log), table, save_log)
        read = press_log_of(read_log_table(path, log_format))
        return replace(read, warnings=(*found.warnings, *read.warnings)), found.marker_pitch_mm
    cells = read_log_table(Path(log), log_format)
    read = press_log_of(cells, radius_mm=radius_mm)
    if not depth_curves.holds_depths(cells):
        return read, np.nan
    notes = [f"{log}: the contact point of every press was estimated from its depth and force"]
    if "volume_mm3" not in read:
        curves, left_out = depth_curves.read_depth_curves(read)
        fitted = depth_curves.explain_curves(curves)
        depth_curves.check_identified(Path(log), fitted)
        radius_mm = float(np.median([fit.radius_mm for fit in fitted.curves.values()]))
        notes += [
            *left_out,
            f"{log}: the ball's radius is fitted, {radius_mm:.3g} mm, so that V = k_n F holds as "
            "well as it can: give --radius-mm before you believe in stiffening",
        ]
        read = press_log_of(cells, radius_mm=radius_mm)
    read, _ = free_contact_points(read)
    columns = {name: values for name, values in read.columns.items() if name != "depth_mm"}
    return replace(read, columns=columns, warnings=(*notes, *read.warnings)), np.nan


def _measure_images(folder: Path, table: Path | None, log: Path) -> tuple[Path, MeasuredLog]:
    """The press log that a folder of images with forces holds, written to ``log``."""
    images = read_press_folder(folder, WITH_FORCES)
    lookup = None
    if table is not None:
        lookup = load_table(table)
        if lookup.background.shape != images.background.shape:
            msg = (
                f"{table}: made for {lookup.background.shape[1]}×{lookup.background.shape[0]} px, "
                f"the images in {folder} are {images.background.shape[1]}×"
                f"{images.background.shape[0]}; use the table of this sensor and camera setting"
            )
            raise PressError(msg)
    own = None
    if lookup is None:
        with contextlib.suppress(PressError):  # too few balls of known radius
            presses = usable_presses(read_presses(folder), least=MIN_PRESSES_FOR_OWN_TABLE)
            own = fit_lookup(presses) if len(presses) >= MIN_FOR_OWN_TABLE else None
    found = measure_presses(images, lookup or own)
    if own is not None:
        warning = (
            f"{folder}: no --table given; volumes are computed with a table fitted to these images"
        )
        found = replace(found, method="own table", warnings=(warning, *found.warnings))
    with atomic_path(log) as partial:
        found.frame.to_csv(partial, index=False)
    return log, found


def result_text(result: ContactCalibration, *, json_output: bool) -> str:
    """What the command prints."""
    if isinstance(result.fit, ContactFit):
        record, text = summary_dict(result.fit), summary_text
        if result.field is not None and json_output:
            record["field"] = result.field.summary()
        elif result.field is not None:
            return f"{text(record)}\n{result.field.sentence()}"
    else:
        record, text = asdict(result.fit), depth_curves.depth_text
    return json.dumps(record, indent=2) if json_output else text(record)


def _explain_depths(
    table: LogTable, out: Path, report: Path | None, radius_mm: float | None
) -> ContactCalibration:
    """The law of curves without volumes is the k_n that all of them share."""
    read = press_log_of(table, radius_mm=radius_mm)
    log = table.path
    curves, left_out = depth_curves.read_depth_curves(read)
    found = depth_curves.explain_curves(curves, radius_mm)
    depth_curves.check_identified(log, found)
    known = depth_curves.known_radii(curves, radius_mm)[0]
    doubts = compliance_doubts(found.shared_k_n, 2 * found.reference_n, table)
    doubts = [] if known else doubts  # else those of the log are said already
    least = depth_curves.LEAST_ZERO_SHARE
    zeros_n = [one.zero_n for one in curves if abs(one.zero_n) > least * np.ptp(one.force_n)]
    untared = []
    if zeros_n:
        untared.append(
            f"{log}: force_normal_n is {min(zeros_n):.3g} to {max(zeros_n):.3g} N at rest: that is "
            "subtracted from each curve; tare the gauge before you record"
        )
    warnings = (
        *read.warnings,
        *map(str, read.dropped),
        *left_out,
        *doubts,
        *untared,
        *depth_curves.depth_warnings(log, found, known),
    )
    provenance: dict[str, Any] = {
        "data": {log.name: sha256_of(log)},
        "versions": {"tacgen": __version__},
        "trials": {"fit": len(found.curves), "left_out": len(read.dropped) + len(left_out)},
        "curves": asdict(found)["curves"],
        "warnings": list(warnings),
    }
    law = depth_curves.law_of(found, provenance)
    save_law(law, out)
    if report is not None:
        from tacgen.calibrate.contact.report import write_depth_page

        write_depth_page(found, curves, warnings, report)
    return ContactCalibration(found, law, warnings)

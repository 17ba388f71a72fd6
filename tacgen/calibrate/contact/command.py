"""``tacgen calibrate contact``: forces with volumes, depths or images to a contact law."""

import contextlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from tacgen.calibrate.contact.law_fit import ContactFit, fit_contact, summary_dict, summary_text
from tacgen.calibrate.contact.marker_fit import FieldFit, field_data, fit_field, load_tracks
from tacgen.calibrate.contact.rules import RULES
from tacgen.calibrate.lookup.table_fit import fit_lookup
from tacgen.contact.law import ContactLaw, save_law
from tacgen.core.errors import PressError
from tacgen.core.files import atomic_path, refuse_other_page, sha256_of
from tacgen.core.safe_io import read_rgb
from tacgen.optics.table import load_table
from tacgen.presses.lab_table import LogFormat, read_log_table
from tacgen.presses.press_folder import WITH_FORCES, read_press_folder, read_presses
from tacgen.presses.press_forces import MeasuredLog, measure_presses, measure_recording
from tacgen.presses.press_log import PLAIN, PressLog, press_log_of
from tacgen.presses.screening import usable_presses
from tacgen.sensor.read_image import ImageReader, sensor_of
from tacgen.sensor.recordings import bag_files, open_recording

CONTACT_POINTS = {"auto": None, "free": True, "fixed": False}


@dataclass(frozen=True, slots=True)
class ContactCalibration:
    """What was fitted, the law that was written, and warnings."""

    fit: ContactFit
    law: ContactLaw
    warnings: tuple[str, ...]
    field: FieldFit | None = None


@dataclass(frozen=True, slots=True)
class LogSource:
    """A press log to read, with the options for reading it.

    ``path`` is a press log with volumes, depths or both, a folder of press images with forces, or a
    bag of ``sensor`` and a gauge, of whose ``topics`` two are named where there are more; of the
    last two, ``table`` turns pictures into volumes. ``radius_mm`` is that of the ball where the
    log does not say it, ``marker_pitch_mm`` of the dots whose motion it sums. ``markers`` are
    tracks of the dots of ``sensor``, a CSV file or such a folder.
    """

    path: Path
    log_format: LogFormat = PLAIN
    radius_mm: float | None = None
    table: Path | None = None
    marker_pitch_mm: float | None = None
    markers: Path | None = None
    sensor: str | None = None
    topics: Sequence[str] = ()
    background: Path | None = None

    def read(self, save_log: Path) -> PressLog:
        """The press log; pictures are measured into ``save_log``.

        Balls of unknown radius have no ``volume_mm3`` yet.
        """
        log, found = self.path, None
        if bag_files(log):
            found = self._measure_bag()
        elif log.is_dir():
            found = _measure_images(log, self.table)
        if found is not None:
            log = save_log
            with atomic_path(log) as partial:
                found.frame.to_csv(partial, index=False)
        read = press_log_of(read_log_table(log, self.log_format), radius_mm=self.radius_mm)
        if found is not None:
            read = replace(
                read,
                warnings=(*found.warnings, *read.warnings),
                volume_stderr_share=found.volume_stderr_share,
                marker_pitch_mm=found.marker_pitch_mm,
            )
        pitch_mm = self.marker_pitch_mm
        return read if pitch_mm is None else replace(read, marker_pitch_mm=pitch_mm)

    def _measure_bag(self) -> MeasuredLog:
        if self.sensor is None:
            msg = f"{self.path}: which sensor took its pictures? Name it with --sensor"
            raise PressError(msg)
        recording = open_recording(self.path, self.topics)
        at_rest = recording.background_rgb
        if self.background is not None:
            at_rest = read_rgb(self.background, PressError)
        return measure_recording(
            ImageReader(sensor_of(self.sensor, self.table), at_rest), recording
        )


def calibrate_contact(
    source: LogSource,
    out: Path,
    report: Path | None = None,
    *,
    by: str | None = None,
    contact_point: str = "auto",
) -> ContactCalibration:
    """Fit a press log, write the law to ``out`` and, where asked for, a page into ``report``.

    A log that is measured in images is kept beside the law. Marker tracks give k_s, friction and
    decay of the shear field.

    Raises ``PressError`` if the log cannot be used or an option is not known.
    """
    if contact_point not in CONTACT_POINTS:
        known = ", ".join(CONTACT_POINTS)
        msg = f"--contact-point {contact_point!r} is not known; use one of {known}"
        raise PressError(msg)
    if report is not None:
        refuse_other_page(Path(report) / "index.html", "calibrate contact")
    read = source.read(Path(out).with_suffix(".csv"))
    fit = fit_contact(read, by=by, free_contact_point=CONTACT_POINTS[contact_point])
    law, field, data = fit.law, None, None
    if source.markers is not None:
        gel, tracks = load_tracks(source.markers, source.sensor, fit.log)
        data = field_data(tracks, gel, law.k_n_mm3_per_n.value)
        field = fit_field(data, law.k_s_mm_per_n if fit.shear else None)
        fit = replace(fit, warnings=(*fit.warnings, *tracks.warnings))
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


def _measure_images(folder: Path, table: Path | None) -> MeasuredLog:
    """The press log that a folder of images with forces holds."""
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
            presses = usable_presses(read_presses(folder), least=RULES.min_presses_for_own_table)
            own = fit_lookup(presses) if len(presses) >= RULES.min_pictures_for_own_table else None
    found = measure_presses(images, lookup or own)
    if own is not None:
        warning = (
            f"{folder}: no --table given; volumes are computed with a table fitted to these images"
        )
        found = replace(found, warnings=(warning, *found.warnings))
    return found


def result_text(result: ContactCalibration, *, json_output: bool) -> str:
    """What the command prints."""
    record, field = summary_dict(result.fit), result.field
    if json_output:
        return json.dumps(record | ({"field": field.summary()} if field else {}), indent=2)
    return summary_text(record) + (f"\n{field.sentence()}" if field else "")

"""All that one session of presses says, its pictures and its forces, on one page."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from tacgen.calibrate.contact.command import LogSource
from tacgen.core.errors import PressError
from tacgen.core.files import refuse_other_page
from tacgen.diagnose.contact.command import diagnose_log
from tacgen.diagnose.contact.report import error_bars, residual_figure
from tacgen.diagnose.contact.result import diagnosis_record as contact_record
from tacgen.diagnose.optics.command import diagnose_presses
from tacgen.diagnose.optics.pictures import MEAN_GAIN, mean_residuals
from tacgen.diagnose.record import VERDICTS, diagnosis_record, write_record
from tacgen.report.formatting import unit_text
from tacgen.report.page import write_page

CHANNELS = {
    "rgb": "Pictures",
    "normal": "Volume and normal force",
    "shear": "Motion and shear force",
    "markers": "Motion of the dots",
}
PICTURES, LOG, MARKERS = "presses", "press_log.csv", "markers.csv"
"""What a session's folder may hold, by the names that ``tacgen rig`` gives them."""


@dataclass(frozen=True, slots=True)
class Session:
    """The parts of a session that can be diagnosed: pictures, a log or pictures with forces."""

    pictures: Path | None
    log: Path | None
    markers: Path | None

    @classmethod
    def of(cls, folder: Path) -> "Session":
        """What there is in a folder; raises ``PressError`` if there is nothing to diagnose."""
        pictures = next((one for one in (folder / PICTURES, folder) if _has_pictures(one)), None)
        log = folder / LOG if (folder / LOG).is_file() else None
        if log is None and pictures is not None and _has_forces(pictures):
            log = pictures
        if pictures is None and log is None:
            msg = (
                f"{folder}: no presses to diagnose; it needs press images with their presses.csv "
                f"(here or in {PICTURES}/), or {LOG}"
            )
            raise PressError(msg)
        return cls(pictures, log, folder / MARKERS if (folder / MARKERS).is_file() else None)


def _has_pictures(folder: Path) -> bool:
    return (folder / "presses.csv").is_file()


def _has_forces(pictures: Path) -> bool:
    return "force_normal_n" in pd.read_csv(pictures / "presses.csv", nrows=1).columns


def diagnose_session(
    folder: Path,
    out: Path,
    *,
    mm_per_px: float | None = None,
    ball_radius_mm: float | None = None,
    sensor: str | None = None,
) -> dict[str, Any]:
    """Diagnose what a session's folder holds; returns the content of ``diagnosis.json``.

    The whole of each part lies in ``out/optics`` and ``out/contact``, as the commands of these
    names leave it; ``out`` has one page and one record of all channels. Pictures with forces are
    measured with the table that their own diagnosis extended. Tracks of dots need the name of their
    ``sensor``.

    Raises ``PressError`` if there is nothing to diagnose, or a part cannot be used.
    """
    folder, out = Path(folder), Path(out)
    session, page = Session.of(folder), out / "report.html"
    refuse_other_page(page, "diagnose presses")
    channels: dict[str, Mapping[str, Any]] = {}
    notes: list[str] = []
    maps, residuals, pages = [], {}, []
    table = None
    if session.pictures is not None:
        optics, used = diagnose_presses(
            session.pictures,
            out / "optics",
            mm_per_px=mm_per_px,
            ball_radius_mm=ball_radius_mm,
        )
        channels |= optics.as_dict()["channels"]
        notes += [*used.warnings, *map(str, used.dropped)]
        maps.append(("the table, and the table with what was found", mean_residuals(optics)))
        pages.append("optics/report.html")
        table = out / "optics" / "table.npz"
    if session.markers is not None and sensor is None:
        notes.append(f"{session.markers} is left out: name the sensor of its dots with --sensor")
    if session.log is not None:
        source = LogSource(
            session.log,
            radius_mm=ball_radius_mm,
            table=table if session.log.is_dir() else None,
            markers=session.markers if sensor else None,
            sensor=sensor,
        )
        contact = diagnose_log(source, out / "contact")
        found = contact_record(contact)
        channels |= found["channels"]
        notes += found["notes"]
        for name, one in contact.channels.items():
            residuals[CHANNELS[name]] = residual_figure(found["channels"][name], one)
        pages.append("contact/report.html")
    record = diagnosis_record(channels, notes)
    verdicts = [channel["verdict"] for channel in channels.values()]
    write_page(
        page,
        f"Diagnosis of {folder.name}",
        summary=" ".join(f"{CHANNELS[name]}: {one['sentence']}" for name, one in channels.items()),
        verdict=next(one for one in VERDICTS if one in verdicts),
        template="session_diagnosis.html",
        made_by="diagnose presses",
        errors=error_bars({CHANNELS[name]: one for name, one in channels.items()}),
        maps=maps,
        map_gain=MEAN_GAIN,
        residuals=residuals,
        found=[row for name, one in channels.items() for row in _rows(CHANNELS[name], one)],
        measure_next=_measure_next(channels),
        pages=pages,
        notes=notes,
    )
    write_record(record, out)
    return record


def _rows(title: str, channel: Mapping[str, Any]) -> list[tuple[str, str, str, Any]]:
    """Channel, what it lacks or follows, fitted parameters and p, of everything that was found."""
    rows = []
    for effect in channel["effects"]:
        values = [
            f"{name} {one['value']:.3g} ± {one['stderr']:.1g} {unit_text(one['unit'])}"
            for name, one in effect["parameters"].items()
            if one["stderr"]
        ]
        rows.append((title, effect["name"], "; ".join(values), effect.get("p_value")))
    for one in channel["unexplained"]:
        rows.append((title, f"follows {one['covariate']}", "no listed effect", one["p_value"]))
    return rows


def _measure_next(channels: Mapping[str, Mapping[str, Any]]) -> Sequence[str]:
    """The measurements that would separate what these presses cannot."""
    lines = list(channels.get("rgb", {}).get("cannot_tell", ()))
    for channel in channels.values():
        for one in (*channel["effects"], *channel["unexplained"]):
            lines += [f"{line}." for line in one.get("separating_measurements", ())]
    return list(dict.fromkeys(lines))

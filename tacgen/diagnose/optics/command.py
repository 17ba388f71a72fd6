"""What ``tacgen diagnose optics`` does: read presses, diagnose, write table, JSON and page."""

from pathlib import Path

from tacgen.core.files import refuse_other_page
from tacgen.diagnose.optics.diagnose import OpticsDiagnosis, diagnose_optics
from tacgen.diagnose.optics.pictures import mean_residuals, press_pictures
from tacgen.diagnose.optics.report import write_optics_page
from tacgen.diagnose.record import write_record
from tacgen.optics.table import load_table, save_table
from tacgen.presses.press_folder import read_presses
from tacgen.presses.press_images import PressImages
from tacgen.presses.screening import usable_presses


def diagnose_presses(
    presses_path: Path,
    out: Path,
    *,
    table_path: Path | None = None,
    mm_per_px: float | None = None,
    ball_radius_mm: float | None = None,
) -> tuple[OpticsDiagnosis, PressImages]:
    """Diagnose the presses at a path; write diagnosis.json, table.npz and report.html."""
    refuse_other_page(Path(out) / "report.html", "diagnose optics")
    given = None if table_path is None else load_table(table_path)
    raw = read_presses(presses_path, mm_per_px=mm_per_px, ball_radius_mm=ball_radius_mm)
    # Beside a table from before a lens or a camera that changed is what is looked for.
    presses = usable_presses(raw, same_light=given is None)
    diagnosis = diagnose_optics(presses, given)
    record = diagnosis.as_dict()
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    write_record(record, out)
    save_table(diagnosis.table, out / "table.npz")
    write_optics_page(
        out / "report.html",
        record["channels"]["rgb"],
        press_pictures(presses, diagnosis),
        mean_residuals(diagnosis),
        applied=sorted(diagnosis.table.effects),
        excluded=[str(press) for press in presses.dropped],
    )
    return diagnosis, presses

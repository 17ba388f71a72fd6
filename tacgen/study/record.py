"""What a folder keeps of a study: which one it is, and the rows that are finished."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tacgen.core.errors import LearningError
from tacgen.core.files import sha256_of_content
from tacgen.learning.run_folder import read_json
from tacgen.study.study_recipe import Row, Study

RECORD = "table.json"
_MEND = "remove it; finished datasets and runs stay and are not done again"


def declaration_sha256(study: Study, row: Row, *, quick: bool) -> str:
    """A hash of what the study says of a row, before anything is calibrated."""
    return sha256_of_content(
        [
            row.name,
            study.data_recipe(row, quick=quick).sha256(),
            study.train_recipe(row, quick=quick).sha256(),
            row.calibrate_friction,
            row.calibrate_contact,
        ]
    )


def kept_rows(study: Study, out: Path, *, quick: bool) -> dict[str, dict[str, Any]]:
    """The rows in the table of ``out``, by name, of which the study still says the same.

    Raises
    ------
    LearningError
        If the table is of another study, or the folder has the other version of this one.
    """
    path = out / RECORD
    if not path.is_file():
        return {}
    table = read_json(path, _MEND)
    rows = table.get("rows")
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        msg = f"{path}: is not what was written; {_MEND}"
        raise LearningError(msg)
    _refuse_another(table, study, out, quick)
    declared = {declaration_sha256(study, row, quick=quick): row.name for row in study.rows}
    found = {str(row.get("declaration_sha256")): row for row in rows}
    return {declared[key]: row for key, row in found.items() if key in declared}


def _refuse_another(table: Mapping[str, Any], study: Study, out: Path, quick: bool) -> None:
    there = _called(table.get("study"), table.get("quick") is True)
    wanted = _called(study.name, quick)
    if there != wanted:
        msg = f"{out}: holds {there}, this is {wanted}; give another --out, or remove the folder"
        raise LearningError(msg)


def _called(name: object, quick: bool) -> str:
    return f"the study {name!r}, {'reduced (--quick)' if quick else 'whole'}"

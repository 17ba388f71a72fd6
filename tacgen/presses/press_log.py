"""Press logs: the samples of ball presses, read from CSV or Parquet and checked once.

Columns are those of the contract (``trial``, ``time_s``, ``force_normal_n``, ``volume_mm3`` and
the optional ones below); any other column is a covariate. What makes a whole file useless raises;
what makes one press doubtful leaves that press out and says so in ``PressLog.dropped``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tacgen.core.errors import PressError
from tacgen.core.files import sha256_of
from tacgen.core.units import STANDARD_GRAVITY_M_S2
from tacgen.presses.log_checks import DroppedTrial, check_trials, force_unit_problem

REQUIRED = ("trial", "time_s", "force_normal_n", "volume_mm3")
SHEAR_FORCES = ("force_shear_x_n", "force_shear_y_n")
SHEAR_MOTIONS = ("shear_x_mm", "shear_y_mm")
OPTIONAL_NUMBERS = ("radius_mm", "x_mm", "y_mm", *SHEAR_FORCES, *SHEAR_MOTIONS)
CONTRACT = (*REQUIRED, "indenter", *OPTIONAL_NUMBERS)
FORCE_UNITS_N = MappingProxyType(
    {"n": 1.0, "mn": 1e-3, "gf": STANDARD_GRAVITY_M_S2 * 1e-3, "kgf": STANDARD_GRAVITY_M_S2}
)
"""Newtons in one of each unit that a force gauge may show."""

MAX_LISTED = 5
"""Bad cells of one column that an error spells out."""

Columns = Mapping[str, NDArray[Any]]


@dataclass(frozen=True, slots=True)
class PressLog:
    """A checked press log: equally long, read-only columns, whole trials in one block each.

    Attributes
    ----------
    columns : mapping of str to (N,) array
        ``trial`` int64; numbers float64; text as str. The required columns are finite. The
        optional numbers of the contract and numeric covariates are NaN where the file is empty;
        the shear columns are NaN for all samples of a trial or for none.
    path : Path
        The file it was read from.
    rows : (N,) int64
        Row in the file of each sample, counted as a spreadsheet does: the header is row 1.
    dropped : tuple of DroppedTrial
        Presses that were left out, and why.
    warnings : tuple of str
        What the reader of any result should know about this log.
    session_clock : bool
        Whether ``time_s`` runs on from trial to trial, so that drift has a meaning.
    sha256 : str
        Of the file's bytes.
    """

    columns: Columns
    path: Path
    rows: NDArray[np.int64]
    dropped: tuple[DroppedTrial, ...] = ()
    warnings: tuple[str, ...] = ()
    session_clock: bool = True
    sha256: str = ""

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.columns[name]

    def __contains__(self, name: object) -> bool:
        return name in self.columns

    @property
    def trials(self) -> NDArray[np.int64]:
        """Trial numbers in the order in which they were pressed."""
        numbers, first = np.unique(self.columns["trial"], return_index=True)
        ordered: NDArray[np.int64] = numbers[np.argsort(first)]
        return ordered

    @property
    def has_shear(self) -> bool:
        """Whether a trial holds both shear force and shear motion."""
        names = (*SHEAR_FORCES, *SHEAR_MOTIONS)
        return all(name in self for name in names) and bool(self._shear_mask().any())

    @property
    def covariates(self) -> tuple[str, ...]:
        """Columns beyond the contract's, in the file's order."""
        return tuple(name for name in self.columns if name not in CONTRACT)

    def select(self, mask: NDArray[np.bool_]) -> PressLog:
        """The samples where ``mask`` (N,) holds; what is said about the file stays."""
        columns = {name: _frozen(values[mask]) for name, values in self.columns.items()}
        return replace(self, columns=MappingProxyType(columns), rows=_frozen(self.rows[mask]))

    def with_shear(self) -> PressLog:
        """The trials whose shear force and shear motion are known."""
        return self.select(self._shear_mask())

    def frame(self) -> pd.DataFrame:
        """The columns as a DataFrame, to write or to look at."""
        return pd.DataFrame(dict(self.columns))

    def _shear_mask(self) -> NDArray[np.bool_]:
        known = [np.isfinite(self.columns[name]) for name in (*SHEAR_FORCES, *SHEAR_MOTIONS)]
        return np.logical_and.reduce(known)


def read_press_log(path: Path, *, force_unit: str | None = None) -> PressLog:
    """Read and check a press log.

    Parameters
    ----------
    path : Path
        CSV, or Parquet by its suffix (``.parquet``, ``.pq``).
    force_unit : str, optional
        Unit of the force columns (a key of ``FORCE_UNITS_N``). By default newtons, and forces
        that cannot be newtons are an error; a unit that is given is believed.

    Raises
    ------
    PressError
        With every problem of the file at once: unreadable or empty, missing or doubled columns,
        cells that are not numbers, forces in another unit, no press left that can be trusted.
    """
    path = Path(path)
    frame = read_table(path)
    if force_unit is not None and force_unit not in FORCE_UNITS_N:
        msg = f"force unit {force_unit!r} is not known; use one of {', '.join(FORCE_UNITS_N)}"
        raise PressError(msg)
    problems = column_problems(frame, path, REQUIRED)
    if problems:
        raise PressError.from_problems(problems)
    numbers, problems = numeric_columns(frame, path, (*REQUIRED, *OPTIONAL_NUMBERS))
    problems += _trial_number_problems(numbers["trial"], path)
    if problems:
        raise PressError.from_problems(problems)
    for name in ("force_normal_n", *SHEAR_FORCES):
        if name in numbers and force_unit is not None:
            numbers[name] = numbers[name] * FORCE_UNITS_N[force_unit]
    columns = {
        name: numbers[name] if name in numbers else _covariate(frame[name])
        for name in frame.columns
    }
    columns["trial"] = columns["trial"].astype(np.int64)
    if force_unit is None and (problem := force_unit_problem(columns, path)):
        raise PressError(problem)
    return _checked(columns, path)


def read_table(path: Path) -> pd.DataFrame:
    """A CSV (as text) or Parquet file as a DataFrame with stripped column names.

    Raises
    ------
    PressError
        Where the file is missing, empty, not a table, or has two columns of one name.
    """
    path = Path(path)
    if not path.is_file():
        msg = f"{path}: no such file; give a press log as .csv or .parquet"
        raise PressError(msg)
    try:
        if path.suffix.lower() in (".parquet", ".pq"):
            frame = pd.read_parquet(path)
        else:
            frame = pd.read_csv(path, dtype=str, encoding="utf-8-sig", header=None,
                                keep_default_na=False, skip_blank_lines=False)  # fmt: skip
            frame = frame.iloc[1:].set_axis(frame.iloc[0].tolist(), axis=1).reset_index(drop=True)
    except (OSError, ValueError, LookupError, TypeError, pd.errors.EmptyDataError) as error:
        # pandas and pyarrow raise the latter for metadata that is not what they write themselves.
        msg = f"{path}: cannot be read as a table ({error}); save it as comma-separated UTF-8 text"
        raise PressError(msg) from error
    frame.columns = [str(name).strip() for name in frame.columns]
    doubled = sorted({name for name in frame.columns if list(frame.columns).count(name) > 1})
    if doubled:
        msg = f"{path}: columns appear twice: {', '.join(doubled)}; keep one of each"
        raise PressError(msg)
    if frame.empty:
        msg = f"{path}: holds no samples; a press log has one row a sample under its header"
        raise PressError(msg)
    return frame


def column_names(path: Path) -> list[str]:
    """The header of a table; empty where it cannot be read, which ``read_table`` then says."""
    try:
        if Path(path).suffix.lower() in (".parquet", ".pq"):
            return [str(name) for name in pd.read_parquet(path).columns]
        header = pd.read_csv(path, nrows=0, encoding="utf-8-sig")
        return [str(name).strip() for name in header.columns]
    except (OSError, ValueError):
        return []


def column_problems(frame: pd.DataFrame, path: Path, required: tuple[str, ...]) -> list[str]:
    """What is wrong with the header, a line each."""
    if frame.shape[1] == 1 and (
        separator := next((s for s in ";\t|" if s in frame.columns[0]), "")
    ):
        return [f"{path}: columns are separated by {separator!r}; save it with commas"]
    problems = []
    for name in required:
        if name not in frame.columns:
            others = [str(other) for other in frame.columns if other not in CONTRACT]
            near = get_close_matches(name, others, n=1, cutoff=0.55)
            hint = f"rename {near[0]!r} if it is that" if near else f"add it ({_MEANINGS[name]})"
            problems.append(f"{path}: column {name!r} is missing; {hint}")
    return problems


_MEANINGS = {
    "trial": "one integer a press",
    "time_s": "the session's clock in seconds",
    "force_normal_n": "normal force in newtons",
    "volume_mm3": "indented volume in mm³",
    "depth_mm": "indentation in mm",
    "curve": "a name a curve",
}


def numeric_columns(
    frame: pd.DataFrame, path: Path, names: tuple[str, ...]
) -> tuple[dict[str, NDArray[np.float64]], list[str]]:
    """Those of ``names`` that the table has, as float64; empty cells are NaN; and the problems."""
    numbers: dict[str, NDArray[np.float64]] = {}
    problems = []
    for name in names:
        if name not in frame.columns:
            continue
        text = _as_text(frame[name])
        values = pd.to_numeric(text, errors="coerce").to_numpy(dtype=np.float64)
        bad = np.isnan(values) & ~text.str.lower().isin(["", "nan", "na", "n/a", "none", "null"])
        for index in np.flatnonzero(bad)[:MAX_LISTED]:
            cell = text.iloc[index]
            mend = "use a decimal point" if "," in cell else "write a number or leave it empty"
            problems.append(f"{path}: row {index + 2}: {name} = {cell!r} is not a number; {mend}")
        if bad.sum() > MAX_LISTED:
            problems.append(f"{path}: … and {bad.sum() - MAX_LISTED} more such cells in {name}")
        numbers[name] = np.where(np.isfinite(values), values, np.nan)
    return numbers, problems


def _trial_number_problems(trial: NDArray[np.float64], path: Path) -> list[str]:
    wrong = np.flatnonzero(~(trial == np.round(trial)))
    return [
        f"{path}: row {index + 2}: trial is "
        f"{'empty' if np.isnan(trial[index]) else format(trial[index], 'g')}, not an integer; "
        "give each press a number"
        for index in wrong[:MAX_LISTED]
    ]


def _checked(columns: Columns, path: Path) -> PressLog:
    rows = np.arange(len(columns["trial"]), dtype=np.int64) + 2
    checked = check_trials(columns, rows, path)
    if not checked.keep.any():
        reasons = [str(trial) for trial in checked.dropped[:MAX_LISTED]]
        if len(checked.dropped) > MAX_LISTED:
            reasons.append(f"… and {len(checked.dropped) - MAX_LISTED} more")
        raise PressError.from_problems([f"{path}: no press is left that can be trusted", *reasons])
    frozen = {name: _frozen(values[checked.keep]) for name, values in columns.items()}
    return PressLog(
        columns=MappingProxyType(frozen),
        path=path,
        rows=_frozen(rows[checked.keep]),
        dropped=checked.dropped,
        warnings=checked.warnings,
        session_clock=checked.session_clock,
        sha256=sha256_of(path),
    )


def _covariate(series: pd.Series) -> NDArray[Any]:
    """Float64 where every filled cell is a number, text otherwise."""
    text = _as_text(series)
    filled = ~text.str.lower().isin(["", "nan", "na", "n/a", "none", "null"])
    values = pd.to_numeric(text, errors="coerce").to_numpy(dtype=np.float64)
    if filled.any() and np.isfinite(values[filled]).all() and series.name != "indenter":
        return values
    return text.where(filled, "").to_numpy(dtype=str)


def _as_text(series: pd.Series) -> pd.Series:
    if pd.api.types.is_bool_dtype(series):
        series = series.astype(int)
    return series.astype(object).where(series.notna(), "").astype(str).str.strip()


def _frozen(values: NDArray[Any]) -> NDArray[Any]:
    values = np.array(values)
    values.setflags(write=False)
    return values

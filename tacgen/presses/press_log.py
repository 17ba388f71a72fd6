"""Press logs: the samples of ball presses, read from CSV or Parquet and checked once.

Columns are ``trial``, ``time_s``, ``force_normal_n``, ``volume_mm3`` and the optional ones below;
any other column is a covariate. What makes a whole file useless raises;
what makes one press unusable drops that press, with the reason in ``PressLog.dropped``.
"""

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.core.arrays import BoolArray, FloatArray, IntArray
from tacgen.core.columns import DEPTH_CURVES, PRESS_LOG, PRESSES, csv_problem, similar_columns
from tacgen.core.errors import PressError, require_known
from tacgen.core.files import sha256_of
from tacgen.core.optional_dependencies import require_extra
from tacgen.core.records import frozen_array
from tacgen.core.units import STANDARD_GRAVITY_M_S2
from tacgen.presses.independent_rows import independent_rows

REQUIRED = ("trial", "time_s", "force_normal_n", "volume_mm3")
SHEAR_FORCES = ("force_shear_x_n", "force_shear_y_n")
SHEAR_MOTIONS = ("shear_x_mm", "shear_y_mm")
SHEAR = (*SHEAR_FORCES, *SHEAR_MOTIONS)
OPTIONAL_NUMBERS = ("radius_mm", "x_mm", "y_mm", *SHEAR)
CONTRACT = (*REQUIRED, "indenter", *OPTIONAL_NUMBERS)
FORCE_UNITS_N = MappingProxyType(
    {"n": 1.0, "mn": 1e-3, "gf": STANDARD_GRAVITY_M_S2 * 1e-3, "kgf": STANDARD_GRAVITY_M_S2}
)
"""Newtons in one of each unit that a force gauge may show."""

FIRST_ROW = 2  # of the samples, as a spreadsheet counts: the header is row 1
MAX_LISTED = 5  # bad cells of one column that an error spells out

MAX_EMPTY_SHARE = 0.5
"""Up to this share of a trial's samples may be empty before the whole trial is dropped: what is
measured beside them is as good as ever."""

MAX_WARNED = 5  # presses whose empty cells or gaps are spelled out

MAX_PLAUSIBLE_FORCE_N = 100.0
"""Above what a gripper presses on a gel with: the WSG-50 ends at 80 N."""

PLAUSIBLE_COMPLIANCE_MM3_PER_N = (0.15, 150.0)
"""Published gels are between 1 and 10 mm³/N; an order of magnitude more."""

OUTLIER_FACTOR = 25.0
"""A trial this many times softer or stiffer than the median one was logged in another unit."""

GAP_FACTOR = 25.0  # a step of the clock this many times the trial's median step is a gap

Columns = Mapping[str, NDArray[Any]]
Cells = Sequence[str]
"""A column of a table as text, a cell a row; empty where the file has none."""

EMPTY_CELLS = ("", "nan", "na", "n/a", "none", "null")  # in any case


@dataclass(frozen=True, slots=True)
class DroppedTrial:
    """A press that is not used: which, where, why, and the fix."""

    trial: int
    rows: tuple[int, int]
    reason: str
    fix: str
    path: str = ""

    def __str__(self) -> str:
        first, last = self.rows
        where = f"row {first}" if first == last else f"rows {first} to {last}"
        return f"{self.path}: {where}: trial {self.trial} is dropped: {self.reason}; {self.fix}"


@dataclass(frozen=True, slots=True)
class PressLog:
    """A checked press log: equally long, read-only columns, whole trials in one block each.

    ``trial`` is int64, other numbers float64, text str. The required columns are finite. Optional
    numbers and numeric covariates are NaN where the file is empty; the shear columns are NaN for
    all samples of a trial or for none.
    """

    columns: Columns
    path: Path
    rows: IntArray  # (N,), each sample's row in the file as a spreadsheet counts: the header is 1
    dropped: tuple[DroppedTrial, ...] = ()
    warnings: tuple[str, ...] = ()  # what the reader of any result should know about this log
    session_clock: bool = True  # whether time_s runs on from trial to trial: drift has a meaning
    sha256: str = ""  # of the file's bytes

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.columns[name]

    def __contains__(self, name: object) -> bool:
        return name in self.columns

    @property
    def trials(self) -> IntArray:
        """Trial numbers in the order in which they were pressed."""
        numbers, first = np.unique(self.columns["trial"], return_index=True)
        ordered: IntArray = numbers[np.argsort(first)]
        return ordered

    @property
    def has_shear(self) -> bool:
        """Whether a trial holds both shear force and shear motion."""
        return all(name in self for name in SHEAR) and bool(self._shear_mask().any())

    @property
    def covariates(self) -> tuple[str, ...]:
        """Columns beyond the contract's, in the file's order."""
        return tuple(name for name in self.columns if name not in CONTRACT)

    def select(self, mask: BoolArray) -> "PressLog":
        """The samples where ``mask`` (N,) holds; notes on the file stay."""
        rows = frozen_array(self.rows[mask], np.int64)
        return replace(self, columns=_frozen(self.columns, mask), rows=rows)

    def with_shear(self) -> "PressLog":
        """The trials whose shear force and shear motion are known."""
        return self.select(self._shear_mask())

    def _shear_mask(self) -> BoolArray:
        known = [np.isfinite(self.columns[name]) for name in SHEAR]
        return np.asarray(np.logical_and.reduce(known))


def read_press_log(path: Path, *, force_unit: str | None = None) -> PressLog:
    """Read and check a press log: CSV, or Parquet by its suffix (``.parquet``, ``.pq``).

    ``force_unit`` is that of the force columns (a key of ``FORCE_UNITS_N``). By default newtons,
    and forces that cannot be newtons are an error; a unit that is given is not checked.

    Raises ``PressError`` with every problem of the file at once: unreadable or empty, missing or
    doubled columns, cells that are not numbers, forces in another unit, no usable press.
    """
    path = Path(path)
    table = read_table(path)
    require_known("force unit", force_unit or "n", FORCE_UNITS_N, PressError)
    problems = column_problems(table, path, REQUIRED)
    PressError.raise_if(problems)
    numbers, problems = numeric_columns(table, path, (*REQUIRED, *OPTIONAL_NUMBERS))
    problems += trial_number_problems(numbers["trial"], path)
    PressError.raise_if(problems)
    for name in ("force_normal_n", *SHEAR_FORCES):
        if name in numbers and force_unit is not None:
            numbers[name] = numbers[name] * FORCE_UNITS_N[force_unit]
    columns = {
        name: numbers[name] if name in numbers else _covariate(name, cells)
        for name, cells in table.items()
    }
    columns["trial"] = columns["trial"].astype(np.int64)
    if force_unit is None and (problem := _force_unit_problem(columns, path)):
        raise PressError(problem)
    log = _checked(columns, path)
    similar = similar_columns(table, PRESS_LOG, str(path))
    independent, found = independent_rows(log.columns)
    notes = (f"{path}: {note}" for note in found)
    return replace(log.select(independent), warnings=(*similar, *log.warnings, *notes))


def read_table(path: Path) -> dict[str, Cells]:
    """The columns of a CSV or Parquet file as stripped text, by stripped name.

    Raises ``PressError`` where the file is missing, empty, not a table, or has two columns of one
    name.
    """
    path = Path(path)
    if not path.is_file():
        msg = f"{path}: no such file; give a press log as .csv or .parquet"
        raise PressError(msg)
    try:
        header, columns = _parquet(path) if _is_parquet(path) else _csv(path)
    except (OSError, ValueError, LookupError, TypeError, csv.Error) as error:
        # pandas and pyarrow raise the latter for metadata that is not what they write themselves.
        msg = f"{path}: cannot be read as a table: {csv_problem(error)}"
        raise PressError(msg) from error
    names = [name.strip() for name in header]
    doubled = sorted({name for name in names if names.count(name) > 1})
    if doubled:
        msg = f"{path}: columns appear twice: {', '.join(doubled)}; keep one of each"
        raise PressError(msg)
    if not columns or not columns[0]:
        msg = f"{path}: holds no samples; a press log has one row a sample under its header"
        raise PressError(msg)
    return dict(zip(names, columns, strict=True))


def _is_parquet(path: Path) -> bool:
    return path.suffix.lower() in (".parquet", ".pq")


def _csv(path: Path) -> tuple[list[str], list[Cells]]:
    """Header and columns; cells that a row lacks are empty."""
    text = path.read_text(encoding="utf-8").lstrip("\ufeff")  # the mark that spreadsheets write
    rows = csv.reader(io.StringIO(text, newline=""))
    header = next(rows, [])
    if not header:
        msg = "No columns to parse from file"
        raise ValueError(msg)
    filled, last = list[list[str]](), ""
    for row in rows:
        if len(row) > len(header):
            msg = f"Expected {len(header)} fields in line {rows.line_num}, saw {len(row)}"
            raise ValueError(msg)
        filled.append([cell.strip() for cell in row] + [""] * (len(header) - len(row)))
        last = row[-1] if row else ""
    if "\n" in last and not text.rstrip().endswith('"'):
        begin = ", ".join(filled[-1]).splitlines()[0][:40]
        msg = f"a quote that is not closed in the row that begins with {begin!r}"
        raise ValueError(msg)
    return header, list(zip(*filled, strict=True))


def _parquet(path: Path) -> tuple[list[str], list[Cells]]:
    import pandas as pd  # 60 MB and 0.3 s, which a log in CSV does without

    require_extra("parquet", f"{path}: reading Parquet needs", PressError)
    frame = pd.read_parquet(path)
    known = frame.notna()
    columns = list[Cells]()
    for k in range(frame.shape[1]):
        values = frame.iloc[:, k]
        if pd.api.types.is_bool_dtype(values):
            values = values.astype("Int64")
        texts = values.astype(object).where(known.iloc[:, k], "")
        columns.append([_text(value) for value in texts])
    return [str(name) for name in frame.columns], columns


def _text(value: object) -> str:
    return (value.decode() if isinstance(value, bytes) else str(value)).strip()


def column_names(path: Path) -> list[str]:
    """The header of a table; empty where it cannot be read, which ``read_table`` then reports."""
    path = Path(path)
    try:
        if _is_parquet(path):
            return list(read_table(path))
        with path.open(encoding="utf-8-sig", newline="") as file:
            return [name.strip() for name in next(csv.reader(file), [])]
    except (PressError, OSError, ValueError, csv.Error):
        return []


def column_problems(names: Iterable[str], path: Path, required: tuple[str, ...]) -> list[str]:
    """What is wrong with the header, a line each."""
    names = list(names)
    if len(names) == 1 and (separator := next((s for s in ";\t|" if s in names[0]), "")):
        return [f"{path}: columns are separated by {separator!r}; save it with commas"]
    problems = []
    for name in required:
        if name not in names:
            others = [other for other in names if other not in CONTRACT]
            near = get_close_matches(name, others, n=1, cutoff=0.55)
            meaning = {**PRESS_LOG, **PRESSES, **DEPTH_CURVES}[name]
            hint = f"rename {near[0]!r} if it is that" if near else f"add it ({meaning})"
            problems.append(f"{path}: column {name!r} is missing; {hint}")
    return problems


def numeric_columns(
    table: Mapping[str, Cells], path: Path, names: tuple[str, ...]
) -> tuple[dict[str, FloatArray], list[str]]:
    """Those of ``names`` that the table has, as float64; empty cells are NaN; and the problems."""
    numbers: dict[str, FloatArray] = {}
    problems = []
    for name in names:
        if name not in table:
            continue
        values, filled = _parsed(table[name])
        bad = np.isnan(values) & filled
        for index in np.flatnonzero(bad)[:MAX_LISTED]:
            cell = table[name][index]
            fix = "use a decimal point" if "," in cell else "write a number or leave it empty"
            problems.append(f"{path}: row {index + 2}: {name} = {cell!r} is not a number; {fix}")
        if bad.sum() > MAX_LISTED:
            problems.append(f"{path}: … and {bad.sum() - MAX_LISTED} more such cells in {name}")
        numbers[name] = np.where(np.isfinite(values), values, np.nan)
    return numbers, problems


def trial_number_problems(trial: FloatArray, path: Path) -> list[str]:
    """Trials that are empty or no integers, a line each."""
    wrong = np.flatnonzero(~(trial == np.round(trial)))
    return [
        f"{path}: row {index + 2}: trial is "
        f"{'empty' if np.isnan(trial[index]) else format(trial[index], 'g')}, not an integer; "
        "give each press a number"
        for index in wrong[:MAX_LISTED]
    ]


def _checked(columns: Columns, path: Path) -> PressLog:
    found = _Findings(columns, path, np.ones(len(columns["trial"]), dtype=bool))
    blocks = _trial_blocks(columns["trial"])
    for block in blocks:
        _check_cells(found, block)
        _check_clock(found, block)
    # One line for what is the same of very many presses, after the first few.
    more = len(found.warnings) - MAX_WARNED
    if more > 0:
        del found.warnings[MAX_WARNED:]
        found.warn(f"{more} more presses have empty cells or gaps in their clock likewise")
    _check_repeats(found, blocks)
    for block in blocks:
        _check_contact(found, block)
    _check_stray_units(found, blocks)
    session_clock = _check_session_clock(found, blocks)
    _check_covariates(found)
    dropped = tuple(sorted(found.dropped, key=lambda each: each.rows))
    if not found.keep.any():
        reasons = [str(trial) for trial in dropped[:MAX_LISTED]]
        if len(dropped) > MAX_LISTED:
            reasons.append(f"… and {len(dropped) - MAX_LISTED} more")
        raise PressError.from_problems([f"{path}: no usable press remains", *reasons])
    return PressLog(
        columns=_frozen(columns, found.keep),
        path=path,
        rows=frozen_array(np.flatnonzero(found.keep) + FIRST_ROW, np.int64),
        dropped=dropped,
        warnings=tuple(found.warnings),
        session_clock=session_clock,
        sha256=sha256_of(path),
    )


def _covariate(name: str, cells: Cells) -> NDArray[Any]:
    """Float64 where every filled cell is a number, text otherwise."""
    values, filled = _parsed(cells)
    if filled.any() and np.isfinite(values[filled]).all() and name != "indenter":
        return values
    return np.where(filled, np.asarray(cells, dtype=str), "")


def _parsed(cells: Cells) -> tuple[FloatArray, BoolArray]:
    """The cells as numbers (NaN where they are none), and whether they are filled."""
    filled = np.array([cell.lower() not in EMPTY_CELLS for cell in cells], dtype=bool)
    return np.array([_number(cell) for cell in cells], dtype=np.float64), filled


def _number(cell: str) -> float:
    try:
        # Python also reads 1_000 and the digits of other scripts.
        return float(cell) if cell.isascii() and "_" not in cell else float("nan")
    except ValueError:
        return float("nan")


def _frozen(columns: Columns, mask: BoolArray) -> Columns:
    frozen = {name: frozen_array(values[mask], values.dtype) for name, values in columns.items()}
    return MappingProxyType(frozen)


@dataclass(slots=True)
class _Findings:
    """What the checks have found so far; a block holds the indices of one trial's samples."""

    columns: Columns
    path: Path
    keep: BoolArray
    dropped: list[DroppedTrial] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def kept(self, block: IntArray) -> IntArray:
        return block[self.keep[block]]

    def trial(self, block: IntArray) -> int:
        return int(self.columns["trial"][block[0]])

    def drop(self, block: IntArray, reason: str, fix: str) -> None:
        if self.keep[block].any():
            self.keep[block] = False
            span = int(block[0]) + FIRST_ROW, int(block[-1]) + FIRST_ROW
            self.dropped.append(DroppedTrial(self.trial(block), span, reason, fix, str(self.path)))

    def warn(self, text: str) -> None:
        self.warnings.append(f"{self.path}: {text}")


def _trial_blocks(trial: IntArray) -> list[IntArray]:
    """Runs of consecutive samples of one trial."""
    return np.split(np.arange(len(trial)), np.flatnonzero(np.diff(trial)) + 1)


def _force_unit_problem(columns: Columns, path: Path) -> str:
    """The problem where the forces of the whole log cannot be newtons; empty where they can."""
    peak, compliance = _peaks_and_compliances(columns, _trial_blocks(columns["trial"]))
    if not np.isfinite(compliance).any():
        return ""
    typical_peak, typical = float(np.nanmedian(peak)), float(np.nanmedian(compliance))
    softest, stiffest = PLAUSIBLE_COMPLIANCE_MM3_PER_N[1], PLAUSIBLE_COMPLIANCE_MM3_PER_N[0]
    suspicious = typical_peak > MAX_PLAUSIBLE_FORCE_N or (typical_peak > 20 and typical < stiffest)
    unit, newtons, option = "grams", STANDARD_GRAVITY_M_S2 * 1e-3, "gf"
    if typical_peak * newtons > MAX_PLAUSIBLE_FORCE_N:
        unit, newtons, option = "millinewtons", 1e-3, "mn"
    if not suspicious or typical / newtons > softest:
        return ""
    row = int(np.nanargmax(columns["force_normal_n"])) + FIRST_ROW
    return (
        f"{path}: row {row}: force_normal_n reaches {np.nanmax(peak):.4g} (median over presses "
        f"{typical_peak:.4g}) at {typical:.2g} mm³ a unit of force: these look like {unit}, not "
        f"newtons; multiply the force columns by {newtons:.6g}, or give --force-unit {option} "
        "(--force-unit n if they are newtons)"
    )


def _peaks_and_compliances(
    columns: Columns, blocks: list[IntArray]
) -> tuple[FloatArray, FloatArray]:
    """Peak force of each block, and its volume per force there; NaN where nothing is known."""
    peak, compliance = np.full(len(blocks), np.nan), np.full(len(blocks), np.nan)
    for index, block in enumerate(blocks):
        force, volume = columns["force_normal_n"][block], columns["volume_mm3"][block]
        known = np.isfinite(force) & np.isfinite(volume)
        if known.any():
            loaded = known & (force >= 0.5 * force[known].max())
            peak[index] = force[known].max()
            if peak[index] > 0:
                compliance[index] = np.median(volume[loaded]) / np.median(force[loaded])
    return peak, compliance


def _check_cells(found: _Findings, block: IntArray) -> None:
    """Empty or infinite cells: a few drop their samples, many the trial."""
    names = (*REQUIRED, *(name for name in SHEAR if name in found.columns))
    finite = {name: np.isfinite(found.columns[name][block]) for name in names}
    finite = {name: known for name, known in finite.items() if name in REQUIRED or known.any()}
    bad = ~np.logical_and.reduce(list(finite.values()))
    if not bad.any():
        return
    guilty = ", ".join(name for name, known in finite.items() if not known.all())
    where = ", ".join(str(index + FIRST_ROW) for index in block[bad][:MAX_LISTED])
    what = f"{guilty} is empty, NaN or infinite in {bad.sum()} of {len(bad)} samples"
    if bad.mean() > MAX_EMPTY_SHARE:
        found.drop(block, f"{what} (row {where})", "fill the cells or delete the press")
        return
    found.keep[block] &= ~bad
    fix = "these samples are dropped, fill the cells or delete the rows"
    found.warn(f"row {where}: trial {found.trial(block)}: {what}; {fix}")


def _check_clock(found: _Findings, block: IntArray) -> None:
    kept = found.kept(block)
    steps = np.diff(found.columns["time_s"][kept])
    if (steps < 0).any():
        row, more = kept[1:][steps < 0][0] + FIRST_ROW, int((steps < 0).sum()) - 1
        reason = f"time_s goes backwards at row {row}" + (f" and {more} more" if more else "")
        fix = "sort the rows by trial and time, and give each press its own trial number"
        found.drop(block, reason, fix)
        return
    if not (steps > 0).any():
        return
    gaps = steps > GAP_FACTOR * np.median(steps[steps > 0])
    if gaps.any():
        found.warn(
            f"row {kept[1:][gaps][0] + FIRST_ROW}: trial {found.trial(block)}: the clock jumps by "
            f"{steps[gaps][0]:.3g} s ({gaps.sum()} such gaps): what depends on the load's history "
            "is not known across it"
        )


def _check_repeats(found: _Findings, blocks: list[IntArray]) -> None:
    """Copies of a press under any number, and numbers that stand for several presses."""
    seen: dict[bytes, IntArray] = {}
    first_row: dict[int, int] = {}
    for block in blocks:
        if not found.keep[block].any():
            continue
        trial, row = found.trial(block), int(block[0]) + FIRST_ROW
        force, volume = (found.columns[name][block] for name in REQUIRED[2:])
        original = seen.setdefault(force.tobytes() + volume.tobytes(), block)
        if original is not block and len(block) > 3:
            where = f"trial {found.trial(original)} (from row {original[0] + FIRST_ROW})"
            found.drop(block, f"it is a copy of {where}", "delete one of the two")
        elif first_row.setdefault(trial, row) != row:
            known = f"trial {trial} is already at row {first_row[trial]}"
            reason = f"{known}, so it is not known which press this one is"
            fix = "give each press its own trial number, in one block of rows"
            found.drop(block, reason, fix)


def _check_contact(found: _Findings, block: IntArray) -> None:
    kept = found.kept(block)
    if not len(kept):
        return
    force, volume = found.columns["force_normal_n"][kept], found.columns["volume_mm3"][kept]
    if len(kept) > 1 and np.ptp(force) == 0.0:
        found.drop(block, f"the force never changes ({force[0]:g} N)", "check the gauge")
    elif not (force > 0).any():
        found.drop(block, "the force is never positive", "zero the gauge, check its sign")
    elif not (volume != 0).any():
        found.drop(block, "the volume is always 0: no contact was seen", "check the images")


def _check_stray_units(found: _Findings, blocks: list[IntArray]) -> None:
    blocks = [block for block in blocks if found.keep[block].any()]
    if not blocks:
        return
    peak, compliance = _peaks_and_compliances(found.columns, blocks)
    typical_peak, typical = np.nanmedian(peak), np.nanmedian(compliance)
    if typical > PLAUSIBLE_COMPLIANCE_MM3_PER_N[1]:
        doubt = "is it in mm³ and N, or in px³ or kgf?"
        found.warn(f"volume per force is {typical:.3g} mm³/N, far above any gel's: {doubt}")
    if len(blocks) < 3 or not typical > 0:
        return
    for block, one_peak, one in zip(blocks, peak, compliance, strict=True):
        stiff = one < typical / OUTLIER_FACTOR and one_peak > typical_peak * OUTLIER_FACTOR
        soft = one > typical * OUTLIER_FACTOR and one_peak < typical_peak / OUTLIER_FACTOR
        if stiff or soft:
            reason = (
                f"its force peaks at {one_peak:.3g}, the others at {typical_peak:.3g} (median), "
                f"and volume per force is {one:.2g} against {typical:.2g} mm³/N: it looks like "
                "another unit (grams?)"
            )
            found.drop(block, reason, "write its force in newtons")


def _check_session_clock(found: _Findings, blocks: list[IntArray]) -> bool:
    times_s = [found.columns["time_s"][found.kept(block)] for block in blocks]
    times_s = [time_s for time_s in times_s if len(time_s)]
    runs = all(after[0] >= before[-1] for before, after in pairwise(times_s))
    if not runs:
        found.warn(
            "time_s does not run on from trial to trial (it starts again, or presses overlap): "
            "drift with session time is not known; record one clock for the whole session"
        )
    return runs


def _check_covariates(found: _Findings) -> None:
    """A warning for covariates with empty cells: tests of them use the other samples."""
    for name, values in found.columns.items():
        if name in ("radius_mm", *SHEAR) or not found.keep.any():
            continue
        kept = values[found.keep]
        empty = np.isnan(kept) if kept.dtype.kind == "f" else kept == ""
        if kept.dtype.kind in "fU" and empty.any():
            row = np.flatnonzero(found.keep)[np.argmax(empty)] + FIRST_ROW
            found.warn(f"row {row}: {name} is empty in {empty.sum()} of {len(kept)} samples")

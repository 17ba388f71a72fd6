"""Tables as laboratories write them: delimiter, decimal mark, headers with units, comment lines.

``read_table`` turns a file into cells of text under headers with their units; ``read_log_table``
finds the columns of a press log among them, in numbers of its own units.
"""

import contextlib
import csv
import io
import itertools
import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from pathlib import Path

import numpy as np
import pandas as pd

from tacgen.core.errors import PressError, require_extra, require_known
from tacgen.core.records import DEPTH_CURVES, PRESS_LOG, csv_problem
from tacgen.core.types import BoolArray, FloatArray, IntArray
from tacgen.presses.headers import (
    FORCE_UNITS_N,
    UNITS,
    Column,
    find_columns,
    split_header,
    unit_in,
    units_in,
)
from tacgen.presses.rules import LOG

EMPTY_CELLS = frozenset(
    (
        *("nan", "na", "n/a", "<na>", "none", "null", "-", "--", "---", "–", "—"),
        *("-nan", "nan(ind)", "-nan(ind)", "1.#qnan", "-1.#ind", "1.#ind"),
        *("#n/a", "#na", "#div/0!", "#value!", "#num!", "#ref!", "#name?", "#null!"),
    )
)
"""Texts of cells without a value, in any case."""
COMMENT_MARKS = ("#", "%", "//")
MARKS = "#%/ "  # what they are made of
DELIMITERS = (";", "\t", "|", ",")  # in the order in which they are believed: commas may be decimal

_SPACES = " '’\u00a0\u2009\u202f"  # between thousands
_SPACED = re.compile(rf"[+-]?\d{{1,3}}([{_SPACES}]\d{{3}})+([.,]\d*)?")
_NUMBERS = {
    mark: re.compile(
        rf"[+-]?(?=\{mark}?\d)([1-9]\d{{0,2}}(\{other}\d{{3}})+|\d*)(\{mark}\d*)?([eE][+-]?\d+)?"
    )
    for mark, other in ((".", ","), (",", "."))
}
"""Numbers by the mark of their decimals; the other one may part thousands."""
_WITH_UNIT = re.compile(r"([+-]?[\d.,]+(?:[eE][+-]?\d+)?)\s*([A-Za-zµμ³^]+3?)")
_STAMP = re.compile(r"[\d\s:.,/+TZ-]*\d:\d\d[\d\s:.,+Z-]*([AaPp][Mm])?")
_BROKEN_CELL = re.compile(r'(?m)(?:^|(?<=[;\t|,]))"[^"\n]*\n[^"]*"')  # of several lines
_NOTHING = "No columns to parse from file"
BLOCKS = ("blank lines", "pauses")
"""What may part presses that have no numbers: ``--column trial="blank lines"``."""
TEXTS = ("indenter", "curve")
"""Columns of a press log that are no numbers."""


@dataclass(frozen=True, slots=True)
class LogFormat:
    """What the user says of a log: headers by column, signs to turn, the unit of all forces.

    A header may end in a unit in brackets, which counts before the file's own.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    flip: tuple[str, ...] = ()
    force_unit: str | None = None

    @classmethod
    def of_options(
        cls, columns: Sequence[str], flip: Sequence[str], force_unit: str | None = None
    ) -> "LogFormat":
        """From ``NAME=HEADER`` texts, and names of columns or their first word (`force`)."""
        known = [*PRESS_LOG, *DEPTH_CURVES]
        pairs = [text.partition("=") for text in columns]
        for text, (name, mark, header) in zip(columns, pairs, strict=True):
            if not (mark and header.strip()):
                msg = f'--column {text}: write it as force_normal_n="HEADER" or ="HEADER [mN]"'
                raise PressError(msg)
            require_known("--column", name.strip(), known, PressError)
        short = {"force": "force_normal_n", "depth": "depth_mm", "volume": "volume_mm3"}
        turned = tuple(short.get(name, name) for name in flip)
        for name in turned:
            require_known("--flip", name, [*short, *known], PressError)
        named = {name.strip(): header.strip() for name, _, header in pairs}
        return cls(named, turned, force_unit)

    @property
    def arguments(self) -> list[str]:
        """The options again, for a command to follow."""
        columns = [f"{name}={header}" for name, header in self.columns.items()]
        words = [*(("--column", one) for one in columns), *(("--flip", one) for one in self.flip)]
        words += [("--force-unit", self.force_unit)] if self.force_unit else []
        return [word for pair in words for word in pair]


@dataclass(frozen=True, slots=True)
class Table:
    """Cells of a file as stripped text, empty where it has no value."""

    path: Path
    cells: pd.DataFrame  # its index counts the file's rows as a spreadsheet does
    blocks: IntArray  # (N,), which of the blocks of rows that blank lines or headers part
    delimiter: str = ","
    notes: tuple[str, ...] = ()

    def decimal_mark(self, names: Iterable[str]) -> str:
        """The mark of the decimals in some columns; empty where they contradict each other.

        Numbers that may have thousands parted (`1.234`) say nothing beside others. On their own
        they are such where other numbers of their column are whole and below a thousand.
        """
        clear, parted, unclear = set[str](), set[str](), set[str]()
        for name in names:
            column = self.cells[name].iloc[: LOG.probed_cells]
            cells = [cell for cell in column if "," in cell or "." in cell]
            fits = [
                {m for m, number in _NUMBERS.items() if number.fullmatch(cell)} for cell in cells
            ]
            clear = clear.union(*(marks for marks in fits if len(marks) == 1))
            either = {
                "," if "," in c else "." for c, m in zip(cells, fits, strict=True) if len(m) > 1
            }
            whole = sum(cell.isdecimal() and len(cell) < 4 and cell != "0" for cell in column)
            if whole > LOG.least_whole_share * len(column):
                parted |= {"." if mark == "," else "," for mark in either}
            unclear |= either - {self.delimiter}
        found = clear or parted or unclear
        return found.pop() if len(found) == 1 else "" if found else "."

    def with_numbers(
        self, names: Iterable[str], mark: str | None = None
    ) -> tuple[pd.DataFrame, list[str]]:
        """The cells with numbers in columns of ``names``, NaN where empty; and what is no number.

        Their decimals have ``mark``, by default the one that is found in them.
        """
        names = [name for name in names if name in self.cells]
        mark = self.decimal_mark(names) if mark is None else mark
        frame, problems = self.cells.copy(), list[str]()
        for name in names:
            cells, values = frame[name], parsed(frame[name], mark)
            bad = cells[np.isnan(values) & (cells != "")]
            for row, cell in bad.iloc[: LOG.max_listed].items():
                fix = "use a decimal point" if "," in cell else "write a number or leave it empty"
                problems.append(f"{self.path}: row {row}: {name} = {cell!r} is not a number; {fix}")
            if len(bad) > LOG.max_listed:
                more = f"… and {len(bad) - LOG.max_listed} more such cells in {name}"
                problems.append(f"{self.path}: {more}")
            frame[name] = np.where(np.isfinite(values), values, np.nan)
        return frame, problems


@dataclass(frozen=True, slots=True)
class LogTable:
    """A table whose columns have the names and units of a press log."""

    path: Path
    frame: pd.DataFrame  # every column, known ones by their names; numbers, or text of all cells
    columns: Mapping[str, Column]  # of a press log, as the file has them
    problems: tuple[str, ...]  # cells that are no numbers
    notes: tuple[str, ...]
    unclear: tuple[str, ...]  # columns that are not read, and why
    parted: Mapping[str, IntArray]  # numbers of presses (N,) by what parts them, of ``BLOCKS``

    def require(self, *names: str) -> None:
        """Raise one ``PressError`` with what was found, what is missing and what suffices.

        A name may be two joined by `` or ``, of which one suffices.
        """
        lines = missing_columns(self.frame, self.path, names, {**PRESS_LOG, **DEPTH_CURVES})
        if not lines:
            return
        first = next(name for name in names if not set(name.split(" or ")) & {*self.frame})
        found = [
            name if column.header == name else f"{name} (as {column.header!r})"
            for name, column in self.columns.items()
        ]
        others = [repr(name) for name in self.frame if name not in self.columns]
        lines += self.unclear
        lines += [
            f"{self.path}: {by} part its rows into {number[-1] + 1} blocks; if each is a press, "
            f'give --column trial="{by}"'
            for by, number in self.parted.items()
            if first == "trial"
        ]
        lines.append(
            f"{self.path}: found {', '.join(found) or 'no known column'}; not read: "
            f"{', '.join(others) or 'none'}; name one with --column "
            f'{first.split(" or ")[0]}="HEADER [UNIT]"'
        )
        raise PressError.from_problems(lines)


def missing_columns(
    columns: Iterable[str], path: Path, required: Iterable[str], meaning: Mapping[str, str]
) -> list[str]:
    """A line for each required column that is missing; of two joined by `` or `` one suffices."""
    columns, problems = list(columns), []
    for name in required:
        ways = name.split(" or ")
        if not set(ways) & set(columns):
            others = [one for one in columns if one not in meaning]
            near = get_close_matches(ways[0], others, n=1, cutoff=0.55)
            called = ways if len(ways) > 1 else ["it"]
            added = [f"{it} ({meaning[one]})" for it, one in zip(called, ways, strict=True)]
            problems.append(
                f"{path}: column {' or '.join(map(repr, ways))} is missing; add "
                f"{' or '.join(added)}" + (f", or rename {near[0]!r} if it is that" if near else "")
            )
    return problems


def read_log_table(path: Path, log_format: LogFormat) -> LogTable:
    """Read a log, CSV or Parquet, and find the columns of a press log in it.

    Raises ``PressError`` where it is no table, or an option names what is not there.
    """
    unit, by = log_format.force_unit, log_format.columns.get("trial", "")
    require_known("force unit", unit or "n", FORCE_UNITS_N, PressError)
    table = read_table(path)
    cells, clocks = _with_whole_stamps(_with_units_of_cells(table.cells))
    notes = [f"{whole!r} and {part!r} are one clock: added" for whole, part in clocks.items()]
    given = {name: one for name, one in log_format.columns.items() if one not in BLOCKS}
    if len(clocks) == 1 and "time_s" not in cells:
        given = {"time_s": next(iter(clocks)), **given}
    found, unclear = find_columns(list(cells), path, given)
    renamed = [
        f"{column.header!r} as {name}" + (f" (× {column.factor:g})" if column.factor != 1 else "")
        for name, column in found.items()
        if column.header != name
    ]
    notes += [f"read {', '.join(renamed)}"] if renamed else []
    names = {column.header: name for name, column in found.items()}
    cells = cells[[header for header in cells if header in names or header not in found]]
    cells, below = _without_summary(cells.rename(columns=names))
    if "trial" in cells:
        cells, labelled = _with_numbered_labels(cells)
        below += labelled
    table = replace(table, cells=cells, blocks=table.blocks[: len(cells)])
    numeric = [name for name in found if name not in TEXTS]
    mark = table.decimal_mark(numeric)
    notes += ["numbers have decimal commas"] if mark == "," else []
    clock = _clock_times(cells["time_s"]) if "time_s" in cells else None
    plain = [name for name in numeric if clock is None or name != "time_s"]
    frame, problems = table.with_numbers(plain, mark)
    if clock is not None:
        frame["time_s"] = clock
    for name in log_format.flip:
        if name not in numeric:
            msg = f"{path}: --flip {name}: there is no such column; it has {', '.join(cells)}"
            raise PressError(msg)
    for name in numeric:
        if unit is not None and name.endswith("_n"):
            found[name] = replace(found[name], factor=FORCE_UNITS_N[unit], is_given=True)
        frame[name] *= found[name].factor * (-1.0 if name in log_format.flip else 1.0)
    for name in frame.columns.difference([*numeric, *TEXTS]):
        values, filled = parsed(frame[name], mark), frame[name] != ""
        if filled.any() and np.isfinite(values[filled]).all():
            frame[name] = values
    parted = _parted(table.blocks, frame["time_s"].to_numpy() if "time_s" in frame else None)
    if by in BLOCKS:
        if by not in parted:
            msg = f'{path}: --column trial="{by}": no {by} part its rows; number the presses'
            raise PressError(msg)
        frame["trial"], found["trial"] = parted[by].astype(np.float64), Column(by)
        notes.append(f"{parted[by][-1] + 1} presses, parted by {by}")
    return LogTable(
        path=path,
        frame=frame,
        columns=found,
        problems=tuple(problems),
        notes=(*table.notes, *(f"{path}: {note}" for note in (*notes, *below))),
        unclear=tuple(unclear),
        parted=parted,
    )


def _parted(blocks: IntArray, time_s: FloatArray | None) -> dict[str, IntArray]:
    """Numbers of presses (N,) by what parts them: blank lines; gaps and restarts of the clock."""
    found = {"blank lines": blocks}
    if time_s is not None:
        steps = np.diff(time_s)
        breaks = (steps < 0) | clock_gaps(steps)
        found["pauses"] = np.concatenate([[0], np.cumsum(breaks)]).astype(np.int64)
    most = LOG.most_blocks_share * len(blocks)
    return {by: number for by, number in found.items() if 0 < number[-1] < most}


def clock_gaps(steps_s: FloatArray) -> BoolArray:
    """Which steps (N,) of a clock are far longer than usual, and than one beside them.

    Times that lie ever further apart, as in a hold that is sampled by its logarithm, have none.
    """
    if not (steps_s > 0).any():
        return np.zeros(len(steps_s), dtype=bool)
    beside = np.pad(steps_s, 1, constant_values=np.inf)
    usual = np.maximum(np.median(steps_s[steps_s > 0]), np.minimum(beside[:-2], beside[2:]))
    return np.asarray(steps_s > LOG.gap_factor * usual)


def _with_units_of_cells(cells: pd.DataFrame) -> pd.DataFrame:
    """Columns of which every cell ends in one unit (`1.2 N`), with it in the header instead."""
    for header in list(cells):
        filled = cells[header][cells[header] != ""]
        if filled.empty or not _WITH_UNIT.fullmatch(filled.iloc[0]) or split_header(header)[1]:
            continue
        parts = [_WITH_UNIT.fullmatch(cell) for cell in filled]
        units = {unit_in(match[2]) if match else "" for match in parts}
        unit = units.pop()
        if unit and not units and (with_unit := f"{header} [{unit}]") not in cells:
            numbers = pd.Series([match[1] for match in parts if match], filled.index, dtype=object)
            cells = cells.assign(**{header: numbers.reindex(cells.index, fill_value="")})
            cells = cells.rename(columns={header: with_unit})
    return cells


def _with_whole_stamps(cells: pd.DataFrame) -> tuple[pd.DataFrame, dict[str, str]]:
    """Columns with the parts of a second added to its whole seconds, and the headers of both.

    ROS writes a stamp as ``secs`` and ``nsecs``, ROS 2 as ``sec`` and ``nanosec``.
    """
    clocks: dict[str, str] = {}
    ends = [unit for unit, factor in UNITS["s"].items() if factor == 1.0]
    parts = [unit for unit, factor in UNITS["s"].items() if factor < 1.0]
    for whole, end, unit in itertools.product(list(cells), ends, parts):
        part = whole.removesuffix(end) + unit
        if not whole.endswith(end) or part not in cells or whole in clocks:
            continue
        seconds, rest = parsed(cells[whole]), UNITS["s"][unit] * parsed(cells[part])
        is_stamp = (seconds == np.round(seconds)) & (rest >= 0.0) & (rest < 1.0)
        filled = (cells[whole] != "").to_numpy()
        if filled.any() and is_stamp[filled].all():
            stamps = (seconds + rest).tolist()
            cells = cells.assign(**{whole: ["" if np.isnan(s) else repr(s) for s in stamps]})
            cells, clocks[whole] = cells.drop(columns=part), part
    return cells, clocks


def _without_summary(cells: pd.DataFrame) -> tuple[pd.DataFrame, list[str]]:
    """The rows that are samples; below them may be means, remarks, a torn last line.

    Those have a text where a press's number or time stands in the rows above.
    """
    counted = [cells[name].to_numpy() for name in ("trial", "time_s") if name in cells]
    counted = [column for column in counted if _is_number(column[0])]
    count = len(cells)
    while count and any(c[count - 1] and not _is_number(c[count - 1]) for c in counted):
        count -= 1
    if count == len(cells) or len(cells) - count > min(LOG.most_summary_rows, count):
        return cells, []
    below = cells.iloc[count:]
    text = next(filter(None, below.iloc[0]))
    rows = f"rows {below.index[0]} to {below.index[-1]}, below the samples, are not read"
    return cells.iloc[:count], [f"{rows} ({text!r} …)"]


def _with_numbered_labels(cells: pd.DataFrame) -> tuple[pd.DataFrame, list[str]]:
    """Names of presses (`A1`) as numbers in order of appearance, and notes on what was read so.

    A number that stands on the first row of its press alone is that of the rows below.
    """
    notes, trial = list[str](), cells["trial"].mask(cells["trial"] == "")
    if not trial.notna().any():
        return cells, notes
    once = trial.notna().iloc[0] and not trial.dropna().duplicated().any()
    if once and LOG.least_labelled * trial.count() <= len(trial):
        trial = trial.ffill()
        notes.append(
            "presses are numbered on their first row; the rows below are taken to be of it"
        )
    numbers, labels = pd.factorize(trial)
    counts = np.bincount(numbers[numbers >= 0])
    is_name = ~np.array([_is_number(label) for label in labels])
    if is_name.all() or (is_name.any() and counts[is_name].min() >= LOG.least_labelled):
        trial = pd.Series(numbers, trial.index).astype(str).mask(numbers < 0)
        first = ", ".join(labels[: LOG.max_listed])
        notes.append(f"presses {first} … are numbered from 0 as they appear")
    return cells.assign(trial=trial.fillna("")), notes


def _clock_times(cells: pd.Series) -> FloatArray | None:
    """Seconds since the first of dates and times (N,); None where the cells are no such."""
    filled = cells[cells != ""]
    if filled.empty or not all(map(_STAMP.fullmatch, filled)):
        return None
    texts = cells.str.replace(r"(?<=:\d\d),", ".", regex=True)
    by_day = bool(re.match(r"\d{1,2}\.", filled.iloc[0]))
    times = pd.to_datetime(texts, errors="coerce", format="mixed", dayfirst=by_day, utc=True)
    if times.isna().sum() > len(cells) - len(filled):
        return None
    return np.array((times - times.min()).dt.total_seconds(), dtype=np.float64)


def read_table(path: Path) -> Table:
    """A CSV or Parquet file (by its suffix: ``.parquet``, ``.pq``); delimiter and header are found.

    Comment lines, blank rows and columns without a name are not read; a row of units below the
    header is joined to it in brackets.

    Raises ``PressError`` where the file is missing, empty, not a table, or has two columns of one
    name.
    """
    path = Path(path)
    if not path.is_file():
        msg = f"{path}: no such file; give a press log as .csv or .parquet"
        raise PressError(msg)
    try:
        table = _parquet(path) if path.suffix.lower() in (".parquet", ".pq") else _csv(path)
    except (OSError, ValueError, LookupError, TypeError, csv.Error) as error:
        # pandas and pyarrow raise the latter for metadata that is not what they write themselves.
        msg = f"{path}: cannot be read as a table: {csv_problem(error)}"
        raise PressError(msg) from error
    cells = table.cells.loc[:, table.cells.columns != ""]
    if len(cells.columns) and all(map(_is_number, cells)):
        msg = f"{path}: its first row holds numbers; write the columns' names above it"
        raise PressError(msg)
    doubled = sorted({*cells.columns[cells.columns.duplicated()]})
    if doubled:
        msg = f"{path}: columns appear twice: {', '.join(doubled)}; keep one of each"
        raise PressError(msg)
    if cells.empty:
        msg = f"{path}: holds no samples; a press log has one row a sample under its header"
        raise PressError(msg)
    return replace(table, cells=cells)


def _csv(path: Path) -> Table:
    _refuse_large(path, path.stat().st_size, LOG.max_bytes, "bytes")
    text = _decoded(path.read_bytes()).replace("\r\n", "\n").replace("\r", "\n")
    _refuse_large(path, text.count("\n"), LOG.max_cells // 2, "rows")
    if '"' in text:
        text = _BROKEN_CELL.sub(lambda cell: cell[0].replace("\n", " "), text)
    lines = text.replace("\u2212", "-").split("\n")  # the sign that word processors write
    start, delimiter = _dialect(lines)
    header = lines[start].lstrip().lstrip(MARKS)
    width = len(_split(f"{header}{delimiter}end", delimiter)) - 1  # some may have no name
    _refuse_large(path, width * (len(lines) - start), LOG.max_cells, "cells")
    below = [
        "#" if _is_comment(line) else line.rstrip(f"{delimiter} ") for line in lines[start + 1 :]
    ]
    if delimiter == " ":
        header, *below = (" ".join(line.split()) for line in (header, *below))
    texts = pd.read_csv(
        io.StringIO("\n".join([*[""] * start, header, *below])),
        skiprows=start,
        sep=delimiter,
        header=None,
        names=range(width),
        index_col=False,
        dtype=object,
        na_filter=False,
        skip_blank_lines=False,
        skipinitialspace=True,
    ).to_numpy()
    stated = np.array([*map(_cell, texts.ravel())], dtype=object).reshape(texts.shape)
    cells = pd.DataFrame(stated, range(start + 1, start + 1 + len(stated)), dtype=object)
    return _samples(path, cells, delimiter)


def _samples(path: Path, cells: pd.DataFrame, delimiter: str) -> Table:
    """The rows that are samples, under headers with their units, of all from the header on."""
    cells = cells[~cells[0].str.startswith(COMMENT_MARKS)]
    names = cells.iloc[0]
    kinds = pd.Series("row", cells.index)
    kinds[(cells.to_numpy() == "").all(axis=1)] = "blank"
    kinds[(cells.to_numpy() == names.to_numpy()).all(axis=1)] = "header"
    units = [""] * len(names)
    for row in kinds.index[(kinds == "row") & (kinds.shift() != "row")]:
        if found := units_in([*cells.loc[row]]):
            kinds[row] = "units"
            units = units if any(units) else found
    filled = kinds[kinds != "blank"]
    for row in filled.index[(filled == "row") & (filled.shift(-1) == "header")]:
        title = [*filter(None, cells.loc[row])]
        if len(title) == 1 and not _is_number(title[0]):
            kinds[row] = "title"  # of the block that begins
    is_row, headers = kinds == "row", int((kinds == "header").sum())
    blocks = (is_row & ~is_row.shift(fill_value=False)).cumsum()[is_row] - 1
    columns = [
        f"{name} [{unit}]" if unit else name for name, unit in zip(names, units, strict=True)
    ]
    return Table(
        path,
        cells[is_row].set_axis(columns, axis=1),
        blocks.to_numpy(np.int64),
        delimiter,
        (f"{path}: the header stands {headers} times",) if headers > 1 else (),
    )


def _cell(text: str) -> str:
    """Empty where it states no value; what a spreadsheet writes as `="1.0"` is 1.0."""
    cell = text.strip()
    if cell[-1:].isdigit():  # as nearly all do, and none of the others
        return cell
    cell = cell[2:-1] if cell.startswith('="') else cell
    return "" if cell.lower() in EMPTY_CELLS else cell


def _refuse_large(path: Path, count: int, most: int, what: str) -> None:
    if count > most:
        every = -(-count // most) + 1
        msg = f"{path}: holds {count} {what}, more than {most}; keep every {every}th row of it"
        raise PressError(msg)


def _decoded(data: bytes) -> str:
    """UTF-8 or, with its mark, UTF-16, as spreadsheets write; else Western European letters."""
    if data.startswith(b"PK\x03\x04"):
        msg = "an Excel workbook"
        raise ValueError(msg)
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16")
    if data[1:200:2].count(0) > 90:  # UTF-16 without its mark
        return data.decode("utf-16-le")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        if b"\0" in data:
            raise
        return data.decode("cp1252")


def _dialect(lines: Sequence[str]) -> tuple[int, str]:
    """Index of the header's line and the delimiter: what parts it and most rows below it alike."""
    probed = [k for k, line in enumerate(lines) if line.strip() and not _is_comment(line)]
    probed = probed[: LOG.probed_rows]
    if not probed:
        raise ValueError(_NOTHING)
    for delimiter in (*DELIMITERS, " "):
        rows = {k: _split(lines[k], delimiter) for k in probed}
        later = [*rows.values()][len(rows) // 2 :]
        width, count = Counter(map(len, later)).most_common(1)[0]
        if width > 1 and 2 * count > len(later):
            return _header_line(lines, rows, width, delimiter), delimiter
    return probed[0], next((d for d in DELIMITERS if d in lines[probed[0]]), ",")


def _header_line(
    lines: Sequence[str], rows: Mapping[int, Sequence[str]], width: int, delimiter: str
) -> int:
    """The line that names the columns: the last with texts above the first row of numbers.

    In a preamble may stand as many cells. Without such a line it is a comment of as many cells, as
    numpy and ROS write it, else the first line of as many.
    """
    whole = [cells for cells in rows.values() if len(cells) == width]
    known = [[*map(_is_number, cells)] for cells in whole[len(whole) // 2 :]]
    numeric: list[int] = np.flatnonzero(np.mean(known, axis=0) > 0.5).tolist()

    def numbers(k: int) -> set[bool]:
        """Whether cells hold numbers in the columns that do below."""
        return {_is_number(rows[k][j]) for j in numeric if j < len(rows[k]) and _cell(rows[k][j])}

    wide = [k for k, cells in rows.items() if len(cells) >= max(width - 1, 2)]
    first = next((k for k in wide if numbers(k) == {True}), 0)
    named = [k for k in wide if k < first and True not in numbers(k) and not units_in(rows[k])]
    comments = [
        k
        for k in range(first)
        if _is_comment(lines[k])
        and len(_split(lines[k].lstrip().lstrip(MARKS), delimiter)) == width
    ]
    return [*wide[:1], *comments, *named][-1]


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith(COMMENT_MARKS)


def _split(line: str, delimiter: str) -> list[str]:
    """The cells of a line, without empty ones at its end."""
    by_csv = csv.reader([line], delimiter=delimiter, skipinitialspace=True)
    cells = line.split() if delimiter == " " else next(by_csv, [])
    while cells and not cells[-1].strip():
        cells = cells[:-1]
    return cells


def _parquet(path: Path) -> Table:
    require_extra("parquet", f"{path}: reading Parquet needs", PressError)
    from pyarrow.parquet import read_metadata

    about = read_metadata(path)
    _refuse_large(path, about.num_rows * max(about.num_columns, 1), LOG.max_cells, "cells")
    frame = pd.read_parquet(path).reset_index(drop=True)
    bools = [name for name in frame if pd.api.types.is_bool_dtype(frame[name])]
    frame = frame.astype(dict.fromkeys(bools, "Int64"))
    cells = frame.astype(object).where(frame.notna(), "").map(_text)
    cells.index, cells.columns = cells.index + 2, [str(name).strip() for name in cells]
    return Table(path, cells, np.zeros(len(cells), dtype=np.int64), delimiter="")


def _text(value: object) -> str:
    return _cell(value.decode() if isinstance(value, bytes) else str(value))


def trial_number_problems(trial: pd.Series, path: Path) -> list[str]:
    """Trials that are empty or no integers, a line each."""
    wrong = trial[~(trial == trial.round())]
    return [
        f"{path}: row {row}: trial is {'empty' if np.isnan(value) else f'{value:g}'}, not an "
        "integer; give each press a number"
        for row, value in wrong.iloc[: LOG.max_listed].items()
    ]


def parsed(cells: Iterable[str], mark: str = ".") -> FloatArray:
    """The cells as numbers (N,), whose decimals have this mark; NaN where they are none."""
    cells = list(cells)
    text = "".join(cells)
    if text.isascii() and "_" not in text and not (mark == "," and "." in text):
        with contextlib.suppress(ValueError):  # several times as fast
            return np.array([*map(float, cells)], dtype=np.float64)
    return np.array([_number(cell, mark) for cell in cells], dtype=np.float64)


def _number(cell: str, mark: str) -> float:
    if _SPACED.fullmatch(cell):
        cell = re.sub(f"[{_SPACES}]", "", cell)
    if mark and _NUMBERS[mark].fullmatch(cell):
        cell = cell.replace("." if mark == "," else ",", "").replace(mark, ".")
    try:
        # Python also reads 1_000 and the digits of other scripts.
        return float(cell) if cell.isascii() and "_" not in cell else float("nan")
    except ValueError:
        return float("nan")


def _is_number(cell: str) -> bool:
    return any(math.isfinite(_number(cell, mark)) for mark in _NUMBERS)

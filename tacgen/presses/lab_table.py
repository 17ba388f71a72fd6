"""Tables as laboratories write them: delimiter, decimal mark, headers with units, comment lines.

A column of a press log is found by its own name, by another name for the same quantity (`Fz [N]`,
`Depth (um)`, `Press #`), or by what ``LogFormat.columns`` says. Units in brackets are converted;
a unit that is not one of the quantity is not guessed.
"""

import csv
import io
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from types import MappingProxyType

import numpy as np

from tacgen.core.arrays import BoolArray, FloatArray, IntArray
from tacgen.core.columns import DEPTH_CURVES, PRESS_LOG, PRESSES, csv_problem
from tacgen.core.errors import PressError, require_known
from tacgen.core.optional_dependencies import require_extra
from tacgen.core.units import STANDARD_GRAVITY_M_S2

Cells = Sequence[str]
"""A column of a table as text, a cell a row; empty where the file has none."""

EMPTY_CELLS = ("", "nan", "na", "n/a", "none", "null")  # in any case
MAX_LISTED = 5  # bad cells of one column that an error spells out
COMMENT_MARKS = ("#", "%", "//")
MARKS = "#%/ "  # what they are made of
PROBED = 200  # rows that tell the delimiter
DELIMITERS = (";", "\t", "|", ",")  # in the order in which they are believed: commas may be decimal

FORCE_UNITS_N = MappingProxyType(
    {"n": 1.0, "mn": 1e-3, "gf": STANDARD_GRAVITY_M_S2 * 1e-3, "kgf": STANDARD_GRAVITY_M_S2}
)
"""Newtons in one of each unit that ``--force-unit`` knows."""

_FORCE = {"N": 1.0, "Newton": 1.0, "newton": 1.0, "mN": 1e-3, "uN": 1e-6, "kN": 1e3}
_FORCE |= dict.fromkeys(("g", "gf", "gram", "grams"), FORCE_UNITS_N["gf"])
_FORCE |= dict.fromkeys(("kg", "kgf", "kp"), FORCE_UNITS_N["kgf"])
_LENGTH = {"mm": 1.0, "m": 1e3, "cm": 10.0, "um": 1e-3, "micron": 1e-3, "microns": 1e-3, "nm": 1e-6}
_LENGTH |= {"in": 25.4, "inch": 25.4}
_TIME = dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 1.0)
_TIME |= {"ms": 1e-3, "msec": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}
_VOLUME = {"mm3": 1.0, "mm^3": 1.0, "ul": 1.0, "cm3": 1e3, "ml": 1e3, "m3": 1e9}
_UNITS = {"n": _FORCE, "mm": _LENGTH, "s": _TIME, "mm3": _VOLUME}
"""What one of each unit is in the unit that ends a column's name."""

_SYNONYMS: Mapping[str, tuple[str, ...]] = {
    "trial": ("trial", "press", "run", "test", "repetition", "versuch"),
    "time_s": ("time", "timestamp", "time stamp", "t", "elapsed", "elapsed time", "zeit", "clock"),
    "force_normal_n": (
        *("force", "normal force", "force normal", "fz", "force z", "z force", "fn", "F", "load"),
        *("normal load", "load cell", "contact force", "press force", "kraft", "normalkraft"),
    ),
    "volume_mm3": ("volume", "vol", "indented volume", "indentation volume", "displaced volume"),
    "depth_mm": (
        *("depth", "indentation", "indentation depth", "press depth", "penetration", "tiefe"),
        *("penetration depth", "displacement", "compression", "compressive displacement"),
        "eindringtiefe",
    ),
    "radius_mm": ("radius", "ball radius", "indenter radius", "tip radius", "probe radius"),
    "curve": ("curve",),
    "indenter": ("indenter",),
} | {
    name.format(axis): tuple(word.format(axis) for word in words)
    for axis in "xy"
    for name, words in {
        "force_shear_{}_n": ("f{}", "force {}", "{} force", "shear force {}", "force shear {}"),
        "shear_{}_mm": ("shear {}", "marker shear {}", "marker motion {}", "summed shear {}"),
        "{}_mm": ("{}", "contact {}", "position {}", "pos {}", "{} position", "stage {}"),
    }.items()
}
_WITHOUT_UNIT = ("trial", "indenter", "curve")
_UNIT_NOT_NEEDED = ("time_s", "force_normal_n", "volume_mm3", "depth_mm", *_WITHOUT_UNIT)
"""Other names of these are read without a unit too, as the unit of the column's own name; what the
values say of it is checked."""
_NUMBER_WORDS = ("no", "nr", "num", "number", "id", "index", "nummer")

_COMMA = re.compile(r"[+-]?(\d{1,3}(\.\d{3})+|\d*),\d+([eE][+-]?\d+)?")
_POINT = re.compile(r"[+-]?\d*\.\d+([eE][+-]?\d+)?")


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
    """Columns of a file as stripped text, by stripped header."""

    columns: dict[str, Cells]
    rows: IntArray  # (N,), each row's number in the file as a spreadsheet counts
    delimiter: str = ","


@dataclass(frozen=True, slots=True)
class LogTable:
    """A table whose columns have the names and units of a press log."""

    path: Path
    cells: dict[str, Cells]  # every column; known ones by their names
    numbers: dict[str, FloatArray]  # (N,) of the known ones; NaN where a cell is empty
    rows: IntArray
    headers: dict[str, str]  # of the known columns, in the file
    sure: frozenset[str]  # columns whose unit the user has given
    problems: tuple[str, ...]  # cells that are no numbers
    notes: tuple[str, ...]
    unclear: tuple[str, ...]  # columns that are not read, and why

    def require(self, *names: str) -> None:
        """Raise one ``PressError`` with what was found, what is missing and what suffices.

        A name may be two joined by `` or ``, of which one suffices.
        """
        missing = [name for name in names if not set(name.split(" or ")) & self.cells.keys()]
        if not missing:
            return
        found = [
            name if header == name else f"{name} (as {header!r})"
            for name, header in self.headers.items()
        ]
        others = [repr(name) for name in self.cells if name not in self.headers]
        meaning = {**PRESS_LOG, **DEPTH_CURVES}
        lines = [
            f"{self.path}: column {' or '.join(map(repr, name.split(' or ')))} is missing; add "
            f"{' or '.join(f'{one} ({meaning[one]})' for one in name.split(' or '))}"
            f"{_near(name, self.cells)}"
            for name in missing
        ]
        first = missing[0].split(" or ")[0]
        lines += self.unclear
        lines.append(
            f"{self.path}: found {', '.join(found) or 'no known column'}; not read: "
            f'{", ".join(others) or "none"}; name one with --column {first}="HEADER [UNIT]"'
        )
        raise PressError.from_problems(lines)


def _near(name: str, cells: Iterable[str]) -> str:
    others = [one for one in cells if one not in PRESS_LOG]
    near = get_close_matches(name.split(" or ")[0], others, n=1, cutoff=0.55)
    return f", or rename {near[0]!r} if it is that" if near else ""


def read_log_table(path: Path, log_format: LogFormat) -> LogTable:
    """Read a log, CSV or Parquet, and find the columns of a press log in it.

    Raises ``PressError`` where it is no table, or an option names what is not there.
    """
    require_known("force unit", log_format.force_unit or "n", FORCE_UNITS_N, PressError)
    table = read_table(path)
    headers, units, notes, unclear = _named(table.columns, path, log_format)
    names = {header: name for name, header in headers.items()}
    cells = {
        names.get(header, header): column
        for header, column in table.columns.items()
        if header in names or header not in headers
    }
    known = tuple(name for name in headers if name not in ("indenter", "curve"))
    if _has_decimal_commas(table.delimiter, [cells[name] for name in known]):
        cells = {name: [_with_point(cell) for cell in column] for name, column in cells.items()}
        notes.append(f"{path}: numbers have decimal commas")
    cells, labels = _labels_as_numbers(cells)
    clock = _clock_times(cells["time_s"]) if "time_s" in cells else None
    if clock is not None:
        cells["time_s"] = [repr(float(time_s)) for time_s in clock]
    numbers, problems = numeric_columns(cells, path, known, table.rows)
    for name in known:
        factor = units.get(name, 1.0)
        if log_format.force_unit is not None and name.endswith("_n"):
            factor = FORCE_UNITS_N[log_format.force_unit]
        numbers[name] = numbers[name] * (-factor if name in log_format.flip else factor)
    for name in log_format.flip:
        if name not in numbers:
            msg = f"{path}: --flip {name}: there is no such column; it has {', '.join(cells)}"
            raise PressError(msg)
    sure = {name for name in log_format.columns if split_header(log_format.columns[name])[1]}
    if log_format.force_unit is not None:
        sure |= {name for name in known if name.endswith("_n")}
    return LogTable(
        path=path,
        cells=cells,
        numbers=numbers,
        rows=table.rows,
        headers=headers,
        sure=frozenset(sure),
        problems=tuple(problems),
        notes=(*notes, *([f"{path}: {labels}"] if labels else [])),
        unclear=tuple(unclear),
    )


def _named(
    columns: Mapping[str, Cells], path: Path, log_format: LogFormat
) -> tuple[dict[str, str], dict[str, float], list[str], list[str]]:
    """Headers by name, factors to its unit, notes, and what is not read although it looks so."""
    headers: dict[str, str] = {}
    factors: dict[str, float] = {}
    unclear: list[str] = []
    for name, wanted in log_format.columns.items():
        headers[name], unit = _chosen(columns, path, name, wanted)
        if unit:
            factors[name] = _factor(name, unit, f"{path}: --column {name}={wanted!r}")
    taken = set(headers.values())
    for name in _SYNONYMS:
        if name in headers:
            continue
        if name in columns and name not in taken:
            headers[name] = name
            continue
        found = {h: unit for h in columns if h not in taken and (unit := _unit_of(h, name))}
        wrong = [h for h, unit in found.items() if unit not in ("-", *_units(name))]
        unclear += [
            f"{path}: column {h!r} is not read as {name}: {found[h]!r} is none of "
            f'{", ".join(_units(name))}; give --column {name}="HEADER [UNIT]"'
            for h in wrong
        ]
        right = {h: unit for h, unit in found.items() if h not in wrong}
        stated = {h: unit for h, unit in right.items() if unit != "-"}
        if len(right) > 1 and len(stated) != 1:
            unclear.append(
                f"{path}: {' and '.join(map(repr, right))} may both be {name}; say which: "
                f'--column {name}="HEADER"'
            )
        elif chosen := (stated if len(right) > 1 else right):
            ((headers[name], unit),) = chosen.items()
            factors[name] = _units(name).get(unit, 1.0)
            taken.add(headers[name])
    renamed = [
        f"{header!r} as {name}{'' if factors.get(name, 1.0) == 1.0 else f' (× {factors[name]:g})'}"
        for name, header in headers.items()
        if header != name
    ]
    notes = [f"{path}: read {', '.join(renamed)}"] if renamed else []
    return headers, factors, notes, unclear


def _units(name: str) -> Mapping[str, float]:
    return {} if name in _WITHOUT_UNIT else _UNITS[name.rpartition("_")[2]]


def _factor(name: str, unit: str, where: str) -> float:
    if unit not in _units(name):
        known = ", ".join(_units(name)) or "none"
        msg = f"{where}: {unit!r} is not a unit of it that is known; give one of {known}"
        raise PressError(msg)
    return _units(name)[unit]


def _chosen(
    columns: Mapping[str, Cells], path: Path, name: str, wanted: str
) -> tuple[str, str | None]:
    """The header that ``--column`` means, and its unit: the one given, else the header's own."""
    word, unit = split_header(wanted)
    same = [h for h in columns if h == wanted] or [h for h in columns if split_header(h)[0] == word]
    if len(same) != 1:
        what = "several columns" if same else "no column"
        msg = f"{path}: --column {name}: {what} {wanted!r}; it has {', '.join(map(repr, columns))}"
        raise PressError(msg)
    unit = unit or split_header(same[0])[1]
    return same[0], None if name in _WITHOUT_UNIT else unit


def split_header(header: str) -> tuple[str, str | None]:
    """A header's text and the unit in brackets at its end, in plain letters; None without one."""
    match = re.fullmatch(r"(.*\S)\s*[\[({<]([^\[\](){}<>]*)[\])}>]", header.strip())
    if match is None:
        return header.strip(), None
    return match[1], _plain_unit(match[2]) or None


def _plain_unit(text: str) -> str:
    unit = text.strip().replace("µ", "u").replace("μ", "u").replace("³", "3")
    return "" if unit in ("-", "#", "1") else unit


def _unit_of(header: str, name: str) -> str:
    """The unit in which ``header`` states the quantity ``name``; `-` for none, empty for another.

    The unit may stand in brackets or be the last word: `Fz [N]`, `depth_um`, `t/s`.
    """
    text, unit = split_header(header)
    words = re.sub(r"(?<=[a-z]{2})(?=[A-Z])|[^A-Za-z0-9µμ³^]+", " ", text).split()
    if unit is None and len(words) > 1 and _plain_unit(words[-1]) in _units(name):
        unit = _plain_unit(words[-1])
        words = words[: -2 if words[-2] == "in" and len(words) > 2 else -1]
    spoken = [word.lower() if len(words) > 1 or len(word) > 1 else word for word in words]
    if name == "trial":
        while len(spoken) > 1 and spoken[-1] in _NUMBER_WORDS:
            del spoken[-1]
    if " ".join(spoken) not in _SYNONYMS[name] or (name in _WITHOUT_UNIT and unit):
        return ""
    return unit or ("-" if name in _UNIT_NOT_NEEDED else "")


def _has_decimal_commas(delimiter: str, columns: Iterable[Cells]) -> bool:
    """Whether numbers have decimal commas; not where some have points, or commas part the cells."""
    if delimiter == ",":
        return False
    cells = [cell for column in columns for cell in column]
    return any(map(_COMMA.fullmatch, cells)) and not any(map(_POINT.fullmatch, cells))


def _with_point(cell: str) -> str:
    return cell.replace(".", "").replace(",", ".") if _COMMA.fullmatch(cell) else cell


def _labels_as_numbers(cells: dict[str, Cells]) -> tuple[dict[str, Cells], str]:
    """Names of presses (`A1`) as numbers in order of appearance; a note where there were any."""
    trial = cells.get("trial", ())
    filled = [cell for cell in trial if cell.lower() not in EMPTY_CELLS]
    if not filled or any(np.isfinite(_number(cell)) for cell in filled):
        return cells, ""
    number = {label: str(k) for k, label in enumerate(dict.fromkeys(filled))}
    first = ", ".join(list(number)[:MAX_LISTED])
    numbered = [number.get(cell, "") for cell in trial]
    return {**cells, "trial": numbered}, f"presses {first} … are numbered from 0 as they appear"


def _clock_times(cells: Cells) -> FloatArray | None:
    """Seconds since the first of dates and times (N,); None where the cells are no such."""
    filled = [cell for cell in cells if cell.lower() not in EMPTY_CELLS]
    if not filled or not all(
        re.fullmatch(r"[\d\s:.,/+TZ-]*\d:\d\d[\d\s:.,+Z-]*", c) for c in filled
    ):
        return None
    import pandas as pd  # 60 MB and 0.3 s, which numbers do without

    texts = pd.Series([re.sub(r"(?<=:\d\d),", ".", cell) for cell in cells])
    by_day = bool(re.match(r"\d{1,2}\.", filled[0]))
    times = pd.to_datetime(texts, errors="coerce", format="mixed", dayfirst=by_day, utc=True)
    if times.isna().sum() > len(cells) - len(filled):
        return None
    seconds = (times - times.min()).dt.total_seconds()
    return np.asarray(seconds.to_numpy(np.float64))


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
        header, columns, rows, delimiter = _parquet(path) if _is_parquet(path) else _csv(path)
    except (OSError, ValueError, LookupError, TypeError, csv.Error) as error:
        # pandas and pyarrow raise the latter for metadata that is not what they write themselves.
        msg = f"{path}: cannot be read as a table: {csv_problem(error)}"
        raise PressError(msg) from error
    named = [(name.strip(), column) for name, column in zip(header, columns, strict=True)]
    named = [(name, column) for name, column in named if name]
    doubled = sorted(
        name for name, count in Counter(name for name, _ in named).items() if count > 1
    )
    if doubled:
        msg = f"{path}: columns appear twice: {', '.join(doubled)}; keep one of each"
        raise PressError(msg)
    if not named or not len(rows):
        msg = f"{path}: holds no samples; a press log has one row a sample under its header"
        raise PressError(msg)
    return Table(dict(named), rows, delimiter)


_Parts = tuple[list[str], list[Cells], IntArray, str]


def _is_parquet(path: Path) -> bool:
    return path.suffix.lower() in (".parquet", ".pq")


def _csv(path: Path) -> _Parts:
    """Header, columns, each row's number, delimiter; cells that a row lacks are empty."""
    text = _decoded(path.read_bytes()).replace("\r\n", "\n").replace("\r", "\n")
    lines = text.split("\n")
    start, delimiter = _header_line(lines)
    lines[start] = lines[start].lstrip().lstrip(MARKS)
    if delimiter == " ":
        lines = [" ".join(line.split()) for line in lines]
    body = io.StringIO("\n".join(lines[start:]), newline="")
    rows = csv.reader(body, delimiter=delimiter)
    header = next(rows, [])
    if not header:
        msg = "No columns to parse from file"
        raise ValueError(msg)
    filled, numbers, last = list[list[str]](), list[int](), ""
    for number, row in enumerate(rows, start=start + 2):
        if row and row[0].lstrip().startswith(COMMENT_MARKS):
            continue
        while len(row) > len(header) and not row[-1].strip():
            row = row[:-1]  # a delimiter at the row's end
        if len(row) > len(header):
            msg = f"Expected {len(header)} fields in line {number}, saw {len(row)}"
            raise ValueError(msg)
        last = row[-1] if row else ""
        cells = [cell.strip() for cell in row] + [""] * (len(header) - len(row))
        if any(cells):
            filled.append(cells)
            numbers.append(number)
    if "\n" in last and not text.rstrip().endswith('"'):
        begin = ", ".join(filled[-1]).splitlines()[0][:40]
        msg = f"a quote that is not closed in the row that begins with {begin!r}"
        raise ValueError(msg)
    if filled and (units := _unit_row(filled[0])):
        header = [
            f"{name} [{unit}]" if unit else name for name, unit in zip(header, units, strict=True)
        ]
        del filled[0], numbers[0]
    columns = [list(column) for column in zip(*filled, strict=True)] or [[] for _ in header]
    return header, list(columns), np.array(numbers, dtype=np.int64), delimiter


def _decoded(data: bytes) -> str:
    """UTF-8 or, with its mark, UTF-16, as spreadsheets write; else Western European letters."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        if b"\0" in data:
            raise
        return data.decode("cp1252")


def _header_line(lines: Sequence[str]) -> tuple[int, str]:
    """Index of the header's line and the delimiter: what parts it and most rows below it alike.

    The header is the first line, beyond comments and a preamble, whose cells are as many as those
    of the rows; a comment where the rows begin at once, as numpy writes it.
    """
    open_lines = [k for k, line in enumerate(lines) if line.strip() and not _is_comment(line)]
    if not open_lines:
        msg = "No columns to parse from file"
        raise ValueError(msg)
    fallback = open_lines[0], next((d for d in DELIMITERS if d in lines[open_lines[0]]), ",")
    for delimiter in (*DELIMITERS, " "):
        counts = [_count(lines[k], delimiter) for k in open_lines[:PROBED]]
        later = counts[len(counts) // 2 :]
        typical, share = Counter(later).most_common(1)[0]
        if typical < 2 or 2 * share <= len(later):
            continue
        first = next(
            k for k, count in zip(open_lines, counts, strict=False) if 1 < count >= typical - 1
        )
        cells = [_with_point(cell.strip()) for cell in _cells(lines[first], delimiter)]
        if not all(np.isfinite(_number(cell)) for cell in cells if cell):
            return first, delimiter
        above = [k for k in range(first) if _is_comment(lines[k])]
        fits = [k for k in above if _count(lines[k].strip().lstrip(MARKS), delimiter) == typical]
        if fits:
            return fits[-1], delimiter
    return fallback


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith(COMMENT_MARKS)


def _cells(line: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        return line.split()
    return next(csv.reader([line], delimiter=delimiter), [])


def _count(line: str, delimiter: str) -> int:
    cells = _cells(line, delimiter)
    while cells and not cells[-1].strip():
        cells = cells[:-1]
    return len(cells)


def _unit_row(cells: Sequence[str]) -> list[str]:
    """The units in a row below the header; empty where it is no such row."""
    units = [_plain_unit(cell.strip("[](){} ")) for cell in cells]
    known = {unit for dimension in _UNITS.values() for unit in dimension}
    if sum(unit in known for unit in units) * 2 < sum(map(bool, units)) or not any(units):
        return []
    return [] if any(np.isfinite(_number(cell)) for cell in cells) else units


def _parquet(path: Path) -> _Parts:
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
    header = [str(name) for name in frame.columns]
    return header, columns, np.arange(len(frame), dtype=np.int64) + 2, ""


def _text(value: object) -> str:
    return (value.decode() if isinstance(value, bytes) else str(value)).strip()


def column_problems(names: Iterable[str], path: Path, required: tuple[str, ...]) -> list[str]:
    """Required columns that a list of presses lacks, a line each."""
    names = list(names)
    problems = []
    for name in required:
        if name not in names:
            near = get_close_matches(name, [n for n in names if n not in PRESSES], 1, cutoff=0.55)
            hint = f"rename {near[0]!r} if it is that" if near else f"add it ({PRESSES[name]})"
            problems.append(f"{path}: column {name!r} is missing; {hint}")
    return problems


def numeric_columns(
    table: Mapping[str, Cells], path: Path, names: tuple[str, ...], rows: IntArray
) -> tuple[dict[str, FloatArray], list[str]]:
    """Those of ``names`` that the table has, as float64; empty cells are NaN; and the problems.

    ``rows`` (N,) are the rows' numbers in the file.
    """
    numbers: dict[str, FloatArray] = {}
    problems = []
    for name in names:
        if name not in table:
            continue
        values, filled = parsed(table[name])
        bad = np.isnan(values) & filled
        for index in np.flatnonzero(bad)[:MAX_LISTED]:
            cell = table[name][index]
            fix = "use a decimal point" if "," in cell else "write a number or leave it empty"
            problems.append(f"{path}: row {rows[index]}: {name} = {cell!r} is not a number; {fix}")
        if bad.sum() > MAX_LISTED:
            problems.append(f"{path}: … and {bad.sum() - MAX_LISTED} more such cells in {name}")
        numbers[name] = np.where(np.isfinite(values), values, np.nan)
    return numbers, problems


def trial_number_problems(trial: FloatArray, path: Path, rows: IntArray) -> list[str]:
    """Trials that are empty or no integers, a line each."""
    wrong = np.flatnonzero(~(trial == np.round(trial)))
    return [
        f"{path}: row {rows[index]}: trial is "
        f"{'empty' if np.isnan(trial[index]) else format(trial[index], 'g')}, not an integer; "
        "give each press a number"
        for index in wrong[:MAX_LISTED]
    ]


def parsed(cells: Cells) -> tuple[FloatArray, BoolArray]:
    """The cells as numbers (NaN where they are none), and whether they are filled."""
    filled = np.array([cell.lower() not in EMPTY_CELLS for cell in cells], dtype=bool)
    return np.array([_number(cell) for cell in cells], dtype=np.float64), filled


def _number(cell: str) -> float:
    try:
        # Python also reads 1_000 and the digits of other scripts.
        return float(cell) if cell.isascii() and "_" not in cell else float("nan")
    except ValueError:
        return float("nan")

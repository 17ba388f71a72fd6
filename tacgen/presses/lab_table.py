"""Tables as laboratories write them: delimiter, decimal mark, headers with units, comment lines.

A column of a press log is found by its own name, by another name for the same quantity (`Fz [N]`,
`Depth (um)`, `Press #`), or by what ``LogFormat.columns`` says. Units in brackets are converted;
a unit that is not one of the quantity is not guessed.
"""

import csv
import itertools
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from types import MappingProxyType

import numpy as np

from tacgen.core.errors import PressError, require_extra, require_known
from tacgen.core.records import DEPTH_CURVES, PRESS_LOG, PRESSES, csv_problem
from tacgen.core.types import STANDARD_GRAVITY_M_S2, BoolArray, FloatArray, IntArray

Cells = Sequence[str]
"""A column of a table as text, a cell a row; empty where the file has none."""

EMPTY_CELLS = frozenset(
    (
        *("", "nan", "na", "n/a", "<na>", "none", "null", "-", "--", "---", "–", "—"),
        *(
            "#n/a",
            "#na",
            "#div/0!",
            "#value!",
            "#num!",
            "#ref!",
            "#name?",
            "#null!",
        ),  # spreadsheets
    )
)
"""Cells without a value, in any case."""
MAX_LISTED = 5  # bad cells of one column that an error spells out
COMMENT_MARKS = ("#", "%", "//")
MARKS = "#%/ "  # what they are made of
MAX_BYTES, MAX_CELLS = 256 << 20, 6_000_000  # of a table; a cell takes 140 bytes as it is read
PROBED = 200  # rows that tell the delimiter
PROBED_CELLS = 2000  # of a column, that tell the marks in its numbers
LEAST_LABELLED = 4  # rows of a press that has a name: fewer are a slip of the pen
MOST_SUMMARY_ROWS = 20  # below the samples
DELIMITERS = (";", "\t", "|", ",")  # in the order in which they are believed: commas may be decimal

FORCE_UNITS_N = MappingProxyType(
    {"n": 1.0, "mn": 1e-3, "gf": STANDARD_GRAVITY_M_S2 * 1e-3, "kgf": STANDARD_GRAVITY_M_S2}
)
"""Newtons in one of each unit that ``--force-unit`` knows."""

_FORCE = dict.fromkeys(("N", "Newton", "newton", "newtons"), 1.0)
_FORCE |= {"mN": 1e-3, "uN": 1e-6, "kN": 1e3, "cN": 1e-2, "lbf": 0.45359237 * STANDARD_GRAVITY_M_S2}
_FORCE |= dict.fromkeys(("g", "gf", "gram", "grams"), FORCE_UNITS_N["gf"])
_FORCE |= dict.fromkeys(("kg", "kgf", "kp"), FORCE_UNITS_N["kgf"])
_FORCE |= dict.fromkeys(("millinewton", "millinewtons"), 1e-3)
_LENGTH = {"mm": 1.0, "m": 1e3, "cm": 10.0, "um": 1e-3, "micron": 1e-3, "microns": 1e-3, "nm": 1e-6}
_LENGTH |= {"in": 25.4, "inch": 25.4}
_LENGTH |= dict.fromkeys(("millimeter", "millimeters", "millimetre", "millimetres"), 1.0)
_LENGTH |= dict.fromkeys(("micrometer", "micrometers", "micrometre", "micrometres"), 1e-3)
_TIME = dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 1.0)
_TIME |= dict.fromkeys(("ms", "msec", "millisecond", "milliseconds"), 1e-3)
_TIME |= dict.fromkeys(("us", "usec", "usecs", "microsecond", "microseconds"), 1e-6)
_TIME |= dict.fromkeys(("ns", "nsec", "nsecs", "nanosec", "nanosecond", "nanoseconds"), 1e-9)
_TIME |= {"min": 60.0, "h": 3600.0, "d": 86400.0}
_VOLUME = {"mm3": 1.0, "ul": 1.0, "cm3": 1e3, "ml": 1e3, "m3": 1e9, "um3": 1e-9}
_VOLUME |= {"uL": 1.0, "mL": 1e3}
_UNITS = {"n": _FORCE, "mm": _LENGTH, "s": _TIME, "mm3": _VOLUME}
"""What one of each unit is in the unit that ends a column's name."""

_SYNONYMS: Mapping[str, tuple[str, ...]] = {
    "trial": (
        *("trial", "press", "run", "test", "repetition", "specimen", "cycle"),
        *("versuch", "prüfung", "messung", "probe", "essai", "ensayo"),
    ),
    "time_s": (
        *("time", "timestamp", "time stamp", "t", "elapsed", "elapsed time", "clock", "test time"),
        *("zeit", "prüfzeit", "zeitstempel", "temps", "tiempo"),
    ),
    "force_normal_n": (
        *("force", "normal force", "force normal", "fz", "force z", "z force", "fn", "F", "load"),
        *("normal load", "load cell", "contact force", "press force", "standard force"),
        *("wrench force z", "kraft", "normalkraft", "standardkraft", "force normale", "effort"),
        *("fuerza", "fuerza normal"),
    ),
    "volume_mm3": ("volume", "vol", "indented volume", "indentation volume", "displaced volume"),
    "depth_mm": (
        *("depth", "indentation", "indentation depth", "press depth", "penetration", "travel"),
        *("penetration depth", "displacement", "compression", "compressive displacement"),
        *(
            "extension",
            "compressive extension",
            "distance",
            "deformation",
            "stroke",
            "tiefe",
            "eindringtiefe",
            "weg",
            "standardweg",
        ),
        *("profondeur", "enfoncement", "déplacement", "profundidad", "desplazamiento"),
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
_DIAMETERS = tuple(name.replace("radius", "diameter") for name in _SYNONYMS["radius_mm"])
_WITHOUT_UNIT = ("trial", "indenter", "curve")
_UNIT_NOT_NEEDED = ("time_s", "force_normal_n", "volume_mm3", "depth_mm", *_WITHOUT_UNIT)
"""Other names of these are read without a unit too, as the unit of the column's own name; what the
values say of it is checked."""
_NUMBER_WORDS = ("no", "nr", "num", "number", "id", "index", "nummer", "name", "n")

_MARKED = re.compile(r"[+-]?([\d.,]*[.,][\d.,]*)([eE][+-]?\d+)?")
"""A number with points or commas in it."""
_COMMA = re.compile(r"[+-]?(\d{1,3}(\.\d{3})+|\d*)(,\d+)?([eE][+-]?\d+)?")
_THOUSANDS = re.compile(r"[+-]?\d{1,3}(,\d{3})+(\.\d*)?([eE][+-]?\d+)?")
_SPACED = re.compile(r"[+-]?\d{1,3}([ '’\u00a0\u2009\u202f]\d{3})+([.,]\d*)?")
"""A number whose thousands are parted by spaces or apostrophes."""
_WITH_UNIT = re.compile(r"([+-]?[\d.,]+(?:[eE][+-]?\d+)?)\s*([A-Za-zµμ³^]+3?)")
BLOCKS = ("blank lines", "pauses")
"""What may part presses that have no numbers: ``--column trial="blank lines"``."""
GAP_FACTOR = 25.0  # a step of the clock this many times the median step is a gap
MOST_BLOCKS = 0.1  # of the rows: with more, they are no presses
LEAST_WHOLE = 0.05  # of a column's numbers, below 1000 and without a mark: marks part thousands


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
    blocks: IntArray  # (N,), which of the blocks of rows that blank lines or headers part
    delimiter: str = ","
    notes: tuple[str, ...] = ()


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
    parted: Mapping[str, IntArray]  # numbers of presses (N,) by what parts them, of ``BLOCKS``

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
        lines += [
            f"{self.path}: {by} part its rows into {number[-1] + 1} blocks; if each is a press, "
            f'give --column trial="{by}"'
            for by, number in self.parted.items()
            if "trial" in missing
        ]
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
    by = log_format.columns.get("trial", "")
    named = {name: one for name, one in log_format.columns.items() if one not in BLOCKS}
    columns, clocks = _with_whole_stamps(_with_units_of_cells(table.columns))
    if len(clocks) == 1 and "time_s" not in columns:
        named = {"time_s": next(iter(clocks)), **named}
    headers, units, notes, unclear = _named(columns, path, named)
    names = {header: name for name, header in headers.items()}
    cells = {
        names.get(header, header): column
        for header, column in columns.items()
        if header in names or header not in headers
    }
    known = tuple(name for name in headers if name not in ("indenter", "curve"))
    count, note = _without_summary(cells, path, table.rows)
    cells = {name: column[:count] for name, column in cells.items()}
    added = [
        f"{path}: {whole!r} and {part!r} are one clock: added" for whole, part in clocks.items()
    ]
    rows, notes = table.rows[:count], [*table.notes, *added, *notes, *note]
    cells, mend, marks = _with_points(cells, known, table.delimiter)
    cells, labels = _labels_as_numbers(cells)
    notes += [f"{path}: {text}" for text in (*marks, *labels)]
    clock = _clock_times(cells["time_s"]) if "time_s" in cells else None
    if clock is not None:
        cells["time_s"] = [repr(float(time_s)) for time_s in clock]
    numbers, problems = numeric_columns(cells, path, known, rows, mend)
    for name in known:
        factor = units.get(name, 1.0)
        if log_format.force_unit is not None and name.endswith("_n"):
            factor = FORCE_UNITS_N[log_format.force_unit]
        numbers[name] = numbers[name] * (-factor if name in log_format.flip else factor)
    for name in log_format.flip:
        if name not in numbers:
            msg = f"{path}: --flip {name}: there is no such column; it has {', '.join(cells)}"
            raise PressError(msg)
    parted = _parted(table.blocks[:count], numbers.get("time_s"))
    if by in BLOCKS:
        if by not in parted:
            msg = f'{path}: --column trial="{by}": no {by} part its rows; number the presses'
            raise PressError(msg)
        cells["trial"] = [str(number) for number in parted[by]]
        numbers["trial"] = parted[by].astype(np.float64)
        headers["trial"] = by
        notes.append(f"{path}: {parted[by][-1] + 1} presses, parted by {by}")
    sure = {name for name in log_format.columns if split_header(log_format.columns[name])[1]}
    if log_format.force_unit is not None:
        sure |= {name for name in known if name.endswith("_n")}
    return LogTable(
        path=path,
        cells=cells,
        numbers=numbers,
        rows=rows,
        headers=headers,
        sure=frozenset(sure),
        problems=tuple(problems),
        notes=tuple(notes),
        unclear=tuple(unclear),
        parted=parted,
    )


def _parted(blocks: IntArray, time_s: FloatArray | None) -> dict[str, IntArray]:
    """Numbers of presses (N,) by what parts them: blank lines; gaps and restarts of the clock."""
    found = {"blank lines": blocks}
    if time_s is not None:
        steps = np.diff(time_s)
        usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else np.inf
        breaks = (steps < 0) | (steps > GAP_FACTOR * usual)
        found["pauses"] = np.concatenate([[0], np.cumsum(breaks)]).astype(np.int64)
    most = MOST_BLOCKS * len(blocks)
    return {by: number for by, number in found.items() if 0 < number[-1] < most}


def _with_units_of_cells(columns: Mapping[str, Cells]) -> dict[str, Cells]:
    """Columns of which every cell ends in one unit (`1.2 N`), with it in the header instead."""
    found: dict[str, Cells] = {}
    for header, cells in columns.items():
        first = next((cell for cell in cells if cell.lower() not in EMPTY_CELLS), "")
        match = _WITH_UNIT.fullmatch(first)
        unit = _plain_unit(match[2]) if match else ""
        if any(unit in known for known in _UNITS.values()) and not split_header(header)[1]:
            parts = [(cell, _WITH_UNIT.fullmatch(cell)) for cell in cells]
            if all(_plain_unit(m[2]) == unit if m else c.lower() in EMPTY_CELLS for c, m in parts):
                found[f"{header} [{unit}]"] = [m[1] if m else "" for _, m in parts]
                continue
        found[header] = cells
    return found


def _with_whole_stamps(columns: Mapping[str, Cells]) -> tuple[dict[str, Cells], dict[str, str]]:
    """Columns with the parts of a second added to its whole seconds, and the headers of both.

    ROS writes a stamp as ``secs`` and ``nsecs``, ROS 2 as ``sec`` and ``nanosec``.
    """
    found, clocks = dict(columns), dict[str, str]()
    ends = [unit for unit, factor in _TIME.items() if factor == 1.0]
    parts = [unit for unit, factor in _TIME.items() if factor < 1.0]
    for whole, end, unit in itertools.product(columns, ends, parts):
        part = whole.removesuffix(end) + unit
        if not whole.endswith(end) or part not in found or whole in clocks:
            continue
        (seconds, filled), (rest, _) = parsed(columns[whole]), parsed(columns[part])
        rest *= _TIME[unit]
        is_stamp = (seconds == np.round(seconds)) & (rest >= 0.0) & (rest < 1.0)
        if filled.any() and is_stamp[filled].all():
            stamps = (seconds + rest).tolist()
            found[whole] = ["" if np.isnan(one) else repr(one) for one in stamps]
            del found[part]
            clocks[whole] = part
    return found, clocks


def _without_summary(
    cells: Mapping[str, Cells], path: Path, rows: IntArray
) -> tuple[int, list[str]]:
    """How many rows are samples, and a note on those below: means, remarks, a torn last line.

    They have a text where a press's number or time stands in the rows above.
    """
    counted = [cells[name] for name in ("trial", "time_s") if name in cells]
    counted = [column for column in counted if len(column) and _is_number(column[0])]
    count = len(rows)
    while count and any(
        column[count - 1].lower() not in EMPTY_CELLS and not _is_number(column[count - 1])
        for column in counted
    ):
        count -= 1
    if count == len(rows) or not 0 < len(rows) - count <= min(MOST_SUMMARY_ROWS, count):
        return len(rows), []
    text = next(c for column in cells.values() if (c := column[count]))
    return count, [
        f"{path}: rows {rows[count]} to {rows[-1]}, below the samples, are not read ({text!r} …)"
    ]


def _is_number(cell: str) -> bool:
    return bool(np.isfinite(_number(cell)) or _MARKED.fullmatch(cell) or _SPACED.fullmatch(cell))


def _named(
    columns: Mapping[str, Cells], path: Path, given: Mapping[str, str]
) -> tuple[dict[str, str], dict[str, float], list[str], list[str]]:
    """Headers by name, factors to its unit, notes, and what is not read although it looks so."""
    headers: dict[str, str] = {}
    factors: dict[str, float] = {}
    unclear: list[str] = []
    for name, wanted in given.items():
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
            factors[name] = _units(name).get(unit, 1.0) * _per_radius(headers[name])
            taken.add(headers[name])
    renamed = [
        f"{header!r} as {name}{'' if factors.get(name, 1.0) == 1.0 else f' (× {factors[name]:g})'}"
        for name, header in headers.items()
        if header != name
    ]
    notes = [f"{path}: read {', '.join(renamed)}"] if renamed else []
    return headers, factors, notes, unclear


def _per_radius(header: str) -> float:
    return 0.5 if "diameter" in header.lower() else 1.0


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


def states_unit(header: str, name: str) -> bool:
    """Whether a header says the unit of the quantity ``name``; tacgen's own names do."""
    return header == name or _unit_of(header, name) not in ("", "-")


def _plain_unit(text: str) -> str:
    unit = text.strip().replace("µ", "u").replace("μ", "u").replace("³", "3").replace("^3", "3")
    return "" if unit in ("-", "#", "1") else unit


def _spoken_unit(text: str, name: str) -> str:
    """The unit of ``name`` that a word is, in the case of a header too: `Mm`, `Sec`; else empty."""
    unit = _plain_unit(text)
    forms = [unit]
    if unit != "MN":  # a million newtons are no thousandth of one
        forms += [unit[:1].lower() + unit[1:], *([unit.lower()] if len(unit) > 1 else [])]
    return next((form for form in forms if form in _units(name)), "")


def _unit_of(header: str, name: str) -> str:
    """The unit in which ``header`` states the quantity ``name``; `-` for none, empty for another.

    The unit may stand in brackets or be the last word: `Fz [N]`, `depth_um`, `t/s`.
    """
    text, unit = split_header(header)
    words = re.sub(r"(?<=[a-z]{2})(?=[A-Z])|[^\w³^]+|_", " ", text).split()
    if unit is not None:
        unit = _spoken_unit(unit, name) or unit
    elif len(words) > 1 and (last := _spoken_unit(words[-1], name)):
        unit = last
        words = words[: -2 if words[-2] == "in" and len(words) > 2 else -1]
    words = words[1:] if words[:1] == ["field"] else words  # as `rostopic echo -p` begins
    spoken = [word.lower() if len(words) > 1 or len(word) > 1 else word for word in words]
    if name == "trial":
        while len(spoken) > 1 and spoken[-1] in _NUMBER_WORDS:
            del spoken[-1]
        if len(spoken) > 1 and spoken[0].lower() in _NUMBER_WORDS:
            del spoken[0]
    known = _SYNONYMS[name] + (_DIAMETERS if name == "radius_mm" else ())
    # A single letter may be a volume where its unit says so; `F_n` is written in two words.
    known += ("V",) if name == "volume_mm3" and unit else ()
    if not {" ".join(spoken), "".join(spoken)} & set(known) or (name in _WITHOUT_UNIT and unit):
        return ""
    return unit or ("-" if name in _UNIT_NOT_NEEDED else "")


def _with_points(
    cells: dict[str, Cells], known: Iterable[str], delimiter: str
) -> tuple[dict[str, Cells], Callable[[str], str], list[str]]:
    """The cells with decimal points, what mends one with marks between thousands, and notes."""
    probed = [cells[name][:PROBED_CELLS] for name in known]
    mark = _decimal_mark(probed, delimiter)
    if mark == ",":
        cells = {name: [_with_point(cell) for cell in column] for name, column in cells.items()}
        return cells, lambda c: _with_point(_without_spaces(c)), ["numbers have decimal commas"]
    if mark == ".":
        return cells, lambda cell: _without_spaces(_without_commas(cell)), []
    return cells, _without_spaces, []


def _decimal_mark(columns: Iterable[Cells], delimiter: str) -> str:
    """The mark of the decimals in numbers; empty where they contradict each other.

    Numbers that may have thousands parted (`1.234`) say nothing beside others. On their own they
    are such where other numbers of their column are whole and below a thousand.
    """
    clear, parted, unclear = set[str](), set[str](), set[str]()
    for column in columns:
        marks = [_mark_in(match[1]) for cell in column if (match := _MARKED.fullmatch(cell))]
        clear |= {mark for mark in marks if mark in (",", ".")}
        either = {mark[-1] for mark in marks if mark in ("either ,", "either .")}
        whole = sum(cell.isdecimal() and len(cell) < 4 and cell != "0" for cell in column)
        if whole > LEAST_WHOLE * len(column):
            parted |= {"." if mark == "," else "," for mark in either}
        unclear |= either - {delimiter}
    found = clear or parted or unclear
    return found.pop() if len(found) == 1 else "" if found else "."


def _mark_in(digits: str) -> str:
    """The decimal mark in a number: a comma, a point, either, or none that can be."""
    last = max(digits.rfind(","), digits.rfind("."))
    mark, head, tail = digits[last], digits[:last], digits[last + 1 :]
    other = "." if mark == "," else ","
    parts = head.replace(other, mark).split(mark)
    in_threes = 1 <= len(parts[0]) <= 3 and all(len(part) == 3 for part in parts[1:])
    if mark in head:  # more than once
        return other if in_threes and len(tail) == 3 and other not in head else ""
    if other in head:
        return mark if in_threes else ""
    return f"either {mark}" if in_threes and len(tail) == 3 and head[0] != "0" else mark


def _with_point(cell: str) -> str:
    if _COMMA.fullmatch(cell):
        return cell.replace(".", "").replace(",", ".")
    return cell


def _without_commas(cell: str) -> str:
    return cell.replace(",", "") if _THOUSANDS.fullmatch(cell) else cell


def _without_spaces(cell: str) -> str:
    return re.sub(r"[ '’\u00a0\u2009\u202f]", "", cell) if _SPACED.fullmatch(cell) else cell


def _labels_as_numbers(cells: dict[str, Cells]) -> tuple[dict[str, Cells], list[str]]:
    """Names of presses (`A1`) as numbers in order of appearance, and a note where there were any.

    A number that stands on the first row of its press alone is that of the rows below.
    """
    trial, notes = cells.get("trial", ()), list[str]()
    rows = Counter(trial)
    for cell in [cell for cell in rows if cell.lower() in EMPTY_CELLS]:
        del rows[cell]
    if not rows:
        return cells, notes
    if max(rows.values()) == 1 and trial[0] in rows and LEAST_LABELLED * len(rows) <= len(trial):
        place = np.maximum.accumulate([k if c in rows else 0 for k, c in enumerate(trial)])
        trial = [trial[k] for k in place.tolist()]
        cells, rows = {**cells, "trial": trial}, Counter(trial)
        notes.append(
            "presses are numbered on their first row; the rows below are taken to be of it"
        )
    names = {cell: count for cell, count in rows.items() if not np.isfinite(_number(cell))}
    if names and (len(names) == len(rows) or min(names.values()) >= LEAST_LABELLED):
        number = {label: str(k) for k, label in enumerate(rows)}
        first = ", ".join(list(number)[:MAX_LISTED])
        cells = {**cells, "trial": [number.get(cell, "") for cell in trial]}
        notes.append(f"presses {first} … are numbered from 0 as they appear")
    return cells, notes


def _clock_times(cells: Cells) -> FloatArray | None:
    """Seconds since the first of dates and times (N,); None where the cells are no such."""
    filled = [cell for cell in cells if cell.lower() not in EMPTY_CELLS]
    if not filled or not all(
        re.fullmatch(r"[\d\s:.,/+TZ-]*\d:\d\d[\d\s:.,+Z-]*([AaPp][Mm])?", c) for c in filled
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
        read = _parquet(path) if _is_parquet(path) else _csv(path)
    except (OSError, ValueError, LookupError, TypeError, csv.Error) as error:
        # pandas and pyarrow raise the latter for metadata that is not what they write themselves.
        msg = f"{path}: cannot be read as a table: {csv_problem(error)}"
        raise PressError(msg) from error
    named = [(name.strip(), column) for name, column in zip(read.header, read.columns, strict=True)]
    named = [(name, column) for name, column in named if name]
    doubled = sorted(
        name for name, count in Counter(name for name, _ in named).items() if count > 1
    )
    if doubled:
        msg = f"{path}: columns appear twice: {', '.join(doubled)}; keep one of each"
        raise PressError(msg)
    if named and all(_is_number(name) for name, _ in named):
        msg = f"{path}: its first row holds numbers; write the columns' names above it"
        raise PressError(msg)
    if not named or not len(read.rows):
        msg = f"{path}: holds no samples; a press log has one row a sample under its header"
        raise PressError(msg)
    notes = tuple(f"{path}: {note}" for note in read.notes)
    return Table(dict(named), read.rows, read.blocks, read.delimiter, notes)


@dataclass(frozen=True, slots=True)
class _Parts:
    header: list[str]
    columns: list[Cells]
    rows: IntArray
    blocks: IntArray
    delimiter: str = ""
    notes: tuple[str, ...] = ()


def _is_parquet(path: Path) -> bool:
    return path.suffix.lower() in (".parquet", ".pq")


def _csv(path: Path) -> _Parts:
    """Header, columns, each row's number, delimiter; cells that a row lacks are empty."""
    _refuse_large(path, path.stat().st_size, MAX_BYTES, "bytes")
    text = _decoded(path.read_bytes()).replace("\r\n", "\n").replace("\r", "\n")
    _refuse_large(path, text.count("\n"), MAX_CELLS // 2, "rows")
    text = text.replace("\u2212", "-")  # the sign that word processors write
    of_formulas = '=""' in text  # how spreadsheets mark a text: ="1.0"
    lines = text.split("\n")
    start, delimiter = _header_line(lines)
    lines[start] = lines[start].lstrip().lstrip(MARKS)
    if delimiter == " ":
        lines = [" ".join(line.split()) for line in lines]
    reader = csv.reader((f"{line}\n" for line in lines[start:]), delimiter=delimiter)
    header = next(reader, [])
    if not header:
        msg = "No columns to parse from file"
        raise ValueError(msg)
    _refuse_large(path, len(header) * (len(lines) - start), MAX_CELLS, "cells")
    rows = _Rows([name.strip() for name in header])
    for number, row in enumerate(reader, start=start + 2):
        rows.add(number, [cell.strip() for cell in row], of_formulas=of_formulas)
    if rows.filled and "\n" in "".join(rows.filled[-1]) and not text.rstrip().endswith('"'):
        begin = ", ".join(rows.filled[-1]).splitlines()[0][:40]
        msg = f"a quote that is not closed in the row that begins with {begin!r}"
        raise ValueError(msg)
    columns = [list(column) for column in zip(*rows.filled, strict=True)] or [[] for _ in header]
    return _Parts(
        header=[
            f"{name} [{unit}]" if unit else name
            for name, unit in zip(header, rows.units or [""] * len(header), strict=True)
        ],
        columns=list(columns),
        rows=np.array(rows.numbers, dtype=np.int64),
        blocks=np.array(rows.blocks, dtype=np.int64),
        delimiter=delimiter,
        notes=(f"the header stands {rows.headers} times",) if rows.headers > 1 else (),
    )


def _refuse_large(path: Path, count: int, most: int, what: str) -> None:
    if count > most:
        every = -(-count // most) + 1
        msg = f"{path}: holds {count} {what}, more than {most}; keep every {every}th row of it"
        raise PressError(msg)


@dataclass(slots=True)
class _Rows:
    """Rows below a header: samples, in blocks that blank lines and further headers part."""

    names: list[str]
    filled: list[list[str]] = field(default_factory=list)
    numbers: list[int] = field(default_factory=list)
    blocks: list[int] = field(default_factory=list)
    units: list[str] = field(default_factory=list)
    headers: int = 1
    _is_new: bool = True

    def add(self, number: int, cells: list[str], *, of_formulas: bool) -> None:
        """Take the line ``number`` for what it is; raises ``ValueError`` if it is too long."""
        first = cells[0] if cells else ""
        if first.startswith(COMMENT_MARKS) and first.lower() not in EMPTY_CELLS:
            return
        count = len(self.names)
        while len(cells) > count and not cells[-1]:
            del cells[-1]  # a delimiter at the row's end
        if len(cells) != count:
            if len(cells) > count:
                msg = f"Expected {count} fields in line {number}, saw {len(cells)}"
                raise ValueError(msg)
            cells += [""] * (count - len(cells))
        if of_formulas:
            cells = [cell[2:-1] if cell.startswith('="') else cell for cell in cells]
        is_empty = first.lower() in EMPTY_CELLS and all(c.lower() in EMPTY_CELLS for c in cells)
        if cells == self.names:
            self._is_new, self.headers = True, self.headers + 1
            self._drop_title()
        elif self._is_new and (units := _unit_row(cells)):
            self.units = self.units or units
        elif is_empty:
            self._is_new = True
        else:
            self.blocks.append(self.blocks[-1] + self._is_new if self.blocks else 0)
            self.filled.append(cells)
            self.numbers.append(number)
            self._is_new = False

    def _drop_title(self) -> None:
        """A text alone in the row above a further header is the title of its block."""
        cells = list(filter(None, self.filled[-1])) if self.filled else []
        if len(cells) == 1 and not _is_number(cells[0]):
            del self.filled[-1], self.numbers[-1], self.blocks[-1]


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


def _header_line(lines: Sequence[str]) -> tuple[int, str]:
    """Index of the header's line and the delimiter: what parts it and most rows below it alike.

    The header is the first line, beyond comments and a preamble, whose cells are as many as those
    of the rows; a comment of as many where that line has numbers, as numpy and ROS write it.
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
        for least in (typical, max(typical - 1, 2)):
            first = next(k for k, n in zip(open_lines, counts, strict=False) if n >= least)
            above = [k for k in range(first) if _is_comment(lines[k])]
            fits = [
                k for k in above if _count(lines[k].strip().lstrip(MARKS), delimiter) == typical
            ]
            cells = [cell.strip() for cell in _cells(lines[first], delimiter)]
            are_numbers = [*map(_is_number, filter(None, cells))]
            if fits and (all(are_numbers) or any(are_numbers)):
                return fits[-1], delimiter
            if not all(are_numbers):
                return first, delimiter
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
    from pyarrow.parquet import read_metadata

    about = read_metadata(path)
    _refuse_large(path, about.num_rows * max(about.num_columns, 1), MAX_CELLS, "cells")
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
    rows = np.arange(len(frame), dtype=np.int64)
    return _Parts(header, columns, rows + 2, 0 * rows)


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
    table: Mapping[str, Cells],
    path: Path,
    names: tuple[str, ...],
    rows: IntArray,
    mend: Callable[[str], str] = str,
) -> tuple[dict[str, FloatArray], list[str]]:
    """Those of ``names`` that the table has, as float64; empty cells are NaN; and the problems.

    ``rows`` (N,) are the rows' numbers in the file; a cell that is no number is read as ``mend``
    makes it.
    """
    numbers: dict[str, FloatArray] = {}
    problems = []
    for name in names:
        if name not in table:
            continue
        values, filled = parsed(table[name])
        bad = np.isnan(values) & filled
        for index in np.flatnonzero(bad).tolist():
            values[index] = _number(mend(table[name][index]))
        bad &= np.isnan(values)
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
    text = "".join(cells)
    plain = text.isascii() and "_" not in text
    try:  # several times as fast
        values = np.array([*map(float if plain else _number, cells)], dtype=np.float64)
    except ValueError:
        values = np.array([*map(_number, cells)], dtype=np.float64)
    filled = np.ones(len(cells), dtype=bool)
    for index in np.flatnonzero(np.isnan(values)).tolist():
        filled[index] = cells[index].lower() not in EMPTY_CELLS
    return values, filled


def _number(cell: str) -> float:
    try:
        # Python also reads 1_000 and the digits of other scripts.
        return float(cell) if cell.isascii() and "_" not in cell else float("nan")
    except ValueError:
        return float("nan")

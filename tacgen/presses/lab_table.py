"""Tables as laboratories write them: delimiter, decimal mark, headers with units, comment lines.

A column of a press log is found by its own name, by another name for the same quantity (`Fz [N]`,
`Depth (um)`, `Press #`), or by what ``LogFormat.columns`` says. Units in brackets are converted;
a unit that is not one of the quantity is not guessed.
"""

import csv
import itertools
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pandas as pd

from tacgen.core.errors import PressError, require_extra, require_known
from tacgen.core.records import DEPTH_CURVES, PRESS_LOG, csv_problem
from tacgen.core.types import STANDARD_GRAVITY_M_S2, BoolArray, FloatArray, IntArray
from tacgen.presses.rules import LOG

EMPTY_CELLS = frozenset(
    (
        *("nan", "na", "n/a", "<na>", "none", "null", "-", "--", "---", "–", "—"),
        *("#n/a", "#na", "#div/0!", "#value!", "#num!", "#ref!", "#name?", "#null!"),
    )
)
"""Texts of cells without a value, in any case."""
COMMENT_MARKS = ("#", "%", "//")
MARKS = "#%/ "  # what they are made of
DELIMITERS = (";", "\t", "|", ",")  # in the order in which they are believed: commas may be decimal

FORCE_UNITS_N = MappingProxyType(
    {"n": 1.0, "mn": 1e-3, "gf": STANDARD_GRAVITY_M_S2 * 1e-3, "kgf": STANDARD_GRAVITY_M_S2}
)
"""Newtons in one of each unit that ``--force-unit`` knows."""
_SPELLINGS: Mapping[str, Mapping[str, float]] = {
    "n": {
        "N Newton newton newtons": 1.0,
        "mN millinewton millinewtons": 1e-3,
        "uN": 1e-6,
        "kN": 1e3,
        "cN": 1e-2,
        "lbf": 0.45359237 * STANDARD_GRAVITY_M_S2,
        "g gf gram grams": FORCE_UNITS_N["gf"],
        "kg kgf kp": FORCE_UNITS_N["kgf"],
    },
    "mm": {
        "mm millimeter millimeters millimetre millimetres": 1.0,
        "m": 1e3,
        "cm": 10.0,
        "um micron microns micrometer micrometers micrometre micrometres": 1e-3,
        "nm": 1e-6,
        "in inch": 25.4,
    },
    "s": {
        "s sec secs second seconds": 1.0,
        "ms msec millisecond milliseconds": 1e-3,
        "us usec usecs microsecond microseconds": 1e-6,
        "ns nsec nsecs nanosec nanosecond nanoseconds": 1e-9,
        "min": 60.0,
        "h": 3600.0,
        "d": 86400.0,
    },
    "mm3": {"mm3 ul uL": 1.0, "cm3 ml mL": 1e3, "m3": 1e9, "um3": 1e-9},
}
_UNITS = {
    end: {word: factor for words, factor in units.items() for word in words.split()}
    for end, units in _SPELLINGS.items()
}
"""What one of each unit is in the unit that ends a column's name."""
_ALL_UNITS = frozenset(itertools.chain(*_UNITS.values()))

_SYNONYMS: dict[str, str] = {
    "trial": "trial, press, run, test, repetition, specimen, cycle, versuch, prüfung, messung, "
    "probe, essai, ensayo",
    "time_s": "time, timestamp, time stamp, t, elapsed, elapsed time, clock, test time, zeit, "
    "prüfzeit, zeitstempel, temps, tiempo",
    "force_normal_n": "force, normal force, force normal, fz, force z, z force, fn, F, load, "
    "normal load, load cell, contact force, press force, standard force, wrench force z, kraft, "
    "normalkraft, standardkraft, force normale, effort, fuerza, fuerza normal",
    "volume_mm3": "volume, vol, indented volume, indentation volume, displaced volume",
    "depth_mm": "depth, indentation, indentation depth, press depth, penetration, travel, "
    "penetration depth, displacement, compression, compressive displacement, extension, "
    "compressive extension, distance, deformation, stroke, tiefe, eindringtiefe, weg, standardweg, "
    "profondeur, enfoncement, déplacement, profundidad, desplazamiento",
    "radius_mm": "radius, ball radius, indenter radius, tip radius, probe radius, diameter, "
    "ball diameter, indenter diameter, tip diameter, probe diameter",
    "curve": "curve",
    "indenter": "indenter",
}
for _axis in "xy":
    _SYNONYMS |= {
        f"force_shear_{_axis}_n": f"f{_axis}, force {_axis}, {_axis} force, shear force {_axis}, "
        f"force shear {_axis}",
        f"shear_{_axis}_mm": f"shear {_axis}, marker shear {_axis}, marker motion {_axis}, "
        f"summed shear {_axis}",
        f"{_axis}_mm": f"{_axis}, contact {_axis}, position {_axis}, pos {_axis}, "
        f"{_axis} position, stage {_axis}",
    }
_WORDS = {name: frozenset(words.split(", ")) for name, words in _SYNONYMS.items()}
_WITHOUT_UNIT = ("trial", "indenter", "curve")
_UNIT_NOT_NEEDED = ("time_s", "force_normal_n", "volume_mm3", "depth_mm", *_WITHOUT_UNIT)
"""Other names of these are read without a unit too, as the unit of the column's own name; what the
values say of it is checked."""
_NUMBER_WORDS = ("no", "nr", "num", "number", "id", "index", "nummer", "name", "n")

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
_NOTHING = "No columns to parse from file"
BLOCKS = ("blank lines", "pauses")
"""What may part presses that have no numbers: ``--column trial="blank lines"``."""


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

    cells: pd.DataFrame  # its index counts the file's rows as a spreadsheet does
    blocks: IntArray  # (N,), which of the blocks of rows that blank lines or headers part
    delimiter: str = ","
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class LogTable:
    """A table whose columns have the names and units of a press log."""

    path: Path
    cells: pd.DataFrame  # every column; known ones by their names; as those of ``Table``
    numbers: dict[str, FloatArray]  # (N,) of the known ones; NaN where a cell is empty
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
        lines = missing_columns(self.cells, self.path, names, {**PRESS_LOG, **DEPTH_CURVES})
        if not lines:
            return
        first = next(name for name in names if not set(name.split(" or ")) & {*self.cells})
        found = [
            name if header == name else f"{name} (as {header!r})"
            for name, header in self.headers.items()
        ]
        others = [repr(name) for name in self.cells if name not in self.headers]
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
    given = {name: one for name, one in log_format.columns.items() if one not in BLOCKS}
    if len(clocks) == 1 and "time_s" not in cells:
        given = {"time_s": next(iter(clocks)), **given}
    headers, factors, unclear = _named(list(cells), path, given)
    names = {header: name for name, header in headers.items()}
    cells = cells[[header for header in cells if header in names or header not in headers]]
    cells = cells.rename(columns=names)
    numeric = [name for name in headers if name not in ("indenter", "curve")]
    notes = [f"{whole!r} and {part!r} are one clock: added" for whole, part in clocks.items()]
    renamed = [
        f"{header!r} as {name}" + (f" (× {factor:g})" if factor != 1.0 else "")
        for name, header in headers.items()
        if header != name and (factor := factors.get(name, 1.0))
    ]
    notes += [f"read {', '.join(renamed)}"] if renamed else []
    count = _sample_count(cells)
    if count < len(cells):
        below = cells.iloc[count:]
        text = next(filter(None, below.iloc[0]))
        notes.append(
            f"rows {below.index[0]} to {below.index[-1]}, below the samples, are not read "
            f"({text!r} …)"
        )
    cells, mark = _with_points(cells.iloc[:count].copy(), numeric, table.delimiter)
    notes += ["numbers have decimal commas"] if mark == "," else []
    if "trial" in cells:
        cells["trial"], labels = _labels_as_numbers(cells["trial"])
        notes += labels
    if "time_s" in cells and (clock := _clock_times(cells["time_s"])) is not None:
        cells["time_s"] = [repr(time_s) for time_s in clock.tolist()]
    numbers, problems = numeric_columns(cells, path, numeric)
    for name in log_format.flip:
        if name not in numbers:
            msg = f"{path}: --flip {name}: there is no such column; it has {', '.join(cells)}"
            raise PressError(msg)
    for name in numeric:
        factor = factors.get(name, 1.0)
        if unit is not None and name.endswith("_n"):
            factor = FORCE_UNITS_N[unit]
        numbers[name] *= -factor if name in log_format.flip else factor
    parted = _parted(table.blocks[:count], numbers.get("time_s"))
    if by in BLOCKS:
        if by not in parted:
            msg = f'{path}: --column trial="{by}": no {by} part its rows; number the presses'
            raise PressError(msg)
        cells["trial"] = parted[by].astype(str)
        numbers["trial"] = parted[by].astype(np.float64)
        headers["trial"] = by
        notes.append(f"{parted[by][-1] + 1} presses, parted by {by}")
    sure = {name for name, header in log_format.columns.items() if split_header(header)[1]}
    sure |= {name for name in numeric if unit is not None and name.endswith("_n")}
    return LogTable(
        path=path,
        cells=cells,
        numbers=numbers,
        headers=headers,
        sure=frozenset(sure),
        problems=tuple(problems),
        notes=(*table.notes, *(f"{path}: {note}" for note in notes)),
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
        match = _WITH_UNIT.fullmatch(filled.iloc[0]) if len(filled) else None
        unit = _plain_unit(match[2]) if match else ""
        if unit not in _ALL_UNITS or split_header(header)[1]:
            continue
        parts = [_WITH_UNIT.fullmatch(cell) for cell in filled]
        with_unit = f"{header} [{unit}]"
        if all(m and _plain_unit(m[2]) == unit for m in parts) and with_unit not in cells:
            numbers = pd.Series([m[1] for m in parts if m], filled.index, dtype=object)
            cells = cells.assign(**{header: numbers.reindex(cells.index, fill_value="")})
            cells = cells.rename(columns={header: with_unit})
    return cells


def _with_whole_stamps(cells: pd.DataFrame) -> tuple[pd.DataFrame, dict[str, str]]:
    """Columns with the parts of a second added to its whole seconds, and the headers of both.

    ROS writes a stamp as ``secs`` and ``nsecs``, ROS 2 as ``sec`` and ``nanosec``.
    """
    clocks: dict[str, str] = {}
    ends = [unit for unit, factor in _UNITS["s"].items() if factor == 1.0]
    parts = [unit for unit, factor in _UNITS["s"].items() if factor < 1.0]
    for whole, end, unit in itertools.product(list(cells), ends, parts):
        part = whole.removesuffix(end) + unit
        if not whole.endswith(end) or part not in cells or whole in clocks:
            continue
        seconds, rest = parsed(cells[whole]), _UNITS["s"][unit] * parsed(cells[part])
        is_stamp = (seconds == np.round(seconds)) & (rest >= 0.0) & (rest < 1.0)
        filled = (cells[whole] != "").to_numpy()
        if filled.any() and is_stamp[filled].all():
            stamps = (seconds + rest).tolist()
            cells = cells.assign(**{whole: ["" if np.isnan(s) else repr(s) for s in stamps]})
            cells, clocks[whole] = cells.drop(columns=part), part
    return cells, clocks


def _sample_count(cells: pd.DataFrame) -> int:
    """How many rows are samples; below them may be means, remarks, a torn last line.

    Those have a text where a press's number or time stands in the rows above.
    """
    counted = [cells[name].to_numpy() for name in ("trial", "time_s") if name in cells]
    counted = [column for column in counted if _is_number(column[0])]
    count = len(cells)
    while count and any(c[count - 1] and not _is_number(c[count - 1]) for c in counted):
        count -= 1
    return count if len(cells) - count <= min(LOG.most_summary_rows, count) else len(cells)


def _is_number(cell: str) -> bool:
    patterns = (*_NUMBERS.values(), _SPACED)
    return bool(np.isfinite(_number(cell)) or any(pattern.fullmatch(cell) for pattern in patterns))


def _named(
    columns: Sequence[str], path: Path, given: Mapping[str, str]
) -> tuple[dict[str, str], dict[str, float], list[str]]:
    """Headers by name, factors to its unit, and what is not read although it looks so."""
    headers: dict[str, str] = {}
    factors: dict[str, float] = {}
    unclear: list[str] = []
    for name, wanted in given.items():
        header, unit = _chosen(columns, path, name, wanted)
        where = f"{path}: --column {name}={wanted!r}:"
        if header in headers.values():
            msg = f"{where} another --column names it too; a column is one quantity"
            raise PressError(msg)
        if unit and unit not in _units(name):
            known = ", ".join(_units(name)) or "none"
            msg = f"{where} {unit!r} is not a unit of it that is known; give one of {known}"
            raise PressError(msg)
        headers[name], factors[name] = header, _units(name).get(unit or "", 1.0)
    taken = set(headers.values())
    for name in _WORDS:
        if name in headers:
            continue
        if name in columns and name not in taken:
            headers[name] = name
            continue
        found = {h: unit for h in columns if h not in taken and (unit := _unit_of(h, name))}
        right = {h: unit for h, unit in found.items() if unit in ("-", *_units(name))}
        unclear += [
            f"{path}: column {h!r} is not read as {name}: {found[h]!r} is none of "
            f'{", ".join(_units(name))}; give --column {name}="HEADER [UNIT]"'
            for h in found
            if h not in right
        ]
        stated = {h: unit for h, unit in right.items() if unit != "-"}
        chosen = right if len(right) == 1 else stated
        if len(chosen) == 1:
            ((headers[name], unit),) = chosen.items()
            per_radius = 0.5 if "diameter" in headers[name].lower() else 1.0
            factors[name] = _units(name).get(unit, 1.0) * per_radius
            taken.add(headers[name])
        elif right:
            unclear.append(
                f"{path}: {' and '.join(map(repr, right))} may both be {name}; say which: "
                f'--column {name}="HEADER"'
            )
    return headers, factors, unclear


def _units(name: str) -> Mapping[str, float]:
    return {} if name in _WITHOUT_UNIT else _UNITS[name.rpartition("_")[2]]


def _chosen(columns: Sequence[str], path: Path, name: str, wanted: str) -> tuple[str, str | None]:
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
    # A single letter may be a volume where its unit says so; `F_n` is written in two words.
    known = _WORDS[name] | ({"V"} if name == "volume_mm3" and unit else set())
    if not {" ".join(spoken), "".join(spoken)} & known or (name in _WITHOUT_UNIT and unit):
        return ""
    return unit or ("-" if name in _UNIT_NOT_NEEDED else "")


def _with_points(
    cells: pd.DataFrame, numeric: Iterable[str], delimiter: str
) -> tuple[pd.DataFrame, str]:
    """Numbers with decimal points and nothing between thousands, and the mark they had."""
    mark = _decimal_mark([cells[name].iloc[: LOG.probed_cells] for name in numeric], delimiter)
    for name in cells:
        if re.search(f"[,{_SPACES}]", text := "".join(cells[name])) or (
            mark == "," and "." in text
        ):
            cells[name] = [_with_point(cell, mark) for cell in cells[name]]
    return cells, mark


def _with_point(cell: str, mark: str) -> str:
    if _SPACED.fullmatch(cell):
        cell = re.sub(f"[{_SPACES}]", "", cell)
    if mark and _NUMBERS[mark].fullmatch(cell):
        return cell.replace("." if mark == "," else ",", "").replace(mark, ".")
    return cell


def _decimal_mark(columns: Iterable[pd.Series], delimiter: str) -> str:
    """The mark of the decimals in numbers; empty where they contradict each other.

    Numbers that may have thousands parted (`1.234`) say nothing beside others. On their own they
    are such where other numbers of their column are whole and below a thousand.
    """
    clear, parted, unclear = set[str](), set[str](), set[str]()
    for column in columns:
        cells = [cell for cell in column if "," in cell or "." in cell]
        fits = [{m for m, number in _NUMBERS.items() if number.fullmatch(cell)} for cell in cells]
        clear = clear.union(*(marks for marks in fits if len(marks) == 1))
        either = {"," if "," in c else "." for c, m in zip(cells, fits, strict=True) if len(m) > 1}
        whole = sum(cell.isdecimal() and len(cell) < 4 and cell != "0" for cell in column)
        if whole > LOG.least_whole_share * len(column):
            parted |= {"." if mark == "," else "," for mark in either}
        unclear |= either - {delimiter}
    found = clear or parted or unclear
    return found.pop() if len(found) == 1 else "" if found else "."


def _labels_as_numbers(trial: pd.Series) -> tuple[pd.Series, list[str]]:
    """Names of presses (`A1`) as numbers in order of appearance, and notes on what was read so.

    A number that stands on the first row of its press alone is that of the rows below.
    """
    notes, trial = list[str](), trial.mask(trial == "")
    if not trial.notna().any():
        return trial.fillna(""), notes
    once = trial.notna().iloc[0] and not trial.dropna().duplicated().any()
    if once and LOG.least_labelled * trial.count() <= len(trial):
        trial = trial.ffill()
        notes.append(
            "presses are numbered on their first row; the rows below are taken to be of it"
        )
    numbers, labels = pd.factorize(trial)
    counts = np.bincount(numbers[numbers >= 0])
    is_name = np.array([not np.isfinite(_number(label)) for label in labels], dtype=bool)
    if is_name.all() or (is_name.any() and counts[is_name].min() >= LOG.least_labelled):
        trial = pd.Series(numbers, trial.index).astype(str).mask(numbers < 0)
        first = ", ".join(labels[: LOG.max_listed])
        notes.append(f"presses {first} … are numbered from 0 as they appear")
    return trial.fillna(""), notes


def _clock_times(cells: pd.Series) -> FloatArray | None:
    """Seconds since the first of dates and times (N,); None where the cells are no such."""
    filled = cells[cells != ""]
    pattern = r"[\d\s:.,/+TZ-]*\d:\d\d[\d\s:.,+Z-]*([AaPp][Mm])?"
    if not len(filled) or not all(re.fullmatch(pattern, cell) for cell in filled):
        return None
    texts = pd.Series([re.sub(r"(?<=:\d\d),", ".", cell) for cell in cells])
    by_day = bool(re.match(r"\d{1,2}\.", filled.iloc[0]))
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
        table = _parquet(path) if path.suffix.lower() in (".parquet", ".pq") else _csv(path)
    except (OSError, ValueError, LookupError, TypeError, csv.Error) as error:
        # pandas and pyarrow raise the latter for metadata that is not what they write themselves.
        msg = f"{path}: cannot be read as a table: {csv_problem(error)}"
        raise PressError(msg) from error
    cells = table.cells.loc[:, table.cells.columns != ""]
    doubled = sorted({*cells.columns[cells.columns.duplicated()]})
    if doubled:
        msg = f"{path}: columns appear twice: {', '.join(doubled)}; keep one of each"
        raise PressError(msg)
    if len(cells.columns) and all(map(_is_number, cells)):
        msg = f"{path}: its first row holds numbers; write the columns' names above it"
        raise PressError(msg)
    if cells.empty:
        msg = f"{path}: holds no samples; a press log has one row a sample under its header"
        raise PressError(msg)
    return replace(table, cells=cells)


def _csv(path: Path) -> Table:
    _refuse_large(path, path.stat().st_size, LOG.max_bytes, "bytes")
    text = _decoded(path.read_bytes()).replace("\r\n", "\n").replace("\r", "\n")
    _refuse_large(path, text.count("\n"), LOG.max_cells // 2, "rows")
    text = text.replace("\u2212", "-")  # the sign that word processors write
    lines = text.split("\n")
    start, delimiter = _header_line(lines)
    lines[start] = lines[start].lstrip().lstrip(MARKS)
    if delimiter == " ":
        lines = [" ".join(line.split()) for line in lines]
    reader = csv.reader((f"{line}\n" for line in lines[start:]), delimiter=delimiter)
    header = [name.strip() for name in next(reader, [])]
    if not header:
        raise ValueError(_NOTHING)
    _refuse_large(path, len(header) * (len(lines) - start), LOG.max_cells, "cells")
    names, units, headers = [*map(_cell, header)], [""] * len(header), 1
    rows, blocks, is_new = dict[int, list[str]](), list[int](), True
    for number, row in enumerate(reader, start=start + 2):
        cells = [*map(_cell, row)]
        if cells and cells[0].startswith(COMMENT_MARKS):
            continue
        if len(cells) != len(header):
            if any(cells[len(header) :]):
                msg = f"Expected {len(header)} fields in line {number}, saw {len(cells)}"
                raise ValueError(msg)
            cells = [*cells, *[""] * len(header)][: len(header)]
        if cells == names:
            is_new, headers = True, headers + 1
            title = [*filter(None, next(reversed(rows.values()), ()))]
            if len(title) == 1 and not _is_number(title[0]):  # of the block that begins
                rows.popitem()
                del blocks[-1]
        elif is_new and (found := _unit_row(cells)):
            units = units if any(units) else found
        elif not any(cells):
            is_new = True
        else:
            blocks.append(blocks[-1] + is_new if blocks else 0)
            rows[number], is_new = cells, False
    last = next(reversed(rows.values()), [])
    if "\n" in "".join(last) and not text.rstrip().endswith('"'):
        begin = ", ".join(last).splitlines()[0][:40]
        msg = f"a quote that is not closed in the row that begins with {begin!r}"
        raise ValueError(msg)
    header = [
        f"{name} [{unit}]" if unit else name for name, unit in zip(header, units, strict=True)
    ]
    return Table(
        pd.DataFrame([*rows.values()], index=[*rows], columns=header, dtype=object),
        np.array(blocks, dtype=np.int64),
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


def _header_line(lines: Sequence[str]) -> tuple[int, str]:
    """Index of the header's line and the delimiter: what parts it and most rows below it alike.

    The header is the first line, beyond comments and a preamble, whose cells are as many as those
    of the rows; a comment of as many where that line has numbers, as numpy and ROS write it.
    """
    open_lines = [k for k, line in enumerate(lines) if line.strip() and not _is_comment(line)]
    if not open_lines:
        raise ValueError(_NOTHING)
    fallback = open_lines[0], next((d for d in DELIMITERS if d in lines[open_lines[0]]), ",")
    for delimiter in (*DELIMITERS, " "):
        counts = [_count(lines[k], delimiter) for k in open_lines[: LOG.probed_rows]]
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
    if sum(unit in _ALL_UNITS for unit in units) * 2 < sum(map(bool, units)) or not any(units):
        return []
    return [] if any(np.isfinite(_number(cell)) for cell in cells) else units


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
    return Table(cells, np.zeros(len(cells), dtype=np.int64), delimiter="")


def _text(value: object) -> str:
    return _cell(value.decode() if isinstance(value, bytes) else str(value))


def numeric_columns(
    cells: pd.DataFrame, path: Path, names: Iterable[str]
) -> tuple[dict[str, FloatArray], list[str]]:
    """Those of ``names`` that the table has, as float64; empty cells are NaN; and the problems."""
    numbers: dict[str, FloatArray] = {}
    problems = []
    for name in names:
        if name not in cells:
            continue
        values = parsed(cells[name])
        bad = cells[name][np.isnan(values) & (cells[name] != "")]
        for row, cell in bad.iloc[: LOG.max_listed].items():
            fix = "use a decimal point" if "," in cell else "write a number or leave it empty"
            problems.append(f"{path}: row {row}: {name} = {cell!r} is not a number; {fix}")
        if len(bad) > LOG.max_listed:
            problems.append(f"{path}: … and {len(bad) - LOG.max_listed} more such cells in {name}")
        numbers[name] = np.where(np.isfinite(values), values, np.nan)
    return numbers, problems


def trial_number_problems(trial: FloatArray, path: Path, rows: Sequence[int]) -> list[str]:
    """Trials that are empty or no integers, a line each."""
    wrong = np.flatnonzero(~(trial == np.round(trial)))
    return [
        f"{path}: row {rows[index]}: trial is "
        f"{'empty' if np.isnan(trial[index]) else format(trial[index], 'g')}, not an integer; "
        "give each press a number"
        for index in wrong[: LOG.max_listed]
    ]


def parsed(cells: Iterable[str]) -> FloatArray:
    """The cells as numbers (N,); NaN where they are none."""
    cells = list(cells)
    text = "".join(cells)
    plain = text.isascii() and "_" not in text
    try:  # several times as fast
        return np.array([*map(float if plain else _number, cells)], dtype=np.float64)
    except ValueError:
        return np.array([*map(_number, cells)], dtype=np.float64)


def _number(cell: str) -> float:
    try:
        # Python also reads 1_000 and the digits of other scripts.
        return float(cell) if cell.isascii() and "_" not in cell else float("nan")
    except ValueError:
        return float("nan")

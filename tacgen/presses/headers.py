"""What a header says in a laboratory's table: which quantity of a press log, in which unit.

A column is found by its own name, by another name for the same quantity (`Fz [N]`, `Depth (um)`,
`Press #`), or by what the user says. A unit that is not one of the quantity is not guessed.
"""

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from tacgen.core.errors import PressError
from tacgen.core.types import STANDARD_GRAVITY_M_S2

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
UNITS = {
    end: {word: factor for words, factor in units.items() for word in words.split()}
    for end, units in _SPELLINGS.items()
}
"""What one of each unit is in the unit that ends a column's name."""
_ALL_UNITS = frozenset(itertools.chain(*UNITS.values()))

_SYNONYMS: dict[str, str] = {
    "trial": "trial, press, run, test, repetition, specimen, cycle, versuch, prüfung, messung, "
    "probe, essai, ensayo",
    "time_s": "time, timestamp, time stamp, t, elapsed, elapsed time, clock, test time, zeit, "
    "prüfzeit, zeitstempel, temps, tiempo",
    "force_normal_n": "force, normal force, force normal, fz, force z, z force, fn, F, load, "
    "normal load, axial force, load cell, contact force, press force, standard force, "
    "wrench force z, kraft, normalkraft, standardkraft, force normale, effort, fuerza, "
    "fuerza normal",
    "volume_mm3": "volume, vol, indented volume, indentation volume, displaced volume",
    "depth_mm": "depth, indentation, indentation depth, press depth, penetration, travel, "
    "penetration depth, displacement, axial displacement, compression, compressive displacement, "
    "extension, compressive extension, distance, deformation, stroke, tiefe, eindringtiefe, weg, "
    "standardweg, profondeur, enfoncement, déplacement, profundidad, desplazamiento",
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


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a file that is a quantity of a press log."""

    header: str  # in the file, with its unit
    unit: str = ""  # empty where neither header nor user states it
    factor: float = 1.0  # to the unit of the quantity's name
    is_given: bool = False  # the unit, by the user


def units_of(name: str) -> Mapping[str, float]:
    """Units of a quantity, and what one of each is in the unit that ends its name."""
    return {} if name in _WITHOUT_UNIT else UNITS[name.rpartition("_")[2]]


def split_header(header: str) -> tuple[str, str]:
    """A header's text and the unit in brackets at its end, in plain letters; empty without one."""
    match = re.fullmatch(r"(.*\S)\s*[\[({<]([^\[\](){}<>]*)[\])}>]", header.strip())
    return (match[1], _plain_unit(match[2])) if match else (header.strip(), "")


def units_in(cells: Sequence[str]) -> list[str]:
    """The units in a row below the header; empty where it is no such row."""
    units = [_plain_unit(cell.strip("[](){} ")) for cell in cells]
    is_known = sum(unit in _ALL_UNITS for unit in units) * 2 >= sum(map(bool, units)) > 0
    return units if is_known else []


def unit_in(text: str) -> str:
    """A text that is a unit, in plain letters; else empty."""
    return unit if (unit := _plain_unit(text)) in _ALL_UNITS else ""


def find_columns(
    headers: Sequence[str], path: Path, given: Mapping[str, str]
) -> tuple[dict[str, Column], list[str]]:
    """The columns of a press log by their names, and what is not read although it looks so.

    ``given`` are the headers that the user gives. Raises ``PressError`` where they do not fit.
    """
    found: dict[str, Column] = {}
    unclear: list[str] = []
    for name, wanted in given.items():
        column = _given_column(headers, path, name, wanted)
        if column.header in {one.header for one in found.values()}:
            where = f"{path}: --column {name}={wanted!r}"
            msg = f"{where}: another --column names it too; a column is one quantity"
            raise PressError(msg)
        found[name] = column
    for name in (one for one in _WORDS if one not in given):
        taken = {one.header for one in found.values()}
        if name in headers and name not in taken:
            found[name] = Column(name, next(iter(units_of(name)), ""))
            continue
        stated = {h: u for h in headers if h not in taken and (u := _unit_of(h, name)) is not None}
        right = {h: unit for h, unit in stated.items() if not unit or unit in units_of(name)}
        unclear += [
            f"{path}: column {h!r} is not read as {name}: {unit!r} is none of "
            f'{", ".join(units_of(name))}; give --column {name}="HEADER [UNIT]"'
            for h, unit in stated.items()
            if h not in right
        ]
        chosen = right if len(right) == 1 else {h: unit for h, unit in right.items() if unit}
        if len(chosen) == 1:
            ((header, unit),) = chosen.items()
            per_radius = 0.5 if "diameter" in header.lower() else 1.0
            found[name] = Column(header, unit, units_of(name).get(unit, 1.0) * per_radius)
        elif right:
            unclear.append(
                f"{path}: {' and '.join(map(repr, right))} may both be {name}; say which: "
                f'--column {name}="HEADER"'
            )
    return found, unclear


def _given_column(headers: Sequence[str], path: Path, name: str, wanted: str) -> Column:
    """The column that ``--column`` means: in the unit given there, else in the header's own."""
    word, given = split_header(wanted)
    same = [h for h in headers if h == wanted] or [h for h in headers if split_header(h)[0] == word]
    where = f"{path}: --column {name}"
    if len(same) != 1:
        what = "several columns" if same else "no column"
        msg = f"{where}: {what} {wanted!r}; it has {', '.join(map(repr, headers))}"
        raise PressError(msg)
    unit = "" if name in _WITHOUT_UNIT else given or split_header(same[0])[1]
    if unit and unit not in units_of(name):
        known = ", ".join(units_of(name))
        msg = f"{where}={wanted!r}: {unit!r} is not a unit of it that is known; give one of {known}"
        raise PressError(msg)
    return Column(same[0], unit, units_of(name).get(unit, 1.0), bool(given))


def _plain_unit(text: str) -> str:
    unit = text.strip().replace("µ", "u").replace("μ", "u").replace("³", "3").replace("^3", "3")
    return "" if unit in ("-", "#", "1") else unit


def _spoken_unit(text: str, name: str) -> str:
    """The unit of ``name`` that a word is, in the case of a header too: `Mm`, `Sec`; else empty."""
    unit = _plain_unit(text)
    forms = [unit]
    if unit != "MN":  # a million newtons are no thousandth of one
        forms += [unit[:1].lower() + unit[1:], *([unit.lower()] if len(unit) > 1 else [])]
    return next((form for form in forms if form in units_of(name)), "")


def _unit_of(header: str, name: str) -> str | None:
    """The unit in which ``header`` states the quantity ``name``; None where it is of another.

    The unit may stand in brackets or be the last word: `Fz [N]`, `depth_um`, `t/s`.
    """
    text, unit = split_header(header)
    words = re.sub(r"(?<=[a-z]{2})(?=[A-Z])|[^\w³^]+|_", " ", text).split()
    if unit:
        unit = _spoken_unit(unit, name) or unit
    elif len(words) > 1 and (unit := _spoken_unit(words[-1], name)):
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
    is_it = bool({" ".join(spoken), "".join(spoken)} & known)
    needs_unit, has_unit = name not in _UNIT_NOT_NEEDED, name not in _WITHOUT_UNIT
    return unit if is_it and (bool(unit) >= needs_unit) and (has_unit or not unit) else None

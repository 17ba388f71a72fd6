"""The order in time of pictures, by their names."""

import re
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

from tacgen.core.errors import TacgenError

_NUMBER = re.compile(r"(\d+(?:\.\d+)?)")
_CLOCK_DIGITS = 9
"""Digits before the point of a clock's seconds (since 1970, or nanoseconds): no running number."""


def in_time_order(paths: Sequence[Path], error: type[TacgenError] = TacgenError) -> list[Path]:
    """Pictures in the order of the numbers in their names: ``frame2`` comes before ``frame10``.

    Names may differ in nothing but their numbers. A point is read as that of a decimal, as in
    ``1764234000.9731``.

    Raises ``error`` where the names have no order, or more than one: other words, equal numbers,
    or parts behind a point that may be decimals or numbers of their own (``1.9``, ``1.10``).
    """
    if len(paths) < 2:
        return list(paths)
    parts = {path: _NUMBER.split(path.stem) for path in paths}
    folder, example = paths[0].parent, ", ".join(path.name for path in paths[:3])
    fix = "number the pictures in the order of time: 0.png, 1.png, …"
    if len({tuple(part[::2]) for part in parts.values()}) > 1:
        msg = f"{folder}: the names {example} … do not tell the order of the pictures; {fix}"
        raise error(msg)
    texts = [part[1::2] for part in parts.values()]
    decimal = {path: [Fraction(n) for n in part[1::2]] for path, part in parts.items()}
    whole = {path: [tuple(map(int, n.split("."))) for n in part[1::2]]
             for path, part in parts.items()}  # fmt: skip
    ordered = sorted(paths, key=lambda path: decimal[path])
    if len({tuple(numbers) for numbers in decimal.values()}) < len(paths):
        msg = f"{folder}: of {example} … several have the same number; {fix}"
        raise error(msg)
    if ordered != sorted(paths, key=lambda path: whole[path]) and not _are_decimals(texts):
        msg = f"{folder}: {example} … are in one order as decimals, in another as numbers; {fix}"
        raise error(msg)
    return ordered


def _are_decimals(texts: Sequence[Sequence[str]]) -> bool:
    """Whether what stands behind the points is surely a fraction: of a clock, or with a 0 first."""
    pairs = [number.split(".") for numbers in texts for number in numbers if "." in number]
    clock = all(len(first) >= _CLOCK_DIGITS for first, _ in pairs)
    return clock or any(second.startswith("0") and len(second) > 1 for _, second in pairs)

"""Numbers and units as every page shows them."""

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

MISSING = "–"  # shown where there is no number

_POWER = re.compile(r"\b(mm|cm|m|px)([234])\b")
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_UNIT_NAMES = {"1": "", "c": "°C", "degc": "°C", "um": "µm", "deg": "°", "grey": "grey levels"}
_UNIT_NAMES["mislabel_rate"] = ""


def typeset(text: str) -> str:
    """Replace plain powers of lengths by superscripts: ``mm3/N`` becomes ``mm³/N``.

    Names of columns, such as ``volume_mm3``, stay as they are.
    """
    return _POWER.sub(lambda found: found[1] + found[2].translate(_SUPERSCRIPTS), text)


def unit_text(unit: str) -> str:
    """A unit of a result file as people write it; empty for a pure number."""
    over = unit.split("/")
    named = [_UNIT_NAMES.get(part.lower(), part) for part in over]
    if len(named) > 1:
        named[0] = named[0] or "1"
    return typeset("/".join(named))


def number(value: float | None, digits: int = 4) -> str:
    """A number with so many significant digits; very large and small ones as powers of ten."""
    if value is None or not math.isfinite(value):
        return MISSING
    if value == 0:
        return "0"
    power = math.floor(math.log10(abs(value)))
    text, exponent = f"{value:.{max(0, digits - 1 - power)}f}", ""
    if not -4 <= power < 6:
        text, _, exponent = f"{value:.{max(digits - 1, 0)}e}".partition("e")
        exponent = f"·10{str(int(exponent)).translate(_SUPERSCRIPTS)}"
    text = text.rstrip("0").rstrip(".") if "." in text else text
    return f"{text}{exponent}".replace("-", "−")


def fixed(value: float | None, decimals: int) -> str:
    """A number with so many decimal places."""
    if value is None or not math.isfinite(value):
        return MISSING
    # Adding 0 takes the sign from a value that rounds to nothing.
    return f"{round(value, decimals) + 0.0:.{decimals}f}".replace("-", "−")


def decimals_for(error: float | None) -> int:
    """Decimal places that show two digits of ``error``."""
    if error is None or not (math.isfinite(error) and error > 0):
        return 2
    return max(0, 1 - math.floor(math.log10(error)))


def with_error(value: float | None, stderr: float | None, unit: str = "") -> str:
    """``5.135 ± 0.012 mm³/N``: the error with two digits, the value with as many decimals."""
    suffix = f" {unit_text(unit)}".rstrip()
    if stderr is None or not (math.isfinite(stderr) and stderr > 0):
        return number(value) + suffix
    decimals = decimals_for(stderr)
    return f"{fixed(value, decimals)} ± {fixed(stderr, decimals)}{suffix}"


def estimate(record: Mapping[str, Any]) -> str:
    """An estimate of a result file: a dict of value, stderr and unit."""
    return with_error(record["value"], record["stderr"], record.get("unit", ""))


def interval(ends: Sequence[float | None], unit: str = "") -> str:
    """``5.10 to 5.17 mm³/N``, both ends with the decimals that separate them."""
    suffix = f" {unit_text(unit)}".rstrip()
    low, high = ends
    if low is None or high is None:
        return f"{number(low)} to {number(high)}{suffix}"
    decimals = decimals_for(high - low)
    return f"{fixed(low, decimals)} to {fixed(high, decimals)}{suffix}"


def percent(share: float | None, decimals: int = 1) -> str:
    """``3.2 %`` for 0.032."""
    return MISSING if share is None else f"{fixed(100 * share, decimals)} %"


def p_value(value: float | None) -> str:
    """A p-value with two digits."""
    return number(value, 2)

"""Numbers and units as pages show them."""

import math

import pytest

from tacgen.report.formatting import interval, number, typeset, unit_text, with_error


def test_powers_of_lengths_are_raised_and_names_stay():
    assert typeset("5.1 mm3/N of volume_mm3, 3 mm2/px, mm3") == (
        "5.1 mm³/N of volume_mm3, 3 mm²/px, mm³"
    )


@pytest.mark.parametrize(
    ("unit", "text"),
    [("mm3/N", "mm³/N"), ("1/C", "1/°C"), ("1", ""), ("grey", "grey levels"), ("um", "µm")],
)
def test_units_of_result_files_are_typeset(unit, text):
    assert unit_text(unit) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (5.13512, "5.135"),
        (0.0, "0"),
        (-12.0, "−12"),
        (3.7e-9, "3.7·10⁻⁹"),
        (2.5e7, "2.5·10⁷"),
        (None, "–"),
        (math.nan, "–"),
    ],
)
def test_a_number_has_four_digits(value, text):
    assert number(value) == text


def test_a_value_has_the_decimals_of_its_error():
    assert with_error(5.13512, 0.0123, "mm3/N") == "5.135 ± 0.012 mm³/N"
    assert with_error(5.13512, None, "mm3/N") == "5.135 mm³/N"
    assert with_error(1234.6, 120.0) == "1235 ± 120"
    assert with_error(-0.0002, 0.016) == "0.000 ± 0.016"


def test_ends_of_an_interval_have_the_same_decimals():
    assert interval((5.1, 5.1734), "mm3/N") == "5.100 to 5.173 mm³/N"
    assert interval((None, 2.0)) == "– to 2"

"""``tacgen bench``: what it measures has a name, a positive value and a unit."""

import pytest

from tacgen.cli.bench import reading_figures


@pytest.mark.slow
def test_figures_of_reading():
    figures = {name: (value, unit) for name, value, unit, _ in reading_figures(1)}
    assert set(figures) == {"read_ms_320x240", "read_ms_640x480"}
    assert all(value > 0 and unit == "ms" for value, unit in figures.values())

"""Sensors by name: the YAML files of ``recipes/sensors`` and their tables."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, NonNegativeFloat, PositiveFloat, PositiveInt

from tacgen.core.config import Finite, Section
from tacgen.core.errors import RecipeError
from tacgen.core.files import is_file
from tacgen.core.records import Markers, Sensor
from tacgen.core.resources import sensor_path
from tacgen.core.yaml_source import read_yaml, validate


class SensorChoice(Section):
    """A sensor of ``recipes/sensors`` and what to change about it."""

    name: str = "gelsight"
    table: str | None = None
    dome_radius_mm: NonNegativeFloat | None = None
    mm_per_px: PositiveFloat | None = None


def _by_name(given: Any) -> Any:
    return {"name": given} if isinstance(given, str) else given


SensorByName = Annotated[SensorChoice, BeforeValidator(_by_name)]
"""A sensor in a recipe: its name, or a :class:`SensorChoice`."""


class _MarkersYaml(Section):
    rows: PositiveInt
    columns: PositiveInt
    pitch_mm: PositiveFloat
    radius_mm: PositiveFloat


class _Led(Section):
    direction: tuple[Finite, Finite, Finite]
    rgb: tuple[NonNegativeFloat, NonNegativeFloat, NonNegativeFloat]


class _SensorYaml(Section):
    name: str
    height_px: PositiveInt
    width_px: PositiveInt
    mm_per_px: PositiveFloat
    gel_depth_mm: PositiveFloat
    dome_radius_mm: NonNegativeFloat = 0.0
    markers: _MarkersYaml | None = None
    leds: tuple[_Led, ...] = ()
    table: str = ""


def load_sensor(choice: SensorChoice | str, *, needs_table: bool = True) -> Sensor:
    """The sensor that ``choice`` names, with its changes; ``table`` becomes a path that exists.

    With ``needs_table`` False a sensor that is yet to be calibrated has an empty ``table``.

    Raises
    ------
    RecipeError
        If the sensor is unknown, its YAML is wrong or its table is not there.
    """
    choice = SensorChoice(name=choice) if isinstance(choice, str) else choice
    path = sensor_path(choice.name)
    given = validate(_SensorYaml, read_yaml(path))
    table = choice.table or given.table
    places = [path.parent / table, Path(table)]
    if choice.table:
        places.reverse()
    found = next((place for place in places if table and is_file(place)), None)
    if found is None and needs_table:
        msg = f"{path}: there is no table {table!r}; `tacgen calibrate lookup` makes one"
        raise RecipeError(msg)
    return Sensor(
        name=given.name,
        height_px=given.height_px,
        width_px=given.width_px,
        mm_per_px=choice.mm_per_px or given.mm_per_px,
        gel_depth_mm=given.gel_depth_mm,
        dome_radius_mm=(
            given.dome_radius_mm if choice.dome_radius_mm is None else choice.dome_radius_mm
        ),
        markers=Markers(**given.markers.model_dump()) if given.markers else None,
        leds=tuple((led.direction, led.rgb) for led in given.leds),
        table=str(found or ""),
    )

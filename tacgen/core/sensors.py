"""Sensors by name: the YAML files of ``recipes/sensors`` and their tables."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, ClassVar

from pydantic import BeforeValidator, FiniteFloat, NonNegativeFloat, PositiveFloat, PositiveInt

from tacgen.core.errors import RecipeError
from tacgen.core.files import is_file
from tacgen.core.records import Markers, Sensor
from tacgen.core.resources import packaged, sensor_path
from tacgen.core.schema import KeyPath, Located, Section, YamlSource, as_named, read_yaml, validate


class SensorChoice(Located):
    """A sensor of ``recipes/sensors`` and what to change about it."""

    path_key: ClassVar[str] = "table"

    name: str = "gelsight"
    """Name of a shipped sensor, or path of a sensor's YAML file."""
    table: str | None = None
    """Lookup table (table.npz) instead of the sensor's own; a path from the recipe's folder."""
    dome_radius_mm: NonNegativeFloat | None = None
    """Radius of curvature of the gel; 0 for a flat gel."""
    mm_per_px: PositiveFloat | None = None
    """Pixel size on the gel."""


SensorByName = Annotated[
    SensorChoice, BeforeValidator(as_named, json_schema_input_type=str | SensorChoice)
]
"""A sensor in a recipe: its name, or a :class:`SensorChoice`."""


class _Led(Section):
    """A light, for shadows."""

    direction: tuple[FiniteFloat, FiniteFloat, FiniteFloat]
    """Direction from the gel to the light, gel frame."""
    rgb: tuple[NonNegativeFloat, NonNegativeFloat, NonNegativeFloat]
    """Weight of its shadow in each colour channel."""


class _SensorYaml(Section):
    """A sensor."""

    name: str
    """Name of the sensor."""
    height_px: PositiveInt
    """Height of its images."""
    width_px: PositiveInt
    """Width of its images."""
    mm_per_px: PositiveFloat
    """Pixel size on the gel."""
    gel_depth_mm: PositiveFloat
    """Thickness of the gel, the largest indentation."""
    dome_radius_mm: NonNegativeFloat = 0.0
    """Radius of curvature of the gel; 0 for a flat gel."""
    gel_size_mm: tuple[PositiveFloat, PositiveFloat] | None = None
    """Width and height of the gel, which is larger than what the camera sees; 5 mm around the
    window if not given."""
    markers: Markers | None = None
    """Printed dots; none if not given."""
    leds: tuple[_Led, ...] = ()
    """Lights, for ``optics.shadows``."""
    table: str = ""
    """Lookup table (table.npz); a path from this file's folder."""


def shipped_sensor(shape_px: tuple[int, int]) -> str:
    """The first shipped sensor with images of this (height, width); empty if there is none."""
    paths = sorted((packaged("recipes") / "sensors").glob("*.yaml"))
    return next((p.stem for p in paths if load_sensor(p.stem).shape_px == shape_px), "")


def sensor_lines(
    table: Path, shape_px: tuple[int, int], mm_per_px: float, dome_radius_mm: float | None = None
) -> list[str]:
    """Lines of YAML with which a recipe uses ``table``: of a shipped sensor, or of a new one."""
    if name := shipped_sensor(shape_px):
        choice = f"name: {name}, table: {table}, mm_per_px: {mm_per_px:.6g}"
        if dome_radius_mm not in (None, load_sensor(name).dome_radius_mm):
            choice += f", dome_radius_mm: {dome_radius_mm:g}"
        return ["in a recipe in this folder:", f"sensor: {{{choice}}}"]
    return [
        "in a new file my_sensor.yaml in this folder:",
        "name: my_sensor",
        f"height_px: {shape_px[0]}",
        f"width_px: {shape_px[1]}",
        f"mm_per_px: {mm_per_px:.6g}",
        "gel_depth_mm: 2.0   # thickness of the gel",
        *([f"dome_radius_mm: {dome_radius_mm:g}"] if dome_radius_mm else []),
        f"table: {table}",
        "in a recipe in this folder:",
        "sensor: my_sensor.yaml",
    ]


def sensor_problems(
    choice: SensorChoice, source: YamlSource, markers: KeyPath | None = None
) -> Iterator[str]:
    """Problems of the recipe ``source`` with the sensor that it chooses: there is none of the name.

    ``markers`` is the key by which the recipe asks for the sensor's printed dots, if it does.
    """
    try:
        sensor_path(choice.name, beside=choice.folder)
    except RecipeError as error:
        yield source.problem(("sensor",), f"= {choice.name!r}: {error}")
        return
    if markers and load_sensor(choice, needs_table=False).markers is None:
        yield source.problem(markers, f"= true: {no_markers(choice.name)}")


def no_markers(sensor: str) -> str:
    """Why dots cannot be drawn on a sensor's images, with the fix."""
    return (
        f"the sensor {sensor} has no markers to draw; leave them out, or give its dots in the "
        "sensor's file, `markers: {rows, columns, pitch_mm, radius_mm}`"
    )


def load_sensor(choice: SensorChoice | str, *, needs_table: bool = True) -> Sensor:
    """The sensor that ``choice`` names, with its changes; ``table`` becomes a path that exists.

    With ``needs_table`` False a sensor that is yet to be calibrated has an empty ``table``.

    Raises ``RecipeError`` if the sensor is unknown, its YAML is wrong or its table is not there.
    """
    choice = SensorChoice(name=choice) if isinstance(choice, str) else choice
    path = sensor_path(choice.name, beside=choice.folder)
    given = validate(_SensorYaml, read_yaml(path))
    table = choice.table or given.table
    places = [path.parent / table, Path(table)]
    if choice.table:
        places = [*([choice.folder / table] if choice.folder else []), *reversed(places)]
    found = next((place for place in places if table and is_file(place)), None)
    if found is None and needs_table:
        msg = f"{path}: there is no table {table!r}; `tacgen calibrate lookup` makes one"
        raise RecipeError(msg)
    changes = choice.model_dump(include={"mm_per_px", "dome_radius_mm"}, exclude_none=True)
    figures = given.model_dump(exclude={"markers", "leds", "table"}) | changes
    return Sensor(
        **figures,
        markers=given.markers,
        leds=tuple((led.direction, led.rgb) for led in given.leds),
        table=str(found or ""),
    )

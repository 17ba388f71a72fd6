"""What ``object.yaml`` says: the shape, the measured figures, and where each comes from."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar, get_type_hints

from pydantic import (
    AfterValidator,
    Field,
    NonNegativeFloat,
    PositiveFloat,
    StrictFloat,
    StrictInt,
    TypeAdapter,
    ValidationError,
    model_validator,
)

from tacgen.core.config import Axis, Finite, Section, finite
from tacgen.core.errors import ObjectError, TacgenError
from tacgen.core.yaml_source import read_yaml, validate
from tacgen.objects.shapes import BUILDERS

NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$"

Source = Annotated[str, Field(min_length=3)]
Positive = Annotated[PositiveFloat, AfterValidator(finite)]
NotNegative = Annotated[NonNegativeFloat, AfterValidator(finite)]
Byte = Annotated[int, Field(ge=0, le=255)]
FileName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,99}$")]


Value = TypeVar("Value")


class Stated(Section, Generic[Value]):
    """A figure, and where it comes from."""

    value: Value
    """The figure, in the unit that the key names."""
    source: Source
    """Where the value comes from."""


class GraspRanges(Section):
    """Axis values of recipes that do not give them."""

    force_n: Axis
    """Forces of a finger."""
    x_mm: Axis = (0.0,)
    """Gripper's centre along x."""
    y_mm: Axis = (0.0,)
    """Gripper's centre along y."""
    z_mm: Axis
    """Height of the pads' centre above the table."""
    source: Source
    """Where the values come from."""

    def axes(self) -> dict[str, tuple[float, ...]]:
        """The axes by name, without the source."""
        return {name: getattr(self, name) for name in ("force_n", "x_mm", "y_mm", "z_mm")}


class ShapeSource(Section):
    """A procedural builder with its dimensions, or mesh files in the object's folder."""

    builder: str | None = None
    """Name of a procedural shape, instead of a mesh."""
    parameters: dict[str, StrictInt | StrictFloat] = Field(default_factory=dict)
    """Dimensions of the procedural shape."""
    mesh: FileName | None = None
    """Surface, a file in the object's folder."""
    collision: FileName | None = None
    """Convex parts, a file in the object's folder."""
    scale: Positive = 1.0
    """mm per unit of the mesh files."""
    source: Source
    """Where the shape comes from."""

    @model_validator(mode="after")
    def _one_of_both(self) -> ShapeSource:
        if (self.builder is None) == (self.mesh is None):
            msg = "takes either `builder` or `mesh`; give one of them"
            raise ValueError(msg)
        if self.mesh is not None and (self.collision is None or self.parameters):
            msg = "with `mesh` takes `collision` and no `parameters`; see `tacgen objects add`"
            raise ValueError(msg)
        if self.builder is not None:
            if self.collision is not None or self.scale != 1.0:
                msg = "with `builder` takes neither `collision` nor `scale`; remove them"
                raise ValueError(msg)
            _check_parameters(self.builder, self.parameters)
        return self


def _check_parameters(builder: str, given: Mapping[str, float]) -> None:
    """Every parameter must be one that the builder takes, of its type, and none may lack."""
    if builder not in BUILDERS:
        msg = f"builder {builder!r} is not known; known: {', '.join(sorted(BUILDERS))}"
        raise ValueError(msg)
    function = BUILDERS[builder]
    known = inspect.signature(function).parameters
    problems = [
        f"parameters.{name} is not one of {builder}'s: {', '.join(known)}"
        for name in given
        if name not in known
    ]
    problems += [
        f"parameters.{name} is missing"
        for name, parameter in known.items()
        if parameter.default is inspect.Parameter.empty and name not in given
    ]
    hints = get_type_hints(function)
    for name in (name for name in given if name in known):
        try:
            finite(TypeAdapter(hints[name]).validate_python(given[name]))
        except (ValidationError, ValueError):
            problems.append(f"parameters.{name} = {given[name]!r} is not a {hints[name].__name__}")
    if problems:
        raise ValueError("; ".join(problems))


class ObjectDescription(Section):
    """One object, as ``object.yaml`` describes it."""

    name: Annotated[str, Field(pattern=NAME_PATTERN)]
    """Name of the object and of its folder."""
    description: str = ""
    """One sentence on it."""
    shape: ShapeSource
    """The surface and the convex parts."""
    mass_kg: Stated[Positive]
    """The weighed mass."""
    center_of_mass_mm: Stated[tuple[Finite, Finite, Finite]]
    """Centre of mass in the object's frame: x, y and z."""
    dimensions_mm: Stated[tuple[PositiveFloat, PositiveFloat, PositiveFloat]]
    """Extents along x, y and z of the object in its rest pose."""
    friction: Stated[Annotated[NotNegative, Field(le=2.0)]]
    """Coulomb coefficient against the gel."""
    spinning_friction_mm: Stated[NotNegative]
    """Largest moment about the contact normal over normal force."""
    grasp_ranges: GraspRanges
    """Grasps of recipes that do not give an axis."""
    color_rgb: tuple[Byte, Byte, Byte] = (190, 190, 190)
    """Colour in pictures, 0 to 255."""

    def build_arguments(self) -> dict[str, Any]:
        """The builder's keyword arguments, each of the type that it asks for."""
        if self.shape.builder is None:
            return {}
        hints = get_type_hints(BUILDERS[self.shape.builder])
        return {name: hints[name](value) for name, value in self.shape.parameters.items()}


def read_description(folder: Path) -> ObjectDescription:
    """Read and check ``folder/object.yaml``.

    Raises ``ObjectError`` if it cannot be read; every problem in it is listed.
    """
    path = Path(folder) / "object.yaml"
    try:
        source = read_yaml(path)
    except TacgenError as error:
        raise ObjectError(str(error)) from None
    description = validate(ObjectDescription, source, ObjectError)
    if description.name != Path(folder).resolve().name:
        msg = source.problem(
            ("name",),
            f"= {description.name!r}, but its folder is called {Path(folder).resolve().name!r}; "
            "make them the same",
        )
        raise ObjectError(msg)
    return description

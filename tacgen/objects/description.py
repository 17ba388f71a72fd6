"""What ``object.yaml`` says: the shape, the measured figures, and where each comes from."""

from pathlib import Path
from typing import Annotated, Generic, Literal, TypeVar

from pydantic import (
    AllowInfNan,
    ConfigDict,
    Field,
    FiniteFloat,
    NonNegativeFloat,
    PositiveFloat,
    StrictFloat,
    model_validator,
)

from tacgen.core.errors import ObjectError, TacgenError
from tacgen.core.schema import Axis, Section, read_yaml, validate

NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$"

Source = Annotated[str, Field(min_length=3)]
Positive = Annotated[PositiveFloat, AllowInfNan(False)]
NotNegative = Annotated[NonNegativeFloat, AllowInfNan(False)]
Dimension = Annotated[StrictFloat, Field(gt=0, le=1000)]
"""mm; ``tacgen objects add`` refuses larger meshes too."""
Byte = Annotated[int, Field(ge=0, le=255)]
FileName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,99}$")]

Row = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Value = TypeVar("Value")

SOLIDS = {
    "box": {"x_mm", "y_mm", "z_mm"},
    "cylinder": {"diameter_mm", "height_mm"},
    "sphere": {"diameter_mm"},
}
"""Parameters of each ``shape.builder``."""


class Stated(Section, Generic[Value]):
    """A figure, and where it comes from."""

    # Docstrings would be looked up again for each type of `Stated`, which takes 10 ms each.
    model_config = ConfigDict(use_attribute_docstrings=False)

    value: Value = Field(description="The figure, in the unit that the key names.")
    source: Source = Field(description="Where the value comes from.")


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
    """Mesh files in the object's folder, or a plain solid with its dimensions."""

    builder: Literal["box", "cylinder", "sphere"] | None = None
    """Name of a plain solid, instead of a mesh."""
    parameters: dict[str, Dimension] = Field(default_factory=dict)
    """Dimensions of the plain solid."""
    mesh: FileName | None = None
    """Surface, a file in the object's folder."""
    collision: FileName | None = None
    """Convex parts, a file in the object's folder."""
    scale: Positive = 1.0
    """mm per unit of the mesh files."""
    source: Source
    """Where the shape comes from."""

    @model_validator(mode="after")
    def _one_of_both(self) -> "ShapeSource":
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
            if set(self.parameters) != SOLIDS[self.builder]:
                names = ", ".join(sorted(SOLIDS[self.builder]))
                msg = f"a {self.builder} has the parameters {names}; give exactly these"
                raise ValueError(msg)
        return self


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
    center_of_mass_mm: Stated[Row]
    """Centre of mass in the object's frame: x, y and z."""
    inertia_kg_mm2: Stated[tuple[Row, Row, Row]] | None = None
    """Inertia about the centre of mass; without it that of an even filling."""
    dimensions_mm: Stated[tuple[PositiveFloat, PositiveFloat, PositiveFloat]]
    """Extents along x, y and z of the object in its rest pose."""
    friction: Stated[Annotated[NotNegative, Field(le=2.0)]]
    """Coulomb coefficient against the gel."""
    spinning_friction_mm: Stated[NotNegative] | None = None
    """Largest moment about the contact normal over normal force; without it that of the gel."""
    grasp_ranges: GraspRanges
    """Grasps of recipes that do not give an axis."""
    color_rgb: tuple[Byte, Byte, Byte] = (190, 190, 190)
    """Colour in pictures, 0 to 255."""


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

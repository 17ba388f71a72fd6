"""What every YAML of tacgen is made of: sections without unknown keys, numbers, axes of a grid."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    FiniteFloat,
    PrivateAttr,
)

MAX_AXIS_VALUES = 10_000  # more is a misspelt axis


class Section(BaseModel):
    """A part of a YAML file: frozen, and no key that is not known."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)


def as_named(given: Any) -> Any:
    """A section that is given by its name alone."""
    return {"name": given} if isinstance(given, str) else given


class Located(Section):
    """A section that names files; relative paths start at the folder of the YAML file."""

    path_key: ClassVar[str] = "file"
    """The key that holds the path."""

    _folder: Path | None = PrivateAttr(None)

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and self.__dict__ == other.__dict__

    @property
    def folder(self) -> Path | None:
        """Folder of the YAML file that holds the section; None if no file does."""
        return self._folder


def set_folders(
    value: object, folder_of: Callable[[tuple[str | int, ...]], Path], key_path: Any = ()
) -> None:
    """Set the folder of every located section in ``value``, by its key path in the file."""
    if isinstance(value, (list, tuple)):
        for i, item in enumerate(value):
            set_folders(item, folder_of, (*key_path, i))
    elif isinstance(value, Section):
        if isinstance(value, Located):
            value._folder = folder_of((*key_path, value.path_key))
        for name in type(value).model_fields:
            set_folders(getattr(value, name), folder_of, (*key_path, name))


def _axis_values(given: Any) -> Any:
    """``4.0``, ``[1, 2]``, ``{linspace: [a, b, n]}`` and the like as a list."""
    if isinstance(given, (int, float)) and not isinstance(given, bool):
        return [given]
    if isinstance(given, (list, tuple)):
        return given
    kinds = ("linspace", "geomspace", "range")
    if not isinstance(given, dict) or len(given) != 1 or next(iter(given)) not in kinds:
        msg = (
            "must be a number, a list, {linspace: [start, stop, count]}, "
            "{geomspace: [start, stop, count]} or {range: [start, stop, step]}"
        )
        raise ValueError(msg)
    kind, arguments = next(iter(given.items()))
    is_triple = isinstance(arguments, list) and len(arguments) == 3
    if not (is_triple and all(isinstance(x, (int, float)) and math.isfinite(x) for x in arguments)):
        msg = f"{kind} takes three numbers, got {arguments!r}"
        raise ValueError(msg)
    start, stop, third = map(float, arguments)
    if kind == "geomspace" and min(start, stop) <= 0:
        msg = f"geomspace goes by equal factors between values above 0, got {arguments!r}"
        raise ValueError(msg)
    if kind == "range":
        if third == 0 or (stop - start) / third < 0:
            msg = f"range from {start:g} to {stop:g} cannot be divided into steps of {third:g}"
            raise ValueError(msg)
        # A small tolerance keeps the end value in, whatever 0.05 is in binary.
        count = int(np.floor((stop - start) / third + 1e-9)) + 1
        stop = start + (count - 1) * third
    elif (count := int(third)) < 1 or count != third:
        msg = f"{kind} takes a whole number of values, at least 1, got {arguments[2]!r}"
        raise ValueError(msg)
    if count > MAX_AXIS_VALUES:
        msg = f"has {count} values, more than {MAX_AXIS_VALUES}"
        raise ValueError(msg)
    spaced = np.geomspace if kind == "geomspace" else np.linspace
    return [round(float(value), 9) for value in spaced(start, stop, count)]


def _distinct(values: tuple[float, ...]) -> tuple[float, ...]:
    if not values:
        msg = "is empty; give at least one value"
        raise ValueError(msg)
    return tuple(dict.fromkeys(values))


Axis = Annotated[
    tuple[FiniteFloat, ...],
    BeforeValidator(
        _axis_values, json_schema_input_type=float | list[float] | dict[str, list[float]]
    ),
    AfterValidator(_distinct),
]

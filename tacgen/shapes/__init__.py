"""Procedural objects: surfaces with the detail that a gel feels, from published dimensions.

A builder is a pure function from keyword dimensions (mm) to a ``Shape``. ``object.yaml`` names
it by its key in ``BUILDERS``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from tacgen.shapes.boxes import carton
from tacgen.shapes.cans import drawn_can, round_can
from tacgen.shapes.shape import Body, Shape

BUILDERS: Mapping[str, Callable[..., Shape]] = MappingProxyType(
    {builder.__name__: builder for builder in (round_can, drawn_can, carton)}
)

__all__ = ["BUILDERS", "Body", "Shape"]

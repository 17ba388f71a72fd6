"""Procedural objects: surfaces with the detail that a gel feels, from published dimensions.

A builder is a pure function from keyword dimensions (mm) to a ``Shape``. ``object.yaml`` names
it by its key in ``BUILDERS``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from tacgen.objects.shapes.boxes import carton, wood_block
from tacgen.objects.shapes.cans import drawn_can, round_can
from tacgen.objects.shapes.containers import mug, squeeze_bottle
from tacgen.objects.shapes.fruit import strawberry
from tacgen.objects.shapes.scissors import scissors
from tacgen.objects.shapes.screwdriver import flat_screwdriver
from tacgen.objects.shapes.shape import Body, Shape
from tacgen.objects.shapes.spatula import slotted_spatula
from tacgen.objects.shapes.toys import golf_ball, twisty_cube

_BUILDERS = (
    carton,
    drawn_can,
    flat_screwdriver,
    golf_ball,
    mug,
    round_can,
    scissors,
    slotted_spatula,
    squeeze_bottle,
    strawberry,
    twisty_cube,
    wood_block,
)

BUILDERS: Mapping[str, Callable[..., Shape]] = MappingProxyType(
    {builder.__name__: builder for builder in _BUILDERS}
)

__all__ = ["BUILDERS", "Body", "Shape"]

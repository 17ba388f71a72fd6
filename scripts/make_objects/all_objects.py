"""The shipped objects by name, with their published dimensions.

Source: the object table of Calli et al. 2015 (Table I); the can's seam is that of a 211 × 400 can,
2 11/16 in. All that no table gives is drawn by eye or has typical values.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
from numpy.typing import NDArray

from scripts.make_objects.boxes import carton, wood_block
from scripts.make_objects.cans import drawn_can, round_can
from scripts.make_objects.containers import mug, squeeze_bottle
from scripts.make_objects.fruit import strawberry
from scripts.make_objects.scissors import scissors
from scripts.make_objects.screwdriver import flat_screwdriver
from scripts.make_objects.shape import Shape
from scripts.make_objects.spatula import slotted_spatula
from scripts.make_objects.toys import golf_ball, twisty_cube
from tacgen.core.resources import packaged
from tacgen.objects.description import read_description
from tacgen.objects.meshes import mass_properties

OBJECTS: Mapping[str, Callable[[], Shape]] = {
    "cup": partial(mug, diameter_mm=80.0, height_mm=82.0),
    "flat_screwdriver": partial(flat_screwdriver, handle_diameter_mm=31.0, length_mm=215.0),
    "golf_ball": partial(golf_ball, diameter_mm=42.7),
    "mustard_bottle": partial(squeeze_bottle, width_mm=50.0, length_mm=85.0, height_mm=175.0),
    "potted_meat_can": partial(
        drawn_can, width_mm=50.0, length_mm=97.0, height_mm=82.0, corner_mm=14.0
    ),
    "rubiks_cube": partial(twisty_cube, side_mm=57.0),
    "scissors": partial(scissors, width_mm=87.0, length_mm=200.0, thickness_mm=14.0),
    "spatula": partial(slotted_spatula, width_mm=83.0, length_mm=350.0, height_mm=35.0),
    "strawberry": partial(strawberry, diameter_mm=43.8, length_mm=55.0),
    "sugar_box": partial(carton, width_mm=38.0, length_mm=89.0, height_mm=175.0),
    "tomato_soup_can": partial(
        round_can, body_diameter_mm=66.0, height_mm=101.0, seam_diameter_mm=68.3
    ),
    "wood_block": partial(wood_block, side_mm=85.0, height_mm=200.0),
}


def inertia_kg_mm2(name: str, shape: Shape) -> NDArray[np.float64]:
    """The inertia (3, 3) of a shape of several materials, scaled to the weighed mass."""
    mass_kg = read_description(packaged("objects") / name).mass_kg.value
    bodies = [(body.mesh, body.density_kg_m3) for body in shape.bodies]
    return mass_properties(bodies, mass_kg)[1]

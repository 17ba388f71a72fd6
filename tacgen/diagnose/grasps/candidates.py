"""What may be wrong with a simulated grasp: the candidates, their bounds and their prior spread."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

NAMES = (
    "grip_force",
    "mass",
    "center_of_mass",
    "friction",
    "spinning_friction",
    "height_offset",
    "compliance",
    "scale",
)
WHOLE_WORLD = ("grip_force", "height_offset", "compliance")


@dataclass(frozen=True, slots=True)
class Parameter:
    """A number of the simulated world that a candidate moves.

    Attributes
    ----------
    key
        Name of the field of ``altered_worlds.Alteration``.
    nodes : tuple of float
        Values at which outcomes are simulated or predicted, ascending, the declared one among
        them; in between they are interpolated.
    spread : float
        Prior standard deviation about the declared value, of the logarithm for a factor.
    """

    name: str
    key: str
    unit: str
    declared: float
    nodes: tuple[float, ...]
    spread: float

    @property
    def is_factor(self) -> bool:
        """Whether the number multiplies what is declared."""
        return self.declared == 1.0

    def coordinate(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values on the axis on which the prior is normal and outcomes are interpolated."""
        return np.log(values) if self.is_factor else np.asarray(values, dtype=np.float64)

    def value(self, coordinate: float) -> float:
        """The value at a place on that axis."""
        return math.exp(coordinate) if self.is_factor else coordinate


_FACTORS = (0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.25, 1.4, 1.6, 2.0)
_RECIPROCALS = tuple(1 / factor for factor in reversed(_FACTORS))
_OFFSETS_N = tuple(0.25 * k for k in range(-16, 17))

PARAMETERS = (
    Parameter("grip_force", "force_scale", "1", 1.0, _FACTORS, 0.2),
    Parameter("grip_force", "force_offset_n", "N", 0.0, _OFFSETS_N, 1.0),
    Parameter("mass", "mass_factor", "1", 1.0, _RECIPROCALS, 0.4),
    Parameter(
        "center_of_mass", "center_of_mass_x_mm", "mm", 0.0, (-30.0, -15.0, 0.0, 15.0, 30.0), 20.0
    ),
    Parameter(
        "center_of_mass",
        "center_of_mass_y_mm",
        "mm",
        0.0,
        (-30.0, -20.0, -10.0, 0.0, 10.0, 20.0, 30.0),
        20.0,
    ),
    Parameter(
        "center_of_mass", "center_of_mass_z_mm", "mm", 0.0, (-30.0, -15.0, 0.0, 15.0, 30.0), 20.0
    ),
    Parameter("friction", "friction_factor", "1", 1.0, _FACTORS, 0.5),
    Parameter(
        "spinning_friction",
        "spinning_friction_factor",
        "1",
        1.0,
        (0.5, 0.7, 0.85, 1.0, 1.2, 1.5, 2.0),
        0.4,
    ),
    Parameter("height_offset", "height_offset_mm", "mm", 0.0, (-4.0, 0.0, 4.0), 3.0),
    Parameter("compliance", "compliance_mm_per_n", "mm/N", 0.0, (0.0, 0.1), 0.1),
    Parameter("scale", "object_scale", "1", 1.0, (0.95, 1.0, 1.05), 0.05),
)
"""Spreads are the sizes of error that are usual: a gripper's force is off by a fifth, a container
is full or half empty, a centre of mass is off by centimetres."""


NAME_WEIGHTS = {
    "grip_force": 1.5,
    "mass": 1.0,
    "center_of_mass": 1.0,
    "friction": 0.7,
    "spinning_friction": 0.3,
    "height_offset": 0.3,
    "compliance": 0.3,
    "scale": 0.3,
}
"""Prior weights: masses are weighed, while the force between the pads is hardly ever measured;
friction has been calibrated on labels of the same kind before (`tacgen friction`); the last four
rarely decide a grasp."""
_SHARES = {"force_scale": 0.7, "force_offset_n": 0.3}
"""Parts of one name's weight; equal where not given."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """A parameter, the objects whose grasps it acts on, and its prior weight."""

    parameter: Parameter
    objects: tuple[str, ...]
    share: float

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.parameter.name


def candidates_for(objects: Sequence[str]) -> tuple[Candidate, ...]:
    """Every candidate for grasps of these objects.

    What belongs to the gripper or the table acts on all of them. What belongs to an object is
    tried for each object alone and for all of them together, since a worn gel, a wrong habit of
    weighing or of placing touches all.
    """
    found = []
    for parameter in PARAMETERS:
        of_name = sum(other.name == parameter.name for other in PARAMETERS)
        if parameter.name in WHOLE_WORLD or len(objects) == 1:
            sets = [tuple(objects)]
        else:
            sets = [(name,) for name in objects]
            sets.append(tuple(objects))
        part = _SHARES.get(parameter.key, 1 / of_name)
        weight = NAME_WEIGHTS[parameter.name] * part / len(sets)
        found += [Candidate(parameter, chosen, weight) for chosen in sets]
    return tuple(found)


_ADVICE = {
    frozenset(("mass", "friction")): "weigh the object",
    frozenset(("mass", "grip_force")): "weigh the object, or measure the force between the pads; "
    "a second object tells too: the force is common to both",
    frozenset(("friction", "grip_force")): "measure the force between the pads, or grasp a second "
    "object of another surface: the force is common to both",
    frozenset(("center_of_mass", "mass")): "weigh the object, and balance it on an edge",
    frozenset(("center_of_mass", "friction")): "balance the object on an edge",
    frozenset(("center_of_mass", "grip_force")): "balance the object on an edge",
    frozenset(("center_of_mass", "spinning_friction")): "grasp on both sides of the centre: a "
    "shift helps on one side and harms on the other",
    frozenset(("height_offset", "scale")): "measure the object and the height of the pads",
}


def advice(name: str, other: str) -> str:
    """What would tell two candidates apart for certain."""
    known = _ADVICE.get(frozenset((name, other)))
    return f"{name} or {other}: {known or 'grasps in which the two predict different outcomes'}"

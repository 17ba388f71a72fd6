"""The gel beside a contact, where it does not fall off as the calibration's exponential does."""

from collections.abc import Mapping
from types import MappingProxyType

from tacgen.optics.effects import effect as base

SKIRT_RADII = (1.1, 1.35, 1.7, 2.2)
"""Where the slope's factor is a parameter, in contact radii; the last holds beyond. The rim, half a
decay length of the usual gel outside it, one, and two."""


SLOPES = {
    f"slope_{radii:g}_radii": base.OpticalParameter(1.0, 0.2, 3.0, step=0.05, prior=0.5)
    for radii in SKIRT_RADII
}


class Skirt(base.OpticalEffect):
    """The slope that a press adds beside its contact is a multiple of the exponential's.

    What a table carries of it is ``width``: how many times as wide as Taxim's the skirt around
    any object is drawn, such that a ball's has the slopes that were found.
    """

    name = "skirt"
    stage = base.Stage.GEL
    parameters = MappingProxyType({**SLOPES, "width": base.OpticalParameter(1.0, 1.0, 4.0)})

    def slope_factors(self, **values: float) -> tuple[tuple[float, float], ...]:
        """At each of ``SKIRT_RADII`` its parameter; nothing where none is given."""
        if not values.keys() & SLOPES:
            return ()
        given = (values.get(name, p.identity) for name, p in SLOPES.items())
        return tuple(zip(SKIRT_RADII, given, strict=True))

    def candidates(self, scene: base.PressScene) -> list[base.OpticalCandidate]:
        """One curve for all presses and colours."""
        one = "one curve for all colours"
        return [base.OpticalCandidate(self.name, one, SLOPES, rigid=True)]


SKIRT = base.register(Skirt())


def skirt_width(effects: Mapping[str, Mapping[str, float]]) -> float:
    """How many times as wide as Taxim's a table's effects make the skirt around a contact."""
    return effects.get(SKIRT.name, {}).get("width", 1.0)

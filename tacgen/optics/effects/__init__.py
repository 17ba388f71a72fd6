"""Optical effects: one module each, which registers what it defines."""

from importlib import import_module
from pkgutil import iter_modules

from tacgen.optics.effects.effect import (
    Candidate,
    OpticalEffect,
    Parameter,
    Patch,
    PressScene,
    Stage,
    check_effects,
    optical_effect,
    optical_effects,
    register,
    unregister,
)
from tacgen.optics.effects.shadow import with_cast_shadows

for _module in iter_modules(__path__):
    import_module(f"{__name__}.{_module.name}")

__all__ = [
    "Candidate",
    "OpticalEffect",
    "Parameter",
    "Patch",
    "PressScene",
    "Stage",
    "check_effects",
    "optical_effect",
    "optical_effects",
    "register",
    "unregister",
    "with_cast_shadows",
]

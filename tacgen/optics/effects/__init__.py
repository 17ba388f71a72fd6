"""Optical effects: one module each, which registers what it defines."""

from importlib import import_module
from pkgutil import iter_modules

from tacgen.optics.effects.effect import OpticalCandidate as OpticalCandidate
from tacgen.optics.effects.effect import OpticalEffect as OpticalEffect
from tacgen.optics.effects.effect import OpticalParameter as OpticalParameter
from tacgen.optics.effects.effect import Patch as Patch
from tacgen.optics.effects.effect import PressScene as PressScene
from tacgen.optics.effects.effect import Stage as Stage
from tacgen.optics.effects.effect import check_effects as check_effects
from tacgen.optics.effects.effect import optical_effect as optical_effect
from tacgen.optics.effects.effect import optical_effects as optical_effects
from tacgen.optics.effects.effect import register as register
from tacgen.optics.effects.effect import unregister as unregister
from tacgen.optics.effects.shadow import with_cast_shadows as with_cast_shadows

for _module in iter_modules(__path__):
    import_module(f"{__name__}.{_module.name}")

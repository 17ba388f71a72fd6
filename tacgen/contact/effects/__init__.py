"""What a linear contact law can lack: one module an effect, one registry.

Every module of this folder is imported, and those of effects register themselves.
"""

from importlib import import_module
from pkgutil import iter_modules

from tacgen.contact.effects.base import (
    CHANNELS,
    STAGES,
    Channel,
    Effect,
    LoadHistory,
    Parameter,
    Stage,
    Variant,
    all_effects,
    find_effect,
    register,
    separating_measurement,
)

for _module in iter_modules(__path__):
    import_module(f"{__name__}.{_module.name}")

__all__ = [
    "CHANNELS",
    "STAGES",
    "Channel",
    "Effect",
    "LoadHistory",
    "Parameter",
    "Stage",
    "Variant",
    "all_effects",
    "find_effect",
    "register",
    "separating_measurement",
]

"""What a linear contact law can lack: one module an effect, one registry."""

from tacgen.contact.effects import (  # noqa: F401  (importing a module registers its effects)
    anisotropy,
    conditioning,
    creep,
    drift,
    geometry,
    hysteresis,
    latency,
    normal_coupling,
    position,
    saturation,
    shear_coupling,
    slip,
    stiffening,
    temperature,
    zero_offset,
)
from tacgen.contact.effects.history import LoadHistory
from tacgen.contact.effects.registry import (
    CHANNELS,
    STAGES,
    Channel,
    Effect,
    Parameter,
    Stage,
    Variant,
    all_effects,
    effect_names,
    find_effect,
    register,
)

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
    "effect_names",
    "find_effect",
    "register",
]

"""Optical effects: one module each, which registers what it defines."""

from tacgen.optics.effects import (
    background_gain,
    blur,
    cross_talk,
    illumination,
    press_center,
    saturation,
    scale,
    shadow,
    vignetting,
)
from tacgen.optics.effects.effect import (
    Candidate,
    Leds,
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
from tacgen.optics.effects.shadow import leds_of_table, with_cast_shadows

__all__ = [
    "Candidate",
    "Leds",
    "OpticalEffect",
    "Parameter",
    "Patch",
    "PressScene",
    "Stage",
    "background_gain",
    "blur",
    "check_effects",
    "cross_talk",
    "illumination",
    "leds_of_table",
    "optical_effect",
    "optical_effects",
    "press_center",
    "register",
    "saturation",
    "scale",
    "shadow",
    "unregister",
    "vignetting",
    "with_cast_shadows",
]

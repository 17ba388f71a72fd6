"""Exposure, or lamps, that changed since the background was photographed."""

from __future__ import annotations

from types import MappingProxyType
from typing import Any

from tacgen.core.arrays import FloatArray
from tacgen.optics.effects.effect import (
    CHANNELS,
    Candidate,
    OpticalEffect,
    Parameter,
    Patch,
    PressScene,
    Stage,
    by_channel,
    register,
)

PRESS_GAIN = Parameter(0.0, -0.5, 0.5, prior=0.05)
PRESS_OFFSET = Parameter(0.0, -80.0, 80.0, "grey", step=0.5, prior=4.0)
"""What single presses differ by: a camera's own regulation moves an exposure by some percent."""


class BackgroundGain(OpticalEffect):
    """A gain and an offset of each channel."""

    name = "background_gain"
    stage = Stage.EXPOSURE
    parameters = MappingProxyType(
        {
            **{f"gain_{c}": Parameter(1.0, 0.4, 1.6, prior=0.3) for c in CHANNELS},
            **{
                f"offset_{c}": Parameter(0.0, -80.0, 80.0, "grey", step=0.5, prior=30.0)
                for c in CHANNELS
            },
        }
    )

    def apply(self, array: FloatArray, patch: Patch, **values: Any) -> FloatArray:
        """Gain · image + offset."""
        gain = by_channel([values.get(f"gain_{c}", 1.0) for c in CHANNELS], array)
        offset = by_channel([values.get(f"offset_{c}", 0.0) for c in CHANNELS], array)
        return array * gain + offset

    def candidates(self, scene: PressScene) -> list[Candidate]:
        """Of all presses alike, or scattered over them."""
        gains = {name: p for name, p in self.parameters.items() if name.startswith("gain")}
        offsets = {name: p for name, p in self.parameters.items() if name.startswith("offset")}
        return [
            Candidate(self.name, "exposure and offset since the background", self.parameters),
            Candidate(
                self.name, "offset of each picture", offsets, dict.fromkeys(offsets, PRESS_OFFSET)
            ),
            Candidate(
                self.name, "exposure of each picture", gains, dict.fromkeys(gains, PRESS_GAIN)
            ),
        ]


register(BackgroundGain())

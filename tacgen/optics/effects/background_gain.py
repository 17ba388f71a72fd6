"""Exposure, or lamps, that changed since the background was photographed."""

from __future__ import annotations

from types import MappingProxyType
from typing import Any

from tacgen.core.arrays import FloatArray
from tacgen.optics.effects import effect as base

PRESS_GAIN = base.Parameter(0.0, -0.5, 0.5, prior=0.05)
PRESS_OFFSET = base.Parameter(0.0, -80.0, 80.0, "grey", step=0.5, prior=4.0)
"""What single presses differ by: a camera's own regulation moves an exposure by some percent."""


class BackgroundGain(base.OpticalEffect):
    """A gain and an offset of each channel."""

    name = "background_gain"
    stage = base.Stage.EXPOSURE
    parameters = MappingProxyType(
        {
            **{f"gain_{c}": base.Parameter(1.0, 0.4, 1.6, prior=0.3) for c in base.CHANNELS},
            **{
                f"offset_{c}": base.Parameter(0.0, -80.0, 80.0, "grey", step=0.5, prior=30.0)
                for c in base.CHANNELS
            },
        }
    )

    def apply(self, array: FloatArray, patch: base.Patch, **values: Any) -> FloatArray:
        """Gain · image + offset."""
        gain = base.by_channel([values.get(f"gain_{c}", 1.0) for c in base.CHANNELS], array)
        offset = base.by_channel([values.get(f"offset_{c}", 0.0) for c in base.CHANNELS], array)
        return array * gain + offset

    def candidates(self, scene: base.PressScene) -> list[base.Candidate]:
        """Of all presses alike, or scattered over them."""
        gains = {name: p for name, p in self.parameters.items() if name.startswith("gain")}
        offsets = {name: p for name, p in self.parameters.items() if name.startswith("offset")}
        return [
            base.Candidate(self.name, "exposure and offset since the background", self.parameters),
            base.Candidate(
                self.name, "offset of each picture", offsets, dict.fromkeys(offsets, PRESS_OFFSET)
            ),
            base.Candidate(
                self.name, "exposure of each picture", gains, dict.fromkeys(gains, PRESS_GAIN)
            ),
        ]


base.register(BackgroundGain())

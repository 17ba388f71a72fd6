"""Exposure, or lamps, that changed since the background was taken."""

from types import MappingProxyType
from typing import Any

from tacgen.core.types import FloatArray
from tacgen.optics.effects import effect as base

GAINS = {f"gain_{c}": base.OpticalParameter(1.0, 0.4, 1.6, prior=0.3) for c in base.CHANNELS}
DRIFTS = {f"drift_{c}": base.OpticalParameter(0.0, -0.8, 0.8, prior=0.3) for c in base.CHANNELS}
OFFSETS = {
    f"offset_{c}": base.OpticalParameter(0.0, -80.0, 80.0, "grey", step=0.5, prior=30.0)
    for c in base.CHANNELS
}


class BackgroundGain(base.OpticalEffect):
    """A gain and an offset of each channel; ``drift`` is what the gain rises by over a session."""

    name = "background_gain"
    stage = base.Stage.EXPOSURE
    parameters = MappingProxyType({**GAINS, **OFFSETS, **DRIFTS})

    def apply(self, array: FloatArray, patch: base.Patch, **values: Any) -> FloatArray:
        """Gain · image + offset."""
        gain, drift, offset = (
            base.by_channel([values.get(f"{name}_{c}", still) for c in base.CHANNELS], array)
            for name, still in (("gain", 1.0), ("drift", 0.0), ("offset", 0.0))
        )
        return array * (gain + drift * array.dtype.type(patch.time)) + offset

    def candidates(self, scene: base.PressScene) -> list[base.OpticalCandidate]:
        """Gains of all presses alike, growing over the session, or one for each picture."""
        return [
            base.OpticalCandidate(self.name, "exposure since the table", GAINS),
            base.OpticalCandidate(
                self.name, "exposure and offset since the table", {**GAINS, **OFFSETS}
            ),
            base.OpticalCandidate(
                self.name, "exposure that drifts over the session", DRIFTS, over_session=True
            ),
            base.OpticalCandidate(self.name, "exposure of each picture", each=tuple(GAINS)),
        ]


base.register(BackgroundGain())

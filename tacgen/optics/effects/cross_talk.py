"""Colours that leak into each other."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from tacgen.core.types import FloatArray
from tacgen.optics.effects import effect as base

LEAKS = {
    shown + leaking: base.OpticalParameter(0.0, -0.6, 0.6, prior=0.3)
    for shown in base.CHANNELS
    for leaking in base.CHANNELS
    if shown != leaking
}
"""``rg`` is the share of green's change that is added to red, and so on."""

CAMERA = {
    f"camera_{shown}{leaking}": base.OpticalParameter(float(shown == leaking), -0.8, 1.8, prior=0.3)
    for shown in base.CHANNELS
    for leaking in base.CHANNELS
}
"""The camera's matrix of colours, on whole grey levels: what red is made of, and so on."""


class CrossTalk(base.OpticalEffect):
    """Colours mix: in what a contact changes, or in the camera."""

    name = "cross_talk"
    stage = base.Stage.COLOR
    parameters = MappingProxyType({**LEAKS, **CAMERA})

    def apply(self, array: FloatArray, patch: base.Patch, **values: Any) -> FloatArray:
        """Shares of the other channels' changes are added to each, then the camera mixes."""
        grey = array
        if LEAKS.keys() & values:
            grey = array + _mixed(array - patch.background, "", values)
        return _mixed(grey, "camera_", values) if CAMERA.keys() & values else grey

    def candidates(self, scene: base.PressScene) -> list[base.OpticalCandidate]:
        """Only beside a table from before: one fitted to the same presses mixes as they do."""
        if not scene.has_table:
            return []
        return [
            base.OpticalCandidate(self.name, "colours of what a contact changes", LEAKS),
            base.OpticalCandidate(self.name, "the camera's colours", CAMERA),
        ]

    def cannot_tell(self, scene: base.PressScene, found: Sequence[base.OpticalCandidate]) -> str:
        """A fitted table has its own colours."""
        if scene.has_table:
            return ""
        return (
            "cross_talk: a table fitted to the same presses has its own colours, which hold any "
            "mixing of the channels; give the table from before (--table), or press the gel "
            "with one lamp on at a time."
        )


def _mixed(grey: FloatArray, prefix: str, values: Mapping[str, Any]) -> FloatArray:
    """What shares of three channels (..., 3) make, by the parameters ``prefix`` + two channels."""
    parts = []
    for shown in base.CHANNELS:
        still = [float(prefix + shown + c in CAMERA and c == shown) for c in base.CHANNELS]
        named = zip(base.CHANNELS, still, strict=True)
        shares = base.by_channel([values.get(prefix + shown + c, s) for c, s in named], grey)
        parts.append(shares[0] * grey[..., 0] + shares[1] * grey[..., 1] + shares[2] * grey[..., 2])
    return np.stack(parts, axis=-1)


base.register(CrossTalk())

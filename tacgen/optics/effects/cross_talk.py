"""Colours that leak into each other."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from tacgen.core.arrays import FloatArray
from tacgen.optics.effects import effect as base

LEAKS = {
    shown + leaking: base.Parameter(0.0, -0.6, 0.6, prior=0.3)
    for shown in base.CHANNELS
    for leaking in base.CHANNELS
    if shown != leaking
}
"""``rg`` is the share of green's change that is added to red, and so on."""

CAMERA = {
    f"camera_{shown}{leaking}": base.Parameter(float(shown == leaking), -0.8, 1.8, prior=0.3)
    for shown in base.CHANNELS
    for leaking in base.CHANNELS
}
"""The camera's matrix of colours, on whole grey levels: what red is made of, and so on."""


class CrossTalk(base.OpticalEffect):
    """Colours mix: in what a contact changes, or in the camera."""

    name = "cross_talk"
    stage = base.Stage.COLOR
    follows_form_errors = True
    parameters = MappingProxyType({**LEAKS, **CAMERA})

    def apply(self, array: FloatArray, patch: base.Patch, **values: Any) -> FloatArray:
        """Shares of the other channels' changes are added to each, then the camera mixes."""
        change = array - patch.background
        mixed = []
        for k, shown in enumerate(base.CHANNELS):
            leak = [np.asarray(values.get(shown + c, 0.0), array.dtype) for c in base.CHANNELS]
            mixed.append(array[..., k] + sum(leak[c] * change[..., c] for c in range(3)))
        return np.stack([self._camera(mixed, shown, values) for shown in base.CHANNELS], axis=-1)

    def _camera(self, grey: list[FloatArray], shown: str, values: Mapping[str, Any]) -> FloatArray:
        """What the camera's matrix makes of three channels."""
        names = [f"camera_{shown}{leaking}" for leaking in base.CHANNELS]
        shares = [values.get(name, CAMERA[name].identity) for name in names]
        return np.asarray(
            sum(np.asarray(s, one.dtype) * one for s, one in zip(shares, grey, strict=True))
        )

    def candidates(self, scene: base.PressScene) -> list[base.Candidate]:
        """Only beside a table from before: one fitted to the same presses mixes as they do."""
        if not scene.has_table:
            return []
        return [
            base.Candidate(self.name, "colours of what a contact changes", LEAKS),
            base.Candidate(self.name, "the camera's colours", CAMERA),
        ]

    def cannot_tell(self, scene: base.PressScene, found: Sequence[base.Candidate]) -> str:
        """A fitted table has its own colours."""
        if scene.has_table:
            return ""
        return (
            "cross_talk: a table fitted to the same presses has its own colours, which hold any "
            "mixing of the channels; give the table from before (--table), or press the gel "
            "with one lamp on at a time."
        )


base.register(CrossTalk())

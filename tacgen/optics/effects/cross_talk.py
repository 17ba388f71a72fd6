"""Colours that leak into each other."""

from __future__ import annotations

from collections.abc import Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from tacgen.core.arrays import FloatArray
from tacgen.optics.effects import effect as base


class CrossTalk(base.OpticalEffect):
    """The change of one colour shows in another: ``rg`` is the share of green's change in red."""

    name = "cross_talk"
    stage = base.Stage.COLOR
    parameters = MappingProxyType(
        {
            shown + leaking: base.Parameter(0.0, -0.6, 0.6, prior=0.3)
            for shown in base.CHANNELS
            for leaking in base.CHANNELS
            if shown != leaking
        }
    )

    def apply(self, array: FloatArray, patch: base.Patch, **values: Any) -> FloatArray:
        """Shares of the other channels' changes are added to each."""
        change = np.moveaxis(array - patch.background, -1, 0)
        given = {name: np.asarray(values.get(name, 0.0), array.dtype) for name in self.parameters}
        mixed = [
            sum(
                given[shown + leaking] * change[k]
                for k, leaking in enumerate(base.CHANNELS)
                if leaking != shown
            )
            for shown in base.CHANNELS
        ]
        return np.asarray(array + np.stack(mixed, axis=-1))

    def candidates(self, scene: base.PressScene) -> list[base.Candidate]:
        """Only beside a given table: one that is fitted to the same presses mixes as they do."""
        if not scene.has_table:
            return []
        return [base.Candidate(self.name, "channels leak into each other", self.parameters)]

    def cannot_tell(self, scene: base.PressScene, found: Sequence[base.Candidate]) -> str:
        """A fitted table has its own colours."""
        if scene.has_table:
            return ""
        return (
            "cross_talk: a table fitted to the same presses has its own colours, which hold any "
            "mixing of the channels; give the table from before (--table), or photograph the gel "
            "with one lamp on at a time."
        )


base.register(CrossTalk())

"""Light that differs with the place on the gel."""

from collections.abc import Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from tacgen.core.types import FloatArray
from tacgen.optics.effects import effect as base

PLACES = ("uu", "vv", "uv", "u", "v")
"""Terms of the place in the image."""


class Illumination(base.OpticalEffect):
    """What a contact changes is brighter or dimmer by its place.

    ``r_u`` is what red gains along u, ``r_uu`` what it gains with u², and so on.
    """

    name = "illumination"
    stage = base.Stage.LIGHT
    parameters = MappingProxyType(
        {
            f"{channel}_{place}": base.OpticalParameter(0.0, -4.0, 4.0, step=0.02, prior=1.0)
            for channel in base.CHANNELS
            for place in PLACES
        }
    )

    def apply(self, array: FloatArray, patch: base.Patch, **values: Any) -> FloatArray:
        """The change from the background, times a quadratic of the place for each channel."""
        u, v = np.broadcast_arrays(patch.u, patch.v)
        place = np.stack([u * u, v * v, u * v, u, v], axis=-1).astype(array.dtype)
        shares = [[values.get(f"{c}_{p}", 0.0) for c in base.CHANNELS] for p in PLACES]
        brighter = 1 + place @ np.array(shares, dtype=array.dtype)
        return patch.background + (array - patch.background) * brighter

    def candidates(self, scene: base.PressScene) -> list[base.OpticalCandidate]:
        """Only beside a table from before: one fitted to the same presses holds the light."""
        if not scene.has_table:
            return []
        return [base.OpticalCandidate(self.name, "light of each channel by place", self.parameters)]

    def cannot_tell(self, scene: base.PressScene, found: Sequence[base.OpticalCandidate]) -> str:
        """Lamps close by are a property of the sensor."""
        if scene.has_table:
            return ""
        return (
            "illumination: a table fitted to the same presses holds how their light differs over "
            "the gel; whether it has changed is seen against the table from before (--table)."
        )


base.register(Illumination())

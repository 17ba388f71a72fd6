"""A lens that darkens towards the corners."""

from types import MappingProxyType
from typing import Any

import numpy as np

from tacgen.core.types import FloatArray
from tacgen.optics.effects import effect as base


class Vignetting(base.OpticalEffect):
    """1 − strength · r² of the light arrives, r = 1 at the corners.

    ``change_strength`` is for a background that was taken through the same lens: only what
    a contact changes is dimmed.
    """

    name = "vignetting"
    stage = base.Stage.LENS
    parameters = MappingProxyType(
        dict.fromkeys(
            ("strength", "change_strength"), base.OpticalParameter(0.0, -0.6, 0.95, step=0.02)
        )
    )

    def apply(
        self,
        array: FloatArray,
        patch: base.Patch,
        *,
        strength: float = 0.0,
        change_strength: float = 0.0,
        **_: Any,
    ) -> FloatArray:
        """Dim the change, then the whole."""
        square = (patch.u**2 + patch.v**2)[..., None]
        twice, twice_change = (
            np.asarray(2 * s, array.dtype)[..., None] for s in (strength, change_strength)
        )
        gain = (1 - twice * square).astype(array.dtype)
        dimmed = (array - patch.background) * (twice_change * square)
        return (array - dimmed.astype(array.dtype)) * gain

    def candidates(self, scene: base.PressScene) -> list[base.OpticalCandidate]:
        """A background through the same lens, or not."""
        change, whole = ({name: self.parameters[name]} for name in ("change_strength", "strength"))
        return [
            base.OpticalCandidate(self.name, "of what presses change", change),
            base.OpticalCandidate(self.name, "of the background too", whole),
        ]


base.register(Vignetting())

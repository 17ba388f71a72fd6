"""A wrong size of the pixel, the ball or the labelled circles."""

from collections.abc import Sequence
from types import MappingProxyType

import numpy as np

from tacgen.core.types import FloatArray
from tacgen.optics.effects import effect as base


class Scale(base.OpticalEffect):
    """All contacts, or all balls, are larger or smaller than the presses' labels say."""

    name = "scale"
    stage = base.Stage.PRESS
    parameters = MappingProxyType(
        {
            "contact_per_label": base.OpticalParameter(1.0, 0.5, 1.6, step=0.005),
            "ball_per_stated": base.OpticalParameter(1.0, 0.6, 1.8, step=0.005, prior=0.15),
        }
    )

    def on_press(
        self, place_mm: FloatArray, ball_mm: float, **values: float
    ) -> tuple[FloatArray, float]:
        """Contact and ball radius times their factors."""
        place = place_mm * np.array([1.0, 1.0, values.get("contact_per_label", 1.0)])
        return place, ball_mm * values.get("ball_per_stated", 1.0)

    def candidates(self, scene: base.PressScene) -> list[base.OpticalCandidate]:
        """The ball, or the labelled circles."""
        ball, contact = "ball_per_stated", "contact_per_label"
        return [
            base.OpticalCandidate(
                self.name, "ball over the stated, or pixel under it", {ball: self.parameters[ball]}
            ),
            base.OpticalCandidate(
                self.name,
                "contact radius over the labelled one",
                {contact: self.parameters[contact]},
            ),
        ]

    def cannot_tell(self, scene: base.PressScene, found: Sequence[base.OpticalCandidate]) -> str:
        """One ball fixes no size."""
        if len(np.unique(scene.ball_radii_mm)) > 1:
            return ""
        return (
            "scale: with one ball, a wrong size of a pixel or of the ball stretches the table's "
            "slopes and changes little else; press a second ball of another size."
        )


base.register(Scale())

"""Labels that miss the place of a press."""

from types import MappingProxyType

import numpy as np

from tacgen.core.types import FloatArray
from tacgen.optics.effects import effect as base


class PressCenter(base.OpticalEffect):
    """Each press lies off its labelled centre, and may be larger than labelled."""

    name = "press_center"
    stage = base.Stage.PRESS
    parameters = MappingProxyType(
        {
            "shift_x": base.OpticalParameter(0.0, -0.6, 0.6, "radii", prior=0.15),
            "shift_y": base.OpticalParameter(0.0, -0.6, 0.6, "radii", prior=0.15),
            "growth": base.OpticalParameter(0.0, -0.4, 0.4, prior=0.1),
        }
    )

    def on_press(
        self, place_mm: FloatArray, ball_mm: float, **values: float
    ) -> tuple[FloatArray, float]:
        """The centre moves by shares of the labelled radius, the radius grows by a share of it."""
        shift = [values.get("shift_x", 0.0), values.get("shift_y", 0.0), values.get("growth", 0.0)]
        return place_mm + place_mm[2] * np.array(shift), ball_mm

    def candidates(self, scene: base.PressScene) -> list[base.OpticalCandidate]:
        """All centres off by the same, or each by its own."""
        centers = {name: self.parameters[name] for name in ("shift_x", "shift_y")}
        return [
            base.OpticalCandidate(self.name, "all centres off by the same", centers),
            base.OpticalCandidate(self.name, "each press's place", each=tuple(self.parameters)),
        ]


base.register(PressCenter())

"""Labels that miss the place of a press."""

from __future__ import annotations

from types import MappingProxyType
from typing import Any

import numpy as np

from tacgen.core.arrays import FloatArray
from tacgen.optics.effects import effect as base


class PressCenter(base.OpticalEffect):
    """Each press lies off its labelled centre, and may be larger than labelled."""

    name = "press_center"
    stage = base.Stage.PRESS
    parameters = MappingProxyType(
        {
            "shift_x": base.Parameter(0.0, -0.6, 0.6, "radii", prior=0.15),
            "shift_y": base.Parameter(0.0, -0.6, 0.6, "radii", prior=0.15),
            "growth": base.Parameter(0.0, -0.4, 0.4, prior=0.1),
        }
    )
    follows_form_errors = True

    def on_press(
        self, place_mm: FloatArray, ball_mm: FloatArray, **values: Any
    ) -> tuple[FloatArray, FloatArray]:
        """Centres move by shares of the labelled radius, radii grow by a share of it."""
        shift = np.stack([values.get("shift_x", 0.0), values.get("shift_y", 0.0)], axis=-1)
        center = place_mm[:, :2] + shift * place_mm[:, 2:]
        return np.column_stack([center, place_mm[:, 2] * (1 + values.get("growth", 0.0))]), ball_mm

    def candidates(self, scene: base.PressScene) -> list[base.Candidate]:
        """Centres alone, or radii with them."""
        centers = {name: self.parameters[name] for name in ("shift_x", "shift_y")}
        return [
            base.Candidate(self.name, "each press's centre", own=centers),
            base.Candidate(self.name, "each press's centre and radius", own=self.parameters),
        ]


base.register(PressCenter())

"""A camera that clips."""

from types import MappingProxyType
from typing import Any

import numpy as np

from tacgen.core.types import FloatArray
from tacgen.optics.effects import effect as base

SHARP_KNEE_GREY = 0.05
"""A knee below this is none: the image is rounded to whole grey levels."""

FIRST_KNEE_GREY = 1.0
"""Where a fit begins: at a sharp knee its derivative vanishes."""

MIN_CLIPPED_SHARE = 0.01
"""Share of a channel's values that must stand at the brightest level for a camera to clip."""

PILE_RATIO = 1.5
"""And so many times more must stand there than a little below: a tail without clipping falls."""

BELOW_GREY = 8.0
"""How far below: beyond the camera's noise, within the brightest values."""

WITHIN_GREY = 2.5
"""Values this near a level count as standing at it: the camera's noise."""

TOP_QUANTILE = 0.9998
"""The brightest level, a few noisy pixels aside."""

SEARCH_GREY = 12
"""Grey levels below the brightest in which the fullest one is looked for: noise above it."""


def clip_level(grey: FloatArray) -> float:
    """The grey level near the brightest that most values (n, 3) stand at."""
    top = float(np.quantile(grey, TOP_QUANTILE))
    counts = np.bincount(np.rint(grey).astype(int).ravel(), minlength=256)
    first = max(0, int(top) - SEARCH_GREY)
    return float(first + np.argmax(counts[first : int(top) + 1]))


def seems_clipped(grey: FloatArray) -> bool:
    """Whether the brightest values (n, 3) pile up."""
    apart = grey - clip_level(grey)
    piled = (np.abs(apart) < WITHIN_GREY).mean(axis=0)
    below = (np.abs(apart + BELOW_GREY) < WITHIN_GREY).mean(axis=0)
    return bool(((piled >= MIN_CLIPPED_SHARE) & (piled >= PILE_RATIO * below)).any())


class Saturation(base.OpticalEffect):
    """Nothing is brighter than a level, towards which it bends over a knee."""

    name = "saturation"
    stage = base.Stage.CAMERA
    parameters = MappingProxyType(
        {
            "level_grey": base.OpticalParameter(255.0, 60.0, 255.0, "grey", step=0.5),
            "knee_grey": base.OpticalParameter(0.0, 0.0, 25.0, "grey", step=0.3),
        }
    )

    def apply(
        self,
        array: FloatArray,
        patch: base.Patch,
        *,
        level_grey: float = 255.0,
        knee_grey: float = 0.0,
        **_: Any,
    ) -> FloatArray:
        """The smaller of image and level, soft over the knee."""
        level, knee = np.asarray(level_grey, array.dtype), np.asarray(knee_grey, array.dtype)
        if knee < SHARP_KNEE_GREY:
            return np.minimum(array, level)
        return level - knee * np.logaddexp(np.zeros_like(knee), (level - array) / knee)

    def candidates(self, scene: base.PressScene) -> list[base.OpticalCandidate]:
        """Where the brightest values pile up."""
        ends = clip_level(scene.grey) == self.parameters["level_grey"].upper  # as every scale does
        if ends or not seems_clipped(scene.grey):
            return []
        start = {"level_grey": clip_level(scene.grey), "knee_grey": 0.0}
        level = {"level_grey": self.parameters["level_grey"]}
        soft, bends = {**start, "knee_grey": FIRST_KNEE_GREY}, self.parameters
        return [
            base.OpticalCandidate(
                self.name, "the camera clips", level, starts=(start,), evident=True
            ),
            base.OpticalCandidate(
                self.name, "the camera bends", bends, starts=(soft,), evident=True
            ),
        ]


base.register(Saturation())

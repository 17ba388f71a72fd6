"""A membrane that bridges what is narrower than its own thickness, and a lens out of focus."""

from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np

from tacgen.core.types import FloatArray
from tacgen.optics.effects import effect as base
from tacgen.optics.smooth import half_kernel, smooth

FIRST_SIGMA_PX = 1.0
"""Width that a fit begins at: at 0 the derivative vanishes."""

MAX_SIGMA_RADII = 0.8
"""Beyond this width, in contact radii, no contact is left to see."""

STEP_PX = 0.25
"""Step of the finite difference: a kernel narrower than that is a single pixel."""

WHOLE_PICTURE_MM = 1000.0
"""Wider than any sensor."""


def _blurred(array: FloatArray, sigma_px: float) -> FloatArray:
    """A Gaussian on a map (h, w); beyond the edges it goes on with its slope there."""
    kernel = half_kernel(sigma_px)
    reach = min(len(kernel) - 1, min(array.shape) - 1)
    if reach < 1:
        return array.copy()
    padded = np.pad(array, reach, mode="reflect", reflect_type="odd").astype(np.float32)
    whole = (0, padded.shape[0], 0, padded.shape[1])
    smooth(padded, whole, kernel)
    return np.ascontiguousarray(padded[reach:-reach, reach:-reach])


class Blur(base.OpticalEffect):
    """The gel's surface is smoothed by a Gaussian."""

    name = "blur"
    stage = base.Stage.SURFACE
    parameters = MappingProxyType({"sigma_mm": base.OpticalParameter(0.0, 0.0, 2.0, "mm")})

    def apply(
        self, array: FloatArray, patch: base.Patch, *, sigma_mm: float = 0.0, **_: Any
    ) -> FloatArray:
        """A Gaussian on the height map."""
        return _blurred(array, sigma_mm / patch.mm_per_px)

    def reach_mm(self, depth_mm: float, *, sigma_mm: float = 0.0, **_: Any) -> float:
        """Three standard deviations, and what the kernel's even number of pixels adds."""
        return 4 * sigma_mm

    def candidates(self, scene: base.PressScene) -> list[base.OpticalCandidate]:
        """One width."""
        upper, step = MAX_SIGMA_RADII * scene.contact_radius_mm, STEP_PX * scene.mm_per_px
        sigma = replace(self.parameters["sigma_mm"], upper=upper, step=step)
        start = {"sigma_mm": FIRST_SIGMA_PX * scene.mm_per_px}
        return [base.OpticalCandidate(self.name, "Gaussian", {"sigma_mm": sigma}, starts=(start,))]


class Defocus(base.OpticalEffect):
    """The whole picture, the bare gel's too, is smoothed by a Gaussian."""

    name = "defocus"
    reported_name = Blur.name
    stage = base.Stage.FOCUS
    parameters = Blur.parameters

    def apply(
        self, array: FloatArray, patch: base.Patch, *, sigma_mm: float = 0.0, **_: Any
    ) -> FloatArray:
        """A Gaussian on each channel."""
        sigma_px = sigma_mm / patch.mm_per_px
        return np.dstack([_blurred(array[..., k], sigma_px) for k in range(3)])

    def reach_mm(self, depth_mm: float, **_: Any) -> float:
        """The whole picture: at a window's edge neighbours would be missing."""
        return WHOLE_PICTURE_MM

    def candidates(self, scene: base.PressScene) -> list[base.OpticalCandidate]:
        """None: the noise of the pictures shows it, not their error."""
        return []


base.register(Blur())
base.register(Defocus())

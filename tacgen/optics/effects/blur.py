"""A membrane that bridges what is narrower than its own thickness."""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np

from tacgen.core.arrays import FloatArray
from tacgen.optics.effects import effect as base
from tacgen.optics.smooth import half_kernel, radial_gaussian, smooth

FIRST_SIGMA_RADII = 0.15
"""Width that a fit begins at, in contact radii: at 0 the derivative vanishes."""

MAX_SIGMA_RADII = 0.8
"""Beyond this width no contact is left to see."""

STEP_RADII = 0.02
"""Of the finite difference: half of a radial profile's own step."""


class Blur(base.OpticalEffect):
    """The gel's surface is smoothed by a Gaussian."""

    name = "blur"
    stage = base.Stage.SURFACE
    parameters = MappingProxyType({"sigma_mm": base.Parameter(0.0, 0.0, 2.0, "mm")})

    def apply(
        self, array: FloatArray, patch: base.Patch, *, sigma_mm: float = 0.0, **_: Any
    ) -> FloatArray:
        """A Gaussian on the height map; beyond the edges it goes on with its slope there."""
        kernel = half_kernel(sigma_mm / patch.mm_per_px)
        reach = min(len(kernel) - 1, min(array.shape) - 1)
        if reach < 1:
            return array.copy()
        padded = np.pad(array, reach, mode="reflect", reflect_type="odd").astype(np.float32)
        whole = (0, padded.shape[0], 0, padded.shape[1])
        smooth(padded, whole, kernel, np.empty_like(padded))
        return np.ascontiguousarray(padded[reach:-reach, reach:-reach])

    def reach_mm(self, depth_mm: float, *, sigma_mm: float = 0.0, **_: Any) -> float:
        """Three standard deviations, up to the kernel's next multiple of four pixels."""
        return 4 * sigma_mm

    def on_profile(
        self, slope: FloatArray, step_mm: float, *, sigma_mm: float = 0.0, **_: float
    ) -> FloatArray:
        """The same Gaussian in the plane, on the slope of a round surface."""
        return radial_gaussian(len(slope), sigma_mm / step_mm, order=1) @ slope

    def candidates(self, scene: base.PressScene) -> list[base.Candidate]:
        """One width."""
        radius = scene.contact_radius_mm
        sigma = replace(
            self.parameters["sigma_mm"], upper=MAX_SIGMA_RADII * radius, step=STEP_RADII * radius
        )
        return [
            base.Candidate(
                self.name,
                "membrane",
                {"sigma_mm": sigma},
                starts=lambda _: [{"sigma_mm": FIRST_SIGMA_RADII * radius}],
                hides_form=True,
            )
        ]


base.register(Blur())

"""Taxim's image model: a quadratic in image position at each slope."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from tacgen.core.types import FloatArray
from tacgen.optics import shade
from tacgen.optics.image_models.base import (
    ImageModel,
    Shade,
    TableSection,
    between_nodes,
    features,
    register_model,
)

PLACES = 13
"""Nodes of position, each way, at which it is inverted."""


@register_model
@dataclass(frozen=True, slots=True)
class Quadratic(ImageModel):
    """Taxim's: a quadratic in image position at each node of slope and direction.

    ``coefficients`` (n_slope, n_direction, 3, 6), ``max_slope_rad`` and ``interpolation`` are those
    of a :class:`tacgen.optics.LookupTable`.
    """

    coefficients: NDArray[np.float32]
    max_slope_rad: float
    interpolation: str = "linear"

    kind: ClassVar[str] = "quadratic"

    def shade(self, background: NDArray[np.float32], mm_per_px: float) -> Shade:
        """As of ``ImageModel``."""
        nodes = shade.packed_nodes(self.coefficients)
        interpolate = self.interpolation == "linear" and nodes.shape[0] > 1
        n_rows, n_columns = background.shape[:2]
        u = ((np.arange(n_columns) + 0.5) / n_columns - 0.5).astype(np.float32)
        v = ((np.arange(n_rows) + 0.5) / n_rows - 0.5).astype(np.float32)
        ready = shade.QuadraticNodes(
            mm_per_px, nodes, self.max_slope_rad, interpolate, u, v, background
        )
        return lambda surface, window, spans, image: shade.shade_window(
            surface, window, spans, image, ready
        )

    def slope_colors(self, gx: FloatArray, gy: FloatArray) -> FloatArray:
        """As of ``ImageModel``."""
        side = np.linspace(-0.5, 0.5, PLACES)
        v, u = np.meshgrid(side, side, indexing="ij")
        nodes = np.einsum("sdcf,vuf->sdvuc", self.coefficients, features(u, v))
        return between_nodes(nodes, self.max_slope_rad, gx, gy)

    def save(self) -> TableSection:
        """As of ``ImageModel``."""
        return {"coefficients": self.coefficients}, {}

    @classmethod
    def load(cls, arrays: Mapping[str, NDArray[Any]], numbers: Mapping[str, Any]) -> "Quadratic":
        """As of ``ImageModel``."""
        coefficients = arrays["coefficients"].astype(np.float32)
        return cls(coefficients, numbers["max_slope_rad"], numbers["interpolation"])

"""Image model of light of any course in position, and of what a contact adds to it."""

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
    register_model,
)


@dataclass(frozen=True, slots=True)
class ContactLight:
    """What gel pressed in answers otherwise than gel of the same slope at rest.

    At depth d below the gel at rest a pixel with unit normal (nx, ny, ·) gains
    d / (d + ``depth_mm``) · (c₀ + c₁ nx + c₂ ny), the c linear between nodes of position.

    ``change`` (n_rows, n_columns, 3, 3) holds c₀, c₁, c₂ at each node, RGB grey levels last; node
    (r, c) stands where it does in a table's ``response``. At ``depth_mm`` half of it shows. The gel
    at rest, of ``dome_radius_mm`` (0: flat), is 0 mm high at its centre.
    """

    change: NDArray[np.float32]
    depth_mm: float
    dome_radius_mm: float = 0.0

    def rest_mm(self, shape_px: tuple[int, int], mm_per_px: float) -> NDArray[np.float32]:
        """Height (H, W) of the gel at rest."""
        height, width = shape_px
        if self.dome_radius_mm <= 0:
            return np.zeros(shape_px, dtype=np.float32)
        x = (np.arange(width) - (width - 1) / 2) * mm_per_px
        y = (np.arange(height) - (height - 1) / 2) * mm_per_px
        square = np.minimum(x[None, :] ** 2 + y[:, None] ** 2, (0.95 * self.dome_radius_mm) ** 2)
        sag = np.sqrt(self.dome_radius_mm**2 - square) - self.dome_radius_mm
        return np.asarray(sag, dtype=np.float32)


@register_model
@dataclass(frozen=True, slots=True)
class Response(ImageModel):
    """Light of any course in position, and perhaps what a contact adds to it.

    ``response`` (n_slope, n_direction, n_rows, n_columns, 3) and ``contact`` are those of a
    :class:`tacgen.optics.LookupTable`.
    """

    response: NDArray[np.float32]
    max_slope_rad: float
    contact: ContactLight | None = None

    kind: ClassVar[str] = "response"

    @property
    def sees_depth(self) -> bool:
        """Whether a contact adds anything."""
        return self.contact is not None

    def shade(self, background: NDArray[np.float32], mm_per_px: float) -> Shade:
        """As of ``ImageModel``."""
        response = shade.packed_response(self.response)
        (height, width), light = background.shape[:2], self.contact
        if light is None:
            rest_mm, lines = background[:, :, 0], np.empty((0, 9, width), np.float32)
        else:
            rest_mm = light.rest_mm((height, width), mm_per_px)
            lines = shade.contact_lines(light.change, width)
        depth_mm = 1.0 if light is None else light.depth_mm
        ready = shade.ResponseNodes(
            mm_per_px, response, self.max_slope_rad, background, rest_mm, lines, depth_mm
        )
        return lambda surface, window, spans, image: shade.shade_response(
            surface, window, spans, image, ready
        )

    def slope_colors(self, gx: FloatArray, gy: FloatArray) -> FloatArray:
        """As of ``ImageModel``."""
        return between_nodes(self.response, self.max_slope_rad, gx, gy)

    def contact_light(self, shape_px: tuple[int, int]) -> tuple[NDArray[np.float32], float]:
        """As of ``ImageModel``."""
        if self.contact is None:
            return ImageModel.contact_light(self, shape_px)
        at_rows = shade.at_pixels(self.contact.change, shape_px[0], 0)
        return shade.at_pixels(at_rows, shape_px[1], 1), self.contact.depth_mm

    def save(self) -> TableSection:
        """As of ``ImageModel``; the response in half precision."""
        arrays: dict[str, NDArray[Any]] = {"response": self.response.astype(np.float16)}
        if self.contact is None:
            return arrays, {}
        arrays["contact"] = self.contact.change.astype(np.float32)
        numbers = {
            "depth_mm": self.contact.depth_mm,
            "dome_radius_mm": self.contact.dome_radius_mm,
        }
        return arrays, {"contact": numbers}

    @classmethod
    def load(cls, arrays: Mapping[str, NDArray[Any]], numbers: Mapping[str, Any]) -> "Response":
        """As of ``ImageModel``."""
        contact = None
        if "contact" in arrays:
            change = arrays["contact"].astype(np.float32)
            contact = ContactLight(change, **numbers["contact"])
        return cls(arrays["response"].astype(np.float32), numbers["max_slope_rad"], contact)

    def problems(self) -> list[str]:
        """What is wrong with the shapes of its arrays."""
        problems = []
        shape = self.response.shape
        if len(shape) != 5 or min(shape) < 2 or shape[4] != 3:
            problems.append(
                f"response has shape {shape}, not (n_slope, n_direction, n_rows, n_columns, 3) "
                "with at least two nodes each way"
            )
        if self.contact is not None and (
            self.contact.change.shape != (*shape[2:4], 3, 3) or not self.contact.depth_mm > 0
        ):
            problems.append(
                f"contact has shape {self.contact.change.shape} and depth "
                f"{self.contact.depth_mm:g} mm, not (n_rows, n_columns, 3, 3) with the response's "
                "nodes of position and a depth above 0"
            )
        return problems

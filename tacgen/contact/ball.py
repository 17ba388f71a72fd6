"""A ball pressed into the gel to an indented volume."""

from dataclasses import dataclass

import numpy as np

from tacgen.contact.gel import gel_map_mm, pixel_centers_mm
from tacgen.contact.indentation import contact_depth, solve_indentation
from tacgen.core.records import Sensor
from tacgen.core.types import FloatArray


@dataclass(frozen=True, slots=True)
class GelLattice:
    """Points of a sensor's gel, on columns and rows, at which the depth below a ball is computed.

    Attributes
    ----------
    x_mm : (W,) float
    y_mm : (H,) float
        Places of the columns and rows, gel frame.
    rest_mm : (H, W) float
        Height of the gel at rest.
    cell_mm2 : float
        Area that a point stands for.
    thickness_mm : float
        Of the gel: no point of it is pressed deeper.
    """

    x_mm: FloatArray
    y_mm: FloatArray
    rest_mm: FloatArray
    cell_mm2: float
    thickness_mm: float

    @classmethod
    def of(cls, sensor: Sensor, every: int = 1) -> "GelLattice":
        """The centres of every so-manyth pixel of a sensor."""
        x_mm, y_mm = pixel_centers_mm(sensor)
        some = slice(every // 2, None, every)
        rest_mm = gel_map_mm(sensor)[some, some]
        area_mm2 = every**2 * sensor.pixel_area_mm2
        return cls(x_mm[some], y_mm[some], rest_mm, area_mm2, sensor.gel_depth_mm)

    def ball_depth_mm(
        self, radius_mm: float, center_mm: FloatArray | tuple[float, float], volume_mm3: float
    ) -> FloatArray:
        """Depth (H, W) of the gel below a ball that displaces a volume, mm; 0 without contact."""
        away = (self.x_mm - center_mm[0]) ** 2 + (self.y_mm[:, None] - center_mm[1]) ** 2
        below = away < radius_mm**2
        if volume_mm3 <= 0 or not below.any():
            return np.zeros(away.shape)
        gap = np.full(away.shape, np.inf)
        gap[below] = -np.sqrt(radius_mm**2 - away[below]) - self.rest_mm[below]
        gap -= gap.min()
        depth_mm = solve_indentation(gap, volume_mm3, self.cell_mm2)
        return np.asarray(contact_depth(gap, min(depth_mm, self.thickness_mm)))

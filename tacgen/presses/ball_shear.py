"""How a ball that is pressed and pulled along the gel moves the marker dots, frame by frame."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacgen.contact.gel import gel_map_mm
from tacgen.contact.indentation import contact_depth, solve_indentation
from tacgen.contact.shear import dilation_mm
from tacgen.contact.shear_field import TOLERANCE
from tacgen.core.records import Sensor
from tacgen.core.types import FloatArray
from tacgen.sensor.gel_shear import GelShear

EVERY = 4  # pixels: so far apart the depth below a ball is computed, finer than the lattice
STICKS = 1e4  # a friction at which all points stick


@dataclass(frozen=True, slots=True)
class Place:
    """A round place of the gel, gel frame, where friction is another."""

    x_mm: float
    y_mm: float
    radius_mm: float
    friction: float


class BallShear:
    """The shear field of one sensor's gel under balls; ``decay_mm`` as of ``ShearField``."""

    def __init__(self, sensor: Sensor, decay_mm: float) -> None:
        gel, s = GelShear(sensor), sensor.mm_per_px
        self.field, self.cell_mm2 = gel.field(decay_mm), gel.cell_mm2
        self._sensor = sensor
        self._gel_mm = gel_map_mm(sensor)[EVERY // 2 :: EVERY, EVERY // 2 :: EVERY]
        rows, columns = self._gel_mm.shape
        fine_x = (np.arange(columns) * EVERY + EVERY // 2 - (sensor.width_px - 1) / 2) * s
        fine_y = (np.arange(rows) * EVERY + EVERY // 2 - (sensor.height_px - 1) / 2) * s
        self._fine_mm = np.stack(np.meshgrid(fine_x, fine_y), axis=-1)
        self._fine_mm2 = (EVERY * s) ** 2
        # The node that each point of the fine grid is nearest to.
        nodes = self.field.nodes_mm
        at_x = np.abs(fine_x[:, None] - nodes[0, :, 0]).argmin(axis=1)
        at_y = np.abs(fine_y[:, None] - nodes[:, 0, 1]).argmin(axis=1)
        self._node = at_y[:, None] * nodes.shape[1] + at_x[None, :]

    def depth_mm(self, radius_mm: float, center_mm: FloatArray, volume_mm3: float) -> FloatArray:
        """Mean indentation (rows, columns) of the lattice's cells by a ball, mm."""
        shape = self.field.nodes_mm.shape[:2]
        away = ((self._fine_mm - center_mm) ** 2).sum(axis=-1)
        below = away < radius_mm**2
        if volume_mm3 <= 0 or not below.any():
            return np.zeros(shape)
        gap = np.full(away.shape, np.inf)
        gap[below] = -np.sqrt(radius_mm**2 - away[below]) - self._gel_mm[below]
        delta = solve_indentation(gap, volume_mm3, self._fine_mm2)
        depth = contact_depth(gap, min(delta, float(gap.min()) + self._sensor.gel_depth_mm))
        total = np.bincount(self._node.ravel(), depth.ravel(), shape[0] * shape[1])
        return np.asarray(total.reshape(shape) * self._fine_mm2 / self.cell_mm2)

    def dilation_mm(self, points_mm: FloatArray, depth_mm: FloatArray) -> FloatArray:
        """Motion (n, 2) of points away from an indentation (rows, columns)."""
        inside = depth_mm > 0
        if not inside.any():
            return np.zeros_like(points_mm)
        nodes = self.field.nodes_mm[inside]
        points = np.asarray(points_mm, np.float64)
        return np.asarray(dilation_mm(points, nodes, depth_mm[inside], self.cell_mm2))

    def middle_mm(self, depth_mm: FloatArray) -> FloatArray:
        """Middle (2,) of the pressure of an indentation (rows, columns), gel frame."""
        weight = depth_mm / max(float(depth_mm.sum()), 1e-12)
        return np.asarray(np.tensordot(weight, self.field.nodes_mm, axes=([0, 1], [0, 1])))

    def strain(
        self,
        points_mm: FloatArray,
        pressure: Sequence[FloatArray],
        force_n: FloatArray,
        friction: float,
        place: Place | None = None,
        tolerance: float = TOLERANCE,
    ) -> FloatArray:
        """Motion (T, n, 2) of points per compliance, N/mm², over the frames of one press.

        ``pressure`` (T) maps (rows, columns) are in N/mm², ``force_n`` (T, 2) the shear force.
        """
        points = np.asarray(points_mm, np.float64)
        factor = np.ones(self.field.nodes_mm.shape[:2])
        if place is not None:
            nodes = self.field.nodes_mm
            away = np.hypot(nodes[..., 0] - place.x_mm, nodes[..., 1] - place.y_mm)
            # Cells on the rim belong to it in part, so that its radius acts evenly.
            share = np.clip((place.radius_mm - away) / np.sqrt(self.cell_mm2) + 0.5, 0.0, 1.0)
            factor += share * (place.friction / friction - 1.0)
        state, out = None, np.zeros((len(pressure), *points_mm.shape))
        for frame, (map_n, force) in enumerate(zip(pressure, force_n, strict=True)):
            # The pressure does nothing but limit the traction: its product with friction counts.
            center = np.asarray(self.middle_mm(map_n), np.float64)
            limit = np.asarray(map_n * factor, np.float64)
            pull = np.asarray(force, np.float64)
            state = self.field.step(limit, pull, 0.0, center, friction, state, tolerance)
            out[frame] = self.field.motion_mm(state, points, 1.0)
        return out

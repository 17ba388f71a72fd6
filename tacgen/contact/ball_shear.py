"""How a ball that is pressed and pulled along the gel moves the marker dots, frame by frame."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydantic import ConfigDict, FiniteFloat, PositiveFloat

from tacgen.contact.ball import GelLattice
from tacgen.contact.gel_shear import GelShear
from tacgen.contact.shear import dilation_mm
from tacgen.contact.shear_field import TOLERANCE
from tacgen.core.records import Sensor
from tacgen.core.types import FloatArray

EVERY = 4  # pixels: so far apart the depth below a ball is computed, finer than the lattice
STICKS = 1e4  # a friction at which all points stick


@dataclass(frozen=True, slots=True)
class Place:
    """A round place of the gel with another friction."""

    __pydantic_config__ = ConfigDict(extra="forbid", use_attribute_docstrings=True)

    x_mm: FiniteFloat = 0.0
    """Its middle along x, gel frame."""
    y_mm: FiniteFloat = 0.0
    """Its middle along y, gel frame."""
    radius_mm: PositiveFloat = 2.0
    """Its radius."""
    friction: PositiveFloat = 0.2
    """Coulomb's coefficient there."""


class BallShear:
    """The shear field of one sensor's gel under balls; arguments as of ``ShearField``."""

    def __init__(self, sensor: Sensor, decay_mm: float, tolerance: float = TOLERANCE) -> None:
        gel = GelShear(sensor)
        self.field, self.cell_mm2 = gel.field(decay_mm), gel.cell_mm2
        self.field.tolerance = tolerance
        self._fine = GelLattice.of(sensor, EVERY)
        # The node that each point of the fine grid is nearest to.
        nodes = self.field.nodes_mm
        at_x = np.abs(self._fine.x_mm[:, None] - nodes[0, :, 0]).argmin(axis=1)
        at_y = np.abs(self._fine.y_mm[:, None] - nodes[:, 0, 1]).argmin(axis=1)
        self._node = at_y[:, None] * nodes.shape[1] + at_x[None, :]

    def depth_mm(self, radius_mm: float, center_mm: FloatArray, volume_mm3: float) -> FloatArray:
        """Mean indentation (rows, columns) of the lattice's cells by a ball, mm."""
        shape = self.field.nodes_mm.shape[:2]
        depth = self._fine.ball_depth_mm(radius_mm, center_mm, volume_mm3)
        total = np.bincount(self._node.ravel(), depth.ravel(), shape[0] * shape[1])
        return np.asarray(total.reshape(shape) * self._fine.cell_mm2 / self.cell_mm2)

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
            state = self.field.step(limit, pull, 0.0, center, friction, state)
            out[frame] = self.field.motion_mm(state, points, 1.0)
        return out

"""The markers of a gel: where they are at rest, and how pressing and shearing moves them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tacgen.contact.raster import Float64
from tacgen.core.compiled import njit
from tacgen.core.records import Markers, Sensor
from tacgen.core.types import FloatArray

DILATION_DECAY_PER_MM2 = 0.479
"""How fast dilation falls off with the square of the distance.

Source: Zhao et al. 2023, FOTS: λ_d = 0.00125 px⁻² at its 19.58 px/mm.
"""
DILATION_GAIN = 0.03
"""Sideways motion of the gel's surface around an indentation, per mm of depth and mm² of contact.
Chosen so that a marker beside a 1 mm deep ball press moves by about 0.1 mm, as on real gels."""

NEGLIGIBLE = 20.0  # e^−20: beyond 6.5 mm the indentation at a point moves nothing

DEFAULT_PITCH_MM = 2.0
"""Spacing of the points at which the motion of a gel without markers is summed."""


@dataclass(frozen=True, slots=True)
class ShearMotion:
    """How the object has moved along the gel: ``shift_mm`` (2,), then a turn about the patch."""

    shift_mm: Float64
    turn_rad: float
    center_mm: Float64

    def moved(self, pose_gel_object: Float64) -> Float64:
        """The pose after the motion, turned about the normal through the patch's centre."""
        cos, sin = np.cos(self.turn_rad), np.sin(self.turn_rad)
        turn = np.eye(4)
        turn[:2, :2] = [[cos, -sin], [sin, cos]]
        turn[:2, 3] = self.center_mm - turn[:2, :2] @ self.center_mm + self.shift_mm
        return turn @ pose_gel_object


def marker_pitch_mm(sensor: Sensor) -> float:
    """Distance between the points at which a gel's motion is summed: each is for its square."""
    return DEFAULT_PITCH_MM if sensor.markers is None else sensor.markers.pitch_mm


def marker_grid_mm(sensor: Sensor) -> Float64:
    """x, y of the markers at rest (n, 2), gel frame; a plain grid where the gel has none."""
    markers = sensor.markers
    if markers is None:
        rows = max(1, int(sensor.height_px * sensor.mm_per_px / DEFAULT_PITCH_MM))
        columns = max(1, int(sensor.width_px * sensor.mm_per_px / DEFAULT_PITCH_MM))
        markers = Markers(rows, columns, DEFAULT_PITCH_MM, 0.0)
    x_mm = (np.arange(markers.columns) - (markers.columns - 1) / 2) * markers.pitch_mm
    y_mm = (np.arange(markers.rows) - (markers.rows - 1) / 2) * markers.pitch_mm
    return np.stack(np.meshgrid(x_mm, y_mm), axis=-1).reshape(-1, 2)


@njit(cache=True, nogil=True)
def _dilation(points_mm: Float64, patch_mm: Float64, weights_mm3: Float64, out: Float64) -> None:
    """Motion (n, 2) of each point away from the patch, for a gain of 1."""
    for i in range(points_mm.shape[0]):
        along_x, along_y = 0.0, 0.0
        for j in range(patch_mm.shape[0]):
            dx = points_mm[i, 0] - patch_mm[j, 0]
            dy = points_mm[i, 1] - patch_mm[j, 1]
            away = DILATION_DECAY_PER_MM2 * (dx * dx + dy * dy)
            if away > NEGLIGIBLE:
                continue
            weight = weights_mm3[j] * np.exp(-away)
            along_x += weight * dx
            along_y += weight * dy
        out[i, 0], out[i, 1] = along_x, along_y


def dilation_mm(
    points_mm: Float64,
    patch_mm: NDArray[np.floating],
    depth_mm: NDArray[np.floating],
    area_mm2: float,
) -> Float64:
    """Motion (n, 2) of points of the gel's surface (n, 2) by an indentation alone.

    ``patch_mm`` (k, 2) are spread evenly over the contact patch, gel frame, each indented by
    ``depth_mm`` (k,) and standing for ``area_mm2``.
    """
    weights_mm3 = np.asarray(depth_mm, dtype=np.float64) * area_mm2
    out = np.empty(points_mm.shape)
    _dilation(np.ascontiguousarray(points_mm), np.ascontiguousarray(patch_mm), weights_mm3, out)
    return DILATION_GAIN * out


def turned(grid_mm: FloatArray, turn_rad: float) -> FloatArray:
    """Places (n, 2) turned about the gel's origin, which is the grid's middle."""
    cos, sin = np.cos(turn_rad), np.sin(turn_rad)
    return np.asarray(grid_mm @ np.array([[cos, sin], [-sin, cos]]))

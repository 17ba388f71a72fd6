"""The markers of a gel: where they are at rest, and how pressing and shearing moves them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tacgen.contact.raster import Float64
from tacgen.core.compiled import njit
from tacgen.core.records import Markers, Sensor

DILATION_REACH, DILATION_GAIN = 1.58, 0.198
"""How far and how strongly an indentation pushes the gel aside: e^−1 at ``reach`` thicknesses, and
the gain for a thickness of 1 mm. Fitted to finite elements of bonded blocks of gel
(``validation.shear.dilation``), of which a thickness is the only length."""

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


def dilation_constants(gel_depth_mm: float) -> tuple[float, float]:
    """Decay (1/mm²) and gain (1/mm³) of ``dilation_mm`` for a gel's thickness."""
    return (DILATION_REACH * gel_depth_mm) ** -2, DILATION_GAIN / gel_depth_mm**3


@njit(cache=True, nogil=True)
def _dilation(
    points_mm: Float64,
    patch_mm: Float64,
    weights_mm3: Float64,
    decay_per_mm2: float,
    gain: float,
    out: Float64,
) -> None:
    for i in range(points_mm.shape[0]):
        along_x, along_y = 0.0, 0.0
        for j in range(patch_mm.shape[0]):
            dx = points_mm[i, 0] - patch_mm[j, 0]
            dy = points_mm[i, 1] - patch_mm[j, 1]
            weight = gain * weights_mm3[j] * np.exp(-decay_per_mm2 * (dx * dx + dy * dy))
            along_x += weight * dx
            along_y += weight * dy
        out[i, 0], out[i, 1] = along_x, along_y


def dilation_mm(
    points_mm: Float64,
    patch_mm: NDArray[np.floating],
    depth_mm: NDArray[np.floating],
    area_mm2: float,
    gel_depth_mm: float,
    under_mm: NDArray[np.floating],
) -> Float64:
    """Motion (n, 2) of points of the gel's surface (n, 2) by an indentation alone.

    ``patch_mm`` (k, 2) are spread evenly over the contact patch, gel frame, each indented by
    ``depth_mm`` (k,) and standing for ``area_mm2``; ``under_mm`` (n,) is the indentation at the
    points: the object holds the gel where it touches, the more the deeper.
    """
    out = np.zeros(points_mm.shape)
    if not len(patch_mm):
        return out
    depth = np.asarray(depth_mm, np.float64)
    points, patch = np.ascontiguousarray(points_mm), np.ascontiguousarray(patch_mm)
    _dilation(points, patch, depth * area_mm2, *dilation_constants(gel_depth_mm), out)
    free = 1.0 - np.minimum(under_mm / max(float(depth.max()), 1e-12), 1.0)
    return np.asarray(free[:, None] * out)


def depth_at(
    depth_mm: NDArray[np.floating], points_mm: Float64, mm_per_px: float
) -> NDArray[np.float64]:
    """Indentation (n,) at points (n, 2) of the gel, bilinear between pixels; 0 beside the map."""
    place = points_mm[:, ::-1] / mm_per_px + (np.array(depth_mm.shape) - 1.0) / 2
    first = np.floor(place).astype(int)
    part = place - first
    found = np.zeros(len(points_mm))
    for down in (0, 1):
        for right in (0, 1):
            at = first + np.array([down, right])
            inside = ((at >= 0) & (at < depth_mm.shape)).all(axis=1)
            weight = np.abs(1 - down - part[:, 0]) * np.abs(1 - right - part[:, 1])
            found[inside] += weight[inside] * depth_mm[tuple(at[inside].T)]
    return found

"""An object pressed into a gel: from its mesh, its pose and the load to the imprint."""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tacgen.contact.gap import GAP_GRAIN_MM, GapMapper, ObjectGap, gap_of_map
from tacgen.contact.gel import gel_size_mm, pixel_centers_mm
from tacgen.contact.gel_response import GelLoad
from tacgen.contact.indentation import solve_grains
from tacgen.contact.shear import ShearMotion
from tacgen.contact.shear_field import ShearState
from tacgen.core.compiled import njit
from tacgen.core.records import ContactPatch, ContactStatus, Mesh, Sensor
from tacgen.core.types import FloatArray, Window

_NONE = np.empty(0, np.int32)
REACH_MARGIN = 1.25
"""Triangles deeper than the last contact by this factor are left out of the first look at a new
one, which is repeated where it turns out to be deeper: the result does not depend on it."""

FIELD_POINTS = 1500  # points of a contact patch for the markers' motion and the pads' torsion

OUTSIDE_SHARE = 0.05
"""Of the pressure, from which on an image that does not show it is called ``outside_window``: what
a reading of the force from an image is off by."""

BESIDE_GEL_MM = 2.0
"""By which a centre of pressure is beyond the gel where nothing presses on the gel: a pad's dome
touches up to 1 mm beyond its outline."""


@dataclass(frozen=True, slots=True)
class Imprint:
    """The mechanics of one contact; the default is a gel that nothing touches.

    ``indentation_mm`` is δ beyond first touch; ``saturated`` where the gel is pressed through to
    its backing. ``window`` (top, bottom, left, right) holds the contact patch, ``depth_mm`` (h, w)
    float32 the indentation over it, in pixels of ``pixel_area_mm2``, by which the volume is summed.
    ``shear`` is that of the gel's surface, which the next frame goes on from, ``motion`` how far it
    has carried the object along; both are None where nothing ever pulled. ``load`` is the frame's.

    The gel around the window is indented too by ``beside_depth_mm`` (n,), each over
    ``beside_area_mm2``, at the indenter's places ``beside_at`` (n,). ``is_beside_gel`` where the
    object presses, but not on the gel. ``first_touch_mm`` is how far above the gel the object's
    surface was in its pose.
    """

    indentation_mm: float = 0.0
    saturated: bool = False
    window: Window = (0, 0, 0, 0)
    depth_mm: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 0), np.float32))
    pixel_area_mm2: float = 0.0
    motion: ShearMotion | None = None
    shear: ShearState | None = None
    load: GelLoad = field(default_factory=GelLoad)
    beside_at: NDArray[np.int32] = field(default_factory=lambda: np.zeros(0, np.int32))
    beside_depth_mm: FloatArray = field(default_factory=lambda: np.zeros(0))
    beside_area_mm2: float = 0.0
    is_beside_gel: bool = False
    first_touch_mm: float = math.inf

    @property
    def volume_mm3(self) -> float:
        """What the gel has really lost in the window: less than asked for where it is saturated."""
        return float(self.depth_mm.sum(dtype=np.float64)) * self.pixel_area_mm2

    @property
    def share(self) -> float:
        """The part of the pressure that acts in the window."""
        if self.is_beside_gel:
            return 0.0
        if not self.beside_depth_mm.size:
            return 1.0
        shown_mm3 = self.volume_mm3
        return shown_mm3 / (shown_mm3 + float(self.beside_depth_mm.sum()) * self.beside_area_mm2)

    @property
    def status(self) -> ContactStatus:
        """What the image shows of the contact."""
        return contact_status(self.share, touches=self.indentation_mm > 0)

    def depth_map_mm(self, sensor: Sensor) -> NDArray[np.float32]:
        """Indentation over the whole pad, (H, W)."""
        whole = np.zeros(sensor.shape_px, dtype=np.float32)
        top, bottom, left, right = self.window
        whole[top:bottom, left:right] = self.depth_mm
        return whole


def contact_status(share: float, *, touches: bool) -> ContactStatus:
    """The status of a frame that shows this share of the pressure on the gel."""
    if share < 1.0 - OUTSIDE_SHARE:
        return "outside_window"
    return "ok" if touches else "no_contact"


@njit(cache=True, nogil=True)
def _patch_bounds(grains: NDArray[np.int32], delta: float) -> tuple[int, int, int, int]:
    """Half-open rectangle of the pixels closer than ``delta`` grains."""
    n_rows, width = grains.shape
    top, bottom = n_rows, 0
    nearest = np.full(width, 2**30, np.int32)
    for r in range(n_rows):
        row = grains[r]
        smallest = np.int32(2**30)
        for k in range(width):
            nearest[k] = min(nearest[k], row[k])
            smallest = min(smallest, row[k])
        if smallest < delta:
            top, bottom = min(top, r), r + 1
    left, right = width, 0
    for k in range(width):
        if nearest[k] < delta:
            left, right = min(left, k), k + 1
    return top, bottom, left, right


@njit(cache=True, nogil=True)
def _fill_depth(
    grains: NDArray[np.int32],
    delta: float,
    bounds: tuple[int, int, int, int],
    grain_mm: float,
    depth_mm: NDArray[np.float32],
) -> None:
    top, bottom, left, right = bounds
    for r in range(top, bottom):
        row, out = grains[r, left:right], depth_mm[r - top]
        for k in range(right - left):
            out[k] = max(0.0, (delta - row[k]) * grain_mm)


class Indenter:
    """Presses objects into the gel of one sensor; ``camera`` as of :class:`TactilePad`."""

    def __init__(self, sensor: Sensor, camera: str = "raster") -> None:
        self.sensor = sensor
        self._mapper = GapMapper(sensor, camera)
        self._x_mm, self._y_mm = pixel_centers_mm(sensor)
        self._reach_mm = sensor.gel_depth_mm
        self._spills = False  # beyond the window, as the last contact did

    def patch(self, mesh: Mesh, pose_gel_object: FloatArray, load: GelLoad) -> ContactPatch:
        """Where the gel presses on an object at a pose: its pressure is the indentation over k_n.

        The law V = k_n F makes the gel an elastic foundation, F = ∫ depth/k_n dA.
        """
        imprint = self.indent(mesh, pose_gel_object, load)
        points_mm, depth_mm, area_mm2 = self.sampled(imprint)
        share = area_mm2 * depth_mm.astype(np.float64)
        if n_beside := len(imprint.beside_depth_mm):
            kept = slice(None, None, 1 + n_beside // FIELD_POINTS)
            beside = imprint.beside_depth_mm[kept]
            total = imprint.beside_area_mm2 * imprint.beside_depth_mm.sum()
            share = np.concatenate([share, total * beside / beside.sum()])
            beside_mm = self._mapper.beside_mm[imprint.beside_at[kept]]
            points_mm = np.concatenate([points_mm, beside_mm])
        return ContactPatch(points_mm, share / max(share.sum(), 1e-12))

    def sampled(self, imprint: Imprint) -> tuple[NDArray[np.float64], NDArray[np.float32], float]:
        """Points (n, 2) of the contact patch, their depth (n,) and the area that each stands for.

        ``FIELD_POINTS`` or fewer tell the patch's shape and weight: the depth is smooth.
        """
        top, bottom, left, right = imprint.window
        every = max(1, int((imprint.depth_mm.size / FIELD_POINTS) ** 0.5))
        depth_mm = imprint.depth_mm[every // 2 :: every, every // 2 :: every]
        rows, columns = np.nonzero(depth_mm)
        if rows.size == 0:
            every, depth_mm = 1, imprint.depth_mm
            rows, columns = np.nonzero(depth_mm)
        x_mm = self._x_mm[left:right][every // 2 :: every][columns]
        y_mm = self._y_mm[top:bottom][every // 2 :: every][rows]
        area_mm2 = self.sensor.pixel_area_mm2 * every**2
        return np.stack([x_mm, y_mm], axis=1), depth_mm[rows, columns], area_mm2

    def outside_share(self, imprint: Imprint) -> NDArray[np.float64]:
        """Shares of the pressure beyond the window's left, top, right and bottom edge, (4,)."""
        if not imprint.beside_depth_mm.size:
            return np.zeros(4)
        half_mm = self.sensor.mm_per_px * np.array(self.sensor.shape_px)[::-1] / 2
        places_mm = self._mapper.beside_mm[imprint.beside_at]
        beyond_mm = np.hstack([-places_mm, places_mm]) - np.tile(half_mm, 2)
        by_edge = np.bincount(beyond_mm.argmax(axis=1), imprint.beside_depth_mm, minlength=4)
        return np.asarray(by_edge / by_edge.sum() * (1.0 - imprint.share))

    def indent(self, mesh: Mesh, pose_gel_object: FloatArray, load: GelLoad) -> Imprint:
        """The imprint of an object at a pose, without its motion by shear."""
        asked = load.indentation_mm if load.volume_mm3 is None else load.volume_mm3
        if not asked or asked <= 0:
            return Imprint()
        if load.center_mm is not None and self._is_beside_gel(load.center_mm):
            return Imprint(is_beside_gel=True)
        reach_mm, beside, places = self._reach_mm, _NONE, _NONE
        while True:
            gap = self._mapper.measure(
                mesh.vertices_mm, mesh.faces, pose_gel_object, reach_mm=reach_mm
            )
            if self._spills:
                beside, places = self._mapper.beside(reach_mm)
            delta, deepest = self._delta(gap, beside, load)
            # What lies beyond the reach could only have made the gel give less: δ is a bound.
            if not gap.touches or delta * GAP_GRAIN_MM <= reach_mm:
                break
            reach_mm = REACH_MARGIN * delta * GAP_GRAIN_MM
        if not self._spills:  # nor could what touches beside the window
            beside, places = self._mapper.beside(delta * GAP_GRAIN_MM)
            if beside.size:
                delta, deepest = self._delta(gap, beside, load)
        if not gap.touches and not beside.size:
            return Imprint(is_beside_gel=True)
        if gap.touches:
            self._reach_mm = max(0.0, REACH_MARGIN * delta * GAP_GRAIN_MM)
        imprint = self._imprint_at(gap, delta, saturated=delta >= deepest)
        touched = beside < delta
        self._spills = bool(touched.any())
        if not self._spills:
            return imprint
        return replace(
            imprint,
            beside_at=places[touched],
            beside_depth_mm=GAP_GRAIN_MM * (delta - beside[touched]),
            beside_area_mm2=self.sensor.pixel_area_mm2 * self._mapper.beside_pixels,
        )

    def indent_map(self, gap_map_mm: NDArray[np.floating], load: GelLoad) -> Imprint:
        """The imprint of an object of which the gap map (H, W), mm, is known, +inf beside it."""
        asked = load.indentation_mm if load.volume_mm3 is None else load.volume_mm3
        gap = gap_of_map(gap_map_mm)
        if not asked or asked <= 0 or not gap.touches:
            return Imprint()
        delta, deepest = self._delta(gap, _NONE, load)
        return self._imprint_at(gap, delta, saturated=delta >= deepest)

    def known(self, depth_map_mm: NDArray[np.float32]) -> Imprint:
        """The imprint of an indentation (H, W), mm, that is known."""
        touched = depth_map_mm > 0.0
        if not touched.any():
            return Imprint()
        rows, columns = np.flatnonzero(touched.any(axis=1)), np.flatnonzero(touched.any(axis=0))
        top, left = int(rows[0]), int(columns[0])
        window = top, int(rows[-1]) + 1, left, int(columns[-1]) + 1
        depth_mm = np.maximum(depth_map_mm[top : window[1], left : window[3]], 0.0)
        deepest_mm, area_mm2 = float(depth_mm.max()), self.sensor.pixel_area_mm2
        is_through = deepest_mm >= self.sensor.gel_depth_mm
        return Imprint(deepest_mm, is_through, window, depth_mm, area_mm2)

    def _delta(
        self, gap: ObjectGap, beside: NDArray[np.int32], load: GelLoad
    ) -> tuple[float, float]:
        """δ of a load, and the largest there can be, in grains beyond first touch in the window.

        The object may touch beside it before: then the gel is pressed through sooner.
        """
        first = min(int(beside.min()), 0) if beside.size else 0
        deepest = self.sensor.gel_depth_mm / GAP_GRAIN_MM + first
        if load.volume_mm3 is None:
            return min((load.indentation_mm or 0.0) / GAP_GRAIN_MM + first, deepest), deepest
        if not (gap.touches or beside.size):
            return deepest, deepest
        volume = load.volume_mm3 / (GAP_GRAIN_MM * self.sensor.pixel_area_mm2)
        weight = float(self._mapper.beside_pixels)
        return solve_grains(gap.grains, volume, deepest, beside, weight), deepest

    def _is_beside_gel(self, center_mm: tuple[float, float]) -> bool:
        width_mm, height_mm = gel_size_mm(self.sensor)
        beyond_mm = abs(center_mm[0]) - width_mm / 2, abs(center_mm[1]) - height_mm / 2
        return max(beyond_mm) > BESIDE_GEL_MM

    def _imprint_at(self, gap: ObjectGap, delta: float, *, saturated: bool) -> Imprint:
        if not gap.touches or delta <= 0:
            return Imprint(saturated=saturated)
        bounds = _patch_bounds(gap.grains, delta)
        top, bottom, left, right = bounds
        depth_mm = np.empty((bottom - top, right - left), dtype=np.float32)
        _fill_depth(gap.grains, delta, bounds, GAP_GRAIN_MM, depth_mm)
        row, column = gap.window[0], gap.window[2]
        window = (row + top, row + bottom, column + left, column + right)
        area_mm2, first_mm = self.sensor.pixel_area_mm2, gap.first_touch_mm
        return Imprint(
            *(delta * GAP_GRAIN_MM, saturated, window, depth_mm, area_mm2), first_touch_mm=first_mm
        )

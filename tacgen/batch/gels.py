"""What the gels of a batch remember: the contact law's effects and the shear, world by world.

Both are computed on the host, as for one sensor: they are functions of a history, and small.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.contact.law import ContactLaw
from tacgen.contact.shear import marker_grid_mm
from tacgen.contact.shear_field import ShearState
from tacgen.core.arrays import FloatArray
from tacgen.core.errors import ContactError
from tacgen.core.records import ContactFrame, Sensor
from tacgen.sensor.gel_response import GelCourse, GelLoad, gel_loads
from tacgen.sensor.gel_shear import GelShear


@dataclass(slots=True)
class _Gel:
    """One world's: its law's history, and its shear in the last frame."""

    course: GelCourse
    shear: ShearState | None = None


class Gels:
    """The gels of N worlds under one contact law."""

    def __init__(self, sensor: Sensor, law: ContactLaw, n: int) -> None:
        self._law, self._shear = law, GelShear(sensor)
        self._markers_mm, self._area_mm2 = marker_grid_mm(sensor), sensor.pixel_area_mm2
        self._gels = [_Gel(GelCourse(law)) for _ in range(n)]

    def begin(self, worlds: Iterable[int]) -> None:
        """A new press, of a gel at rest, in some worlds."""
        for world in worlds:
            self._gels[world].course.begin()
            self._gels[world].shear = None

    @property
    def are_sheared(self) -> bool:
        """Whether any gel was pulled in the frame before."""
        return any(gel.shear is not None for gel in self._gels)

    def loads(
        self, force_n: FloatArray, shear_n: FloatArray, torsion_n_mm: FloatArray, time_s: Any
    ) -> list[GelLoad]:
        """The load on each gel (N,); without ``time_s`` each frame is a new press.

        Raises ``ContactError`` if a force or a time is none.
        """
        times = np.broadcast_to(0.0 if time_s is None else np.asarray(time_s, float), len(force_n))
        rows = np.column_stack([force_n, shear_n, torsion_n_mm, times])
        wrong = np.flatnonzero(~np.isfinite(rows).all(axis=1) | (force_n < 0))
        if wrong.size:
            msg = (
                f"world {wrong[0]}: force_n, shear_n, turn or time_s is not finite, or force_n "
                "negative; give a force into the gel of 0 N or more"
            )
            raise ContactError(msg)
        loads: list[GelLoad] = []
        for world, (gel, row) in enumerate(zip(self._gels, rows, strict=True)):
            frame = ContactFrame(row[4], row[0], row[1:3], row[3], np.eye(4))
            if time_s is None:
                self.begin([world])
                loads += gel_loads(self._law, [frame])
                continue
            if gel.course.last_s is not None and frame.time_s < gel.course.last_s:
                self.begin([world])
            loads.append(gel.course.load(frame, 0.0))
        return loads

    def shear(
        self,
        loads: list[GelLoad],
        depth_mm: NDArray[np.float32],
        beside_mm3: NDArray[np.float64],
        poses: NDArray[np.float64],
    ) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """Poses (N, 4, 4) of the objects after the shear, and the markers' motion (N, M, 2), mm.

        ``depth_mm`` (N, H, W) is the indentation at ``poses`` before it; ``beside_mm3`` (N,) the
        volume that the gel around the window has lost.
        """
        moved, motion_mm = poses.copy(), np.zeros((len(loads), *self._markers_mm.shape), np.float32)
        for world, (gel, load, whole) in enumerate(zip(self._gels, loads, depth_mm, strict=True)):
            rows, columns = (np.flatnonzero(whole.any(axis=axis)) for axis in (1, 0))
            if not rows.size:
                continue
            window = int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1
            patch = np.ascontiguousarray(whole[window[0] : window[1], window[2] : window[3]])
            shown_mm3 = float(patch.sum(dtype=np.float64)) * self._area_mm2
            share = shown_mm3 / (shown_mm3 + beside_mm3[world])
            gel.shear = self._shear.step(patch, window, load, share, gel.shear)
            if gel.shear is not None:
                moved[world] = self._shear.object_motion(gel.shear, load).moved(poses[world])
                motion_mm[world] = self._shear.motion_mm(gel.shear, self._markers_mm, load)
        return moved, motion_mm

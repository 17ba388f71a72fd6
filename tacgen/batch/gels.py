"""What the gels of a batch remember, world by world: the contact law's effects and the shear.

The effects are functions of a history and are computed on the host, as for one sensor; the shear is
solved on the device.
"""

from collections.abc import Iterable
from copy import copy
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from tacgen.batch import shear_kernels
from tacgen.contact.law import ContactLaw
from tacgen.contact.shear_field import AHEAD, MOST_SWEEPS, SKIN, TOLERANCE
from tacgen.core.records import ContactFrame, Sensor
from tacgen.core.types import FloatArray
from tacgen.sensor.gel_response import GelCourse, GelLoad, gel_load, gel_loads
from tacgen.sensor.gel_shear import GelShear


class Gels:
    """The gels of N worlds under one contact law, of which ``part`` are at work at a time.

    ``slides`` (N,) is where ``take`` was asked for more shear than friction holds.
    """

    def __init__(
        self, sensor: Sensor, law: ContactLaw, n: int, device: wp.Device, part: int
    ) -> None:
        self._sensor, self._law, self._n, self._device, self._part = sensor, law, n, device, part
        self.is_plain = not (law.effects or law.collision_margin_mm)  # a factor on the force
        self._courses = [] if self.is_plain else [GelCourse(law) for _ in range(n)]
        self._last_s, self._is_new = np.full(n, -np.inf), np.ones(n, bool)
        at_rest = ContactFrame(0.0, 0.0, np.zeros(2), 0.0, np.eye(4))
        self._plain = gel_load(law, at_rest, 0.0, np.zeros(2))  # what all loads have in common
        self._lattice: Any = None
        self.slides: Any = wp.zeros(n, dtype=wp.bool, device=device)
        self.may_be_sheared = False

    def history(self) -> tuple[Any, ...]:
        """What the gels remember on the host, for ``take_back``; the device goes on last."""
        courses = [copy(course) for course in self._courses]
        return self._last_s.copy(), self._is_new.copy(), courses, self.may_be_sheared

    def take_back(self, history: tuple[Any, ...]) -> None:
        """Remember what they did then."""
        self._last_s, self._is_new, self._courses, self.may_be_sheared = history

    def begin(self, worlds: Iterable[int] | NDArray[np.integer[Any]]) -> None:
        """A new press, of a gel at rest, in some worlds."""
        worlds = np.asarray(list(worlds), int)
        self._last_s[worlds], self._is_new[worlds] = -np.inf, True
        for world in worlds if self._courses else ():
            self._courses[world].begin()

    def at(self, time_s: FloatArray | None) -> None:
        """The worlds' clocks (N,); without them, or where one goes back, a new press begins."""
        self.slides.zero_()
        if time_s is None:
            self.begin(range(self._n))
            return
        self.begin(np.flatnonzero(time_s < self._last_s))
        self._last_s[:] = time_s

    def responses(
        self, force_n: FloatArray, shear_n: FloatArray, time_s: FloatArray | None
    ) -> tuple[FloatArray, FloatArray]:
        """What each gel answers by a law that is not plain: volume, or δ, (N,), and shear (N, 2).

        The shear is over k_s: the force that it is the plain law's answer to.
        """
        loads: list[GelLoad] = []
        for world, (course, force, shear) in enumerate(
            zip(self._courses, force_n, shear_n, strict=True)
        ):
            at_s = 0.0 if time_s is None else time_s[world]
            frame = ContactFrame(at_s, force, shear, 0.0, np.eye(4))
            one = gel_loads(self._law, [frame])[0] if time_s is None else course.load(frame, 0.0)
            loads.append(one)
        normal = [one.indentation_mm if one.volume_mm3 is None else one.volume_mm3 for one in loads]
        sums_mm, k_s = np.array([one.shear_sum_mm for one in loads]), self._plain.k_s_mm_per_n
        return np.array(normal, float), sums_mm / k_s if k_s > 0 else shear_n

    def pull(
        self, force_n: FloatArray, pulls: FloatArray, along_n: FloatArray, *, keeps: bool
    ) -> Any:
        """What the next frame's shear is solved from, on the device.

        ``pulls`` (N, 3) are shear and torsion, N and N·mm; ``along_n`` (N, 2) is the shear over k_s
        that the law makes of it. Without ``keeps`` the frame after is a new press.
        """
        self._lattice = self._lattice or self._prepared()
        gels, turns = self._lattice, self._plain.k_s_mm_per_n > 0
        if self._is_new.any():
            gels.is_sheared.assign(np.where(self._is_new, 0, gels.is_sheared.numpy()))
        self._is_new[:] = False
        gels.force_n.assign(force_n)
        gels.along.assign(np.column_stack([along_n, pulls[:, 2] * turns]))
        self.slides.assign(np.hypot(*pulls[:, :2].T) > self._plain.friction * force_n)
        self.may_be_sheared = keeps
        return gels

    def _prepared(self) -> Any:
        """The lattice of the sensor's gel, and the memory for the shear on it."""
        shear, load, n, b = GelShear(self._sensor), self._plain, self._n, self._part
        field, g = shear.field(load.decay_mm), shear_kernels.Gels()

        def put(values: Any) -> wp.array:
            return wp.array(np.ascontiguousarray(values, np.float64), device=self._device)

        def zeros(*shape: int, dtype: Any = wp.float64) -> wp.array:
            return wp.zeros(shape, dtype=dtype, device=self._device)

        rows, columns = field.shape
        g.pixels, (g.before_rows, g.before_columns) = shear.pixels, shear.before_px
        g.cell_mm, g.pixel_mm2 = shear.lattice_mm, self._sensor.pixel_area_mm2
        g.x_mm, g.y_mm = put(field.nodes_mm[0, :, 0]), put(field.nodes_mm[:, 0, 1])
        g.stiff, g.squares, g.shown = put(field.stiff), put(field.squares), put(field.shown)
        g.alpha, g.beta, g.over = field.alpha, 0.25 * (AHEAD - 1.0) * field.alpha, field.over
        g.skin, g.tolerance, g.most_sweeps = SKIN, TOLERANCE, MOST_SWEEPS
        g.friction, g.compliance_mm3_per_n = load.friction, shear.compliance_mm3_per_n(load)
        g.force_n, g.along, g.is_sheared = zeros(n), zeros(n, 3), zeros(n, dtype=wp.int32)
        wide = rows + 2, columns + 2
        g.sheet, g.held = zeros(n, *wide, 2), zeros(n, *wide, 2)
        g.sheet_before, g.held_before = zeros(b, *wide, 2), zeros(b, *wide, 2)
        g.pressure, g.limit = zeros(b, rows, columns), zeros(b, *wide)
        g.sticks = zeros(b, *wide, dtype=wp.int32)
        g.seen, g.center_mm = zeros(b, dtype=wp.vec2d), zeros(b, dtype=wp.vec2d)
        return g

"""The shear of one pad's gel: from a frame's imprint and load to the field, and what it moves."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tacgen.contact.gel_response import GelLoad
from tacgen.contact.shear import ShearMotion, marker_grid_mm, marker_pitch_mm
from tacgen.contact.shear_field import LATTICE_MM, ShearField, ShearState, weighted
from tacgen.core.compiled import njit
from tacgen.core.records import Sensor
from tacgen.core.types import Window

DECAY_PER_GEL_DEPTH = 0.5
"""How far beside a contact the gel moves with it, over its thickness, where no law says it."""


@njit(cache=True, nogil=True)
def _cell_sums(
    depth_mm: NDArray[np.float32],
    top: int,
    left: int,
    pixels: int,
    sums: NDArray[np.float64],
) -> None:
    """Sums of the indentation over cells of ``pixels`` × ``pixels``."""
    for r in range(depth_mm.shape[0]):
        row = (top + r) // pixels
        for c in range(depth_mm.shape[1]):
            sums[row, (left + c) // pixels] += depth_mm[r, c]


class GelShear:
    """Lattice and field of a sensor's gel.

    Its ``shape`` is (rows, columns) of cells of ``pixels`` × ``pixels``, ``lattice_mm`` wide; the
    first begin ``before_px`` (rows, columns) before the window.
    """

    def __init__(self, sensor: Sensor) -> None:
        self.pixels = max(1, round(LATTICE_MM / sensor.mm_per_px))
        # As many cells beyond the window on either side, so that the lattice is about its middle.
        self.shape = tuple(-(-n // self.pixels) for n in sensor.shape_px)
        self.before_px = tuple(
            (cells * self.pixels - n) // 2
            for cells, n in zip(self.shape, sensor.shape_px, strict=True)
        )
        self._window_px = sensor.shape_px
        self.lattice_mm = self.pixels * sensor.mm_per_px
        self._markers_mm, self._pitch_mm = marker_grid_mm(sensor), marker_pitch_mm(sensor)
        self._decay_mm = DECAY_PER_GEL_DEPTH * sensor.gel_depth_mm
        self._fields: dict[float, ShearField] = {}

    def field(self, decay_mm: float | None) -> ShearField:
        """The lattice with a decay; None: the sensor's."""
        decay = self._decay_mm if decay_mm is None else decay_mm
        if decay not in self._fields:
            rows, columns = self.shape
            size = columns * self.lattice_mm, rows * self.lattice_mm
            self._fields[decay] = ShearField(
                *size, decay, self.lattice_mm, self._markers_mm, self._pitch_mm
            )
        return self._fields[decay]

    @property
    def cell_mm2(self) -> float:
        """Area of a cell of the lattice."""
        return self.lattice_mm**2

    def pressure_share(self, depth_mm: NDArray[np.float32], window: Window) -> NDArray[np.float64]:
        """The part of the normal force on each cell of the lattice: that of the indentation."""
        sums = np.zeros(self.shape)
        top, left = window[0] + self.before_px[0], window[2] + self.before_px[1]
        _cell_sums(depth_mm, top, left, self.pixels, sums)
        total = weighted(sums, np.ones((*self.shape, 1)))[0]
        return np.asarray(sums / max(total, 1e-12))

    def compliance_mm3_per_n(self, load: GelLoad) -> float:
        """``c = k_s · pitch²``, by which the surface's motion ∫ u dA follows a force."""
        return (load.k_s_mm_per_n or 1.0) * (load.marker_pitch_mm or self._pitch_mm) ** 2

    def step(
        self,
        weigh: Callable[[], NDArray[np.float64]],
        load: GelLoad,
        share: float,
        before: ShearState | None,
    ) -> ShearState | None:
        """The shear of an indented gel; None where nothing ever pulled on it.

        ``weigh`` gives its ``pressure_share``, ``share`` is the part of the load that acts in the
        window.
        """
        k_s = load.k_s_mm_per_n or 1.0
        pulls = np.asarray(load.shear_sum_mm, np.float64) / k_s
        if load.k_s_mm_per_n == 0.0 and load.force_n is not None:
            pulls = np.array(load.force_n[:2])
        turns = load.turn_sum_mm2 != 0.0 or any(load.pull_sum_mm)
        if not (pulls.any() or turns or before is not None):
            return None
        field, weight = self.field(load.decay_mm), weigh()
        center_mm = weighted(weight, field.nodes_mm)
        is_part = share < 1.0 and load.center_mm is not None
        about_mm = load.center_mm if is_part and load.center_mm else center_mm
        normal_n = 1.0 if load.force_n is None else load.force_n[2]
        friction = np.inf if load.force_n is None or normal_n <= 0 else load.friction
        pressure = weight * (share * max(normal_n, 1e-9) / self.lattice_mm**2)
        torsion = share * load.turn_about_mm2(about_mm) / k_s
        return field.step(pressure, share * pulls, torsion, center_mm, friction, before)

    def motion_mm(
        self, state: ShearState, points_mm: NDArray[np.float64], load: GelLoad
    ) -> NDArray[np.float64]:
        """How far points (n, 2) of the gel's surface have moved along it, (n, 2)."""
        field = self.field(load.decay_mm)
        return field.motion_mm(state, points_mm, self.compliance_mm3_per_n(load))

    def object_motion(self, state: ShearState, load: GelLoad) -> ShearMotion:
        """How the gel under the object has moved, and with it the object, as a rigid body."""
        field = self.field(load.decay_mm)
        moved = self.compliance_mm3_per_n(load) * field.surface(state)
        x_mm, y_mm = np.moveaxis(field.nodes_mm - state.center_mm, -1, 0)
        spin = np.stack([x_mm * moved[..., 1] - y_mm * moved[..., 0], x_mm**2 + y_mm**2], axis=-1)
        total = weighted(state.pressure, np.ones((*self.shape, 1)))[0]
        turned, second = weighted(state.pressure, spin)
        shift_mm = weighted(state.pressure, moved) / max(total, 1e-12)
        return ShearMotion(shift_mm, turned / max(second, 1e-12), state.center_mm)

    def cells(self, lattice: NDArray[np.float64], shape: tuple[int, int]) -> NDArray[np.float64]:
        """Sums over a grid of ``shape`` cells on the window of a density on the lattice.

        ``lattice`` (rows, columns, n) is per cell of the lattice; what lies beyond the window
        counts to its border.
        """
        by_row, by_column = (
            _overlaps(n, cells, self.pixels, before, window)
            for n, cells, before, window in zip(
                shape, self.shape, self.before_px, self._window_px, strict=True
            )
        )
        return _gathered(by_row, lattice, by_column)


@njit(cache=True, nogil=True)
def _gathered(
    by_row: NDArray[np.float64], lattice: NDArray[np.float64], by_column: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Sums (i, j, n) of ``lattice`` (r, c, n) by shares (i, r) and (j, c)."""
    out = np.zeros((by_row.shape[0], by_column.shape[0], lattice.shape[2]))
    for r in range(lattice.shape[0]):
        for c in range(lattice.shape[1]):
            for i in range(by_row.shape[0]):
                for j in range(by_column.shape[0]):
                    share = by_row[i, r] * by_column[j, c]
                    if share > 0.0:
                        for n in range(lattice.shape[2]):
                            out[i, j, n] += share * lattice[r, c, n]
    return out


def _overlaps(n: int, cells: int, pixels: int, before: int, window: int) -> NDArray[np.float64]:
    """Share (n, cells) of each lattice cell that lies in each of ``n`` parts of the window."""
    edges = np.linspace(0, window, n + 1)
    edges[0], edges[-1] = -np.inf, np.inf
    start = np.arange(cells) * pixels - before
    low = np.maximum(edges[:-1, None], start)
    high = np.minimum(edges[1:, None], start + pixels)
    return np.asarray(np.maximum(high - low, 0.0) / pixels, np.float64)

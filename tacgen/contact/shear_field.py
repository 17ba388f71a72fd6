"""Shear of the gel's surface, point by point, with memory.

The surface is an elastic sheet on an elastic foundation, with a skin: a tangential traction t moves
it by

    u = c (w + ε t),   w − ℓ² ∇²w = (1 − ε) t,   ∫ u dA = c ∫ t dA = c F,

where c = k_s · marker pitch² is what D = k_s F_s measures (Si et al. 2022, Eq. 1), ℓ, the decay, is
how far the motion reaches beside the contact, and ε is the part of the compliance that a point has
by itself. ℓ = 0 is Winkler's foundation, without coupling of neighbours. A point of the contact
patch follows the object while |t| ≤ μ p and slips above, p being the pressure there. Nothing else
is assumed of the patch: the rim, where p falls to 0, slips first (Cattaneo 1938, Mindlin 1949).

What it remembers are w and t: a point that is touched sticks from where it is, one that slips keeps
its traction and follows from there, one that is left springs back. Between two frames the object is
taken to be pressed first, then sheared and turned.

What remains approximate: motion along and across the shear reaches as far, pressure alone moves no
point (``contact.shear.dilation_mm`` is added to the markers), and the lattice's border, the window,
is free: all of the motion lies in it.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.contact.raster import Float64
from tacgen.core.compiled import njit

LATTICE_MM = 0.5  # distance of the points at which the field is solved
SKIN = 0.2  # ε: part of the compliance that is of a point by itself
MOST_SWEEPS = 400
TOLERANCE = 1e-6  # of force and motion, to which a frame is solved
GROSS_SLIP = 0.98
"""Share of what friction can hold up to which sticking points are sought; above, all slip."""
GRAIN = 1e-9  # N/mm² to which the state is rounded, so that the next frame does not see last bits


@dataclass(frozen=True, slots=True)
class ShearState:
    """The shear of the gel's surface in one frame, on the lattice of its ``ShearField``.

    ``sheet`` (rows, columns, 2) is w and ``traction`` (rows, columns, 2) t, N/mm²: the surface has
    moved by c (w + ε t). ``held`` is the part of the traction that sticking and slipping give (see
    ``ShearField.step``), ``pressure`` (rows, columns) the normal part, ``sticks`` (rows, columns)
    where the object holds the gel. ``slide`` (3,) is by how much the object has moved since the
    frame before: along x and y at ``center_mm`` (times c: mm), and its turn.
    """

    sheet: Float64
    held: Float64
    traction: Float64
    pressure: Float64
    sticks: NDArray[np.bool_]
    slide: Float64
    center_mm: Float64


@njit(cache=True, nogil=True)
def _sweep(
    sheet: Float64,
    traction: Float64,
    sticks: NDArray[np.bool_],
    sheet_before: Float64,
    traction_before: Float64,
    limit: Float64,
    stiff: Float64,
    x_mm: Float64,
    y_mm: Float64,
    slide: Float64,
    alpha: float,
    skin: float,
    over: float,
    sums: Float64,
) -> float:
    """One pass of successive over-relaxation over the lattice; returns the largest change.

    Arrays have a margin of one, which is 0. ``limit`` is μ p, negative where nothing touches,
    ``stiff`` one more than α times the neighbours. ``sums`` (11,) gets Σ t_x, Σ t_y, Σ r × t, and
    for the points that touch Σ k, Σ k x, Σ k y, Σ k r² of their stiffness against the object alone,
    and the same when the sheet moves with it where it sticks.
    """
    most = 0.0
    sums[:] = 0.0
    for r in range(1, limit.shape[0] - 1):
        for c in range(1, limit.shape[1] - 1):
            each = 1.0 / stiff[r, c]
            wx = sheet[r - 1, c, 0] + sheet[r + 1, c, 0] + sheet[r, c - 1, 0] + sheet[r, c + 1, 0]
            wy = sheet[r - 1, c, 1] + sheet[r + 1, c, 1] + sheet[r, c - 1, 1] + sheet[r, c + 1, 1]
            wx, wy = each * alpha * wx, each * alpha * wy
            if limit[r, c] >= 0.0:
                x, y = x_mm[c], y_mm[r]
                alone = along = 1.0 / (skin + (1.0 - skin) * each)
                ahead_x = slide[0] - slide[2] * y + sheet_before[r, c, 0] - wx
                ahead_y = slide[1] + slide[2] * x + sheet_before[r, c, 1] - wy
                tx = (skin * traction_before[r, c, 0] + ahead_x) * alone
                ty = (skin * traction_before[r, c, 1] + ahead_y) * alone
                size = math.sqrt(tx * tx + ty * ty)
                sticks[r, c] = size <= limit[r, c]
                if sticks[r, c]:
                    held = sticks[r - 1, c] + sticks[r + 1, c] + sticks[r, c - 1] + sticks[r, c + 1]
                    along = stiff[r, c] - held * alpha
                else:
                    share = limit[r, c] / size
                    tx, ty, alone, along = share * tx, share * ty, share * alone, share * along
                traction[r, c, 0], traction[r, c, 1] = tx, ty
                wx, wy = wx + (1.0 - skin) * tx * each, wy + (1.0 - skin) * ty * each
                sums[0] += tx
                sums[1] += ty
                sums[2] += x * ty - y * tx
                sums[3] += alone
                sums[4] += alone * x
                sums[5] += alone * y
                sums[6] += alone * (x * x + y * y)
                sums[7] += along
                sums[8] += along * x
                sums[9] += along * y
                sums[10] += along * (x * x + y * y)
            wx, wy = over * (wx - sheet[r, c, 0]), over * (wy - sheet[r, c, 1])
            sheet[r, c, 0] += wx
            sheet[r, c, 1] += wy
            most = max(most, abs(wx), abs(wy))
    return most


@njit(cache=True, nogil=True)
def _rigid(off: Float64, k: Float64, least_spin: float, out: Float64) -> None:
    """The motion ``out`` (3,) that makes up for a force and moment ``off`` (3,)."""
    mx, my = k[1] / k[0], k[2] / k[0]  # the middle of what holds
    spin = k[3] - k[0] * (mx * mx + my * my)
    turn = (off[2] - (mx * off[1] - my * off[0])) / max(spin, least_spin * k[0])
    out[0], out[1], out[2] = off[0] / k[0] + turn * my, off[1] / k[0] - turn * mx, turn


@njit(cache=True, nogil=True)
def _solve(
    sheet: Float64,
    traction: Float64,
    sticks: NDArray[np.bool_],
    sheet_before: Float64,
    traction_before: Float64,
    limit: Float64,
    stiff: Float64,
    x_mm: Float64,
    y_mm: Float64,
    load: Float64,
    arm_mm: float,
    alpha: float,
    skin: float,
    over: float,
    tolerance: float,
    slide: Float64,
) -> int:
    """Sweeps until force and moment ``load`` (3,), N/mm² and N/mm, are those of the tractions.

    After each, the object is moved by what force and moment lack: in turn by itself, and together
    with the sheet under the points that stick. Both lower the energy, as each sweep does.
    """
    sums, off, motion = np.zeros(11), np.zeros(3), np.zeros(3)
    size = math.sqrt(load[0] ** 2 + load[1] ** 2 + (load[2] / arm_mm) ** 2)
    for sweep in range(MOST_SWEEPS):
        most = _sweep(
            *(sheet, traction, sticks, sheet_before, traction_before, limit, stiff, x_mm, y_mm),
            *(slide, alpha, skin, over, sums),
        )
        off[:] = load - sums[:3]
        wrong = math.sqrt(off[0] ** 2 + off[1] ** 2 + (off[2] / arm_mm) ** 2)
        if wrong <= tolerance * size and most <= tolerance * np.abs(sheet).max():
            return sweep
        k = sums[3:7] if sweep % 2 else sums[7:11]
        _rigid(off, k, 0.05 * arm_mm**2, motion)
        slide += motion
        if sweep % 2 == 0:
            for r in range(sheet.shape[0]):
                for c in range(sheet.shape[1]):
                    if sticks[r, c]:
                        sheet[r, c, 0] += motion[0] - motion[2] * y_mm[r]
                        sheet[r, c, 1] += motion[1] + motion[2] * x_mm[c]
    return MOST_SWEEPS


class ShearField:
    """The lattice of one pad's gel, ``width_mm`` × ``height_mm``, about the gel frame's origin.

    ``decay_mm`` is ℓ; ``lattice_mm`` the distance of its points, of which the sides are multiples
    up to rounding. ``nodes_mm`` (rows, columns, 2) are their places x, y.
    """

    def __init__(
        self,
        width_mm: float,
        height_mm: float,
        decay_mm: float,
        lattice_mm: float = LATTICE_MM,
        skin: float = SKIN,
    ) -> None:
        rows = max(1, round(height_mm / lattice_mm))
        columns = max(1, round(width_mm / lattice_mm))
        self.shape = rows, columns
        self.lattice_mm, self.decay_mm, self._skin = lattice_mm, decay_mm, skin
        self._x_mm = (np.arange(columns) - (columns - 1) / 2) * lattice_mm
        self._y_mm = (np.arange(rows) - (rows - 1) / 2) * lattice_mm
        self.nodes_mm = np.stack(np.meshgrid(self._x_mm, self._y_mm), axis=-1)
        self._alpha = (decay_mm / lattice_mm) ** 2
        neighbours = sum(
            _wide(np.ones(self.shape))[r : rows + r, c : columns + c]
            for r, c in ((0, 1), (2, 1), (1, 0), (1, 2))
        )
        self._stiff = _wide(1.0 + self._alpha * np.asarray(neighbours))
        jacobi = 4 * self._alpha / (1 + 4 * self._alpha)
        self._over = 2.0 / (1.0 + math.sqrt(1.0 - jacobi**2))  # Young 1954: the fastest

    def step(
        self,
        pressure_n_per_mm2: Float64,
        force_n: Float64,
        torsion_n_mm: float,
        center_mm: Float64,
        friction: float,
        before: ShearState | None = None,
        tolerance: float = TOLERANCE,
    ) -> ShearState:
        """The state after one more frame.

        Parameters
        ----------
        pressure_n_per_mm2 : (rows, columns)
            Of the object on the gel; 0 where it does not touch.
        force_n : (2,)
            Force of the object on the gel, along x and y.
        torsion_n_mm : float
            Its moment about the gel's normal through ``center_mm`` (2,).
        friction : float
            Coulomb's coefficient μ. Where force and moment are more than it can hold, what is
            missing is added by the pressure: the tractions always sum to the force.
        before : ShearState, optional
            Of the frame before; None for a gel at rest.
        """
        pressure = np.ascontiguousarray(pressure_n_per_mm2, np.float64)
        force = np.asarray(force_n, np.float64)
        center = np.asarray(center_mm, np.float64)
        touches = pressure > 0
        if not touches.any():
            return self._at_rest(center)
        limit = np.full(self.shape, -1.0)
        limit[touches] = friction * pressure[touches]
        load = np.array([*force, float(torsion_n_mm)]) / self.lattice_mm**2
        x_mm, y_mm = self._x_mm - center[0], self._y_mm - center[1]
        arm_mm = np.hypot(x_mm, y_mm[:, None])
        within = load * min(1.0, GROSS_SLIP / max(_demand(load, limit, touches, arm_mm), 1e-12))
        start = self._at_rest(center) if before is None else before
        sheet, held, sticks = _wide(start.sheet), _wide(np.zeros((*self.shape, 2))), _wide(touches)
        slide = np.zeros(3)
        if before is not None or load.any():
            _solve(
                sheet,
                held,
                sticks,
                _wide(start.sheet),
                _wide(start.held),
                _wide(limit),
                self._stiff,
                np.pad(x_mm, 1),
                np.pad(y_mm, 1),
                within,
                max(float(arm_mm[touches].mean()), self.lattice_mm),
                self._alpha,
                self._skin,
                self._over,
                tolerance,
                slide,
            )
        sheet, held, sticks = (one[1:-1, 1:-1] for one in (sheet, held, sticks))
        # What the sweeps, or friction, leave of the force acts as the pressure does.
        rest = load[:2] - held.sum(axis=(0, 1))
        traction = held + (pressure / pressure.sum())[..., None] * rest
        sheet, held = np.round(sheet / GRAIN) * GRAIN, np.round(held / GRAIN) * GRAIN
        return ShearState(sheet, held, traction, pressure, sticks, slide, center)

    def _at_rest(self, center_mm: Float64) -> ShearState:
        nothing = np.zeros((*self.shape, 2))
        sticks = np.zeros(self.shape, bool)
        flat = np.zeros(self.shape)
        return ShearState(nothing, nothing, nothing, flat, sticks, np.zeros(3), center_mm)

    def surface(self, state: ShearState) -> Float64:
        """Motion of the surface at the nodes per compliance, (rows, columns, 2), N/mm²."""
        return state.sheet + self._skin * state.held

    def motion_mm(
        self, state: ShearState, points_mm: Float64, compliance_mm3_per_n: float
    ) -> Float64:
        """How far points (n, 2) of the gel's surface have moved along it, (n, 2), mm."""
        return compliance_mm3_per_n * _interpolated(
            self.surface(state),
            self._x_mm[0],
            self._y_mm[0],
            self.lattice_mm,
            np.ascontiguousarray(points_mm),
        )


def _wide(inner: NDArray[Any]) -> NDArray[Any]:
    """With a margin of one, which is 0, around rows and columns."""
    wide = np.zeros((inner.shape[0] + 2, inner.shape[1] + 2, *inner.shape[2:]), inner.dtype)
    wide[1:-1, 1:-1] = inner
    return wide


def _demand(load: Float64, limit: Float64, touches: NDArray[np.bool_], arm_mm: Float64) -> float:
    """Force and moment over what friction can hold: 1 where all slips.

    Source: Howe & Cutkosky 1996, the ellipsoid for the limit surface.
    """
    held = limit[touches]
    force, moment = held.sum(), (held * arm_mm[touches]).sum()
    if not math.isfinite(force):
        return 0.0
    return math.hypot(
        math.hypot(load[0], load[1]) / max(force, 1e-12), load[2] / max(moment, 1e-12)
    )


@njit(cache=True, nogil=True)
def _interpolated(
    field: Float64, x0_mm: float, y0_mm: float, pitch_mm: float, points_mm: Float64
) -> Float64:
    """Bilinear values (n, 2) of a field (rows, columns, 2); beyond its border, the border's."""
    n_rows, n_columns = field.shape[0], field.shape[1]
    out = np.empty((points_mm.shape[0], 2))
    for i in range(points_mm.shape[0]):
        column = min(max((points_mm[i, 0] - x0_mm) / pitch_mm, 0.0), n_columns - 1.0)
        row = min(max((points_mm[i, 1] - y0_mm) / pitch_mm, 0.0), n_rows - 1.0)
        c, r = min(int(column), max(n_columns - 2, 0)), min(int(row), max(n_rows - 2, 0))
        c1, r1 = min(c + 1, n_columns - 1), min(r + 1, n_rows - 1)
        fc, fr = column - c, row - r
        for axis in range(2):
            upper = (1 - fc) * field[r, c, axis] + fc * field[r, c1, axis]
            lower = (1 - fc) * field[r1, c, axis] + fc * field[r1, c1, axis]
            out[i, axis] = (1 - fr) * upper + fr * lower
    return out

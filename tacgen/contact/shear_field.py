"""Shear of the gel's surface, point by point, with memory.

The surface is an elastic sheet on an elastic foundation, with a skin: a tangential traction t moves
it by

    u = c (w + ε t),   w − ℓ² ∇²w − 4 ℓ² ∇(∇ · w) = (1 − ε) t,   ∫ u dA = c ∫ t dA = c F,

where c = k_s · marker pitch² is what D = k_s F_s measures (Si et al. 2022, Eq. 1), ℓ, the decay, is
how far the motion reaches aside of the contact (√5 ℓ ahead of it, as on a thin bonded layer that
keeps its volume), and ε is the part of the compliance that a point has by itself. ℓ = 0 is
Winkler's foundation, without coupling of neighbours. A point of the contact patch follows the
object while |t| ≤ μ p and slips above, p being the pressure there: the rim, where p falls to 0,
slips first (Cattaneo 1938, Mindlin 1949).

What it remembers are w and t: a point that is touched sticks from where it is, one that slips keeps
its traction and follows from there, one that is left springs back. Between two frames the object is
taken to be pressed first, then sheared and turned.

What remains approximate: a small contact that is turned moves the gel too little
(``validation.shear.referee``), pressure alone moves no point (``contact.shear.dilation_mm`` is
added to the markers), one step or 100 to a constant force differ by 0.9 %, with torsion near the
limit by 2–4 %, and more where the object turns far in the grip; beyond the window the gel goes on
without an end, and D, which markers show
of it, is taken to be k_s F_s wherever the contact is.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tacgen.contact.raster import Float64
from tacgen.core.compiled import njit

LATTICE_MM = 0.6  # distance of the points at which the field is solved
SKIN = 0.1
"""ε, the part of the compliance that a point has by itself."""
AHEAD = 5.0
"""ℓ_p² / ℓ², how much farther a push reaches ahead than aside: of an incompressible layer."""
MOST_SWEEPS = 400
TOLERANCE = 1e-5  # of force and motion, to which a frame is solved
GROSS_SLIP = 0.98
"""Share of what friction can hold up to which sticking points are sought; above, all slip."""
LEAST_SEEN = 0.3
"""Part of the motion that markers show at least: beyond their grid D is not what k_s F_s says."""
GRAIN = 1e-9  # N/mm² to which the state is rounded, so that the next frame does not see last bits


@dataclass(frozen=True, slots=True)
class ShearState:
    """The shear of the gel's surface in one frame, on the lattice of its ``ShearField``.

    ``sheet`` (rows, columns, 2) is w and ``held`` (rows, columns, 2) the traction t of sticking and
    slipping, N/mm², from which the surface has moved by c (w + ε t). ``traction`` has beside it
    what friction cannot hold of the force (see ``ShearField.step``). ``pressure`` (rows, columns)
    is the normal part, ``sticks`` (rows, columns) where the object holds the gel. ``slide`` (3,) is
    by how much the object has moved since the frame before: along x and y at ``center_mm`` (times
    c: mm), and its turn. ``seen`` (2,) is the part of the motion along x and y that the markers
    show: D, their sum, is k_s F_s wherever the contact is, and u larger by 1 / ``seen``.
    """

    sheet: Float64
    held: Float64
    traction: Float64
    pressure: Float64
    sticks: NDArray[np.bool_]
    slide: Float64
    center_mm: Float64
    seen: Float64


class Lattice(NamedTuple):
    """The points at which a field is solved, with a margin of one around them.

    ``x_mm`` and ``y_mm`` are those of columns and rows, about the contact's middle; ``stiff``
    (rows, columns, 2) is the sheet's own stiffness of a point, ``squares`` (rows, columns) 1 for
    each square of four points (above and left of the point of its place), on which ∇ · w is taken.
    ``alpha`` is ℓ² over the square of their distance, ``over`` the factor of over-relaxation.
    """

    x_mm: Float64
    y_mm: Float64
    stiff: Float64
    squares: Float64
    alpha: float
    over: float


class Sheet(NamedTuple):
    """What is solved for on a ``Lattice``, with its margin, which is 0.

    ``w`` and ``traction`` (rows, columns, 2) and ``sticks`` (rows, columns) are written; those of
    before are of the frame before. ``limit`` (rows, columns) is μ p, negative where nothing
    touches.
    """

    w: Float64
    traction: Float64
    sticks: NDArray[np.bool_]
    w_before: Float64
    traction_before: Float64
    limit: Float64


@njit(cache=True, nogil=True)
def weighted(weight: Float64, values: Float64) -> Float64:
    """Sums (n,) of values (rows, columns, n) by their weights, the same on every processor."""
    sums = np.zeros(values.shape[2])
    for r in range(weight.shape[0]):
        for c in range(weight.shape[1]):
            for k in range(values.shape[2]):
                sums[k] += weight[r, c] * values[r, c, k]
    return sums


@njit(cache=True, nogil=True)
def _add(sums: Float64, k: float, x: float, y: float) -> None:
    sums[0] += k
    sums[1] += k * x
    sums[2] += k * y
    sums[3] += k * (x * x + y * y)


@njit(cache=True, nogil=True)
def _sweep(of: Sheet, lattice: Lattice, slide: Float64, sums: Float64) -> float:
    """One pass of successive over-relaxation over the lattice; returns the largest change.

    ``slide`` (3,) is the object's motion. ``sums`` (11,) gets Σ t_x, Σ t_y, Σ r × t, and for the
    points that touch Σ k, Σ k x, Σ k y, Σ k r² of their stiffness against the object alone, and the
    same when the sheet moves with it where it sticks.
    """
    sheet, traction, sticks, sheet_before, traction_before, limit = of
    x_mm, y_mm, stiff, squares, alpha, over = lattice
    most, beta = 0.0, 0.25 * (AHEAD - 1.0) * alpha
    sums[:] = 0.0
    for r in range(1, limit.shape[0] - 1):
        for c in range(1, limit.shape[1] - 1):
            each_x, each_y = 1.0 / stiff[r, c, 0], 1.0 / stiff[r, c, 1]
            x0, y0 = sheet[r, c, 0], sheet[r, c, 1]
            xa, ya = sheet[r - 1, c, 0], sheet[r - 1, c, 1]  # above, below, left and right
            xb, yb = sheet[r + 1, c, 0], sheet[r + 1, c, 1]
            xl, yl = sheet[r, c - 1, 0], sheet[r, c - 1, 1]
            xr, yr = sheet[r, c + 1, 0], sheet[r, c + 1, 1]
            xal, yal = sheet[r - 1, c - 1, 0], sheet[r - 1, c - 1, 1]
            xar, yar = sheet[r - 1, c + 1, 0], sheet[r - 1, c + 1, 1]
            xbl, ybl = sheet[r + 1, c - 1, 0], sheet[r + 1, c - 1, 1]
            xbr, ybr = sheet[r + 1, c + 1, 0], sheet[r + 1, c + 1, 1]
            al, ar, bl, br = (
                squares[r, c], squares[r, c + 1], squares[r + 1, c], squares[r + 1, c + 1]
            )  # fmt: skip
            own = beta * (al + ar + bl + br)
            # Twice the divergence on the four squares around.
            al *= xa - xal + x0 - xl + yl - yal + y0 - ya
            ar *= xar - xa + xr - x0 + y0 - ya + yr - yar
            bl *= x0 - xl + xb - xbl + ybl - yl + yb - y0
            br *= xr - x0 + xbr - xb + yb - y0 + ybr - yr
            wx = (own * x0 + alpha * (xa + xb + xl + xr) - beta * (al - ar + bl - br)) * each_x
            wy = (own * y0 + alpha * (ya + yb + yl + yr) - beta * (al + ar - bl - br)) * each_y
            if limit[r, c] >= 0.0:
                x, y = x_mm[c], y_mm[r]
                alone_x = 1.0 / (SKIN + (1.0 - SKIN) * each_x)
                alone_y = 1.0 / (SKIN + (1.0 - SKIN) * each_y)
                alone = along = min(alone_x, alone_y)
                ahead_x = slide[0] - slide[2] * y + sheet_before[r, c, 0] - wx
                ahead_y = slide[1] + slide[2] * x + sheet_before[r, c, 1] - wy
                tx = (SKIN * traction_before[r, c, 0] + ahead_x) * alone_x
                ty = (SKIN * traction_before[r, c, 1] + ahead_y) * alone_y
                size = math.sqrt(tx * tx + ty * ty)
                sticks[r, c] = size <= limit[r, c]
                if sticks[r, c]:
                    held = sticks[r - 1, c] + sticks[r + 1, c] + sticks[r, c - 1] + sticks[r, c + 1]
                    along = 1.0 + (stiff[r, c, 0] - 1.0) * (1.0 - 0.25 * held)
                else:
                    share = limit[r, c] / size
                    tx, ty, alone, along = share * tx, share * ty, share * alone, share * along
                traction[r, c, 0], traction[r, c, 1] = tx, ty
                wx, wy = wx + (1.0 - SKIN) * tx * each_x, wy + (1.0 - SKIN) * ty * each_y
                sums[0] += tx
                sums[1] += ty
                sums[2] += x * ty - y * tx
                _add(sums[3:7], alone, x, y)
                _add(sums[7:], along, x, y)
            wx, wy = over * (wx - x0), over * (wy - y0)
            sheet[r, c, 0], sheet[r, c, 1] = x0 + wx, y0 + wy
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
    of: Sheet, lattice: Lattice, load: Float64, arm_mm: float, tolerance: float, slide: Float64
) -> int:
    """Sweeps until force and moment ``load`` (3,), N/mm² and N/mm, are those of the tractions.

    After each, the object is moved by what force and moment lack: in turn by itself, and together
    with the sheet under the points that stick. Both lower the energy, as each sweep does.
    """
    sheet, sticks = of.w, of.sticks
    sums, off, motion = np.zeros(11), np.zeros(3), np.zeros(3)
    size = math.sqrt(load[0] ** 2 + load[1] ** 2 + (load[2] / arm_mm) ** 2)
    for sweep in range(MOST_SWEEPS):
        most = _sweep(of, lattice, slide, sums)
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
                        sheet[r, c, 0] += motion[0] - motion[2] * lattice.y_mm[r]
                        sheet[r, c, 1] += motion[1] + motion[2] * lattice.x_mm[c]
    return MOST_SWEEPS


class ShearField:
    """The lattice of one pad's gel, ``width_mm`` × ``height_mm``, about the gel frame's origin.

    ``decay_mm`` is ℓ; ``lattice_mm`` the distance of its points, of which the sides are multiples
    up to rounding. ``nodes_mm`` (rows, columns, 2) are their places x, y. D is summed over
    ``markers_mm`` (n, 2), which stand ``marker_pitch_mm`` apart; None: ∫ u dA over the window.

    ``stiff``, ``squares``, ``alpha`` and ``over`` are those of its ``Lattice``, ``shown`` (rows,
    columns, 2) is the part of a force at each node that the sum has of it. ``tolerance`` is that of
    force and motion to which a frame is solved.
    """

    def __init__(
        self,
        width_mm: float,
        height_mm: float,
        decay_mm: float,
        lattice_mm: float = LATTICE_MM,
        markers_mm: Float64 | None = None,
        marker_pitch_mm: float = math.nan,
    ) -> None:
        rows = max(1, round(height_mm / lattice_mm))
        columns = max(1, round(width_mm / lattice_mm))
        self.shape = rows, columns
        self.lattice_mm, self.decay_mm, self.tolerance = lattice_mm, decay_mm, TOLERANCE
        self._x_mm = (np.arange(columns) - (columns - 1) / 2) * lattice_mm
        self._y_mm = (np.arange(rows) - (rows - 1) / 2) * lattice_mm
        self.nodes_mm = np.stack(np.meshgrid(self._x_mm, self._y_mm), axis=-1)
        self.alpha = (decay_mm / lattice_mm) ** 2
        self.squares = np.zeros((rows + 2, columns + 2))
        self.squares[2:-1, 2:-1] = 1.0
        beta = (AHEAD - 1.0) * self.alpha
        inner = 1.0 + 4.0 * self.alpha + beta
        stiff = np.ones((rows, columns, 2))
        for r, c in ((1, 1), (1, 2), (2, 1), (2, 2)):
            stiff += 0.25 * beta * self.squares[r : rows + r, c : columns + c, None]
        # Beyond the border the sheet goes on: its motion falls off by e in ℓ aside, ℓ_p ahead.
        aside, ahead = decay_mm / lattice_mm, math.sqrt(AHEAD) * decay_mm / lattice_mm
        for axis, beyond in ((0, (aside, ahead)), (1, (ahead, aside))):
            edge = np.moveaxis(stiff, axis, 0)
            edge[1:] += self.alpha
            edge[:-1] += self.alpha
            edge[0] += beyond
            edge[-1] += beyond
        self.stiff = _wide(stiff)
        self.stiff[self.stiff == 0.0] = 1.0
        jacobi = 1.0 - 1.0 / inner
        self.over = 2.0 / (1.0 + math.sqrt(1.0 - jacobi**2))  # Young 1954: the fastest
        counted = np.ones(self.shape)
        if markers_mm is not None:
            counted = _counted(self.shape, self.nodes_mm[0, 0], lattice_mm, markers_mm)
            counted *= (marker_pitch_mm / lattice_mm) ** 2
        self.shown = np.stack([self._share_seen(axis, counted) for axis in (0, 1)], axis=-1)

    def _share_seen(self, axis: int, counted: Float64) -> Float64:
        """What the markers' sum has of a force at each node along an axis, over c times it.

        ``counted`` is how often a node's motion is in the sum, times what a marker stands for over
        a cell. The sheet answers i by j as j by i: it is the motion by such a pull.
        """
        pull, sums, slide = _wide(counted), np.zeros(11), np.zeros(3)
        sheet, held, still = (_wide(np.zeros((*self.shape, 2))) for _ in range(3))
        slide[axis] = 1e9  # far beyond what friction holds: what slips is pulled by the limit
        across = np.zeros(max(pull.shape))
        lattice = self._lattice(across, across)
        of = Sheet(sheet, held, pull < 0, still, still, pull)
        for _ in range(MOST_SWEEPS):
            if _sweep(of, lattice, slide, sums) < TOLERANCE:
                break
        return np.asarray(sheet[1:-1, 1:-1, axis] + SKIN * counted)

    def _lattice(self, x_mm: Float64, y_mm: Float64) -> Lattice:
        return Lattice(x_mm, y_mm, self.stiff, self.squares, self.alpha, self.over)

    def step(
        self,
        pressure_n_per_mm2: Float64,
        force_n: Float64,
        torsion_n_mm: float,
        center_mm: Float64,
        friction: float,
        before: ShearState | None = None,
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
        arm_mm = np.sqrt(x_mm**2 + y_mm[:, None] ** 2)
        ones = np.ones((*self.shape, 1))
        total, arm = weighted(pressure, np.concatenate([ones, arm_mm[..., None]], axis=-1))
        # Howe & Cutkosky 1996: the limit surface as an ellipsoid.
        demand = math.hypot(*load[:2]) / max(friction * total, 1e-12)
        demand = math.hypot(demand, load[2] / max(friction * arm, 1e-12))
        within = load * min(1.0, GROSS_SLIP / max(demand, 1e-12))
        start = self._at_rest(center) if before is None else before
        sheet, held, sticks = _wide(start.sheet), _wide(np.zeros((*self.shape, 2))), _wide(touches)
        slide = np.zeros(3)
        if before is not None or load.any():
            lever_mm = max(float(arm / total), self.lattice_mm)
            of = Sheet(sheet, held, sticks, _wide(start.sheet), _wide(start.held), _wide(limit))
            lattice = self._lattice(np.pad(x_mm, 1), np.pad(y_mm, 1))
            _solve(of, lattice, within, lever_mm, self.tolerance, slide)
        sheet, held, sticks = (one[1:-1, 1:-1] for one in (sheet, held, sticks))
        # What the sweeps, or friction, leave of the force acts as the pressure does.
        share = pressure / total
        rest = load[:2] - weighted(ones[..., 0], held)
        traction = held + share[..., None] * rest
        sheet, held = np.round(sheet / GRAIN) * GRAIN, np.round(held / GRAIN) * GRAIN
        seen = np.maximum(weighted(share, self.shown), LEAST_SEEN)
        return ShearState(sheet, held, traction, pressure, sticks, slide, center, seen)

    def _at_rest(self, center_mm: Float64) -> ShearState:
        nothing = np.zeros((*self.shape, 2))
        sticks = np.zeros(self.shape, bool)
        flat = np.zeros(self.shape)
        return ShearState(
            nothing, nothing, nothing, flat, sticks, np.zeros(3), center_mm, np.ones(2)
        )

    def surface(self, state: ShearState) -> Float64:
        """Motion of the surface at the nodes per compliance, (rows, columns, 2), N/mm²."""
        return np.asarray((state.sheet + SKIN * state.held) / state.seen)

    def motion_mm(
        self, state: ShearState, points_mm: Float64, compliance_mm3_per_n: float
    ) -> Float64:
        """How far points (n, 2) of the gel's surface have moved along it, (n, 2), mm."""
        surface, corner = self.surface(state), self.nodes_mm[0, 0]
        return compliance_mm3_per_n * _interpolated(
            surface, corner[0], corner[1], self.lattice_mm, np.ascontiguousarray(points_mm)
        )


def _counted(
    shape: tuple[int, int], corner_mm: Float64, lattice_mm: float, points_mm: Float64
) -> Float64:
    """How much each node (rows, columns) counts in the sum of bilinear values at points (n, 2)."""
    counted = np.zeros(shape)
    place = np.clip((points_mm - corner_mm) / lattice_mm, 0.0, np.array(shape[::-1]) - 1.0)
    first = np.minimum(place.astype(int), np.maximum(np.array(shape[::-1]) - 2, 0))
    part = place - first
    for right in (0, 1):
        for down in (0, 1):
            weight = np.abs(1 - right - part[:, 0]) * np.abs(1 - down - part[:, 1])
            at = np.minimum(first + np.array([right, down]), np.array(shape[::-1]) - 1)
            np.add.at(counted, (at[:, 1], at[:, 0]), weight)
    return counted


def _wide(inner: NDArray[Any]) -> NDArray[Any]:
    """With a margin of one, which is 0, around rows and columns."""
    wide = np.zeros((inner.shape[0] + 2, inner.shape[1] + 2, *inner.shape[2:]), inner.dtype)
    wide[1:-1, 1:-1] = inner
    return wide


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

"""The surface compliance of a gel block by finite elements (scikit-fem).

The block is linear and isotropic, bonded at its back, free at its sides. Elements are linear
hexahedra whose change of volume is integrated at one point, which does not lock near ν = 0.5
(Hughes 2000, The Finite Element Method, § 4.4). Plane after plane of nodes is eliminated from the
back to the surface, where the dense stiffness is inverted: what remains is every surface node's
motion for a force on any other. A quarter of the block stands for all of it: a load is the sum of
four parts that are even or odd in x and y.

Frame: x right, y down, z out of the gel, (0, 0, 0) the middle of its surface; mm and N.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline
from scipy.linalg import lapack
from skfem import Basis, BilinearForm, ElementHex1, ElementVector, MeshHex
from skfem.helpers import ddot, div, sym_grad, trace

Float64 = NDArray[np.float64]

WIDTH_MM, HEIGHT_MM = 24.0, 20.0
"""A GelSight Mini's gel: its view of 18.6 × 14.3 mm and about 3 mm around it."""
THICKNESS_MM = 4.0
YOUNG_N_MM2, POISSON = 0.3, 0.48
PARITIES = ((1, 1), (1, -1), (-1, 1), (-1, -1))


def spaced(fine_mm: float, end_mm: float, knots: tuple[float, ...]) -> Float64:
    """Nodes from 0 to ``end_mm``, ``fine_mm`` apart to the first knot, twice that to the second.

    Then each gap is 1.35 times the one before, up to 1.5 mm.
    """
    nodes, gap = [0.0], fine_mm
    while nodes[-1] < end_mm - 1e-9:
        if nodes[-1] > knots[1] - 1e-9:
            gap = min(1.35 * gap, 1.5)
        elif nodes[-1] > knots[0] - 1e-9:
            gap = 2 * fine_mm
        nodes.append(nodes[-1] + gap)
    out = np.array(nodes)
    graded = out > knots[1] + 1e-9
    out[graded] = knots[1] + (out[graded] - knots[1]) * (end_mm - knots[1]) / (out[-1] - knots[1])
    return out


def layered(fine_mm: float, thickness_mm: float) -> Float64:
    """Heights of the planes of nodes from the back, -thickness, to the surface, 0."""
    gaps: list[float] = []
    gap = fine_mm
    while sum(gaps) < thickness_mm - 1e-9:
        gaps.append(gap)
        gap = min(1.25 * gap, thickness_mm / 6)
    scale = thickness_mm / sum(gaps)
    return -np.concatenate([[0.0], np.cumsum(gaps)])[::-1] * scale


@dataclass(frozen=True)
class GelBlock:
    """A block's size, stiffness and mesh; ``fine_mm`` is the distance of nodes in the middle."""

    thickness_mm: float = THICKNESS_MM
    fine_mm: float = 0.15
    width_mm: float = WIDTH_MM
    height_mm: float = HEIGHT_MM
    young_n_mm2: float = YOUNG_N_MM2
    poisson: float = POISSON
    knots_mm: tuple[float, float] = (1.5, 4.2)

    @cached_property
    def axes_mm(self) -> tuple[Float64, Float64]:
        """Places x (n,), y (m,) of a quarter's surface nodes."""
        return (
            spaced(self.fine_mm, self.width_mm / 2, self.knots_mm),
            spaced(self.fine_mm, self.height_mm / 2, self.knots_mm),
        )

    @cached_property
    def compliance(self) -> dict[tuple[int, int], Float64]:
        """By parity in x and y of z's motion, (3k, 3k) mm/N between a quarter's k surface nodes.

        Nodes in the order of ``np.meshgrid(*axes_mm, indexing="ij")``, each with x, y, z.
        """
        x, y = self.axes_mm
        z = layered(self.fine_mm, self.thickness_mm)
        mesh = MeshHex.init_tensor(x, y, z)
        element = ElementVector(ElementHex1())
        shear = self.young_n_mm2 / (2 * (1 + self.poisson))
        bulk = self.young_n_mm2 / (3 * (1 - 2 * self.poisson))

        @BilinearForm
        def change_of_shape(u, v, _w):  # type: ignore[no-untyped-def]
            d, e = sym_grad(u), sym_grad(v)
            return 2 * shear * (ddot(d, e) - trace(d) * trace(e) / 3)

        @BilinearForm
        def change_of_volume(u, v, _w):  # type: ignore[no-untyped-def]
            return bulk * div(u) * div(v)

        basis = Basis(mesh, element)
        matrix = change_of_shape.assemble(basis)
        matrix += change_of_volume.assemble(Basis(mesh, element, intorder=1))
        matrix = matrix.tocsr()
        place, dof = mesh.p, basis.nodal_dofs
        level = np.searchsorted(z, place[2] - 1e-9)
        planes = []
        for k in range(1, len(z)):
            nodes = np.flatnonzero(level == k)
            planes.append(nodes[np.lexsort((place[1, nodes], place[0, nodes]))])
        at_x0, at_y0 = place[0] < 1e-9, place[1] < 1e-9
        found = {}
        for even_x, even_y in PARITIES:
            held = np.zeros((3, place.shape[1]), dtype=bool)
            held[[0] if even_x > 0 else [1, 2]] |= at_x0
            held[[1] if even_y > 0 else [0, 2]] |= at_y0
            own = [dof[:, p].T.ravel()[~held[:, p].T.ravel()] for p in planes]
            inverse = np.zeros((0, 0))
            for k, dofs in enumerate(own):
                stiffness = matrix[dofs][:, dofs].toarray()
                if k:
                    coupling = matrix[own[k - 1]][:, dofs].tocsr()
                    across = (coupling.T.tocsr() @ inverse).T
                    stiffness -= coupling.T.tocsr() @ across
                inverse = _inverse(stiffness)
            full = np.zeros((3 * len(planes[-1]),) * 2)
            free = np.flatnonzero(~held[:, planes[-1]].T.ravel())
            full[np.ix_(free, free)] = inverse
            found[even_x, even_y] = full
        return found

    def _signs(self, sides: Float64, parity: tuple[int, int]) -> Float64:
        """(n, 3): the factor of each component at nodes in a quarter (``sides`` (n, 2) of ±1)."""
        in_x = np.where(sides[:, :1] < 0, parity[0] * np.array([[-1, 1, 1]]), 1)
        in_y = np.where(sides[:, 1:] < 0, parity[1] * np.array([[1, -1, 1]]), 1)
        return np.asarray(in_x * in_y, dtype=np.float64)

    def contact_nodes(self, radius_mm: float) -> tuple[Float64, NDArray[np.intp], Float64, Float64]:
        """Surface nodes within ``radius_mm`` of the middle of the whole block.

        Returns their places (n, 2), index in the quarter (n,), sides (n, 2) and areas (n,) in mm².
        """
        x, y = self.axes_mm
        full_x = np.concatenate([-x[:0:-1], x])
        full_y = np.concatenate([-y[:0:-1], y])
        area = np.outer(np.gradient(full_x), np.gradient(full_y)).ravel()
        points = np.stack(np.meshgrid(full_x, full_y, indexing="ij"), axis=-1).reshape(-1, 2)
        inside = np.hypot(points[:, 0], points[:, 1]) <= radius_mm
        points, area = points[inside], area[inside]
        index = np.searchsorted(x, np.abs(points[:, 0]) - 1e-9) * len(y)
        index += np.searchsorted(y, np.abs(points[:, 1]) - 1e-9)
        return points, index, np.where(points < -1e-9, -1.0, 1.0), area

    def between(self, index: NDArray[np.intp], sides: Float64) -> Float64:
        """The compliance (3n, 3n) in mm/N between nodes of the whole block."""
        dofs = (3 * index[:, None] + np.arange(3)).ravel()
        out = np.zeros((len(dofs), len(dofs)))
        for parity in PARITIES:
            sign = self._signs(sides, parity).ravel()
            out += 0.25 * sign[:, None] * self.compliance[parity][np.ix_(dofs, dofs)] * sign
        return out

    def surface(self, index: NDArray[np.intp], sides: Float64, force_n: Float64) -> "Surface":
        """The motion of all of the surface under forces (n, 3) on nodes."""
        x, y = self.axes_mm
        dofs = (3 * index[:, None] + np.arange(3)).ravel()
        out = np.zeros((2 * len(x) - 1, 2 * len(y) - 1, 3))
        for parity in PARITIES:
            load = 0.25 * (self._signs(sides, parity) * force_n).ravel()
            quarter = (self.compliance[parity][:, dofs] @ load).reshape(len(x), len(y), 3)
            for side_x in (1.0, -1.0):
                for side_y in (1.0, -1.0):
                    sign = self._signs(np.array([[side_x, side_y]]), parity)[0]
                    part = quarter[:: int(side_x), :: int(side_y)]
                    at_x = slice(len(x) - 1, None) if side_x > 0 else slice(0, len(x))
                    at_y = slice(len(y) - 1, None) if side_y > 0 else slice(0, len(y))
                    on_axis = np.ones(part.shape[:2])
                    on_axis[0 if side_x > 0 else -1] *= 0.5
                    on_axis[:, 0 if side_y > 0 else -1] *= 0.5
                    out[at_x, at_y] += on_axis[..., None] * sign * part
        return Surface(np.concatenate([-x[:0:-1], x]), np.concatenate([-y[:0:-1], y]), out)


@dataclass(frozen=True)
class Surface:
    """Motion (n, m, 3) in mm of the surface's nodes at ``x_mm`` (n,), ``y_mm`` (m,)."""

    x_mm: Float64
    y_mm: Float64
    motion_mm: Float64

    def at(self, points_mm: Float64) -> Float64:
        """Motion (n, 3) at points (n, 2)."""
        parts = [
            RectBivariateSpline(self.x_mm, self.y_mm, self.motion_mm[..., k]) for k in range(3)
        ]
        return np.stack([part.ev(points_mm[:, 0], points_mm[:, 1]) for part in parts], axis=1)


def _inverse(matrix: Float64) -> Float64:
    """Of a symmetric positive definite matrix."""
    factor, info = lapack.dpotrf(matrix, lower=1, overwrite_a=1)
    if info == 0:
        factor, info = lapack.dpotri(factor, lower=1, overwrite_c=1)
    if info:
        msg = f"the stiffness is not positive definite (LAPACK says {info})"
        raise ArithmeticError(msg)
    lower = np.tril(factor)
    return np.asarray(lower + np.tril(factor, -1).T)

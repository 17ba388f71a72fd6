"""How pads and table share the load of an object that stands between closed fingers.

Rigid bodies leave it open, and a solver's answer is that of its first steps. Gels are soft beside a
table: of all forces that balance, those are real whose elastic energy in the gels is least
(Castigliano). So the table carries what it can, and a gel is sheared by what is left.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tacgen.core.types import M_PER_MM, FloatArray, cross

NEAR_TABLE_M = 5e-5  # by which a solver lets an object rise that stands between the fingers
EDGES = 8  # of a pyramid around a friction cone, 8 % wider at most
BALANCE_WEIGHT = 1e4  # of a force that is out of balance, beside one that shears a gel …
SPARE_WEIGHT = 1e-3  # … and beside that one of each edge, so that a single answer is the best
TORSION_ARM_M = 3.0 * M_PER_MM
"""Of a gel: its moment about the normal over the force that moves it by as much energy, √⅓ of the
patch's radius, which is 3 to 8 mm."""


@dataclass(frozen=True, slots=True)
class PadLoad:
    """What a pad does to the object, in world axes.

    The force acts at ``center_m`` (3,), where the touches' mean ``normal`` (3,) points into the
    object; ``moment_n_m`` is about the closing axis.
    """

    center_m: FloatArray
    normal: FloatArray
    force_n: FloatArray
    moment_n_m: float


@dataclass(frozen=True, slots=True)
class Table:
    """What an object stands on: it can push and rub at ``places_m`` (n, 3).

    The forces that it was found to push with are ``pressed_n`` (m, 3), at ``pressed_m`` (m, 3).
    """

    friction: float
    places_m: FloatArray
    pressed_m: FloatArray
    pressed_n: FloatArray


def least_shear(
    pads: Sequence[PadLoad], closing_axis: FloatArray, pad_friction: float, table: Table
) -> list[PadLoad]:
    """The loads, of the same resultant, that shear the gels least, with the table's help.

    The pads' forces along ``closing_axis`` stay.
    """
    from scipy.optimize import nnls  # slow to import

    up, middle_m = np.array([0.0, 0.0, 1.0]), np.mean([pad.center_m for pad in pads], axis=0)
    # Rows: six of balance, then a pad's force along the axis, its shear and its moment.
    wanted = np.zeros(6 + 4 * len(pads))
    wanted[:6] = _wrenches(table.pressed_m - middle_m, table.pressed_n).sum(axis=0)
    columns, parts = list[FloatArray](), list[FloatArray]()
    for row, pad in zip(range(6, len(wanted), 4), pads, strict=True):
        edges = _edges(pad.normal, up, pad_friction)
        wrench = np.zeros((EDGES + 2, len(wanted)))
        wrench[:EDGES, :6] = _wrenches(pad.center_m - middle_m, edges)
        wrench[:EDGES, row] = edges @ closing_axis
        wrench[:EDGES, row + 1 : row + 3] = edges @ np.stack([up, cross(closing_axis, up)], -1)
        wrench[EDGES:, 3:6] = np.outer([1.0, -1.0], closing_axis)
        wrench[EDGES:, row + 3] = 1.0, -1.0
        columns.append(wrench)
        parts.append(edges)
        wanted[:6] += _wrenches(pad.center_m - middle_m, pad.force_n[None])[0]
        wanted[3:6] += pad.moment_n_m / TORSION_ARM_M * closing_axis
        wanted[row] = pad.force_n @ closing_axis
    for place_m in table.places_m:
        wrench = np.zeros((EDGES, len(wanted)))
        edges = _edges(up, closing_axis, table.friction)
        wrench[:, :6] = _wrenches(place_m - middle_m, edges)
        columns.append(wrench)
    weight = np.ones(len(wanted))
    weight[[*range(6), *range(6, len(wanted), 4)]] = BALANCE_WEIGHT
    matrix = (np.concatenate(columns) * weight).T
    count = matrix.shape[1]
    matrix = np.vstack([matrix, SPARE_WEIGHT * np.eye(count)])
    shares, _ = nnls(matrix, np.concatenate([wanted * weight, np.zeros(count)]))
    found = []
    for k, (pad, edges) in enumerate(zip(pads, parts, strict=True)):
        *along, turn, back = shares[k * (EDGES + 2) :][: EDGES + 2]
        moment_n_m = float(turn - back) * TORSION_ARM_M
        found.append(replace(pad, force_n=np.array(along) @ edges, moment_n_m=moment_n_m))
    return found


def outermost(points_m: FloatArray, closing_axis: FloatArray) -> FloatArray:
    """Those of the points (n, 3) that are farthest in one of eight horizontal directions."""
    angle = np.arange(8) * (np.pi / 4)
    beside = cross(np.array([0.0, 0.0, 1.0]), closing_axis)
    ways = np.outer(np.cos(angle), closing_axis) + np.outer(np.sin(angle), beside)
    found: FloatArray = points_m[np.unique(np.argmax(points_m @ ways.T, axis=0))]
    return found


def _edges(normal: FloatArray, beside: FloatArray, friction: float) -> FloatArray:
    """Edges (n, 3) of a pyramid around the friction cone about a normal."""
    normal = normal / np.linalg.norm(normal)
    first = beside - (beside @ normal) * normal
    first /= np.linalg.norm(first)
    second = cross(normal, first)
    angle = (np.arange(EDGES) + 0.5) * (2 * np.pi / EDGES)
    wide = friction / np.cos(np.pi / EDGES)
    around = np.outer(np.cos(angle), first) + np.outer(np.sin(angle), second)
    return np.asarray(normal + wide * around)


def _wrenches(arm_m: FloatArray, forces_n: FloatArray) -> FloatArray:
    """Forces (n, 3) and their moments over ``TORSION_ARM_M``, (n, 6)."""
    return np.hstack([forces_n, cross(arm_m, forces_n) / TORSION_ARM_M])

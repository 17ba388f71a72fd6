"""How an object comes to rest on a table: it rolls, without speed, until nothing is lower."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tacgen.core.records import GraspObject
from tacgen.core.types import FloatArray, turn_rad
from tacgen.physics.world import ball_of

TOUCH_MM = 1e-6  # of the lowest corner, within which others touch the table too: roundoff
MOST_STEPS = 5000  # from corner to corner: a fine ball takes some hundred
TOPPLES_DEG, TOPPLES_MM = 2.0, 0.2
"""Turns, and falls of the centre of mass, below which the simulation settles it by itself, as a
ball's from a corner of its mesh to a facet."""
ON_TABLE_MM = 0.01  # of the lowest corner, up to which an object stands on others too
DIRECTIONS = 96  # around, in which its foot has to reach beyond its centre of mass


def topples_deg(obj: GraspObject) -> float:
    """By how much the object topples from its rest pose before a grasp; 0 if it stands.

    It stands on its collision parts, about its own centre of mass; a ball is simulated as one.
    """
    if len(obj.collision) == 1 and ball_of(obj.collision[0]):
        return 0.0
    corners_mm = np.concatenate([part.vertices_mm for part in obj.collision])
    low = corners_mm[corners_mm[:, 2] <= corners_mm[:, 2].min() + ON_TABLE_MM, :2]
    around = np.arange(DIRECTIONS) * (2 * np.pi / DIRECTIONS)
    ways = np.stack([np.cos(around), np.sin(around)])
    if ((low - obj.center_of_mass_mm[:2]) @ ways).max(axis=0).min() > 0:
        return 0.0  # over what it stands on
    return _topples_deg(corners_mm.tobytes(), obj.center_of_mass_mm.tobytes())


@lru_cache(maxsize=16)
def _topples_deg(corners_mm: bytes, center_mm: bytes) -> float:
    turn = toppled(np.frombuffer(corners_mm).reshape(-1, 3), np.frombuffer(center_mm))
    return 0.0 if turn is None else float(np.degrees(turn_rad(turn)))


def toppled(points_mm: FloatArray, center_of_mass_mm: FloatArray) -> NDArray[np.float64] | None:
    """The rotation (3, 3) by which a body topples from where it stands; None if it stays.

    It rolls over corners and edges of the convex hull of ``points_mm`` (n, 3) so that its centre of
    mass falls fastest, without speed, up to the first pose from which it would have to rise.

    Source: steepest descent of the hull's support function, max over corners v of v·d for the
    direction d to the table, whose subgradient is the corners that touch it (Rockafellar 1970,
    Convex Analysis, §25).
    """
    from scipy.spatial import ConvexHull  # slow to import, and most objects stand

    corners_mm = points_mm[ConvexHull(points_mm).vertices] - center_of_mass_mm
    down = np.array([0.0, 0.0, -1.0])
    first_mm = (corners_mm @ down).max()
    for _ in range(MOST_STEPS):
        height_mm = corners_mm @ down
        lowest_mm = height_mm.max()
        touching = corners_mm[height_mm >= lowest_mm - TOUCH_MM]
        fall = _fall(touching, down)
        if fall is None:
            break
        # The corner that comes down first as d turns to d cos θ + w sin θ.
        way, off_mm = fall
        ahead_mm = corners_mm @ way + off_mm
        rising = np.flatnonzero(ahead_mm > TOUCH_MM)
        next_rad = np.arctan2(np.maximum(lowest_mm - height_mm[rising], 0.0), ahead_mm[rising])
        turn_rad = next_rad.min(initial=np.pi / 2)
        down = np.cos(turn_rad) * down + np.sin(turn_rad) * way
        down /= np.linalg.norm(down)
    turn_deg = np.degrees(np.arccos(np.clip(-down[2], -1.0, 1.0)))
    fall_mm = first_mm - (corners_mm @ down).max()
    if turn_deg < TOPPLES_DEG or fall_mm < TOPPLES_MM:
        return None
    return _turn_to(down, np.array([0.0, 0.0, -1.0]))


def _fall(touching_mm: FloatArray, down: FloatArray) -> tuple[FloatArray, float] | None:
    """The way (3,) in which the centre of mass at the origin falls off corners (n, 3), None if not.

    And how far it is from the nearest point that they support. On a tip or an edge right below it
    falls to where there are none.
    """
    side = np.cross(down, np.eye(3)[np.argmin(np.abs(down))])
    axes = np.stack([side, np.cross(down, side)]) / np.linalg.norm(side)
    flat = touching_mm @ axes.T
    angles = np.sort(np.arctan2(flat[:, 1], flat[:, 0]))
    gaps = np.diff(angles, append=angles[0] + 2 * np.pi)
    if len(flat) > 2 and gaps.max() < np.pi:
        return None  # they are all around it
    starts, along = flat[:, None], flat[None] - flat[:, None]
    share = -(starts * along).sum(-1) / np.maximum((along**2).sum(-1), 1e-300)
    places = (starts + np.clip(share, 0.0, 1.0)[..., None] * along).reshape(-1, 2)
    nearest = places[np.argmin((places**2).sum(axis=1))]
    off_mm = float(np.linalg.norm(nearest))
    if off_mm > TOUCH_MM:
        return -nearest / off_mm @ axes, off_mm
    free = angles[np.argmax(gaps)] + gaps.max() / 2
    return np.array([np.cos(free), np.sin(free)]) @ axes, 0.0


def _turn_to(source: FloatArray, target: FloatArray) -> NDArray[np.float64]:
    """The shortest rotation (3, 3) that takes one unit vector to another.

    Source: Rodrigues' formula, R = 1 + [w] + [w]² / (1 + a·b) with w = a × b.
    """
    w, cosine = np.cross(source, target), float(source @ target)
    if cosine < -1 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    cross = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
    return np.asarray(np.eye(3) + cross + cross @ cross / (1.0 + cosine))

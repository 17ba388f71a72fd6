"""How an object comes to rest on a table: it rolls, without speed, until nothing is lower."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tacgen.core.arrays import FloatArray
from tacgen.core.records import GraspObject
from tacgen.physics.world import ball_of

STEP_RAD = np.radians(0.5)  # of the roll: a card 1 mm thick and 60 mm high stands up to 1°
DIRECTIONS = 24  # around, in which it may roll
LEAST_STEP_RAD = np.radians(0.01)
MOST_STEPS = 2000  # the longest roll is half a turn: 360 steps, and the finer ones at its end
TOPPLES_DEG, TOPPLES_MM = 2.0, 0.2
"""Turns, and falls of the centre of mass, below which the simulation settles it by itself, as a
ball's from a corner of its mesh to a facet."""
FLAT_RAD = np.radians(1.0)  # to the face that it comes to lie on
ON_TABLE_MM = 0.01  # of the lowest corner, up to which an object stands on others too


def topples_deg(obj: GraspObject) -> float:
    """By how much the object topples from its rest pose before a grasp; 0 if it stands.

    It stands on its collision parts, about its own centre of mass; a ball is simulated as one.
    """
    if len(obj.collision) == 1 and ball_of(obj.collision[0]):
        return 0.0
    corners_mm = np.concatenate([part.vertices_mm for part in obj.collision])
    low = corners_mm[corners_mm[:, 2] <= corners_mm[:, 2].min() + ON_TABLE_MM, :2]
    around = np.arange(4 * DIRECTIONS) * (np.pi / 2 / DIRECTIONS)
    ways = np.stack([np.cos(around), np.sin(around)])
    if ((low - obj.center_of_mass_mm[:2]) @ ways).max(axis=0).min() > 0:
        return 0.0  # over what it stands on
    return _topples_deg(corners_mm.tobytes(), obj.center_of_mass_mm.tobytes())


@lru_cache(maxsize=16)
def _topples_deg(corners_mm: bytes, center_mm: bytes) -> float:
    turn = toppled(np.frombuffer(corners_mm).reshape(-1, 3), np.frombuffer(center_mm))
    return 0.0 if turn is None else angle_deg(turn)


def angle_deg(turn: FloatArray) -> float:
    """The angle of a rotation (3, 3)."""
    return float(np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1.0, 1.0))))


def toppled(points_mm: FloatArray, center_of_mass_mm: FloatArray) -> NDArray[np.float64] | None:
    """The rotation (3, 3) by which a body topples from where it stands; None if it stays.

    It rolls over the edges of the convex hull of ``points_mm`` (n, 3) in the direction in which its
    centre of mass falls fastest, up to the first pose from which it would have to rise.
    """
    from scipy.spatial import ConvexHull  # slow to import, and most objects stand

    hull = ConvexHull(points_mm)
    corners_mm = points_mm[hull.vertices] - center_of_mass_mm

    def height_mm(down: FloatArray) -> float:
        """Of the centre of mass over the table, if ``down`` points to it."""
        return float((corners_mm @ down).max())

    down, step = np.array([0.0, 0.0, -1.0]), STEP_RAD
    turns = np.arange(DIRECTIONS) * 2 * np.pi / DIRECTIONS
    first_mm = lowest = height_mm(down)
    for _ in range(MOST_STEPS):
        side = np.linalg.svd(down[None])[2][1:]
        ring = np.cos(step) * down + np.sin(step) * (
            np.cos(turns)[:, None] * side[0] + np.sin(turns)[:, None] * side[1]
        )
        heights = (corners_mm @ ring.T).max(axis=0)
        best = int(np.argmin(heights))
        if heights[best] < lowest:
            down, lowest = ring[best] / np.linalg.norm(ring[best]), float(heights[best])
        elif step <= LEAST_STEP_RAD:
            break
        else:
            step /= 2
    normals = hull.equations[:, :3]
    nearest = normals[np.argmax(normals @ down)]
    if nearest @ down > np.cos(FLAT_RAD):
        down = nearest
    turn_deg = np.degrees(np.arccos(np.clip(-down[2], -1.0, 1.0)))
    if turn_deg < TOPPLES_DEG or first_mm - lowest < TOPPLES_MM:
        return None
    return _turn_to(down, np.array([0.0, 0.0, -1.0]))


def _turn_to(source: FloatArray, target: FloatArray) -> NDArray[np.float64]:
    """The shortest rotation (3, 3) that takes one unit vector to another.

    Source: Rodrigues' formula, R = 1 + [w] + [w]² / (1 + a·b) with w = a × b.
    """
    w, cosine = np.cross(source, target), float(source @ target)
    if cosine < -1 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    cross = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
    return np.asarray(np.eye(3) + cross + cross @ cross / (1.0 + cosine))

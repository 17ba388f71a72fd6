"""How an object comes to rest on a table: it rolls, without speed, until nothing is lower."""

import numpy as np
from numpy.typing import NDArray

from tacgen.core.arrays import FloatArray
from tacgen.core.records import Mesh
from tacgen.objects.meshes import hull, mass_properties

STEP_RAD = np.radians(0.5)  # of the roll: a card 1 mm thick and 60 mm high stands up to 1°
DIRECTIONS = 24  # around, in which it may roll
LEAST_STEP_RAD = np.radians(0.01)
MOST_STEPS = 2000  # the longest roll is half a turn: 360 steps, and the finer ones at its end
TOPPLES_DEG, TOPPLES_MM = 2.0, 0.2
"""Turns, and falls of the centre of mass, below which the simulation settles it by itself, as a
ball's from a corner of its mesh to a facet."""
FLAT_RAD = np.radians(1.0)  # to the face that it comes to lie on


def toppled(surface: Mesh) -> NDArray[np.float64] | None:
    """The rotation (3, 3) by which a solid topples from where it stands; None if it stays.

    The solid, evenly filled, rolls over the convex hull's edges in the direction in which its
    centre of mass falls fastest, up to the first pose from which it would have to rise.
    """
    center_mm, _ = mass_properties([(surface, 1.0)], 1.0)
    around = hull(surface.vertices_mm)
    corners_mm = around.vertices_mm - center_mm

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
    a, b, c = np.moveaxis(around.vertices_mm[around.faces], 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
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

"""What of an object the pads can meet: their domes are spheres, which reach beyond the pads."""

import math
from collections.abc import Sequence

import numpy as np

from tacgen.core.records import GraspConfig, Mesh
from tacgen.core.types import FloatArray
from tacgen.physics.world import ball_of, mesh_of_hull

SLACK_MM = 1.0
"""Around a pad's outline: the largest turn of a success, 0.1 rad, moves its rim by as much."""

LEAST_MM = 0.01  # of a part that reaches in or out: less is rounding, or a sliver that has no hull


def within_reach(
    parts: Sequence[Mesh], config: GraspConfig, *, height_mm: float, pad_mm: tuple[float, float]
) -> tuple[Mesh, ...]:
    """What of convex ``parts`` two pads of width and height ``pad_mm`` can meet, fingers included.

    ``height_mm`` is that of the pads' centre. What is beside or below their outlines is cut off;
    what is above may come down to them, or meet the fingers. A part that is not cut is returned
    itself, and so is a ball.
    """
    along = np.array([-math.sin(config.yaw_rad), math.cos(config.yaw_rad), 0.0])
    middle_mm = config.x_mm * along[0] + config.y_mm * along[1]
    beside_mm, below_mm = (size / 2 + SLACK_MM for size in pad_mm)
    # Of each plane a normal, and how far along it the object may reach.
    normals = np.stack([along, -along, [0.0, 0.0, -1.0]])
    reach_mm = np.array([beside_mm + middle_mm, beside_mm - middle_mm, below_mm - height_mm])
    found = []
    for part in parts:
        beyond_mm = part.vertices_mm @ normals.T - reach_mm
        crossed = beyond_mm.max(axis=0) > LEAST_MM
        if (beyond_mm.min(axis=0) > -LEAST_MM).any():
            continue
        if crossed.any() and not (len(parts) == 1 and ball_of(part)):
            found += _cut(part.vertices_mm, normals[crossed], reach_mm[crossed])
        else:
            found.append(part)
    return tuple(found)


def _cut(points_mm: FloatArray, normals: FloatArray, reach_mm: FloatArray) -> list[Mesh]:
    """The convex hull of ``points_mm`` on the near side of each plane, if any of it is."""
    from scipy.spatial import ConvexHull  # slow to import, and the package need not wait for it

    hull = ConvexHull(points_mm)
    for normal, reach in zip(normals, reach_mm, strict=True):
        beyond_mm = hull.points @ normal - reach
        if beyond_mm.min() > -LEAST_MM:
            return []
        # Each edge in both directions: the faces of a hull are not turned the same way.
        edges = hull.simplices[:, [[0, 1], [1, 2], [2, 0], [1, 0], [2, 1], [0, 2]]].reshape(-1, 2)
        edges = edges[(beyond_mm[edges[:, 0]] < 0) & (beyond_mm[edges[:, 1]] > 0)]
        near, far = hull.points[edges[:, 0]], hull.points[edges[:, 1]]
        share = beyond_mm[edges[:, :1]] / (beyond_mm[edges[:, :1]] - beyond_mm[edges[:, 1:]])
        inside = hull.vertices[beyond_mm[hull.vertices] <= 0]
        hull = ConvexHull(np.concatenate([hull.points[inside], near + share * (far - near)]))
    return [mesh_of_hull(hull)]

"""How a shape comes to rest on the table."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from scripts.make_objects.shape import Body, Shape, moved
from tacgen.objects.meshes import mass_properties


def settled(shape: Shape) -> Shape:
    """``shape``, lying along y, tipped about x until it is stable, then put at the origin.

    Seen along x, a body rests on that edge of its outline's hull above which its centre of mass
    stands; of several such edges, on the one that the table is nearest to already. The middle of
    its extent along x and y goes to the origin and its lowest point to z = 0.
    """
    bodies = [(body.mesh, body.density_kg_m3) for body in shape.bodies]
    center, _ = mass_properties(bodies or [(shape.surface, 1.0)], 1.0)
    tip_rad = resting_tilt_rad(shape.surface.vertices_mm[:, 1:], center[1:])
    c, s = np.cos(tip_rad), np.sin(tip_rad)
    turn = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    tipped = moved(shape.surface, turn=turn).vertices_mm
    low, high = tipped.min(axis=0), tipped.max(axis=0)
    shift = -np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    return Shape(
        moved(shape.surface, turn=turn, shift_mm=shift),
        tuple(moved(part, turn=turn, shift_mm=shift) for part in shape.collision),
        tuple(
            Body(moved(body.mesh, turn=turn, shift_mm=shift), body.density_kg_m3)
            for body in shape.bodies
        ),
    )


def resting_tilt_rad(outline_mm: NDArray[np.float64], center_mm: NDArray[np.float64]) -> float:
    """The smallest turn in the plane after which the points (n, 2) rest stably on a floor.

    ``outline_mm`` holds (along, up); a positive turn lifts what lies at larger ``along``.
    """
    found = ConvexHull(outline_mm)
    tilts = []
    for (first, second), equation in zip(found.simplices, found.equations, strict=True):
        start, side = outline_mm[first], outline_mm[second] - outline_mm[first]
        share = float((center_mm - start) @ side / (side @ side))
        if 0 <= share <= 1:
            # The side's outward normal must come to point down.
            tilts.append(float(np.arctan2(-equation[0], -equation[1])))
    return min(tilts, key=abs)

"""Convex parts of a surface, for the physics; finer where pads would touch them wrongly."""

from collections.abc import Collection, Sequence

import coacd
import manifold3d
import numpy as np
from scipy.spatial import ConvexHull

from tacgen.core.records import Mesh
from tacgen.core.types import FloatArray
from tacgen.objects.meshes import from_manifold, hull, to_manifold, volume_mm3

MAX_PARTS = 24  # PyBullet's time a step grows with the parts
MAX_PART_VERTICES = 512  # a cylinder's 256 sections; a grasp takes 0.15 s, with 128 vertices 0.12
ELEVATIONS_DEG = (-85.0, -55.0, -30.0, -10.0, 10.0, 30.0, 55.0, 85.0)
"""Where a hull is thinned. None at 0, so that a round side ends in an upright facet at its widest;
the outermost near 90, so that a round bottom stands on a small facet."""
DETAIL_MM = 0.2  # finest detail that the search for cuts between convex parts sees
MOST_TO_CUT = 4000  # triangles that the search sees: its time grows with them
CONVEX_SHARE = 0.01  # of its volume that a convex mesh may lack: roundoff, engraving, dimples
CONCAVITIES = (0.1, 0.05)
"""CoACD's threshold, concavity left as a share of the size: the coarse cut, cut again where pads
touch it, suffices for most and takes a third of the time and parts of the fine one."""
MOST_PARTS = 48  # after cutting again: a grasp meets those near the pads alone
CUT_SHARES = np.arange(1, 10) / 10  # of a part's extent, at which it may be cut in two
WORTH_SHARE = 0.005  # of a part's volume that a cut is to take off


def convex_parts(surface: Mesh, concavity: float = CONCAVITIES[0]) -> tuple[Mesh, ...]:
    """Convex hulls that follow ``surface``, at most ``MAX_PARTS``; a convex surface has its own."""
    if volume_mm3(hull(surface.vertices_mm)) <= (1 + CONVEX_SHARE) * volume_mm3(surface):
        return (_even_hull(surface.vertices_mm),)
    return _cut(surface, concavity)


def cut_again(surface: Mesh, parts: Sequence[Mesh], which: Collection[int]) -> tuple[Mesh, ...]:
    """The ``parts`` with those of the numbers ``which`` cut in two, at most ``MOST_PARTS``."""
    whole, found, left = to_manifold(surface), list[Mesh](), MOST_PARTS - len(parts)
    for k, part in enumerate(parts):
        halves = _halves(whole ^ to_manifold(part)) if k in which and left > 0 else []
        found += halves or [part]
        left -= max(len(halves) - 1, 0)
    return tuple(found)


def _halves(solid: manifold3d.Manifold) -> list[Mesh]:
    """Hulls of a solid's two parts beside the plane that leaves them the least volume.

    None if it cannot be cut so that they are smaller than its own.
    """
    coarse = solid.simplify(DETAIL_MM)
    low, high = np.reshape(coarse.bounding_box(), (2, 3))
    planes = [
        (axis, low[k] + share * (high[k] - low[k]))
        for k, axis in enumerate(np.eye(3))
        for share in CUT_SHARES
    ]
    best, at = coarse.hull().volume() * (1 - WORTH_SHARE), None
    for axis, offset in planes:
        sizes = [half.hull().volume() for half in coarse.split_by_plane(axis, offset)]
        if min(sizes) > 0 and sum(sizes) < best:
            best, at = sum(sizes), (axis, offset)
    if at is None:
        return []
    halves = [from_manifold(half) for half in solid.split_by_plane(*at)]
    return [_even_hull(half.vertices_mm) for half in halves if len(half.vertices_mm) > 3]


def _cut(surface: Mesh, concavity: float) -> tuple[Mesh, ...]:
    """Convex hulls that hold all of a surface's vertices.

    CoACD only finds where to cut a simplified copy: a part is the hull of its cut faces and of
    those vertices that are nearest to it.

    Source: Wei et al. 2022, Approximate Convex Decomposition for 3D Meshes with
    Collision-Aware Concavity and Tree Search.
    """
    coacd.set_log_level("error")
    tolerance_mm, coarse = DETAIL_MM, to_manifold(surface).simplify(DETAIL_MM)
    while coarse.num_tri() > MOST_TO_CUT:
        tolerance_mm *= 1.5
        coarse = coarse.simplify(tolerance_mm)
    simple = from_manifold(coarse)
    cut = coacd.run_coacd(
        coacd.Mesh(np.array(simple.vertices_mm), np.array(simple.faces)),
        threshold=concavity,
        max_convex_hull=MAX_PARTS,
        mcts_iterations=60,
        mcts_nodes=10,
        seed=0,
    )
    points_mm = surface.vertices_mm
    around = hull(points_mm)
    found = [_within(corners, around) for corners, _ in cut]
    reach_mm = np.maximum(2 * tolerance_mm, DETAIL_MM)
    beyond_mm = np.stack([_beyond_mm(corners, points_mm, reach_mm) for corners in found])
    lost = np.flatnonzero(np.isinf(beyond_mm.min(axis=0)))
    beyond_mm[:, lost] = [_beyond_mm(corners, points_mm[lost], np.inf) for corners in found]
    least_mm = np.maximum(beyond_mm.min(axis=0), DETAIL_MM)
    return tuple(
        _even_hull(np.concatenate([corners, points_mm[beyond <= least_mm]]))
        for corners, beyond in zip(found, beyond_mm, strict=True)
    )


def _within(corners_mm: FloatArray, around: Mesh) -> FloatArray:
    """The corners of a part, cut off where the simplified copy stuck out of the surface's hull.

    Else the object would stand on what it does not have.
    """
    part = to_manifold(hull(corners_mm)) ^ to_manifold(around)
    return corners_mm if part.is_empty() else from_manifold(part).vertices_mm


def _beyond_mm(corners_mm: FloatArray, points_mm: FloatArray, reach_mm: float) -> FloatArray:
    """How far points (n, 3) are beyond the hull's planes at most (n,); inf if clearly farther."""
    low, high = corners_mm.min(axis=0) - reach_mm, corners_mm.max(axis=0) + reach_mm
    near = np.flatnonzero(((points_mm >= low) & (points_mm <= high)).all(axis=1))
    most = np.full(len(near), -np.inf)
    for *normal, offset in ConvexHull(corners_mm).equations:
        np.maximum(most, points_mm[near] @ np.array(normal) + offset, out=most)
    beyond = np.full(len(points_mm), np.inf)
    beyond[near] = most
    return beyond


def _even_hull(points_mm: FloatArray) -> Mesh:
    """The hull of points (n, 3), of at most ``MAX_PART_VERTICES`` of them.

    Where there are more, those stay that reach farthest in directions evenly around z, as many as
    possible and the same above and below: pads meet it alike on both sides, at any yaw. A collapse
    of edges would leave them touching it off axis.
    """
    corners_mm = kept = hull(points_mm).vertices_mm
    around = MAX_PART_VERTICES
    while len(kept) > MAX_PART_VERTICES:
        around //= 2
        azimuths = (np.arange(around) + 0.5) * 2 * np.pi / around
        farthest = {
            int(np.argmax(corners_mm @ [np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)]))
            for e in np.radians(ELEVATIONS_DEG)
            for a in azimuths
        }
        kept = corners_mm[sorted(farthest)]
    return hull(kept)

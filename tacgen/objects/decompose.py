"""Convex parts for the physics, by CoACD with a fixed seed."""

from __future__ import annotations

import coacd
import numpy as np

from tacgen.core.records import Mesh
from tacgen.objects.meshes import from_manifold, hull, to_manifold

MAX_PARTS = 24  # PyBullet's time a step grows with the parts
MAX_PART_VERTICES = 128  # limits PyBullet's time a step
DETAIL_MM = 0.2  # finest detail that the search for convex parts sees
CONCAVITY = 0.05
"""CoACD's threshold: the concavity left, as a share of the object's size."""


def convex_parts(surface: Mesh, *, seed: int = 0) -> tuple[Mesh, ...]:
    """At most ``MAX_PARTS`` convex hulls that together follow ``surface``.

    Source: Wei et al. 2022, Approximate Convex Decomposition for 3D Meshes with
    Collision-Aware Concavity and Tree Search.
    """
    coacd.set_log_level("error")
    # The search's time grows with the triangles, and detail this fine is not for the physics.
    coarse = from_manifold(to_manifold(surface).simplify(DETAIL_MM))
    parts = coacd.run_coacd(
        coacd.Mesh(np.array(coarse.vertices_mm), np.array(coarse.faces)),
        threshold=CONCAVITY,
        max_convex_hull=MAX_PARTS,
        decimate=True,
        max_ch_vertex=MAX_PART_VERTICES,
        mcts_iterations=100,
        mcts_nodes=15,
        seed=seed,
    )
    return tuple(hull(vertices) for vertices, _ in parts)

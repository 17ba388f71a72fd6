"""Food cans: a round one with a paper label, and a drawn one with rounded corners."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scripts.make_objects.profiles import Curve, arc, between, joined, polar, rounded_rectangle
from scripts.make_objects.shape import Shape, angles_rad, loft, revolve
from tacgen.core.records import Mesh
from tacgen.objects.meshes import hull


def round_can(
    *,
    body_diameter_mm: float,
    height_mm: float,
    seam_diameter_mm: float,
    seam_height_mm: float = 3.0,
    seam_thickness_mm: float = 1.3,
    panel_depth_mm: float = 3.6,
    label_thickness_mm: float = 0.12,
    label_margin_mm: float = 2.2,
    label_overlap_mm: float = 12.0,
    segments: int = 600,
) -> Shape:
    """A three-piece can: double seams at both ends, recessed lids, a label with its overlap."""
    radius, rim = body_diameter_mm / 2, seam_diameter_mm / 2
    metal = radius - label_thickness_mm
    lower = _lid(metal, rim, seam_height_mm, seam_thickness_mm, panel_depth_mm)
    upper = (lower * [1, -1] + [0, height_mm])[::-1]
    label = seam_height_mm + label_margin_mm
    rows = np.concatenate([np.linspace(label - 0.1, label + 0.1, 5), [height_mm / 2]])
    rows = np.concatenate([rows, height_mm - rows[4::-1]])
    profile = joined(lower, np.stack([np.full(len(rows), metal), rows], axis=-1), upper)
    rings = revolve(profile, segments)

    on_label = between(profile[:, 1], label, height_mm - label, 0.2)
    on_label *= profile[:, 0] == metal
    overlap_rad = label_overlap_mm / radius
    doubled = between(angles_rad(segments), 0.12, 0.12 + overlap_rad, 0.02)
    thickness = label_thickness_mm * on_label[:, None] * (1 + doubled)
    rings[:, :, :2] *= (1 + thickness / profile[:, :1])[:, :, None]

    collision = (
        prism(rim, 0.0, seam_height_mm),
        prism(radius, 0.0, height_mm),
        prism(rim, height_mm - seam_height_mm, height_mm),
    )
    return Shape(loft(rings), collision)


def prism(radius_mm: float, from_mm: float, to_mm: float, sides: int = 32) -> Mesh:
    """A regular prism about z whose flat sides, one of them facing +x, touch the cylinder."""
    angle = angles_rad(sides) + np.pi / sides
    ring = polar(radius_mm / np.cos(np.pi / sides), angle)
    return hull(np.concatenate([np.insert(ring, 2, height, axis=1) for height in (from_mm, to_mm)]))


def _lid(
    body_mm: float, rim_mm: float, seam_height_mm: float, thickness_mm: float, panel_mm: float
) -> Curve:
    """Profile of the lower end, from the edge of its panel out, round the seam, to the body."""
    inner = rim_mm - thickness_mm
    bead = thickness_mm / 2
    corner = 0.8
    return joined(
        [(0.85 * inner, panel_mm)],
        arc((inner - corner, panel_mm - corner), corner, 90, 0, 6),
        arc((rim_mm - bead, bead), bead, 180, 360, 13),
        arc((rim_mm - 0.4, seam_height_mm - 0.4), 0.4, 0, 90, 6),
        arc((body_mm + 0.3, seam_height_mm + 0.3), 0.3, 270, 180, 5),
    )


def drawn_can(
    *,
    width_mm: float,
    length_mm: float,
    height_mm: float,
    corner_mm: float,
    seam_mm: float = 0.9,
    seam_height_mm: float = 2.8,
    panel_depth_mm: float = 3.0,
    base_radius_mm: float = 3.0,
    bead_depth_mm: float = 0.35,
    beads: int = 2,
    corner_steps: int = 56,
) -> Shape:
    """A two-piece can with rounded corners: a drawn base, shallow beads, one seam at the top.

    ``seam_mm`` is how far the seam stands out of the wall; the published width and length are
    those over the seam.
    """
    half = (width_mm / 2 - seam_mm, length_mm / 2 - seam_mm)
    outline, normals = rounded_rectangle(*half, corner_mm, 6.0, corner_steps)
    profile = _drawn_profile(
        height_mm, seam_mm, seam_height_mm, panel_depth_mm, base_radius_mm, bead_depth_mm, beads
    )
    rings = offset_rings(outline, normals, profile)
    coarse, coarse_normals = rounded_rectangle(*half, corner_mm, 1e3, corner_steps=5)
    seam_mm = float(profile[:, 0].max())
    body = np.array([[-base_radius_mm, 0.0], [0.0, base_radius_mm], [0.0, height_mm - 1e-3]])
    seam = np.array([[seam_mm, height_mm - seam_height_mm], [seam_mm, height_mm]])
    return Shape(
        loft(rings),
        tuple(hull(offset_rings(coarse, coarse_normals, stretch)) for stretch in (body, seam)),
    )


def offset_rings(outline: Curve, normals: Curve, profile: Curve) -> NDArray[np.float64]:
    """Rings (k, n, 3) of an outline pushed outward by ``profile[:, 0]`` at ``profile[:, 1]``."""
    flat = outline + profile[:, :1, None] * normals
    height = np.broadcast_to(profile[:, 1, None, None], (*flat.shape[:2], 1))
    return np.concatenate([flat, height], axis=-1)


def _drawn_profile(
    height_mm: float,
    seam_mm: float,
    seam_height_mm: float,
    panel_mm: float,
    base_mm: float,
    bead_mm: float,
    beads: int,
) -> Curve:
    """(outward offset, height) from the base, up the wall, over the seam, into the lid."""
    start = height_mm - seam_height_mm
    low, high = base_mm + 3, start - 3
    middles = low + (high - low) * (2 * np.arange(beads) + 1) / (2 * beads)
    # Rows gather in the beads; between them the wall is straight.
    in_bead = np.linspace(-4.5, 4.5, 37)
    wall = np.concatenate([[low], *(middle + in_bead for middle in middles), [high]])
    off = np.min(np.abs(wall[:, None] - middles), axis=1)
    waves = -bead_mm * np.exp(-((off / 1.6) ** 2))
    inner = seam_mm - 1.2
    return joined(
        [(-base_mm - 3.5, 1.0), (-base_mm - 2.0, 1.0), (-base_mm - 1.0, 0.0)],
        arc((-base_mm, base_mm), base_mm, -90, 0, 14),
        np.stack([waves, wall], axis=-1),
        arc((0.3, start - 0.3), 0.3, 180, 90, 5),
        arc((seam_mm - 0.4, start + 0.4), 0.4, -90, 0, 6),
        arc((seam_mm - 0.6, height_mm - 0.6), 0.6, 0, 180, 13),
        arc((inner - 0.8, height_mm - panel_mm + 0.8), 0.8, 0, -90, 6),
        [(inner - 3.0, height_mm - panel_mm)],
    )

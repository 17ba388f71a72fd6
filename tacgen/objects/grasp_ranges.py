"""Grasp ranges for an object about which no more is known than its shape, mass and friction."""

import itertools
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from tacgen.core.arrays import FloatArray
from tacgen.core.records import Mesh
from tacgen.core.units import STANDARD_GRAVITY_M_S2
from tacgen.objects.shading import depth_view, view_axes
from tacgen.physics.gripper import default_gripper
from tacgen.physics.settings import PhysicsSettings
from tacgen.physics.world import ball_of

MARGIN_MM = 5.0  # to either side between open pads and the object
MIN_FORCE_N = 1.0  # below it light objects slip
GEL_REACH_MM = 0.5  # indentation of a flat face at a moderate force; a gel is 2 to 4 mm thick
RASTER_MM = 0.5  # of the views from a pad
TOUCH_RASTER_MM = 0.2  # a touch is found to half of it
DOME_RADIUS_MM = PhysicsSettings().pad_dome_radius_mm
COARSE_STEP_DEG = 5.0
CLEARLY_LARGER = 1.3  # areas vary by some 10 % with the raster of 0.5 mm
FACET_ANGLES_DEG = (3.0, 40.0)
"""Smaller angles are hardly seen; larger ones are edges of the object, as of an octagon (45°)."""
FACET_WIDTH_MM = 0.5  # the shipped objects' facets where pads touch
FACET_AREA_SHARE = 0.1  # a tenth of the surface: less is a rounded edge
THRESHOLD_SHARES = (0.4, 0.7, 1.0, 1.4, 2.0, 3.0, 4.0)
"""Shares of the least holding force: from certain failure to certain success."""


def suggest_ranges(
    surface: Mesh, *, mass_kg: float, friction: float
) -> tuple[dict[str, tuple[float, ...]], list[str]]:
    """Forces about the slip threshold mg/(2μ), and places where both pads meet the object.

    Returns the values by axis, and notes on what could not be satisfied.
    """
    notes, gripper = [], default_gripper()
    most_n = gripper.force_range_n[1]
    threshold = mass_kg * STANDARD_GRAVITY_M_S2 / (2 * max(friction, 0.05))
    clipped = np.clip([share * threshold for share in THRESHOLD_SHARES], MIN_FORCE_N, most_n)
    forces = tuple(dict.fromkeys(float(f"{force:.2g}") for force in clipped))
    if threshold > most_n:
        notes.append(f"slips below {threshold:.0f} N, more than the gripper's {most_n:.0f} N")

    low, high = surface.vertices_mm.min(axis=0), surface.vertices_mm.max(axis=0)
    heights = _distinct(
        max(gripper.lowest_mm, float(share * high[2])) for share in (0.25, 0.5, 0.75)
    )
    sides = _distinct(float(share * (high[1] - low[1]) / 2) for share in (-0.4, 0.0, 0.4))
    z_mm = tuple(z for z in heights if graspable(surface, 0.0, z))
    if not z_mm:
        notes.append("no height at which the pads meet it across x; set grasp_ranges by hand")
        z_mm = heights
    y_mm = tuple(y for y in sides if all(graspable(surface, y, z) for z in z_mm)) or (0.0,)
    return {"force_n": forces, "x_mm": (0.0,), "y_mm": y_mm, "z_mm": z_mm}, notes


def suggest_yaw(surface: Mesh, heights_mm: Sequence[float]) -> float:
    """The yaw at which the pads meet the largest opposite areas, rad in (−π/2, π/2].

    The area is that within ``GEL_REACH_MM`` of the first touch, on the worse of both sides, at the
    best height. 0 unless another yaw has an area ``CLEARLY_LARGER`` times as large.
    """

    def area_mm2(yaw_deg: float) -> float:
        sides = (yaw_deg, yaw_deg + 180.0)
        return max(
            min(_patch_mm2(surface, azimuth_deg, z_mm) for azimuth_deg in sides)
            for z_mm in heights_mm
        )

    coarse = max(np.arange(-85.0, 95.0, COARSE_STEP_DEG), key=area_mm2)
    near = np.arange(coarse - COARSE_STEP_DEG, coarse + COARSE_STEP_DEG + 0.5)
    areas = np.array([area_mm2(float(yaw_deg)) for yaw_deg in near])
    best = float(near[areas >= 0.99 * areas.max()].mean())
    if areas.max() <= CLEARLY_LARGER * area_mm2(0.0):
        return 0.0
    return float(np.radians(best))


def _patch_mm2(surface: Mesh, azimuth_deg: float, z_mm: float) -> float:
    """Area within the gel's reach of a pad at that height; 0 if the object is too wide."""
    depth = _pad_view(surface, azimuth_deg, 0.0, z_mm)
    nearest = float(depth.max())
    if not np.isfinite(nearest) or nearest > (default_gripper().stroke_mm - MARGIN_MM) / 2:
        return 0.0
    return float((depth >= nearest - GEL_REACH_MM).sum() * RASTER_MM**2)


def facet_note(surface: Mesh) -> str:
    """A note on facets of a round surface that an image of the gel would show; empty if none."""
    mesh = trimesh.Trimesh(surface.vertices_mm, surface.faces, process=False)
    ends = mesh.vertices[mesh.face_adjacency_edges]
    length_mm = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    width_mm = 2 * mesh.area_faces[mesh.face_adjacency].min(axis=1) / np.maximum(length_mm, 1e-9)
    angle_deg = np.degrees(mesh.face_adjacency_angles)
    low_deg, high_deg = FACET_ANGLES_DEG
    coarse = (angle_deg > low_deg) & (angle_deg < high_deg) & (width_mm > FACET_WIDTH_MM)
    faces = np.unique(mesh.face_adjacency[coarse])
    if mesh.area_faces[faces].sum() < FACET_AREA_SHARE * mesh.area:
        return ""
    return (
        f"facets of {np.median(width_mm[coarse]):.1f} mm meet at {np.median(angle_deg[coarse]):.0f}"
        "°, which images of the gel show as edges; if the object is round there, export the mesh "
        f"finer (about {FACET_WIDTH_MM:g} mm)"
    )


def graspable(surface: Mesh, y_mm: float, z_mm: float) -> bool:
    """Whether both pads, centred there, meet the object and it fits between them."""
    reach = [_pad_view(surface, azimuth_deg, y_mm, z_mm).max() for azimuth_deg in (0.0, 180.0)]
    widest_mm = default_gripper().stroke_mm - MARGIN_MM
    return bool(np.isfinite(reach).all() and sum(reach) <= widest_mm)


@dataclass(frozen=True, slots=True)
class TouchError:
    """By how much a domed pad at a place touches the convex parts elsewhere than the surface.

    ``off_mm`` (2,) is along x, and across it in the plane of the pad; ``part`` is the part touched.
    """

    y_mm: float
    z_mm: float
    off_mm: FloatArray
    part: int

    @property
    def most_mm(self) -> float:
        """The larger of the two."""
        return float(self.off_mm.max())


def touch_errors(
    surface: Mesh, parts: Sequence[Mesh], ranges: Mapping[str, tuple[float, ...]]
) -> list[TouchError]:
    """The errors at all places of ``ranges`` at which both pads meet the surface, on each side."""
    parts = [_as_collided(part) for part in parts]
    found = []
    for y, z in itertools.product(ranges["y_mm"], ranges["z_mm"]):
        for azimuth_deg in (0.0, 180.0) if graspable(surface, y, z) else ():
            true_mm, _ = _touch_mm((surface,), azimuth_deg, y, z)
            touched_mm, part = _touch_mm(parts, azimuth_deg, y, z)
            along, right, up = np.abs(true_mm - touched_mm)
            found.append(TouchError(y, z, np.array([along, np.hypot(right, up)]), part))
    return found


def touch_error_mm(errors: Iterable[TouchError]) -> FloatArray:
    """The most (2,) of the errors, along x and across it."""
    return np.asarray(np.max([error.off_mm for error in errors] or [np.zeros(2)], axis=0))


def largest_grid(
    ranges: Mapping[str, tuple[float, ...]], bad: Collection[tuple[float, float]]
) -> dict[str, tuple[float, ...]] | None:
    """The ranges with the most places (y, z) of which none is ``bad``; None if all are."""
    z_mm = ranges["z_mm"]
    grids = []
    for size in range(len(z_mm), 0, -1):
        for heights in itertools.combinations(z_mm, size):
            sides = tuple(y for y in ranges["y_mm"] if not {(y, z) for z in heights} & set(bad))
            grids.append((sides, heights))
    y_mm, z_mm = max(grids, key=lambda grid: len(grid[0]) * len(grid[1]))
    return {**ranges, "y_mm": y_mm, "z_mm": z_mm} if y_mm else None


def _as_collided(part: Mesh) -> Mesh:
    """The part; of a ball, which is simulated as a sphere, a fine mesh of that."""
    ball = ball_of(part)
    if ball is None:
        return part
    sphere = trimesh.creation.icosphere(subdivisions=5, radius=ball[1])  # to 0.1 % of the radius
    return Mesh(sphere.vertices + ball[0], np.asarray(sphere.faces, np.int32))


def _touch_mm(
    meshes: Sequence[Mesh], azimuth_deg: float, y_mm: float, z_mm: float
) -> tuple[FloatArray, int]:
    """Where a domed pad first touches (3,): towards it, to the right and up in its plane; whom."""
    views = np.array([_pad_view(m, azimuth_deg, y_mm, z_mm, TOUCH_RASTER_MM) for m in meshes])
    _, rows, columns = views.shape
    up = ((rows - 1) / 2 - np.arange(rows)[:, None]) * TOUCH_RASTER_MM
    right = (np.arange(columns) - (columns - 1) / 2) * TOUCH_RASTER_MM
    reach = views - (up**2 + right**2) / (2 * DOME_RADIUS_MM)
    which, row, column = np.unravel_index(np.argmax(reach), reach.shape)
    return np.array([reach[which, row, column], right[column], up[row, 0]]), int(which)


def _pad_view(
    mesh: Mesh, azimuth_deg: float, y_mm: float, z_mm: float, raster_mm: float = RASTER_MM
) -> FloatArray:
    """Heights of a mesh towards a pad, over all of it; −inf where there is nothing."""
    pad = default_gripper().pad
    size_px = (int(pad.height_mm / raster_mm), int(pad.width_mm / raster_mm))
    center_mm = np.array([0.0, y_mm, z_mm])
    return depth_view(mesh, view_axes(azimuth_deg, 0.0), center_mm, size_px, raster_mm)[0]


def _distinct(values: Iterable[float]) -> tuple[float, ...]:
    return tuple(dict.fromkeys(round(value, 1) + 0.0 for value in values))

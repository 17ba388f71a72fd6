"""Grasp ranges for an object about which no more is known than its shape, mass and friction."""

import itertools
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from tacgen.core.records import Mesh
from tacgen.core.types import PUBLISHED_K_N_MM3_PER_N, STANDARD_GRAVITY_M_S2, FloatArray
from tacgen.objects.shading import depth_view, view_axes
from tacgen.objects.showing import common_window_mm, is_shown
from tacgen.physics.gripper import default_gripper
from tacgen.physics.margins import dome_patch, torsion_limit
from tacgen.physics.settings import PhysicsSettings
from tacgen.physics.world import ball_of

MARGIN_MM = 5.0  # between the open gripper and the object: to either side, and under the palm
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
FORCES_N = (
    1.0,
    1.25,
    1.6,
    2.0,
    2.5,
    3.2,
    4.0,
    5.0,
    6.3,
    8.0,
    10.0,
    12.5,
    16.0,
    20.0,
    25.0,
    32.0,
    40.0,
)
"""Preferred numbers (ISO 3, R10), from below what a picture shows to the most of the gripper."""
SHARES = tuple(0.7 * 1.4**k for k in range(12))
"""Of the least force that holds, by which places are judged: from just failing to very firm."""
_ARM_MM = torsion_limit(
    dome_patch(10.0, dome_radius_mm=DOME_RADIUS_MM, k_n_mm3_per_n=PUBLISHED_K_N_MM3_PER_N)
)(0.0)
"""By which pads hold a moment: mg/(2μ) √(1 + (y/arm)²) holds y beside the centre of mass, by the
ellipsoid of ``torsion_factor``. It grows slowly with the force, by its fourth root."""
RIM_MM = 3.0  # from a pad's middle to an edge: inside the window, and the face under the middle
CANDIDATES = 9  # of each axis, of which those are taken that show something
SIDES = 25  # of which the candidates are taken: of a lying banana's length pads meet a fifth
ENOUGH_PLACES = 5
MOST_VALUES = {"y_mm": 5, "z_mm": 3}  # of the candidates that are tried, which takes seconds
FIRM_N = 25.0  # what a grasp may need that is far from the centre of mass
BODY_SHARE = 0.3  # the handle of a mug is a tenth as thick, that of a hammer as thick as its head
VIEW_MARGIN_MM = 1.0  # of a first touch from the edge of what is seen


def suggest_places(
    surface: Mesh, *, mass_kg: float, center_y_mm: float, friction: float
) -> tuple[dict[str, tuple[float, ...]], list[str]]:
    """Places at which both pads meet the object's body and pictures show the contact, and notes.

    Those are kept of which the pictures already show a grasp that just fails, or else somewhat
    stronger ones, until there are ``ENOUGH_PLACES``: a face larger than the window shows nothing
    but by an edge or a rim. The forces are all that are to be tried.
    """
    slip_n = mass_kg * STANDARD_GRAVITY_M_S2 / (2 * max(friction, 0.05))
    reach_mm = _ARM_MM * math.sqrt(max((FIRM_N / slip_n) ** 2 - 1.0, 0.0))
    every_side, thickest = _sides(surface, center_y_mm, reach_mm)
    ranges = {"force_n": FORCES_N, "x_mm": (0.0,), "y_mm": (thickest,), "z_mm": _heights(surface)}
    few = _thinned(ranges["z_mm"], MOST_VALUES["z_mm"])
    for meets in (_meets_window, graspable):
        sides = tuple(y for y in every_side if any(meets(surface, y, z) for z in few))
        if sides:
            break
    else:
        note = "no place at which the pads meet it across x; set grasp_ranges by hand"
        return ranges, [note]
    middle = min(sides, key=lambda y: abs(y - thickest))
    sides = tuple(sorted({middle, *_thinned(sides, CANDIDATES)}))
    ranges["y_mm"] = sides
    places = set(itertools.product(sides, ranges["z_mm"]))
    met = {place for place in places if meets(surface, *place)}
    needed_n = {y: slip_n * math.hypot(1.0, (y - center_y_mm) / _ARM_MM) for y in sides}
    shown, kept, notes = set[tuple[float, float]](), None, list[str]()
    for share in SHARES:
        shown |= {(y, z) for y, z in met - shown if is_shown(surface, y, z, share * needed_n[y])}
        heights = tuple(z for z in ranges["z_mm"] if (middle, z) in shown)
        kept = heights and largest_grid({**ranges, "z_mm": heights}, places - shown)
        if kept and _count(kept) >= ENOUGH_PLACES:
            break
    kept = kept or largest_grid(ranges, places - shown)
    if not kept:
        notes.append("its pictures will show little: no edge or curve of it is where pads meet it")
        kept = largest_grid(ranges, places - met) or ranges
    return {axis: _thinned(values, MOST_VALUES.get(axis)) for axis, values in kept.items()}, notes


def _count(ranges: Mapping[str, tuple[float, ...]]) -> int:
    """How many places there are, of at most ``MOST_VALUES`` an axis."""
    return math.prod(min(len(ranges[axis]), most) for axis, most in MOST_VALUES.items())


def _heights(surface: Mesh) -> tuple[float, ...]:
    """Heights of the pads' middle, evenly from clear of table and palm to where the top is seen."""
    gripper, top_mm = default_gripper(), float(surface.vertices_mm[:, 2].max())
    half_mm, palm_mm = gripper.hand.box.half_and_center_mm
    fingers_mm = float(palm_mm[2] - half_mm[2])
    lowest_mm = max(gripper.lowest_mm, top_mm - fingers_mm + MARGIN_MM)
    evenly_mm = np.linspace(lowest_mm, max(lowest_mm, top_mm - RIM_MM), CANDIDATES)
    # The uppermost vertex of a scan is not always of the face that a pad meets.
    return _distinct(sorted({*evenly_mm, max(lowest_mm, top_mm - 2 * RIM_MM)}))


def _sides(surface: Mesh, center_y_mm: float, reach_mm: float) -> tuple[tuple[float, ...], float]:
    """Sides over the body, to ``RIM_MM`` from its ends, and of them that of its thickest part.

    The body is where it is at least ``BODY_SHARE`` as thick along x as at its thickest; of it, what
    is within ``reach_mm`` of the centre of mass.
    """
    low, high = surface.vertices_mm.min(axis=0), surface.vertices_mm.max(axis=0)
    size_px = (max(1, int(high[2] - low[2])), max(1, int(high[1] - low[1])))  # of 1 mm
    center_mm = (low + high) / 2
    views = [depth_view(surface, view_axes(a, 0.0), center_mm, size_px, 1.0)[0] for a in (0, 180)]
    thick_mm = (views[0] + views[1][:, ::-1]).max(axis=0)
    thick_mm[thick_mm > _widest_mm()] = 0.0
    y_mm = center_mm[1] + np.arange(size_px[1]) - (size_px[1] - 1) / 2
    thickest_mm = np.median(y_mm[thick_mm >= thick_mm.max() - GEL_REACH_MM])
    body_mm = y_mm[thick_mm >= BODY_SHARE * thick_mm.max()]
    within = center_y_mm - reach_mm, center_y_mm + reach_mm
    middle_mm = float(np.clip(thickest_mm, *within))
    first_mm = min(max(body_mm.min() + RIM_MM, within[0]), middle_mm)
    last_mm = max(min(body_mm.max() - RIM_MM, within[1]), middle_mm)
    sides = _distinct(sorted({*np.linspace(first_mm, last_mm, SIDES), middle_mm}))
    return sides, _distinct([middle_mm])[0]


def faces_pads(surface: Mesh) -> bool:
    """Whether it fits between the open fingers, as a mug does whose handle is not under one, and
    both pads meet the thickest part of its body within what all sensors see.
    """
    if np.ptp(surface.vertices_mm[:, 0]) > _widest_mm():
        return False
    _, middle_mm = _sides(surface, 0.0, np.inf)
    return any(_meets_window(surface, middle_mm, z_mm) for z_mm in _heights(surface))


def _meets_window(surface: Mesh, y_mm: float, z_mm: float) -> bool:
    """Whether both pads meet the object there, within what all sensors see of the gel."""
    if not graspable(surface, y_mm, z_mm):
        return False
    half_mm = common_window_mm() / 2 - VIEW_MARGIN_MM
    touches = [_touch_mm((surface,), azimuth_deg, y_mm, z_mm)[0] for azimuth_deg in (0.0, 180.0)]
    return bool((np.abs([touch[1:] for touch in touches]) <= half_mm).all())


def _thinned(values: tuple[float, ...], most: int | None) -> tuple[float, ...]:
    """At most so many of the values, evenly, both ends among them."""
    if most is None or len(values) <= most:
        return values
    return tuple(values[k] for k in np.linspace(0, len(values) - 1, most).round().astype(int))


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
    """Area within the gel's reach of a pad at that height; 0 if the object is too wide.

    It is between the fingers by the middle of its bounding box, wherever its body is.
    """
    depth = _pad_view(surface, azimuth_deg, 0.0, z_mm)
    nearest = float(depth.max())
    azimuth_rad = math.radians(azimuth_deg)
    along = surface.vertices_mm[:, :2] @ (math.cos(azimuth_rad), math.sin(azimuth_rad))
    middle = float(along.max() + along.min()) / 2
    if not np.isfinite(nearest) or nearest - middle > _widest_mm() / 2:
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
    return bool(np.isfinite(reach).all() and sum(reach) <= _widest_mm())


def _widest_mm() -> float:
    return default_gripper().stroke_mm - MARGIN_MM


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
    """The ranges with the most places (y, z) of which none is ``bad``; None if all are.

    More values than ``MOST_VALUES`` of an axis count as so many.
    """
    z_mm = ranges["z_mm"]
    grids = []
    for size in range(len(z_mm), 0, -1):
        for heights in itertools.combinations(z_mm, size):
            sides = tuple(y for y in ranges["y_mm"] if not {(y, z) for z in heights} & set(bad))
            grids.append((sides, heights))
    kept = max(({**ranges, "y_mm": y, "z_mm": z} for y, z in grids), key=_count)
    return kept if kept["y_mm"] else None


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
    return tuple(dict.fromkeys(round(float(value), 1) + 0.0 for value in values))

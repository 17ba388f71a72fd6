"""The frozen records that the stages exchange; nothing here computes.

Units: N, mm, s, rad, kg. Frames: ``docs/reference/frames.md``. The gel frame has its origin at the
centre of the gel surface at rest, x along image columns, y along image rows (down) and z out of
the gel towards the object. Poses are 4×4 homogeneous matrices with translations in mm.
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import DTypeLike, NDArray
from pydantic import ConfigDict, PositiveFloat, PositiveInt

from tacgen.core.types import FloatArray

PadName = Literal["left", "right"]
"""Names of a gripper's pads."""
PADS: tuple[str, ...] = get_args(PadName)

Status = Literal["executed", "toppled", "unreachable", "no_contact", "crashed"]
ContactStatus = Literal["ok", "no_contact", "outside_window"]
"""What a tactile frame shows: the contact; a gel that nothing touches; a contact of which a part,
or all, lies beside what the camera sees."""
FailureMode = Literal["", "translational_slip", "rotational_slip"]

Until = Literal["lift", "outcome"]
"""Where the tactile frames of a grasp end: at the start of the lift, or when it is over."""

LABEL_SUCCESS, LABEL_FAILURE, LABEL_NOT_EXECUTED = 1, 0, -1


def frozen_array(values: object, dtype: DTypeLike = np.float64) -> NDArray[Any]:
    """A read-only copy of ``values``."""
    array: NDArray[Any] = np.array(values, dtype=dtype)
    array.setflags(write=False)
    return array


def rng_of(seed: int, *key: int) -> np.random.Generator:
    """Random numbers by identity: the same seed and key give the same ones."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


AXES = ("force_n", "x_mm", "y_mm", "z_mm", "yaw_rad")
"""What a gripper is asked to do with an object."""
GraspPoint = tuple[str, float, float, float, float, float]
"""What identifies a grasp: its object and the values of ``AXES``."""


@dataclass(frozen=True, slots=True)
class GraspConfig:
    """One point of the grid: what the gripper is asked to do.

    ``x_mm``, ``y_mm`` are the gripper's centre relative to the centre of the object's footprint,
    ``z_mm`` is the height of the pad's centre above the table, ``yaw_rad`` turns the gripper
    about z; at yaw 0 the fingers close along world x. ``index`` counts over the whole grid of
    the recipe and identifies the grasp's random numbers.
    """

    index: int
    object: str
    force_n: float
    x_mm: float
    y_mm: float
    z_mm: float
    yaw_rad: float = 0.0

    @property
    def point(self) -> GraspPoint:
        """The configuration without its number."""
        return self.object, self.force_n, self.x_mm, self.y_mm, self.z_mm, self.yaw_rad


@dataclass(frozen=True, slots=True)
class Mesh:
    """A triangle mesh: ``vertices_mm`` (n, 3) float64 and ``faces`` (m, 3) int32."""

    vertices_mm: NDArray[np.float64]
    faces: NDArray[np.int32]

    @classmethod
    def fixed(cls, vertices_mm: object, faces: object) -> "Mesh":
        """A mesh that cannot change: what was made ready of it for one frame serves the next."""
        return cls(frozen_array(vertices_mm), frozen_array(faces, np.int32))


@dataclass(frozen=True, slots=True)
class GraspObject:
    """A rigid object, in its own frame: footprint centre at the origin, z up, table at z = 0.

    ``surface`` is the true one, watertight, which the gel senses; ``collision`` are convex parts,
    which the physics collides. ``center_of_mass_mm`` (3,); ``inertia_kg_mm2`` (3, 3) is about it,
    along the object's axes. ``friction`` is Coulomb's coefficient against the gel.
    ``spinning_friction_mm`` is the moment about the contact normal that one pad resists, for each
    newton of normal force; None where it follows from the gel. ``spinning_friction_factor``
    multiplies either. ``grasp_ranges`` holds the axis values (``force_n``, ``x_mm``, ``y_mm``,
    ``z_mm``) of recipes that give none.
    """

    name: str
    surface: Mesh
    collision: tuple[Mesh, ...]
    mass_kg: float
    center_of_mass_mm: NDArray[np.float64]
    inertia_kg_mm2: NDArray[np.float64]
    friction: float
    spinning_friction_mm: float | None
    grasp_ranges: Mapping[str, tuple[float, ...]]
    color_rgb: tuple[int, int, int] = (190, 190, 190)
    folder: Path | None = None
    spinning_friction_factor: float = 1.0


@dataclass(frozen=True, slots=True)
class Markers:
    """The grid of dots printed on the gel."""

    __pydantic_config__ = ConfigDict(extra="forbid", use_attribute_docstrings=True)

    rows: PositiveInt
    """Rows of dots."""
    columns: PositiveInt
    """Columns of dots."""
    pitch_mm: PositiveFloat
    """Distance between neighbouring dots."""
    radius_mm: PositiveFloat
    """Radius of a dot."""


@dataclass(frozen=True, slots=True)
class Sensor:
    """The geometry of a vision-based tactile sensor.

    ``dome_radius_mm`` is the radius of curvature of the gel at rest (0: flat). ``gel_depth_mm``
    is the gel's thickness, the largest indentation there can be. ``gel_size_mm`` are the width and
    height of the gel, whose middle is the window's: it is larger than what the camera sees; None
    where they are not known. ``leds`` holds one unit vector
    a light in gel axes, pointing from the gel's centre towards the light, and its RGB weight.
    """

    name: str
    height_px: int
    width_px: int
    mm_per_px: float
    gel_depth_mm: float
    dome_radius_mm: float = 0.0
    markers: Markers | None = None
    leds: tuple[tuple[tuple[float, float, float], tuple[float, float, float]], ...] = ()
    table: str = ""
    gel_size_mm: tuple[float, float] | None = None

    @property
    def shape_px(self) -> tuple[int, int]:
        """(height, width) of its images."""
        return self.height_px, self.width_px

    @property
    def pixel_area_mm2(self) -> float:
        """Area of the gel that one pixel stands for."""
        return self.mm_per_px**2


@dataclass(frozen=True, slots=True)
class Camera:
    """A pinhole camera that looks at the scene of a grasp.

    Its axes are OpenCV's: x right, y down, z forward; the middle of the first pixel is at (0, 0).
    ``k_px`` (3, 3) are the intrinsics, ``t_world_camera_mm`` (4, 4) takes a point from the camera's
    axes into the world's.
    """

    name: str
    height_px: int
    width_px: int
    k_px: NDArray[np.float64]
    t_world_camera_mm: NDArray[np.float64]

    @property
    def shape_px(self) -> tuple[int, int]:
        """(height, width) of its images."""
        return self.height_px, self.width_px


@dataclass(frozen=True, slots=True)
class ContactFrame:
    """What one pad feels at one time, and where the object then is.

    ``force_shear_n`` (2,) is the force of the object on the gel along the gel's x and y;
    ``force_normal_n`` presses into the gel. ``torsion_n_mm`` is the moment about the normal through
    ``center_mm`` (2,), the contact's centre of pressure in the gel frame, or through the middle of
    the patch where that is None. ``pose_gel_object`` (4, 4) takes object coordinates (mm) into the
    gel frame (mm); its translation along z is only known up to the physics' collision margin.
    ``past`` (n, 4) is the load before, from the unloaded gel on: time (s), force into the gel and
    along its x and y (N); None where it is not known.
    """

    time_s: float
    force_normal_n: float
    force_shear_n: NDArray[np.float64]
    torsion_n_mm: float
    pose_gel_object: NDArray[np.float64]
    center_mm: NDArray[np.float64] | None = None
    past: NDArray[np.float64] | None = None

    @property
    def force_n(self) -> NDArray[np.float64]:
        """Force of the object on the gel (3,): along its x and y, and into it."""
        return np.array([*self.force_shear_n, self.force_normal_n], np.float64)


@dataclass(frozen=True, slots=True)
class ContactPatch:
    """Where a pad presses on the object: ``points_mm`` (n, 2) in the gel frame.

    ``share`` (n,) is each point's share of the normal force; there are no points without contact.
    """

    points_mm: NDArray[np.float64]
    share: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SlipMargin:
    """How far a grasp is from slipping: positive holds, negative slips.

    ``translational`` is (friction limit − tangential load) / weight; ``rotational`` is (torsional
    limit − moment of gravity about the pads' axis) / (weight × 1 mm). ``first_slip_time_s`` is
    NaN and ``first_slip_direction`` (2,), in the gel's x and y, is 0 where nothing slips.
    ``friction_ratio`` and ``torsion_ratio`` are the same limits over what is asked of them:
    above 1 holds; ``whole_torsion_ratio`` is what the latter would be without tangential load,
    and ``swing_moment_share`` (0 to 1) the part of the moment that is to be held so that the object
    turns no farther than a success may. They are NaN where only the differences were kept.
    """

    translational: float
    rotational: float
    first_slip_time_s: float
    first_slip_direction: NDArray[np.float64]
    friction_ratio: float = float("nan")
    torsion_ratio: float = float("nan")
    whole_torsion_ratio: float = float("nan")
    swing_moment_share: float = float("nan")


@dataclass(frozen=True, slots=True, kw_only=True)
class GraspOutcome:
    """How a grasp ended.

    ``grasp_time_s`` is the moment of grasp, when the force was found steady, from closing on (NaN
    where the grasp was not executed), ``grasp_frame`` the frame that was taken at that moment.
    ``lift_start_time_s`` and ``lift_end_time_s`` are on the same clock, as is ``outcome_time_s``:
    when the object passed the limit that made the grasp fail, else the end of the lift. ``reason``
    says why it was not executed, or what was not as it should be.
    """

    status: Status
    label: int
    failure_mode: FailureMode = ""
    rise_mm: float = 0.0
    turn_rad: float = 0.0
    margin: SlipMargin | None = None
    reason: str = ""
    grasp_frame: int = 0
    grasp_time_s: float = float("nan")
    lift_start_time_s: float = float("nan")
    lift_end_time_s: float = float("nan")
    outcome_time_s: float = float("nan")

    def outcome(self) -> dict[str, Any]:
        """The above by name."""
        return {one.name: getattr(self, one.name) for one in fields(GraspOutcome)}


@dataclass(frozen=True, slots=True, kw_only=True)
class GraspTrace(GraspOutcome):
    """Everything the physics says about one grasp.

    ``frames`` maps each tactile pad (``left``, ``right``) to its T frames, ``gel_steps`` to the
    loads at fixed times from the moment of grasp up to the last frame, by which the gel's shear is
    advanced whatever frames are kept. ``object_pose`` (T, 7)
    is x, y, z (mm) and the quaternion x, y, z, w of the object in the world at the frames' times,
    ``gripper_pose`` (T, 7) the same of the gripper, whose left and right gel are then
    ``pad_distance_mm`` (T, 2) from its middle; None where the grasp was not executed.
    """

    config: GraspConfig
    frames: Mapping[str, tuple[ContactFrame, ...]]
    object_pose: NDArray[np.float64]
    gripper_pose: NDArray[np.float64] | None = None
    pad_distance_mm: NDArray[np.float64] | None = None
    gel_steps: Mapping[str, tuple[ContactFrame, ...]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Estimate:
    """A fitted number with its standard error and unit."""

    value: float
    stderr: float = float("nan")
    unit: str = ""


SHORTEST_LIKELY_Z_MM = 1.0
"""A pad is 21 mm high: its centre is never so low, a height in metres always is."""
LARGEST_LIKELY_YAW_RAD = 2 * np.pi  # a full turn; larger angles are in degrees
SIMILAR = 0.7  # least similarity of two names (difflib's ratio): `yaw_deg` and `yaw_rad` have 0.71

_FORCES = {
    "force_normal_n": "normal force, N",
    "force_shear_x_n": "shear force along x, N",
    "force_shear_y_n": "shear force along y, N",
}
PRESS_LOG: Mapping[str, str] = {
    "trial": "number of the press, one integer a press",
    "time_s": "time on the session's clock, s",
    **_FORCES,
    "volume_mm3": "indented volume, mm³",
    "indenter": "name of the indenter",
    "radius_mm": "radius of the ball, mm; empty if the indenter is no ball",
    "x_mm": "centre of the contact along x, gel frame, mm",
    "y_mm": "centre of the contact along y, gel frame, mm",
    "shear_x_mm": "sum of the markers' motion along x, mm",
    "shear_y_mm": "sum of the markers' motion along y, mm",
}
PRESSES: Mapping[str, str] = {
    "file": "name of the press's image",
    "radius_mm": "radius of the ball, mm",
    "center_x_px": "centre of the contact, column, px; found in the image if not given",
    "center_y_px": "centre of the contact, row, px; found in the image if not given",
    "contact_radius_px": "radius of the contact, px; found in the image if not given",
    "x_mm": "position of the stage along x, mm",
    "y_mm": "position of the stage along y, mm",
    "trial": "number of the press, for several images of one press",
    "time_s": "time on the session's clock, s",
    **_FORCES,
}
GRASPS: Mapping[str, str] = {
    "grasp_id": "name of the grasp, and of its folder in images/",
    "object": "name of the object",
    "label": "1 success, 0 failure",
    "force_n": "force of each finger, N",
    "x_mm": "gripper's centre along world x, from the centre of the footprint, mm",
    "y_mm": "gripper's centre along world y, from the centre of the footprint, mm",
    "z_mm": "height of the pads' centre above the table, mm",
    "yaw_rad": "angle of the gripper about z, rad; 0 if not given",
    "failure_mode": "translational_slip, rotational_slip or empty",
    "grasp_frame": "number of the image at the moment of grasp, from 0; found in the images if not "
    "given",
    "lift_frame": "number of the last image before the lift, from 0",
}
DEPTH_CURVES: Mapping[str, str] = {
    "depth_mm": "indentation, mm",
    "force_normal_n": "normal force, N",
    "curve": "name of the curve; one curve if not given",
}


def similar_columns(columns: Iterable[str], known: Iterable[str], where: str) -> list[str]:
    """A warning for each column that is not known but resembles a known one that is missing."""
    columns, known = list(columns), list(known)
    missing = [name for name in known if name not in columns]
    near = {name: get_close_matches(name.lower(), missing, 1, SIMILAR) for name in columns}
    return [
        f"{where}: column {name!r} is not read as {near[name][0]!r}; rename it if it is that"
        for name in columns
        if near[name] and name not in known
    ]


def csv_problem(error: Exception) -> str:
    """Why a CSV file cannot be read, in plain words, from the error of its reader."""
    cells = re.search(r"Expected (\d+) fields in line (\d+), saw (\d+)", str(error))
    if cells:
        expected, line, found = cells.groups()
        return f"line {line} has {found} cells, the header {expected}; quote cells with commas"
    if quote := re.search(r"EOF inside string starting at row (\d+)", str(error)):
        return f"line {int(quote[1]) + 1} opens a quote that is not closed; close or delete it"
    if isinstance(error, UnicodeDecodeError):
        return f"byte {error.start} is not UTF-8 text; save it as comma-separated UTF-8 text"
    if isinstance(error, OSError):
        return f"{error.strerror or error}; check the path and its permissions"
    known = {
        "an Excel workbook": "it is an Excel workbook; save its sheet as CSV",
        "No columns to parse": "it is empty; write a header and one row each below it",
    }
    other = "it is not comma-separated text; save it as comma-separated UTF-8 text"
    return next((text for words, text in known.items() if words in str(error)), other)


def unit_problems(name: str, values: FloatArray) -> str:
    """What is suspicious about the unit of ``z_mm`` or ``yaw_rad``; empty if nothing is."""
    values = values[np.isfinite(values)]
    if not len(values):
        return ""
    if name == "z_mm" and 0 < values.max() < SHORTEST_LIKELY_Z_MM:
        return f"at most {values.max():g} mm above the table; if it is in metres, times 1000"
    if name == "yaw_rad" and np.abs(values).max() > LARGEST_LIKELY_YAW_RAD:
        largest = float(np.abs(values).max())
        return f"up to {largest:g} rad, more than a turn; if it is in degrees, divide by 57.3"
    return ""

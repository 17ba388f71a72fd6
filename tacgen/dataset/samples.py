"""The frozen records that go into a dataset and come out of it: one grasp, and what all share."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.core.records import PADS, Camera, GraspConfig, GraspOutcome, Sensor, Until
from tacgen.dataset.input_hashes import Inputs
from tacgen.dataset.schema import FIELDS, FLAG_FIELDS, FLAG_WORDS, STATE_FIELDS, Layout


@dataclass(frozen=True, slots=True)
class PadSample:
    """The images and forces of one tactile pad during one grasp.

    ``rgb`` (T, H, W, 3) uint8; ``force_normal_n`` (T,) presses into the gel, ``force_shear_n``
    (T, 2) is the force of the object on the gel along the gel's x and y; ``indentation_mm`` (T,) is
    δ of the contact law, how far the object stands in the gel at its deepest point; ``depth_mm``
    float16 is the indentation of each pixel, (T, H, W), or (H, W) at the moment of grasp.
    ``markers_mm`` (T, M, 2) is how far each marker is from its place at rest, ``force_field_n``
    (T, rows, columns, 3) the force on each cell of the window: shear x, y, normal. ``saturated``,
    ``no_contact``, ``nothing_to_see`` and ``outside_window`` (T,) say which frames do not show the
    whole force: the gel is pressed through, nothing touches it, no pixel changes visibly, or a part
    of the pressure is beside the window: ``outside_share`` (T, 4) of it beyond each of ``EDGES``.
    ``visible_share`` (T,) of the pixels differ visibly from the gel at rest.
    """

    rgb: NDArray[np.uint8]
    force_normal_n: NDArray[np.floating]
    force_shear_n: NDArray[np.floating]
    indentation_mm: NDArray[np.floating]
    depth_mm: NDArray[np.floating] | None = None
    saturated: NDArray[np.uint8 | np.bool_] | None = None
    no_contact: NDArray[np.uint8 | np.bool_] | None = None
    nothing_to_see: NDArray[np.uint8 | np.bool_] | None = None
    outside_window: NDArray[np.uint8 | np.bool_] | None = None
    outside_share: NDArray[np.floating] | None = None
    visible_share: NDArray[np.floating] | None = None
    markers_mm: NDArray[np.floating] | None = None
    force_field_n: NDArray[np.floating] | None = None

    def flags(self, frame: int) -> list[str]:
        """Why the image of a frame does not show the whole force, in words; empty where it does."""
        found = ((words, getattr(self, name)) for name, words in FLAG_WORDS.items())
        return [words for words, one in found if one is not None and one[frame]]


@dataclass(frozen=True, slots=True)
class CameraSample:
    """What a camera sees of one grasp, in T frames or, without that axis, at the moment of grasp.

    ``rgb`` (T, h, w, 3) uint8; ``depth_mm`` (T, h, w) float32 along the camera's axis, 0 where
    there is nothing; ``segmentation`` (T, h, w) uint8, numbers of ``schema.SEGMENTS``.
    """

    rgb: NDArray[np.uint8]
    depth_mm: NDArray[np.float32]
    segmentation: NDArray[np.uint8]


@dataclass(frozen=True, slots=True, kw_only=True)
class GraspSample(GraspOutcome):
    """One grasp of a dataset.

    ``pads`` maps ``left`` and/or ``right`` to that pad's images and forces; it is empty where the
    grasp was not executed (its arrays are then written as zeros). ``object_pose`` (T, 7) is x, y, z
    (mm) and the quaternion x, y, z, w in the world. ``label_confidence`` is the label's
    probability, NaN where unknown. ``picture`` (h, w, 3) uint8 shows the scene from outside,
    ``cameras`` maps each camera's name to what it sees.
    """

    config: GraspConfig
    seed: int
    split: str
    pads: Mapping[str, PadSample] = field(default_factory=dict)
    object_pose: NDArray[np.floating] | None = None
    label_confidence: float = math.nan
    picture: NDArray[np.uint8] | None = None
    cameras: Mapping[str, CameraSample] = field(default_factory=dict)


def frame_columns(pad: PadSample) -> dict[str, NDArray[np.floating]]:
    """The numbers of a pad's frames as columns of a table, (T,) each."""
    found: dict[str, NDArray[np.floating]] = {}
    for one in STATE_FIELDS:
        values = np.asarray(one.value(pad))
        found |= zip(one.column_names, values.reshape(len(values), -1).T, strict=True)
    return found


def frame_flags(pad: PadSample) -> dict[str, NDArray[np.bool_]]:
    """What is true or false of a pad's frames, (T,) each, as far as the dataset has it."""
    known = {one.name: one.value(pad) for one in FLAG_FIELDS}
    return {name: np.asarray(held) > 0 for name, held in known.items() if held is not None}


def frame_times_s(
    time_s: NDArray[np.float64],
    grasp_frame: int,
    grasp_time_s: float,
    last_time_s: float = math.nan,
) -> NDArray[np.float64]:
    """When a grasp's frames were taken, (T,), where ``time_s`` are the times of the dataset.

    The frame of the moment of grasp was taken at that moment, but in a sequence of one, which
    states a time of its own. ``last_time_s`` is when frames end that end with the lift's start.
    """
    times_s = np.array(time_s, np.float64)
    if not math.isnan(last_time_s) and (len(times_s) > 1 or times_s[0] > 0):
        times_s = np.minimum(times_s, last_time_s)
        times_s[-1] = last_time_s
    if not math.isnan(grasp_time_s) and (len(times_s) > 1 or times_s[0] == 0):
        times_s[grasp_frame] = grasp_time_s
    return times_s


def rgb_at_load(
    rgb: NDArray[np.uint8], noise_grey: float, seed: int, pad: str, frame: int
) -> NDArray[np.uint8]:
    """A stored image as a reader gives it: with the camera's noise, where it was left out.

    It is the same whenever it is read: drawn for the grasp's ``seed``, the pad and the frame. The
    image of a grasp that was not executed stays black.
    """
    if not noise_grey or not rgb.any():
        return rgb
    from tacgen.optics.noise import with_camera_noise

    return with_camera_noise(rgb, noise_grey, seed, PADS.index(pad), frame)


@dataclass(frozen=True, slots=True)
class DatasetSpec:
    """What all shards of a dataset have in common; their bytes follow from it and the grasps.

    ``recipe`` is the resolved one as plain data, ``recipe_sha256`` the hash of its settings;
    ``calibration`` holds the SHA-256 of each file that the images depend on, by role (``table``,
    ``contact_law``), ``inputs`` all that the shards depend on. A dataset that has grown has a few
    ``grids``, and ``parts`` says how many of the ``n_grasps`` each of them added; each begins a new
    shard.
    ``pads`` are ``left``, ``right`` or both; ``time_s`` the times of the T frames, from
    closing on (0 for a single image). The last shard may hold fewer than ``shard_size`` grasps.
    ``colors_from`` says what the table is of: real presses, or a virtual sensor.
    ``reference_rgb`` (H, W, 3) uint8 is the undeformed gel, ``depth`` whether ``depth_mm`` is kept
    of the moment of grasp, ``depth_of_frames`` of every frame. ``marker_rest_mm`` (M, 2) are the
    markers at rest where their motion is kept, ``force_field`` (rows, columns) the shape of the
    force field if there is one, ``picture_px`` (height, width) that of the scene pictures.
    ``cameras`` look at the scene, in every frame if ``camera_frames`` says so. The images are
    stored without the camera's noise where ``noise_at_load_grey`` is the standard deviation of what
    the reader adds.
    """

    recipe: Mapping[str, Any]
    recipe_sha256: str
    calibration: Mapping[str, str]
    sensor: Sensor
    pads: tuple[str, ...]
    time_s: tuple[float, ...]
    n_grasps: int
    shard_size: int
    reference_rgb: NDArray[np.uint8]
    depth: bool = False
    depth_of_frames: bool = False
    marker_rest_mm: NDArray[np.float64] | None = None
    force_field: tuple[int, int] | None = None
    picture_px: tuple[int, int] | None = None
    noise_at_load_grey: float = 0.0
    inputs: Inputs = field(default_factory=Inputs)
    grids: tuple[Any, ...] = ()
    parts: tuple[int, ...] = ()
    colors_from: str = ""
    cameras: tuple[Camera, ...] = ()
    camera_frames: bool = False

    @property
    def cameras_of_grasp(self) -> bool:
        """Whether cameras see the moment of grasp alone."""
        return bool(self.cameras) and not self.camera_frames

    @property
    def cameras_of_all(self) -> bool:
        """Whether cameras see every frame."""
        return bool(self.cameras) and self.camera_frames

    @property
    def until(self) -> Until:
        """Where the frames end."""
        return "lift" if dict(self.recipe.get("frames") or {}).get("until") == "lift" else "outcome"

    @property
    def part_sizes(self) -> tuple[int, ...]:
        """How many grasps came with each grid."""
        return self.parts or (self.n_grasps,)

    @property
    def layout(self) -> Layout:
        """The arrays of the shards."""
        asked = {field.asked_by for field in FIELDS if field.asked_by}
        is_asked = {name: getattr(self, name) for name in asked}
        absent = frozenset(name for name, how in is_asked.items() if how is None or how is False)
        return Layout(self.sensor.name, self.pads, absent, tuple(c.name for c in self.cameras))

    def sizes(self, n_grasps: int) -> dict[str, int]:
        """The lengths of the axes of a shard of so many grasps, by the letters of the schema."""
        rest_mm = () if self.marker_rest_mm is None else self.marker_rest_mm
        lengths = [n_grasps, len(self.time_s), *self.sensor.shape_px, len(rest_mm)]
        lengths += [*(self.picture_px or (0, 0)), *(self.force_field or (0, 0))]
        found = dict(zip((*"NTHWMhw", "rows", "columns"), lengths, strict=True))
        for one in self.cameras:
            found |= {f"{one.name} height": one.height_px, f"{one.name} width": one.width_px}
        return found

    @property
    def grasp_bytes(self) -> dict[str, int]:
        """What the images, and what is kept of the touch, take of a grasp before compression."""
        sizes, found = self.sizes(1), Counter[str]()
        for one in self.layout.placed():
            if one.field.of in ("pad", "camera") and one.field.image:
                found[one.field.known_as(one.owner)] += one.n_bytes(sizes)
        return dict(found)

    @property
    def n_shards(self) -> int:
        """How many shards the dataset has."""
        return sum(-(-size // self.shard_size) for size in self.part_sizes)

    def shard_range(self, shard: int) -> range:
        """The grasp indices of one shard."""
        return shard_range(self.part_sizes, self.shard_size, shard)[1]


def shard_range(parts: Sequence[int], shard_size: int, shard: int) -> tuple[int, range]:
    """The part that a shard belongs to and the indices of its grasps; none beyond the last."""
    start = 0
    for part, size in enumerate(parts):
        n_shards = -(-size // shard_size)
        if shard < n_shards:
            first = start + shard * shard_size
            return part, range(first, min(first + shard_size, start + size))
        shard, start = shard - n_shards, start + size
    return len(parts), range(start, start)

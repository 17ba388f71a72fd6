"""What a shard holds: one table of its arrays, with type, axes, unit, frame, meaning and source.

Writer, checker, reader, exports and the dataset's card go through ``FIELDS``: a new array is an
entry here, and an attribute of the sample that it is taken from.

A shard of N grasps with T frames and images of H × W pixels holds ``/grasp/…``, one array a column;
``/tactile/<sensor>/rgb``, ``reference``, and where the recipe asks for them ``depth_mm``,
``markers_mm`` and ``force_field_n``; ``/contact/…``; ``/object/pose``; ``/scene/picture`` of h × w
pixels; ``/camera/<name>/{rgb, depth_mm, segmentation}`` of each camera, with its intrinsics ``K``
and pose ``T_world_camera`` as attributes; and ``/time_s``.

With one tactile pad ``<sensor>`` is the sensor's name. With two, everything about a pad
stands once for each: ``/tactile/<sensor>_left/…`` and ``/tactile/<sensor>_right/…``,
``/contact/<sensor>_left/…`` and ``/contact/<sensor>_right/…``. The root attribute ``pads`` says
which there are. Text is UTF-8 of fixed length. A grasp that could not be executed has label −1,
its status, and zeros for all that was not measured.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import groupby
from operator import attrgetter
from typing import Any, get_args

import numpy as np

from tacgen.core.records import Status

FORMAT_VERSION = 1
SPLITS = ("train", "test")
STATUSES = get_args(Status)
FAILURE_MODES = ("", "translational_slip", "rotational_slip")

FRAMES_UNTIL = "frames_until"
"""Root attribute: ``lift`` where no frame is later than the start of the lift."""
NOISE_AT_LOAD = "noise_at_load_grey"
"""Root attribute: standard deviation of the camera's noise that readers add; none if missing."""
REST = "rest_mm"
"""Attribute of an array: where what it moves from is at rest."""

CAMERAS = "cameras"
"""Root attribute: the names of the cameras, with commas between; missing if there are none."""
K, T_WORLD_CAMERA = "K", "T_world_camera"
"""Attributes of a camera's arrays: intrinsics (3, 3) in pixels; its pose (4, 4), mm."""
SEGMENT_NAMES = "names"
"""Attribute of a segmentation: what 0, 1, 2, … are, with commas between."""
SEGMENTS = (
    *("background", "table", "object", "left finger", "left pad", "right finger", "right pad"),
    "gripper",
)
"""What a camera's pixel may show, by its number in a segmentation."""
MAX_CAMERAS = 8
MAX_CELLS = 256
"""Of a force field along a side: about one a pixel of the smallest sensor."""

MAX_OBJECT_BYTES, MAX_REASON_BYTES = 64, 160


@dataclass(frozen=True, slots=True)
class Field:
    """One array of a shard, or of each tactile pad in it.

    ``group`` and ``name`` say where it stands, ``axes`` are its shape (N grasps, T frames, letters
    for what a dataset decides, or fixed lengths). ``source`` is the attribute that it holds: of the
    ``sample`` of a grasp, of the sample of a ``pad`` or a ``camera``, or of the ``spec`` of the
    dataset; where that is None, NaN or zeros stand. ``asked_by`` is the attribute of the spec that
    asks for it, empty for what is always there, and ``recipe`` how a recipe does. ``rest`` is the
    attribute of the spec that holds its values (M, 2) on a gel at rest, which stand beside it as
    the attribute ``rest_mm``. ``dtype`` is numpy's name, or ``S<n>`` for text of at most n bytes of
    UTF-8. ``nan`` says whether values that do not apply may be NaN. An ``image`` array is stored
    compressed, one image a chunk; a ``noisy`` one is of a camera, whose noise asks for a codec of
    its own.
    """

    group: str
    name: str
    dtype: str
    axes: tuple[str | int, ...]
    unit: str
    frame: str
    description: str
    source: str
    asked_by: str = ""
    recipe: str = ""
    rest: str = ""
    nan: bool = False
    image: bool = False
    noisy: bool = False

    @property
    def of(self) -> str:
        """Whose attribute it is: ``sample``, ``pad``, ``camera`` or ``spec``."""
        return self.source.partition(".")[0]

    @property
    def attribute(self) -> str:
        """The attribute, dotted where it lies deeper."""
        return self.source.partition(".")[2]

    @property
    def is_of_pads(self) -> bool:
        """Whether each pad has one."""
        return self.group in ("tactile", "contact")

    @property
    def is_of_frames(self) -> bool:
        """Whether each frame of a grasp has one."""
        return self.axes[:2] == ("N", "T")

    @property
    def column_names(self) -> tuple[str, ...]:
        """Its columns in a table of frames: itself, or x and y of a vector on the gel."""
        if self.axes[2:] != (2,):
            return (self.name,)
        stem, _, unit = self.name.rpartition("_")
        return tuple(f"{stem}_{axis}_{unit}" for axis in "xy")

    def known_as(self, owner: str) -> str:
        """What it is called in a dataset: ``depth_mm`` of any pad, ``camera/front/depth_mm``."""
        return f"camera/{owner}/{self.name}" if self.of == "camera" else self.name

    def value(self, owner: object) -> Any:
        """What ``owner`` has of it; None where it has nothing."""
        try:
            return attrgetter(self.attribute)(owner)
        except AttributeError:  # of a part that is None, such as the margin of what did not execute
            return None


@dataclass(frozen=True, slots=True)
class Placed:
    """A field as a dataset has it: of an ``owner``, a pad, a camera or none, at a ``path``."""

    field: Field
    owner: str
    path: str

    @property
    def shape(self) -> tuple[str | int, ...]:
        """Its axes; each camera has a height and width of its own."""
        own = ("height", "width") if self.field.of == "camera" else ()
        return tuple(f"{self.owner} {axis}" if axis in own else axis for axis in self.field.axes)

    def resolve(self, sizes: Mapping[str, int]) -> tuple[int, ...]:
        """The shape in numbers, by the lengths of the axes."""
        return tuple(sizes[n] if isinstance(n, str) else n for n in self.shape)

    def n_bytes(self, sizes: Mapping[str, int]) -> int:
        """What it takes before compression."""
        return np.dtype(self.field.dtype).itemsize * math.prod(self.resolve(sizes))

    def chunks(self, shape: tuple[int, ...]) -> tuple[int, ...]:
        """The chunk of an ``image`` array of that shape: one image."""
        lead = len(shape) - (3 if self.shape[-1] == 3 else 2)
        return (1,) * lead + shape[lead:]


_TRANSLATIONAL = "(friction limit - tangential load) / weight; NaN where unknown"
_ROTATIONAL = "(torsional limit - moment of gravity) / (weight x 1 mm); NaN where unknown"
_SLIP = "when it first slips; NaN where it does not"
_SLIP_DIRECTION = "unit vector along which it first slips; 0 where it does not"
_CONFIDENCE = "probability of the label by the recipe's uncertainty; NaN where unknown"
_MOMENT = "moment of grasp, from closing on; NaN where none"
_FOOTPRINT = "gripper's centre from the footprint's"
_ON_GEL = "force of the object on the gel along the gel's x and y"
_POSE = "x, y, z in mm and the quaternion x, y, z, w"
_TIME = (
    "time of the frames from closing on; that of the moment of grasp is taken then, and with the "
    "attribute frames_until = lift none after the lift's start"
)
_OUTCOME_TIME = "when a limit of success was passed, from closing on; else the lift's end"


def _column(name: str, unit: str, frame: str, text: str, source: str = "", **how: Any) -> Field:
    """An array with a value for each grasp."""
    given = {"dtype": "float64", "axes": ("N",), "source": f"sample.{source or name}"} | how
    return Field("grasp", name, unit=unit, frame=frame, description=text, **given)


def _text(name: str, n_bytes: int, text: str, source: str = "") -> Field:
    return _column(name, "", "", text, source, dtype=f"S{n_bytes}")


def _of_pad(name: str, axes: tuple[str | int, ...], unit: str, text: str, **how: Any) -> Field:
    """An array of each pad."""
    given = {"group": "contact", "dtype": "float64", "source": f"pad.{name}"} | how
    return Field(name=name, axes=axes, unit=unit, frame="gel", description=text, **given)


def _of_camera(
    name: str, dtype: str, unit: str, text: str, last: tuple[int, ...] = ()
) -> tuple[Field, Field]:
    """An array of each camera: of the moment of grasp, or of every frame."""
    ways: tuple[tuple[str, tuple[str, ...]], ...] = (("grasp", ("N",)), ("all", ("N", "T")))
    first, every = (
        Field(
            group="camera",
            name=name,
            dtype=dtype,
            axes=(*lead, "height", "width", *last),
            unit=unit,
            frame="camera",
            description=text,
            source=f"camera.{name}",
            asked_by=f"cameras_of_{way}",
            recipe=f"scene: {{cameras: …, frames: {way}}}",
            image=True,
        )
        for way, lead in ways
    )
    return first, every


VALIDITY = {
    "saturated": "1: the gel is pressed through to its backing; more force would look the same",
    "no_contact": "1: nothing touches the gel",
    "nothing_to_see": "1: the gel is touched, but no pixel differs visibly from the gel at rest",
    "outside_window": "1: over a twentieth of the pressure is beside what the camera sees",
}
"""What each frame of a pad says of its image, and what that means: 0 where it shows the force."""
FLAG_WORDS = {name: name.replace("_", " ") for name in VALIDITY} | {"outside_window": "cut off"}
"""What a person reads for each of them."""
EDGES = ("left", "top", "right", "bottom")
"""Of a picture, in the order of ``outside_share``."""

_OUTSIDE = f"share of the pressure beyond each edge of the picture: {', '.join(EDGES)}"
_VISIBLE = "share of the picture's pixels that differ visibly from the gel at rest"
_GREY: dict[str, Any] = {"dtype": "uint8", "image": True}
_TOUCH: dict[str, Any] = {"group": "tactile", "image": True}  # compressed, one frame a chunk
_FORCE_FIELD = (
    "force of the object on each cell of the gel's window: along x, along y, into the gel; sums to "
    "the part of the frame's force that acts in the window"
)
FIELDS: tuple[Field, ...] = (
    _column("index", "1", "", "number of the grasp in the dataset", "config.index", dtype="int64"),
    _text("object", MAX_OBJECT_BYTES, "name of the object", "config.object"),
    _column("force_n", "N", "", "commanded gripping force", "config.force_n"),
    _column("x_mm", "mm", "world", _FOOTPRINT, "config.x_mm"),
    _column("y_mm", "mm", "world", _FOOTPRINT, "config.y_mm"),
    _column("z_mm", "mm", "world", "height of the pad's centre", "config.z_mm"),
    _column("yaw_rad", "rad", "world", "gripper's turn about z", "config.yaw_rad"),
    _column("seed", "1", "", "seed of the grasp's random numbers", dtype="int64"),
    _text("split", 8, "train or test"),
    _text("status", 16, "executed, unreachable, no_contact, crashed"),
    _column("label", "1", "", "1 success, 0 failure, -1 not executed", dtype="int8"),
    _text("failure_mode", 24, "translational_slip, rotational_slip"),
    _text("reason", MAX_REASON_BYTES, "why it was not executed"),
    _column("rise_mm", "mm", "world", "how far the object rose"),
    _column("turn_rad", "rad", "gripper", "how far it turned in the gripper"),
    _column("grasp_frame", "1", "", "frame taken at the moment of grasp", dtype="int32"),
    _column("grasp_time_s", "s", "", _MOMENT, nan=True),
    _column("lift_start_time_s", "s", "", "start of the lift", nan=True),
    _column("lift_end_time_s", "s", "", "end of the lift", nan=True),
    _column("outcome_time_s", "s", "", _OUTCOME_TIME, nan=True),
    _column(
        "margin_translational", "weights", "", _TRANSLATIONAL, "margin.translational", nan=True
    ),
    _column("margin_rotational", "weights mm", "", _ROTATIONAL, "margin.rotational", nan=True),
    _column("first_slip_time_s", "s", "", _SLIP, "margin.first_slip_time_s", nan=True),
    _column(
        *("first_slip_direction", "1", "gel", _SLIP_DIRECTION, "margin.first_slip_direction"),
        axes=("N", 2),
    ),
    _column("label_confidence", "1", "", _CONFIDENCE, nan=True),
    _of_pad(
        *("rgb", ("N", "T", "H", "W", 3), "grey level", "tactile images"),
        **_GREY | {"group": "tactile", "noisy": True},
    ),
    _of_pad(
        *("reference", ("H", "W", 3), "grey level", "the undeformed gel"),
        **_GREY | {"group": "tactile", "source": "spec.reference_rgb"},
    ),
    _of_pad(
        *("depth_mm", ("N", "H", "W"), "mm", "indentation at the moment of grasp"),
        **_TOUCH | {"dtype": "float16", "asked_by": "depth", "recipe": "depth: grasp"},
    ),
    _of_pad(
        *("depth_mm", ("N", "T", "H", "W"), "mm", "indentation"),
        **_TOUCH | {"dtype": "float16", "asked_by": "depth_of_frames", "recipe": "depth: all"},
    ),
    _of_pad(
        *("markers_mm", ("N", "T", "M", 2), "mm", "how far each marker is from its place at rest"),
        **_TOUCH | {"dtype": "float32", "asked_by": "marker_rest_mm", "recipe": "markers: true"},
        rest="marker_rest_mm",
    ),
    _of_pad(
        *("force_field_n", ("N", "T", "rows", "columns", 3), "N", _FORCE_FIELD),
        **_TOUCH | {"dtype": "float32", "asked_by": "force_field"},
        recipe="force_field: [rows, columns]",
    ),
    _of_pad("force_normal_n", ("N", "T"), "N", "force into the gel"),
    _of_pad("force_shear_n", ("N", "T", 2), "N", _ON_GEL),
    _of_pad("indentation_mm", ("N", "T"), "mm", "indentation at the deepest point"),
    *(_of_pad(name, ("N", "T"), "1", text, dtype="uint8") for name, text in VALIDITY.items()),
    _of_pad("outside_share", ("N", "T", len(EDGES)), "1", _OUTSIDE, dtype="float32"),
    _of_pad("visible_share", ("N", "T"), "1", _VISIBLE),
    Field(
        *("object", "pose", "float64", ("N", "T", 7), "mm; 1", "world", _POSE),
        source="sample.object_pose",
    ),
    Field(
        *("scene", "picture", "uint8", ("N", "h", "w", 3), "grey level", ""),
        *("the scene from outside", "sample.picture", "picture_px"),
        image=True,
    ),
    *_of_camera("rgb", "uint8", "grey level", "what the camera sees, without noise", (3,)),
    *_of_camera("depth_mm", "float32", "mm", "depth along the camera's axis; 0: nothing there"),
    *_of_camera("segmentation", "uint8", "1", "what is there, by the attribute `names`"),
    Field("", "time_s", "float64", ("T",), "s", "", _TIME, "spec.time_s"),
)
"""Every array of a shard, in the order in which they are written."""

COLUMNS = tuple(field for field in FIELDS if field.group == "grasp")
PAD_FIELDS = tuple(field for field in FIELDS if field.of == "pad")
TOUCH_FIELDS = tuple(f for f in PAD_FIELDS if f.image and not f.noisy)
"""What a dataset may keep of the touch beside the images. Of two with one name it has one."""
TOUCH = tuple(dict.fromkeys(field.name for field in TOUCH_FIELDS))
FRAME_FIELDS = tuple(f for f in PAD_FIELDS if f.is_of_frames and not f.image)
"""Figures of each frame of a pad, (N, T, …)."""
FLAG_FIELDS = tuple(
    f for f in FRAME_FIELDS if f.axes == ("N", "T") and f.dtype in ("bool", "uint8")
)
"""Those that are true or false; a pad without one has None there."""
STATE_FIELDS = tuple(
    f for f in FRAME_FIELDS if f.axes in (("N", "T"), ("N", "T", 2)) and f.unit != "1"
)
"""Those that are a state of the gel: numbers and vectors, but no shares of a picture."""


@dataclass(frozen=True, slots=True)
class Layout:
    """The arrays of one dataset, and where each pad's stand.

    It is without those that are ``asked_by`` what is ``absent``; ``cameras`` are their names.
    """

    sensor: str
    pads: tuple[str, ...]
    absent: frozenset[str] = frozenset()
    cameras: tuple[str, ...] = ()

    @property
    def fields(self) -> tuple[Field, ...]:
        """The fields that the dataset has; of two in one place the later."""
        there = (field for field in FIELDS if field.asked_by not in self.absent)
        return tuple({(field.group, field.name): field for field in there}.values())

    @property
    def of_pads(self) -> tuple[Field, ...]:
        """What it has of each grasp and pad, but the images."""
        return tuple(field for field in self.fields if field.of == "pad" and not field.noisy)

    @property
    def of_cameras(self) -> tuple[Field, ...]:
        """What it has of each camera; nothing where there is none."""
        return tuple(f for f in self.fields if f.of == "camera") if self.cameras else ()

    def find(self, name: str) -> Field | None:
        """That of ``of_pads`` of that name; None where the dataset has none."""
        return next((field for field in self.of_pads if field.name == name), None)

    def path(self, field: Field, pad: str = "") -> str:
        """Where a field stands, of one of the pads or cameras where each has one."""
        one = len(self.pads) == 1
        owner = pad if field.of == "camera" else ""
        if field.is_of_pads and not (one and field.group == "contact"):
            owner = self.sensor if one else f"{self.sensor}_{pad}"
        return "/" + "/".join(part for part in (field.group, owner, field.name) if part)

    def tactile(self, pad: str, name: str) -> str:
        """Path of an array of images of a pad, such as ``rgb``."""
        return self.path(next(f for f in FIELDS if (f.group, f.name) == ("tactile", name)), pad)

    def placed(self) -> Iterator[Placed]:
        """Every array, in the order in which it is written."""
        for _, group in groupby(self.fields, key=lambda field: field.group):
            fields = tuple(group)
            owners = {"camera": self.cameras}.get(fields[0].group, ("",))
            for owner in self.pads if fields[0].is_of_pads else owners:
                yield from (Placed(field, owner, self.path(field, owner)) for field in fields)

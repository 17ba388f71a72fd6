"""What a shard holds: every HDF5 array with its type, shape, unit, frame and meaning.

Layout of ``shards/shard-00000.h5`` with N grasps, T frames, images of H × W pixels::

    /grasp/index, object, force_n, x_mm, y_mm, z_mm, yaw_rad, seed, split             (N,)
    /grasp/status, label, failure_mode, reason, rise_mm, turn_rad, grasp_frame        (N,)
    /grasp/margin_translational, margin_rotational, first_slip_time_s                 (N,)
    /grasp/first_slip_direction                                                       (N, 2)
    /tactile/<sensor>/rgb          (N, T, H, W, 3) uint8
    /tactile/<sensor>/reference    (H, W, 3)       uint8    the undeformed gel
    /tactile/<sensor>/depth_mm     (N, H, W)       float16  optional, at the moment of grasp
    /contact/force_normal_n        (N, T)
    /contact/force_shear_n         (N, T, 2)
    /contact/indentation_mm        (N, T)
    /object/pose                   (N, T, 7)
    /scene/picture                 (N, h, w, 3)    uint8    optional
    /time_s                        (T,)

With one tactile pad ``<sensor>`` is the sensor's name. With two, everything about a pad
stands once for each: ``/tactile/<sensor>_left/…`` and ``/tactile/<sensor>_right/…``,
``/contact/<sensor>_left/…`` and ``/contact/<sensor>_right/…``. The root attribute ``pads`` says
which there are. Text is UTF-8 of fixed length. A grasp that could not be executed has label −1,
its status, and zeros for all that was not measured.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from tacgen.core.records import Sensor

FORMAT_VERSION = 1
PADS = ("left", "right")
SPLITS = ("train", "test")
STATUSES = ("executed", "unreachable", "no_contact", "crashed")
CONTACT_NAMES = ("force_normal_n", "force_shear_n", "indentation_mm")
FAILURE_MODES = ("", "translational_slip", "rotational_slip")

MAX_OBJECT_BYTES, MAX_REASON_BYTES = 64, 160


@dataclass(frozen=True, slots=True)
class ArraySpec:
    """One HDF5 array; ``shape`` mixes the letters of the layout with fixed lengths.

    ``dtype`` is numpy's name, or ``S<n>`` for text of at most n bytes of UTF-8. ``nan`` says
    whether values that do not apply may be NaN. An ``image`` array is stored compressed, one
    image a chunk; a ``noisy`` one is of a camera, whose noise asks for a codec of its own.
    """

    path: str
    dtype: str
    shape: tuple[str | int, ...]
    unit: str
    frame: str
    description: str
    nan: bool = False
    image: bool = False
    noisy: bool = False

    def resolve(self, sizes: Mapping[str, int]) -> tuple[int, ...]:
        """The shape in numbers."""
        return tuple(sizes[n] if isinstance(n, str) else n for n in self.shape)

    def chunks(self, shape: tuple[int, ...]) -> tuple[int, ...]:
        """The chunk of an ``image`` array of that shape: one image."""
        image_axes = 3 if self.shape[-1] == 3 else 2
        lead = len(shape) - image_axes
        return (1,) * lead + shape[lead:]


_NOWHERE, _WORLD, _GEL = "", "world", "gel"

GRASP_ARRAYS = (
    ArraySpec("/grasp/index", "int64", ("N",), "1", _NOWHERE, "number of the grasp in the grid"),
    ArraySpec("/grasp/object", f"S{MAX_OBJECT_BYTES}", ("N",), "", _NOWHERE, "name of the object"),
    ArraySpec("/grasp/force_n", "float64", ("N",), "N", _NOWHERE, "commanded gripping force"),
    ArraySpec(
        "/grasp/x_mm", "float64", ("N",), "mm", _WORLD, "gripper's centre from the footprint's"
    ),
    ArraySpec(
        "/grasp/y_mm", "float64", ("N",), "mm", _WORLD, "gripper's centre from the footprint's"
    ),
    ArraySpec("/grasp/z_mm", "float64", ("N",), "mm", _WORLD, "height of the pad's centre"),
    ArraySpec("/grasp/yaw_rad", "float64", ("N",), "rad", _WORLD, "gripper's turn about z"),
    ArraySpec("/grasp/seed", "int64", ("N",), "1", _NOWHERE, "seed of the grasp's random numbers"),
    ArraySpec("/grasp/split", "S8", ("N",), "", _NOWHERE, "train or test"),
    ArraySpec(
        "/grasp/status", "S16", ("N",), "", _NOWHERE, "executed, unreachable, no_contact, crashed"
    ),
    ArraySpec(
        "/grasp/label", "int8", ("N",), "1", _NOWHERE, "1 success, 0 failure, -1 not executed"
    ),
    ArraySpec(
        "/grasp/failure_mode", "S24", ("N",), "", _NOWHERE, "translational_slip, rotational_slip"
    ),
    ArraySpec(
        "/grasp/reason", f"S{MAX_REASON_BYTES}", ("N",), "", _NOWHERE, "why it was not executed"
    ),
    ArraySpec("/grasp/rise_mm", "float64", ("N",), "mm", _WORLD, "how far the object rose"),
    ArraySpec(
        "/grasp/turn_rad", "float64", ("N",), "rad", "gripper", "how far it turned in the gripper"
    ),
    ArraySpec("/grasp/grasp_frame", "int32", ("N",), "1", _NOWHERE, "frame of the moment of grasp"),
    ArraySpec(
        "/grasp/margin_translational",
        "float64",
        ("N",),
        "weights",
        _NOWHERE,
        "(friction limit - tangential load) / weight; NaN where unknown",
        nan=True,
    ),
    ArraySpec(
        "/grasp/margin_rotational",
        "float64",
        ("N",),
        "weights mm",
        _NOWHERE,
        "(torsional limit - moment of gravity) / (weight x 1 mm); NaN where unknown",
        nan=True,
    ),
    ArraySpec(
        "/grasp/first_slip_time_s",
        "float64",
        ("N",),
        "s",
        _NOWHERE,
        "when it first slips; NaN where it does not",
        nan=True,
    ),
    ArraySpec(
        "/grasp/first_slip_direction",
        "float64",
        ("N", 2),
        "1",
        _GEL,
        "unit vector along which it first slips; 0 where it does not",
    ),
)

_RGB = ArraySpec(
    "/tactile/{pad}/rgb",
    "uint8",
    ("N", "T", "H", "W", 3),
    "grey level",
    _GEL,
    "tactile images",
    image=True,
    noisy=True,
)
_REFERENCE = ArraySpec(
    "/tactile/{pad}/reference",
    "uint8",
    ("H", "W", 3),
    "grey level",
    _GEL,
    "the undeformed gel",
    image=True,
)
_DEPTH = ArraySpec(
    "/tactile/{pad}/depth_mm",
    "float16",
    ("N", "H", "W"),
    "mm",
    _GEL,
    "indentation at the moment of grasp",
    image=True,
)
_CONTACT = (
    ArraySpec(
        "/contact/{pad}force_normal_n", "float64", ("N", "T"), "N", _GEL, "force into the gel"
    ),
    ArraySpec(
        "/contact/{pad}force_shear_n",
        "float64",
        ("N", "T", 2),
        "N",
        _GEL,
        "force of the object on the gel along the gel's x and y",
    ),
    ArraySpec(
        "/contact/{pad}indentation_mm",
        "float64",
        ("N", "T"),
        "mm",
        _GEL,
        "indentation at the deepest point",
    ),
)
_POSE = ArraySpec(
    "/object/pose",
    "float64",
    ("N", "T", 7),
    "mm; 1",
    _WORLD,
    "x, y, z in mm and the quaternion x, y, z, w",
)
_PICTURE = ArraySpec(
    "/scene/picture",
    "uint8",
    ("N", "h", "w", 3),
    "grey level",
    "",
    "the scene from outside",
    image=True,
)
_TIME = ArraySpec("/time_s", "float64", ("T",), "s", "", "time of the frames from closing on")


@dataclass(frozen=True, slots=True)
class Layout:
    """The arrays of one dataset, and where each pad's stand."""

    sensor: str
    pads: tuple[str, ...]
    depth: bool
    picture: bool

    def tactile(self, pad: str, name: str) -> str:
        """Path of ``rgb``, ``reference`` or ``depth_mm`` of a pad."""
        return f"/tactile/{self._pad_name(pad)}/{name}"

    def contact(self, pad: str, name: str) -> str:
        """Path of ``force_normal_n``, ``force_shear_n`` or ``indentation_mm`` of a pad."""
        group = "" if len(self.pads) == 1 else f"{self._pad_name(pad)}/"
        return f"/contact/{group}{name}"

    def arrays(self) -> Iterator[ArraySpec]:
        """Every array, in the order in which it is written."""
        yield from GRASP_ARRAYS
        for pad in self.pads:
            for spec in (_RGB, _REFERENCE, *((_DEPTH,) if self.depth else ())):
                yield replace(spec, path=self.tactile(pad, spec.path.rsplit("/", 1)[1]))
        for pad in self.pads:
            for spec in _CONTACT:
                yield replace(spec, path=self.contact(pad, spec.path.rsplit("}", 1)[1]))
        yield _POSE
        if self.picture:
            yield _PICTURE
        yield _TIME

    def _pad_name(self, pad: str) -> str:
        return self.sensor if len(self.pads) == 1 else f"{self.sensor}_{pad}"


def array_sizes(
    n_grasps: int, n_frames: int, sensor: Sensor, picture_px: tuple[int, int] | None
) -> dict[str, int]:
    """What the letters of the layout stand for."""
    height, width = picture_px or (0, 0)
    return {
        "N": n_grasps,
        "T": n_frames,
        "H": sensor.height_px,
        "W": sensor.width_px,
        "h": height,
        "w": width,
    }

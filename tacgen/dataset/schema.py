"""What a shard holds: every HDF5 array with its type, shape, unit, frame and meaning.

A shard of N grasps with T frames and images of H × W pixels holds ``/grasp/…``, one array a column;
``/tactile/<sensor>/rgb``, ``reference`` and ``depth_mm``; ``/contact/…``; ``/object/pose``;
``/scene/picture`` of h × w pixels; and ``/time_s``.

With one tactile pad ``<sensor>`` is the sensor's name. With two, everything about a pad
stands once for each: ``/tactile/<sensor>_left/…`` and ``/tactile/<sensor>_right/…``,
``/contact/<sensor>_left/…`` and ``/contact/<sensor>_right/…``. The root attribute ``pads`` says
which there are. Text is UTF-8 of fixed length. A grasp that could not be executed has label −1,
its status, and zeros for all that was not measured.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

FORMAT_VERSION = 1
SPLITS = ("train", "test")
STATUSES = ("executed", "unreachable", "no_contact", "crashed")
FAILURE_MODES = ("", "translational_slip", "rotational_slip")

NOISE_AT_LOAD = "noise_at_load_grey"
"""Root attribute: standard deviation of the camera's noise that readers add; none if missing."""

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


_TRANSLATIONAL = "(friction limit - tangential load) / weight; NaN where unknown"
_ROTATIONAL = "(torsional limit - moment of gravity) / (weight x 1 mm); NaN where unknown"
_SLIP_DIRECTION = "unit vector along which it first slips; 0 where it does not"
CONFIDENCE = "/grasp/label_confidence"
_CONFIDENCE = "probability of the label by the recipe's uncertainty; NaN where unknown"
_GRASP: tuple[tuple[str, str, tuple[str | int, ...], str, str, str], ...] = (
    ("index", "int64", ("N",), "1", "", "number of the grasp in the grid"),
    ("object", f"S{MAX_OBJECT_BYTES}", ("N",), "", "", "name of the object"),
    ("force_n", "float64", ("N",), "N", "", "commanded gripping force"),
    ("x_mm", "float64", ("N",), "mm", "world", "gripper's centre from the footprint's"),
    ("y_mm", "float64", ("N",), "mm", "world", "gripper's centre from the footprint's"),
    ("z_mm", "float64", ("N",), "mm", "world", "height of the pad's centre"),
    ("yaw_rad", "float64", ("N",), "rad", "world", "gripper's turn about z"),
    ("seed", "int64", ("N",), "1", "", "seed of the grasp's random numbers"),
    ("split", "S8", ("N",), "", "", "train or test"),
    ("status", "S16", ("N",), "", "", "executed, unreachable, no_contact, crashed"),
    ("label", "int8", ("N",), "1", "", "1 success, 0 failure, -1 not executed"),
    ("failure_mode", "S24", ("N",), "", "", "translational_slip, rotational_slip"),
    ("reason", f"S{MAX_REASON_BYTES}", ("N",), "", "", "why it was not executed"),
    ("rise_mm", "float64", ("N",), "mm", "world", "how far the object rose"),
    ("turn_rad", "float64", ("N",), "rad", "gripper", "how far it turned in the gripper"),
    ("grasp_frame", "int32", ("N",), "1", "", "frame of the moment of grasp"),
    ("margin_translational", "float64", ("N",), "weights", "", _TRANSLATIONAL),
    ("margin_rotational", "float64", ("N",), "weights mm", "", _ROTATIONAL),
    ("first_slip_time_s", "float64", ("N",), "s", "", "when it first slips; NaN where it does not"),
    ("first_slip_direction", "float64", ("N", 2), "1", "gel", _SLIP_DIRECTION),
    ("label_confidence", "float64", ("N",), "1", "", _CONFIDENCE),
)
_MAY_BE_NAN = (
    "margin_translational",
    "margin_rotational",
    "first_slip_time_s",
    "label_confidence",
)
_TACTILE: tuple[tuple[str, str, tuple[str | int, ...], str, str], ...] = (
    ("rgb", "uint8", ("N", "T", "H", "W", 3), "grey level", "tactile images"),
    ("reference", "uint8", ("H", "W", 3), "grey level", "the undeformed gel"),
    ("depth_mm", "float16", ("N", "H", "W"), "mm", "indentation at the moment of grasp"),
)
_ON_GEL = "force of the object on the gel along the gel's x and y"
_CONTACT: tuple[tuple[str, tuple[str | int, ...], str, str], ...] = (
    ("force_normal_n", ("N", "T"), "N", "force into the gel"),
    ("force_shear_n", ("N", "T", 2), "N", _ON_GEL),
    ("indentation_mm", ("N", "T"), "mm", "indentation at the deepest point"),
)
_POSE = "x, y, z in mm and the quaternion x, y, z, w"

GRASP_ARRAYS = tuple(
    ArraySpec(f"/grasp/{name}", dtype, shape, unit, frame, text, nan=name in _MAY_BE_NAN)
    for name, dtype, shape, unit, frame, text in _GRASP
)
GRASP_NAMES = tuple(name for name, *_ in _GRASP)
CONTACT_NAMES = tuple(name for name, *_ in _CONTACT)


@dataclass(frozen=True, slots=True)
class Layout:
    """The arrays of one dataset, and where each pad's stand.

    Datasets collected before there was ``label_confidence`` are without ``confidence``.
    """

    sensor: str
    pads: tuple[str, ...]
    depth: bool
    picture: bool
    confidence: bool = True

    def tactile(self, pad: str, name: str) -> str:
        """Path of ``rgb``, ``reference`` or ``depth_mm`` of a pad."""
        return f"/tactile/{self._pad_name(pad)}/{name}"

    def contact(self, pad: str, name: str) -> str:
        """Path of ``force_normal_n``, ``force_shear_n`` or ``indentation_mm`` of a pad."""
        group = "" if len(self.pads) == 1 else f"{self._pad_name(pad)}/"
        return f"/contact/{group}{name}"

    def arrays(self) -> Iterator[ArraySpec]:
        """Every array, in the order in which it is written."""
        yield from GRASP_ARRAYS if self.confidence else GRASP_ARRAYS[:-1]
        for pad in self.pads:
            for name, dtype, shape, unit, text in _TACTILE[: 3 if self.depth else 2]:
                path, noisy = self.tactile(pad, name), name == "rgb"
                yield ArraySpec(path, dtype, shape, unit, "gel", text, image=True, noisy=noisy)
        for pad in self.pads:
            for name, shape, unit, text in _CONTACT:
                yield ArraySpec(self.contact(pad, name), "float64", shape, unit, "gel", text)
        yield ArraySpec("/object/pose", "float64", ("N", "T", 7), "mm; 1", "world", _POSE)
        if self.picture:
            shape, text = ("N", "h", "w", 3), "the scene from outside"
            yield ArraySpec("/scene/picture", "uint8", shape, "grey level", "", text, image=True)
        yield ArraySpec("/time_s", "float64", ("T",), "s", "", "time of the frames from closing on")

    def _pad_name(self, pad: str) -> str:
        return self.sensor if len(self.pads) == 1 else f"{self.sensor}_{pad}"

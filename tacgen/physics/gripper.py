"""Parallel grippers with tactile pads, by name: the YAML files of ``recipes/grippers``."""

import math
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, FiniteFloat, NonNegativeFloat, PositiveFloat, model_validator

from tacgen.core.errors import PhysicsError
from tacgen.core.records import PADS, Sensor
from tacgen.core.resources import gripper_path
from tacgen.core.schema import Section, read_yaml, validate
from tacgen.core.types import M_PER_MM, FloatArray, cross
from tacgen.physics.settings import MAX_FORCE_N

PAD_MARGIN_MM = 1.0
"""The pads' vertices lie inside their surface by the margin that Bullet adds around hulls."""
PAD_PITCH_MM = 2.0  # of the vertices on the dome: chords of a 30 mm dome lie 17 µm inside it
LARGEST_SPHERE_MM = 60.0
"""A pad of this dome radius or less touches as a sphere: a face that is tilted by 0.13 rad or less
then meets it on the pad. A flatter one is a hull, whose facets are off by 0.02 rad or less."""
TABLE_CLEARANCE_MM = 1.0  # of the gripper, where ranges of grasps are proposed or scaled

_Triple = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
_Axis = tuple[Literal[-1, 0, 1], Literal[-1, 0, 1], Literal[-1, 0, 1]]
_Length = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class Box(Section):
    """A part of the gripper that can meet the object, along the gripper's axes."""

    size_mm: tuple[_Length, _Length, _Length]
    """Extents along x (the closing direction), y and z (up)."""
    center_mm: _Triple
    """Its middle; of a finger's box from the top of its pad's dome, x away from the object."""

    @property
    def half_and_center_mm(self) -> tuple[FloatArray, FloatArray]:
        """Half extents (3,) and centre (3,)."""
        return np.array(self.size_mm) / 2, np.array(self.center_mm)


class Pad(Section):
    """Where a pad is and how its sensor is mounted, in the gripper's frame."""

    side: Literal[-1, 1]
    """On which side of the gripper's centre it is, along x."""
    gel_x: _Axis
    """Direction of the image's columns."""
    gel_y: _Axis
    """Direction of the image's rows."""

    @property
    def gel_axes(self) -> FloatArray:
        """Columns (3, 3) are the gel's x, y and z, which looks at the object."""
        x, y = np.array(self.gel_x, dtype=np.float64), np.array(self.gel_y, dtype=np.float64)
        return np.stack([x, y, cross(x, y)], axis=1)

    @model_validator(mode="after")
    def _looks_at_the_object(self) -> "Pad":
        axes = self.gel_axes
        if not np.array_equal(axes.T @ axes, np.eye(3)) or axes[0, 2] != -self.side:
            msg = (
                f"gel_x = {list(self.gel_x)}, gel_y = {list(self.gel_y)}: their cross product is "
                f"to look at the object, along [{-self.side}, 0, 0]"
            )
            raise ValueError(msg)
        return self


class _Pads(Section):
    """The gripper's two pads; the left one is sampled where one alone has a sensor."""

    left: Pad
    """The pad called left."""
    right: Pad
    """The pad called right."""

    @model_validator(mode="after")
    def _face_each_other(self) -> "_Pads":
        if self.left.side == self.right.side:
            msg = f"both pads have the side {self.left.side}; one is at -1, the other at 1"
            raise ValueError(msg)
        return self


class _PadSize(Section):
    """The pad that collides, a dome cut to a rectangle."""

    width_mm: _Length
    """Along the gripper's y."""
    height_mm: _Length
    """Along the gripper's z."""
    depth_mm: _Length
    """From the dome's top to the finger."""


class _Finger(Section):
    """A finger with its sensor."""

    mass_kg: PositiveFloat
    """Mass."""
    boxes: tuple[Box, ...] = Field(min_length=1)
    """What can meet the object beside the pad."""


class _Hand(Section):
    """The gripper without its fingers."""

    mass_kg: PositiveFloat
    """Mass."""
    box: Box
    """Its housing, above the fingers."""
    flange_height_mm: NonNegativeFloat
    """Height of the flange by which an arm carries it."""


class GripperSpec(Section):
    """A parallel gripper with a tactile pad on each finger.

    Its frame has its origin midway between the pads' centres, x along the closing direction and
    z up.
    """

    name: str
    """Name of the gripper."""
    source: str
    """Where its figures are from."""
    stroke_mm: _Length
    """Largest opening between the pads."""
    force_range_n: tuple[NonNegativeFloat, Annotated[_Length, Field(le=MAX_FORCE_N)]]
    """Least and largest force of a finger."""
    hand: _Hand
    """The gripper without its fingers."""
    finger: _Finger
    """Each finger."""
    pad: _PadSize
    """Each pad."""
    pads: _Pads
    """Where the pads are."""

    def side(self, pad: str) -> Pad:
        """The pad of that name."""
        found: Pad = getattr(self.pads, pad)
        return found

    def carrying(self, sensor: Sensor, pad: str) -> Sensor:
        """The sensor on a pad: its gel, if nothing else is said, is the pad."""
        if sensor.gel_size_mm:
            return sensor
        size_mm = np.array([self.pad.depth_mm, self.pad.width_mm, self.pad.height_mm])
        width_mm, height_mm, _ = np.abs(size_mm @ self.side(pad).gel_axes).tolist()
        return replace(sensor, gel_size_mm=(width_mm, height_mm))

    @property
    def below_mm(self) -> float:
        """How far the pads and fingers reach below the pads' centre."""
        boxes = [box.half_and_center_mm for box in self.finger.boxes]
        lowest_mm = [float(half_mm[2] - center_mm[2]) for half_mm, center_mm in boxes]
        return max(self.pad.height_mm / 2, *lowest_mm)

    @property
    def lowest_mm(self) -> float:
        """Height of the pads' centre at which the gripper well clears the table."""
        return self.below_mm + TABLE_CLEARANCE_MM

    @property
    def sides(self) -> dict[str, Pad]:
        """Both pads by name."""
        return {pad: self.side(pad) for pad in PADS}

    def pad_vertices_m(self, pad: str, dome_radius_mm: float) -> "_Vertices":
        """Vertices of the convex ``pad``, whose dome's top is at the origin.

        Raises ``PhysicsError`` if the dome is narrower than the pad.
        """
        size = self.pad.width_mm, self.pad.height_mm, self.pad.depth_mm
        if (least_mm := math.hypot(size[0], size[1]) / 2) >= dome_radius_mm - PAD_MARGIN_MM:
            msg = (
                f"physics.pad_dome_radius_mm = {dome_radius_mm:g} is less than the pad of "
                f"{self.name!r} needs; set {math.ceil(least_mm + PAD_MARGIN_MM) + 1} or more"
            )
            raise PhysicsError(msg)
        return _pad_vertices_m(float(self.side(pad).side), *size, dome_radius_mm)

    def finger_boxes_mm(self, pad: str) -> list[tuple[FloatArray, FloatArray]]:
        """Half extents (3,) and centre (3,) of the boxes of the finger that carries ``pad``."""
        mirror = np.array([self.side(pad).side, 1.0, 1.0])
        boxes = [box.half_and_center_mm for box in self.finger.boxes]
        return [(half_mm, mirror * center_mm) for half_mm, center_mm in boxes]


_Vertices = tuple[tuple[float, float, float], ...]


def touches_as_sphere(dome_radius_mm: float) -> bool:
    """Whether a pad's dome is a sphere, which reaches beyond the pad's outline."""
    return dome_radius_mm <= LARGEST_SPHERE_MM


def outline_of(pad: str) -> str:
    """Name of the part that ``pad`` is on the way to the grasp: its dome cut to the pad."""
    return f"{pad} outline"


def load_gripper(path: Path) -> GripperSpec:
    """The gripper that a YAML file describes.

    Raises ``RecipeError`` if it is wrong.
    """
    return validate(GripperSpec, read_yaml(path))


@lru_cache(maxsize=1)
def default_gripper() -> GripperSpec:
    """The shipped gripper for which ranges of an object's grasps are proposed."""
    return load_gripper(gripper_path("wsg50"))


@lru_cache(maxsize=8)
def _pad_vertices_m(
    side: float, width_mm: float, height_mm: float, depth_mm: float, dome_radius_mm: float
) -> _Vertices:
    """Vertices that lie ``PAD_MARGIN_MM`` inside the pad.

    Made once, because PyBullet never releases the sequence of vertices that it is given.
    """
    half_y, half_z = width_mm / 2 - PAD_MARGIN_MM, height_mm / 2 - PAD_MARGIN_MM
    y, z = np.meshgrid(_symmetric_range(half_y), _symmetric_range(half_z), indexing="ij")
    drop = dome_radius_mm - np.sqrt((dome_radius_mm - PAD_MARGIN_MM) ** 2 - y**2 - z**2)
    front = np.stack([side * drop, y, z], axis=-1).reshape(-1, 3)
    back = side * (depth_mm - PAD_MARGIN_MM)
    rim = np.array([[back, y, z] for y in (-half_y, half_y) for z in (-half_z, half_z)])
    vertices = np.concatenate([front, rim]) * M_PER_MM
    return tuple((x, y, z) for x, y, z in vertices.tolist())


def _symmetric_range(half: float) -> FloatArray:
    """Values over [−half, half] about ``PAD_PITCH_MM`` apart, 0 among them."""
    return np.linspace(-half, half, 2 * int(np.ceil(half / PAD_PITCH_MM)) + 1)

"""The section ``scene`` of a recipe: the cameras that look at a grasp."""

import math
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, FiniteFloat, model_validator

from tacgen.contact.gap import pose_problem
from tacgen.core.records import Camera, frozen_array
from tacgen.core.schema import Section
from tacgen.dataset.schema import MAX_CAMERAS

STRAIGHT = 1 - 1e-9  # of a camera's forward axis along z, from which it has no upper side there
_Side = Annotated[int, Field(ge=8, le=2048)]
_Place = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
_Row = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]


class LookAt(Section):
    """A camera by what it looks at."""

    from_mm: _Place
    """Place of the camera in the world."""
    to_mm: _Place
    """What is in the middle of its picture, whose upper side is towards world z; of a camera that
    looks straight down or up towards world y."""


class SceneCamera(Section):
    """A camera that looks at the scene."""

    name: str = Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,23}$")
    """Name of the camera."""
    size_px: tuple[_Side, _Side] = (96, 128)
    """Height and width of its pictures."""
    fov_deg: Annotated[float, Field(ge=1, le=150)] = 45.0
    """Angle of view from the upper to the lower edge of the picture."""
    look_at: LookAt | None = None
    """Where it is, and what it looks at."""
    pose: tuple[_Row, _Row, _Row, _Row] | None = None
    """Or: the rows of its pose in the world, which takes camera coordinates (mm; x right, y down, z
    forward) into the world's."""

    @model_validator(mode="after")
    def _is_somewhere(self) -> "SceneCamera":
        if (self.pose is None) == (self.look_at is None):
            msg = "is placed by one of `look_at` and `pose`; give one of them"
            raise ValueError(msg)
        t = self.camera().t_world_camera_mm
        if (problem := pose_problem(t)) and self.pose is not None:
            msg = f"pose {problem}"
            raise ValueError(msg)
        if problem:
            msg = "look_at.to_mm is where the camera is; give a point before it"
            raise ValueError(msg)
        if t[2, 3] <= 0:
            msg = f"is {abs(t[2, 3]):g} mm below the table's top, z = 0; place it above"
            raise ValueError(msg)
        return self

    def camera(self) -> Camera:
        """The camera with its intrinsics and pose."""
        height, width = self.size_px
        # Rounded, for the last bit of a tangent depends on the processor.
        focal_px = round(height / 2 / math.tan(math.radians(self.fov_deg) / 2), 6)
        k_px = [[focal_px, 0, (width - 1) / 2], [0, focal_px, (height - 1) / 2], [0, 0, 1]]
        given = np.array(self.pose) if self.look_at is None else _looking(self.look_at)
        pose = given if pose_problem(given) else _squared(given)
        return Camera(self.name, height, width, frozen_array(k_px), frozen_array(pose))


def _looking(how: LookAt) -> NDArray[np.float64]:
    """The pose of a camera that looks at a point; its rotation is 0 where that is its place."""
    pose, place_mm = np.eye(4), np.array(how.from_mm)
    forward = np.array(how.to_mm) - place_mm
    forward /= max(math.sqrt((forward**2).sum()), 1e-9)
    up = (0.0, 1.0, 0.0) if abs(forward[2]) > STRAIGHT else (0.0, 0.0, 1.0)
    right = np.cross(forward, up)
    right /= max(math.sqrt((right**2).sum()), 1e-9)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    pose[:3, 3] = place_mm
    return pose


def _squared(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """The pose with its axes, forward first, made exactly square."""
    x, _, z = pose[:3, :3].T
    z = z / math.sqrt((z**2).sum())
    x = x - (x * z).sum() * z
    x = x / math.sqrt((x**2).sum())
    found = pose.copy()
    found[:3, :3], found[3] = np.stack([x, np.cross(z, x), z], axis=1), (0.0, 0.0, 0.0, 1.0)
    return found


class Scene(Section):
    """Cameras that look at the scene, beside the tactile pads."""

    cameras: Annotated[tuple[SceneCamera, ...], Field(max_length=MAX_CAMERAS)] = ()
    """Each camera gives colours, depth and segments."""
    frames: Literal["grasp", "all"] = "grasp"
    """Pictures of the moment of ``grasp``, or of ``all`` frames of the sequence."""

"""What the recipe's cameras see of a grasp: the table, the object and the gripper.

The gripper is its description's boxes where the physics has them; an arm, which has no shape here,
is not drawn.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from tacgen.collection.recipe import Recipe
from tacgen.collection.scene import (
    FINGER_COLOR,
    PAD_COLOR,
    TABLE_COLOR,
    pad_distances_mm,
    pose_matrix,
    unit_box,
)
from tacgen.core.records import Camera, GraspObject, GraspTrace
from tacgen.core.types import FloatArray
from tacgen.dataset import CameraSample
from tacgen.dataset.schema import SEGMENTS
from tacgen.objects.pinhole import Solid, pinhole_view
from tacgen.physics.gripper import GripperSpec

HAND_COLOR = (70, 76, 86)
TABLE_MM = (1200.0, 1200.0, 100.0)  # as the physics has it


def cameras_of(recipe: Recipe) -> tuple[Camera, ...]:
    """The cameras that a recipe asks for."""
    return tuple(one.camera() for one in recipe.scene.cameras)


def camera_samples(
    recipe: Recipe, grasped: GraspObject, trace: GraspTrace, gripper: GripperSpec
) -> dict[str, CameraSample]:
    """What each camera of a recipe sees of an executed grasp, in the frames that it asks for."""
    is_all = recipe.scene.frames == "all"
    frames = range(len(trace.object_pose)) if is_all else (trace.grasp_frame,)
    found: dict[str, list[tuple[NDArray[np.generic], ...]]] = {}
    cameras = cameras_of(recipe)
    for frame in frames if cameras else ():
        solids = list(scene_solids(grasped, trace, frame, gripper))
        for camera in cameras:
            found.setdefault(camera.name, []).append(pinhole_view(camera, solids))
    samples = {}
    for name, views in found.items():
        each = [np.stack(one) if is_all else one[0] for one in zip(*views, strict=True)]
        samples[name] = CameraSample(*each)
    return samples


def scene_solids(
    grasped: GraspObject, trace: GraspTrace, frame: int, gripper: GripperSpec
) -> Iterator[Solid]:
    """Everything that is there in a frame of an executed grasp, in the world."""
    yield _box(np.eye(4), TABLE_MM, (0.0, 0.0, -TABLE_MM[2] / 2), TABLE_COLOR, "table")
    pose, surface = pose_matrix(trace.object_pose[frame]), grasped.surface
    vertices_mm = _moved(surface.vertices_mm, pose)
    yield Solid(vertices_mm, surface.faces, grasped.color_rgb, SEGMENTS.index("object"))
    if trace.gripper_pose is None:
        return
    pose, size = pose_matrix(trace.gripper_pose[frame]), gripper.pad
    half_mm, center_mm = gripper.hand.box.half_and_center_mm
    yield _box(pose, 2 * half_mm, center_mm, HAND_COLOR, "gripper")
    for pad, distance_mm in pad_distances_mm(trace, frame).items():
        side = gripper.side(pad).side
        gel_mm = np.array([side * distance_mm, 0.0, 0.0])
        behind_mm = (side * (distance_mm + size.depth_mm / 2), 0.0, 0.0)
        extents = (size.depth_mm, size.width_mm, size.height_mm)
        yield _box(pose, extents, behind_mm, PAD_COLOR, f"{pad} pad")
        for half_mm, center_mm in gripper.finger_boxes_mm(pad):
            yield _box(pose, 2 * half_mm, center_mm + gel_mm, FINGER_COLOR, f"{pad} finger")


def _box(
    pose: NDArray[np.float64],
    extents_mm: Sequence[float] | FloatArray,
    center_mm: Sequence[float] | FloatArray,
    color_rgb: tuple[int, int, int],
    segment: str,
) -> Solid:
    corners, faces = unit_box()
    placed_mm = corners * np.asarray(extents_mm) + np.asarray(center_mm)
    return Solid(_moved(placed_mm, pose), faces, color_rgb, SEGMENTS.index(segment))


def _moved(points_mm: NDArray[np.float64], pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points (n, 3) by a pose; written out, for a library's product varies with the processor."""
    x, y, z = points_mm.T
    columns = [row[0] * x + row[1] * y + row[2] * z + row[3] for row in pose[:3]]
    return np.stack(columns, axis=1)

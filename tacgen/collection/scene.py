"""The scene of a grasp: the table, the object and the gripper, as pictures and cameras show it.

The gripper is its description's boxes where the physics has them; an arm, which has no shape here,
is not drawn. Pictures are drawn on the processor alone, so that a shard holds the same bytes on
every machine.
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray

from tacgen.collection.recipe import Recipe
from tacgen.core.records import PADS, Camera, GraspConfig, GraspObject, GraspTrace
from tacgen.core.types import FloatArray, pose, rotation_about_z, rotation_of
from tacgen.dataset import CameraSample
from tacgen.dataset.schema import SEGMENTS
from tacgen.objects.meshes import from_manifold
from tacgen.objects.pinhole import Solid, camera_around, pinhole_view
from tacgen.physics.gripper import GripperSpec

PICTURE_PX = (150, 200)  # (height, width); enough to recognise the grasp in a gallery
VIEW_DEG = (-58.0, 22.0)  # azimuth and elevation

PAD_COLOR, FINGER_COLOR, TABLE_COLOR = (236, 238, 240), (92, 100, 112), (222, 214, 200)
HAND_COLOR = (70, 76, 86)
TABLE_MM = (1200.0, 1200.0, 100.0)  # as the physics has it
PICTURED_TABLE_MM = (156.0, 156.0, 3.0)


def cameras_of(recipe: Recipe) -> tuple[Camera, ...]:
    """The cameras that a recipe asks for."""
    return tuple(one.camera() for one in recipe.scene.cameras)


def camera_samples(
    recipe: Recipe, grasped: GraspObject, trace: GraspTrace, gripper: GripperSpec
) -> dict[str, CameraSample]:
    """What each camera of a recipe sees of an executed grasp, in the frames that it asks for."""
    is_all = recipe.scene.frames == "all"
    shown = range(len(trace.object_pose)) if is_all else (trace.grasp_frame,)
    found: dict[str, list[tuple[NDArray[np.generic], ...]]] = {}
    cameras = cameras_of(recipe)
    for frame in shown if cameras else ():
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
    yield _table(TABLE_MM)
    yield _object(grasped, pose_matrix(trace.object_pose[frame]))
    if trace.gripper_pose is None:
        return
    held = pose_matrix(trace.gripper_pose[frame])
    half_mm, center_mm = gripper.hand.box.half_and_center_mm
    yield _box(held, 2 * half_mm, center_mm, HAND_COLOR, "gripper")
    yield from _fingers(gripper, held, pad_distances_mm(trace, frame))


def grasp_picture(
    grasped: GraspObject, config: GraspConfig, trace: GraspTrace, frame: int, gripper: GripperSpec
) -> NDArray[np.uint8]:
    """The scene at one frame, (h, w, 3) uint8; the object at rest where nothing was executed.

    The fingers go on beyond the picture: the object fills it.
    """
    stands, openings_mm = np.eye(4), dict.fromkeys(PADS, gripper.stroke_mm / 2)
    if trace.frames and len(trace.object_pose):
        stands, openings_mm = pose_matrix(trace.object_pose[frame]), pad_distances_mm(trace, frame)
    place_mm = [config.x_mm, config.y_mm, config.z_mm]
    at = np.asarray(pose(rotation_about_z(config.yaw_rad), place_mm), np.float64)
    fingers = list(_fingers(gripper, at, openings_mm))
    pads = [one for one in fingers if one.color_rgb == PAD_COLOR]
    shown = [_table(PICTURED_TABLE_MM), _object(grasped, stands)]
    points_mm = np.concatenate([one.vertices_mm for one in (*shown, *pads)])
    return pinhole_view(camera_around(points_mm, PICTURE_PX, *VIEW_DEG), [*shown, *fingers])[0]


def pose_matrix(given: NDArray[np.float64]) -> NDArray[np.float64]:
    """The (4, 4) transform of x, y, z and a quaternion x, y, z, w (7,)."""
    return np.asarray(pose(rotation_of(given[3:]), given[:3]))


def pad_distances_mm(trace: GraspTrace, frame: int) -> dict[str, float]:
    """Distance of each gel from the gripper's middle, as drawn in a frame of an executed grasp.

    Fingers that lost their object go through each other in the physics; real ones meet.
    """
    assert trace.pad_distance_mm is not None
    distances_mm = np.maximum(trace.pad_distance_mm[frame], 0.0)
    return dict(zip(PADS, distances_mm.tolist(), strict=True))


def _object(grasped: GraspObject, at: NDArray[np.float64]) -> Solid:
    surface, segment = grasped.surface, SEGMENTS.index("object")
    return Solid(_moved(surface.vertices_mm, at), surface.faces, grasped.color_rgb, segment)


def _table(size_mm: tuple[float, float, float]) -> Solid:
    return _box(np.eye(4), size_mm, (0.0, 0.0, -size_mm[2] / 2), TABLE_COLOR, "table")


def _fingers(
    gripper: GripperSpec, at: NDArray[np.float64], openings_mm: Mapping[str, float]
) -> Iterator[Solid]:
    """The pads and their fingers, where the gels are so far from the gripper's middle."""
    for pad, distance_mm in openings_mm.items():
        gel_mm = np.array([gripper.side(pad).side * distance_mm, 0.0, 0.0])
        for extents_mm, center_mm, color_rgb, segment in finger_boxes(gripper, pad):
            yield _box(at, extents_mm, center_mm + gel_mm, color_rgb, segment)


def finger_boxes(
    gripper: GripperSpec, pad: str
) -> list[tuple[FloatArray, FloatArray, tuple[int, int, int], str]]:
    """Extents (3,), middle (3,), colour and segment of a pad and of the boxes of its finger.

    Along the gripper's axes, from the middle of the gel's surface.
    """
    size, boxes = gripper.pad, gripper.finger_boxes_mm(pad)
    pad_mm = np.array([size.depth_mm, size.width_mm, size.height_mm])
    behind_mm = np.array([gripper.side(pad).side * size.depth_mm / 2, 0.0, 0.0])
    return [
        (pad_mm, behind_mm, PAD_COLOR, f"{pad} pad"),
        *((2 * half_mm, at_mm, FINGER_COLOR, f"{pad} finger") for half_mm, at_mm in boxes),
    ]


def _box(
    at: NDArray[np.float64],
    extents_mm: Sequence[float] | FloatArray,
    center_mm: Sequence[float] | FloatArray,
    color_rgb: tuple[int, int, int],
    segment: str,
) -> Solid:
    corners, faces = unit_box()
    placed_mm = corners * np.asarray(extents_mm) + np.asarray(center_mm)
    return Solid(_moved(placed_mm, at), faces, color_rgb, SEGMENTS.index(segment))


def _moved(points_mm: NDArray[np.float64], at: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points (n, 3) by a at; written out, for a library's product varies with the processor."""
    x, y, z = points_mm.T
    columns = [row[0] * x + row[1] * y + row[2] * z + row[3] for row in at[:3]]
    return np.stack(columns, axis=1)


@lru_cache(maxsize=1)
def unit_box() -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Vertices and faces of a cube of side 1 about the origin."""
    box = from_manifold(Manifold.cube((1.0, 1.0, 1.0), center=True))
    return box.vertices_mm, box.faces

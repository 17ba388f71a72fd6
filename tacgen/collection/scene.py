"""A picture of a grasp from outside: the object, the table and the fingers, on the processor alone.

Shaded by tacgen's own rasteriser rather than by GL, so that a shard holds the same bytes on every
machine.
"""

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray

from tacgen.core.records import PADS, GraspConfig, GraspObject, GraspTrace
from tacgen.objects.meshes import from_manifold
from tacgen.objects.pinhole import Solid, joined
from tacgen.objects.shading import shaded_view
from tacgen.physics import frames
from tacgen.physics.gripper import GripperSpec

PICTURE_PX = (150, 200)  # (height, width); enough to recognise the grasp in a gallery
VIEW = {"azimuth_deg": -58.0, "elevation_deg": 22.0}

PAD_COLOR, FINGER_COLOR, TABLE_COLOR = (236, 238, 240), (92, 100, 112), (222, 214, 200)
_FINGER_TOP_MM = 65.5  # above the pads' centre, where fingers are cut off: objects fill the picture
_TABLE_RADIUS_MM = 78.0


def grasp_picture(
    grasped: GraspObject, config: GraspConfig, trace: GraspTrace, frame: int, gripper: GripperSpec
) -> NDArray[np.uint8]:
    """The scene at one frame, (h, w, 3) uint8; the object at rest where nothing was executed."""
    pose = np.eye(4)
    openings_mm = dict.fromkeys(PADS, gripper.stroke_mm / 2)
    if trace.frames and len(trace.object_pose):
        pose = pose_matrix(trace.object_pose[frame])
        openings_mm = pad_distances_mm(trace, frame)
    vertices = grasped.surface.vertices_mm @ pose[:3, :3].T + pose[:3, 3]
    parts = [Solid(vertices, grasped.surface.faces, grasped.color_rgb)]
    parts += [_table(), *_gripper(gripper, config, openings_mm)]
    mesh, of = joined(parts)
    colors = np.array([part.color_rgb for part in parts], np.uint8)[of]
    return shaded_view(mesh, colors, size_px=PICTURE_PX, **VIEW)


def pose_matrix(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """The (4, 4) transform of x, y, z and a quaternion x, y, z, w (7,)."""
    return np.asarray(frames.pose(frames.rotation_of(pose[3:]), pose[:3]))


def pad_distances_mm(trace: GraspTrace, frame: int) -> dict[str, float]:
    """Distance of each gel from the gripper's middle, as drawn in a frame of an executed grasp.

    Fingers that lost their object go through each other in the physics; real ones meet.
    """
    assert trace.pad_distance_mm is not None
    distances_mm = np.maximum(trace.pad_distance_mm[frame], 0.0)
    return dict(zip(PADS, distances_mm.tolist(), strict=True))


@lru_cache(maxsize=1)
def _table() -> Solid:
    disc = Manifold.cylinder(3.0, _TABLE_RADIUS_MM, circular_segments=48, center=True)
    mesh = from_manifold(disc.translate((0.0, 0.0, -1.6)))
    return Solid(mesh.vertices_mm, mesh.faces, TABLE_COLOR)


def _gripper(
    gripper: GripperSpec, config: GraspConfig, openings_mm: Mapping[str, float]
) -> list[Solid]:
    """Two fingers with their pads."""
    turn, (corners, faces) = frames.rotation_about_z(config.yaw_rad), unit_box()
    center_mm = np.array([config.x_mm, config.y_mm, config.z_mm])
    parts = []
    for pad, opening_mm in openings_mm.items():
        opened_mm = np.array([gripper.side(pad).side * opening_mm, 0.0, 0.0])
        for extents, place, color in finger_boxes(gripper, pad):
            vertices = (corners * extents + (place + opened_mm)) @ turn.T + center_mm
            parts.append(Solid(vertices, faces, color))
    return parts


def finger_boxes(
    gripper: GripperSpec, pad: str
) -> list[tuple[NDArray[np.float64], NDArray[np.float64], tuple[int, int, int]]]:
    """Extents (3,), middle (3,) and colour of the pad and its finger, drawn as wide as the pad.

    Along the gripper's axes, from the middle of the gel's surface.
    """
    size = gripper.pad
    pad_mm = np.array([size.depth_mm, size.width_mm, size.height_mm])
    boxes = [(pad_mm, np.array([gripper.side(pad).side * pad_mm[0] / 2, 0.0, 0.0]), PAD_COLOR)]
    for half_mm, middle_mm in gripper.finger_boxes_mm(pad):
        low_mm, high_mm = middle_mm - half_mm, middle_mm + half_mm
        low_mm[1], high_mm[1] = -pad_mm[1] / 2, pad_mm[1] / 2
        high_mm[2] = min(high_mm[2], _FINGER_TOP_MM)
        boxes.append((high_mm - low_mm, (high_mm + low_mm) / 2, FINGER_COLOR))
    return boxes


@lru_cache(maxsize=1)
def unit_box() -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Vertices and faces of a cube of side 1 about the origin."""
    box = from_manifold(Manifold.cube((1.0, 1.0, 1.0), center=True))
    return box.vertices_mm, box.faces

"""A picture of a grasp from outside: the object, the table and the fingers, on the processor alone.

Shaded by tacgen's own rasteriser rather than by GL, so that a shard holds the same bytes on every
machine.
"""

from functools import lru_cache

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray

from tacgen.core.records import GraspConfig, GraspObject, GraspTrace, Mesh
from tacgen.objects.meshes import from_manifold
from tacgen.objects.shading import shaded_view
from tacgen.physics import frames
from tacgen.physics.gripper import FINGER_THICKNESS_MM, PAD_HEIGHT_MM, PAD_WIDTH_MM
from tacgen.physics.settings import PAD_DEPTH_MM

PICTURE_PX = (150, 200)  # (height, width); enough to recognise the grasp in a gallery
VIEW = {"azimuth_deg": -58.0, "elevation_deg": 22.0}

PAD_COLOR, FINGER_COLOR, _TABLE_COLOR = (236, 238, 240), (92, 100, 112), (222, 214, 200)
# Along the gripper's x, y and z.
PAD_MM = (PAD_DEPTH_MM, PAD_WIDTH_MM, PAD_HEIGHT_MM)
# The fingers are cut off above, so that the object fills the picture.
FINGER_MM = (FINGER_THICKNESS_MM, PAD_WIDTH_MM, 75.0)
_TABLE_RADIUS_MM = 78.0

Part = tuple[NDArray[np.float64], NDArray[np.int32], tuple[int, int, int]]


def grasp_picture(
    grasped: GraspObject, config: GraspConfig, trace: GraspTrace, frame: int
) -> NDArray[np.uint8]:
    """The scene at one frame, (h, w, 3) uint8; the object at rest where nothing was executed."""
    pose = np.eye(4)
    openings_mm = (55.0, 55.0)
    if trace.frames and len(trace.object_pose):
        pose = pose_matrix(trace.object_pose[frame])
        openings_mm = _openings_mm(config, trace, pose, frame)
    vertices = grasped.surface.vertices_mm @ pose[:3, :3].T + pose[:3, 3]
    parts: list[Part] = [(vertices, grasped.surface.faces, grasped.color_rgb)]
    parts += [_table(), *_gripper(config, openings_mm)]
    return _shade(parts)


def pose_matrix(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """The (4, 4) transform of x, y, z and a quaternion x, y, z, w (7,)."""
    return np.asarray(frames.pose(frames.rotation_of(pose[3:]), pose[:3]))


def _openings_mm(
    config: GraspConfig, trace: GraspTrace, object_pose: NDArray[np.float64], frame: int
) -> tuple[float, float]:
    """Distance of the left and the right gel from the gripper's centre, along the closing axis.

    A pad without a sensor stands as far out as the other: the fingers move symmetrically.
    """
    along = np.array([np.cos(config.yaw_rad), np.sin(config.yaw_rad), 0.0])
    center = np.array([config.x_mm, config.y_mm, 0.0])
    found = {}
    for pad, loads in trace.frames.items():
        gel_origin = object_pose @ np.linalg.inv(loads[frame].pose_gel_object)[:, 3]
        found[pad] = abs(float((gel_origin[:3] - center) @ along))
    left = found.get("left", found.get("right", 55.0))
    return left, found.get("right", left)


@lru_cache(maxsize=1)
def _table() -> Part:
    disc = Manifold.cylinder(3.0, _TABLE_RADIUS_MM, circular_segments=48, center=True)
    mesh = from_manifold(disc.translate((0.0, 0.0, -1.6)))
    return mesh.vertices_mm, mesh.faces, _TABLE_COLOR


def _gripper(config: GraspConfig, openings_mm: tuple[float, float]) -> list[Part]:
    """Two fingers with their pads; the left one is on the −x side."""
    turn, (corners, faces) = frames.rotation_about_z(config.yaw_rad), _unit_box()
    center_mm = np.array([config.x_mm, config.y_mm, config.z_mm])
    finger_z = (FINGER_MM[2] - PAD_HEIGHT_MM) / 2
    parts = []
    for side, opening_mm in zip((-1.0, 1.0), openings_mm, strict=True):
        pad_x = side * (opening_mm + PAD_DEPTH_MM / 2)
        finger_x = side * (opening_mm + PAD_DEPTH_MM + FINGER_THICKNESS_MM / 2)
        for extents, place, color in (
            (PAD_MM, (pad_x, 0.0, 0.0), PAD_COLOR),
            (FINGER_MM, (finger_x, 0.0, finger_z), FINGER_COLOR),
        ):
            parts.append(((corners * extents + place) @ turn.T + center_mm, faces, color))
    return parts


@lru_cache(maxsize=1)
def _unit_box() -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    box = from_manifold(Manifold.cube((1.0, 1.0, 1.0), center=True))
    return box.vertices_mm, box.faces


def _shade(parts: list[Part]) -> NDArray[np.uint8]:
    starts = np.cumsum([0, *(len(vertices) for vertices, _, _ in parts)], dtype=np.int32)
    vertices = np.concatenate([vertices for vertices, _, _ in parts])
    faces = np.concatenate(
        [faces + start for (_, faces, _), start in zip(parts, starts, strict=False)]
    )
    colors = np.repeat(
        np.array([color for _, _, color in parts], dtype=np.uint8),
        [len(faces) for _, faces, _ in parts],
        axis=0,
    )
    return shaded_view(Mesh(vertices, faces), colors, size_px=PICTURE_PX, **VIEW)

"""A picture of a grasp from outside: the object, the table and the fingers, on the processor alone.

Shaded by tacgen's own rasteriser rather than by GL, so that a shard holds the same bytes on every
machine.
"""

from __future__ import annotations

import numpy as np
import trimesh
from numpy.typing import NDArray

from tacgen.objects_io.raster import shaded_view
from tacgen.records import GraspConfig, GraspObject, GraspTrace, Mesh

PICTURE_PX = (150, 200)
VIEW = {"azimuth_deg": -58.0, "elevation_deg": 22.0}

_PAD_COLOR, _FINGER_COLOR, _TABLE_COLOR = (236, 238, 240), (92, 100, 112), (222, 214, 200)
_PAD_MM = (4.0, 24.0, 20.0)
_FINGER_MM = (9.0, 26.0, 70.0)
_PALM_MM = (150.0, 50.0, 22.0)
_TABLE_RADIUS_MM = 78.0

Part = tuple[NDArray[np.float64], NDArray[np.int64], tuple[int, int, int]]


def grasp_picture(
    grasped: GraspObject,
    config: GraspConfig,
    trace: GraspTrace,
    frame: int,
    size_px: tuple[int, int] = PICTURE_PX,
) -> NDArray[np.uint8]:
    """The scene at one frame, (h, w, 3) uint8; the object at rest where nothing was executed."""
    pose = np.eye(4)
    openings_mm = (55.0, 55.0)
    if trace.frames and len(trace.object_pose):
        pose = _pose_matrix(trace.object_pose[frame])
        openings_mm = _openings_mm(config, trace, pose, frame)
    vertices = grasped.surface.vertices_mm @ pose[:3, :3].T + pose[:3, 3]
    parts: list[Part] = [(vertices, grasped.surface.faces.astype(np.int64), grasped.color_rgb)]
    parts += [_table(), *_gripper(config, openings_mm)]
    return _shade(parts, size_px)


def _pose_matrix(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """x, y, z and a quaternion x, y, z, w as a 4×4 matrix."""
    x, y, z, w = pose[3:]
    matrix = trimesh.transformations.quaternion_matrix([w, x, y, z])
    matrix[:3, 3] = pose[:3]
    return matrix


def _openings_mm(
    config: GraspConfig, trace: GraspTrace, object_pose: NDArray[np.float64], frame: int
) -> tuple[float, float]:
    """Distance of the left and the right gel from the gripper's centre, along the closing axis.

    A pad without a sensor stands as far out as the other: the fingers move symmetrically.
    """
    along = np.array([np.cos(config.yaw_rad), np.sin(config.yaw_rad), 0.0])
    center = np.array([config.x_mm, config.y_mm, 0.0])
    found = {}
    for pad, frames in trace.frames.items():
        gel_origin = object_pose @ np.linalg.inv(frames[frame].pose_gel_object)[:, 3]
        found[pad] = abs(float((gel_origin[:3] - center) @ along))
    left = found.get("left", found.get("right", 55.0))
    return left, found.get("right", left)


def _table() -> Part:
    disc = trimesh.creation.cylinder(radius=_TABLE_RADIUS_MM, height=3.0, sections=48)
    disc.apply_translation([0.0, 0.0, -1.6])
    return disc.vertices, disc.faces, _TABLE_COLOR


def _gripper(config: GraspConfig, openings_mm: tuple[float, float]) -> list[Part]:
    """Two fingers with their pads, and the palm above; the left finger is on the −x side."""
    boxes = []
    for side, opening_mm in zip((-1.0, 1.0), openings_mm, strict=True):
        pad_x = side * (opening_mm + _PAD_MM[0] / 2)
        finger_x = side * (opening_mm + _PAD_MM[0] + _FINGER_MM[0] / 2)
        finger_z = _FINGER_MM[2] / 2 - _PAD_MM[2] / 2 - 2.0
        boxes.append((_PAD_MM, (pad_x, 0.0, 0.0), _PAD_COLOR))
        boxes.append((_FINGER_MM, (finger_x, 0.0, finger_z), _FINGER_COLOR))
    palm_z = _FINGER_MM[2] - _PAD_MM[2] / 2 + _PALM_MM[2] / 2 - 2.0
    boxes.append((_PALM_MM, (0.0, 0.0, palm_z), _FINGER_COLOR))
    place = trimesh.transformations.rotation_matrix(config.yaw_rad, [0, 0, 1])
    place[:3, 3] = config.x_mm, config.y_mm, config.z_mm
    parts = []
    for extents, center, color in boxes:
        box = trimesh.creation.box(extents=extents)
        box.apply_translation(center)
        box.apply_transform(place)
        parts.append((box.vertices, box.faces, color))
    return parts


def _shade(parts: list[Part], size_px: tuple[int, int]) -> NDArray[np.uint8]:
    starts = np.cumsum([0] + [len(vertices) for vertices, _, _ in parts])
    vertices = np.concatenate([vertices for vertices, _, _ in parts])
    faces = np.concatenate(
        [faces + start for (_, faces, _), start in zip(parts, starts, strict=False)]
    )
    colors = np.concatenate([np.tile(color, (len(faces), 1)) for _, faces, color in parts])
    whole = Mesh(vertices, faces.astype(np.int32))
    return shaded_view(whole, colors, size_px=size_px, **VIEW)

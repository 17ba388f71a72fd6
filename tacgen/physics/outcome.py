"""What the snapshots of a grasp amount to: loads, motion in the hand, tactile frames."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tacgen.core.records import ContactFrame, GraspObject, frozen_array
from tacgen.core.units import MM_PER_M
from tacgen.physics.contacts import (
    Bodies,
    Snapshot,
    contact_frames,
    gel_pose,
    gripper_pose,
    mean_contacts,
    object_pose,
)
from tacgen.physics.frames import inverse, pose, quaternion_from_rotation, turn_rad
from tacgen.physics.frames import rotation_from_quaternion as rotation_of
from tacgen.physics.labels import Motion
from tacgen.physics.margins import Capacity, PadLoad, grasp_capacity
from tacgen.physics.settings import PhysicsSettings


def capacity_of(
    grasped: Sequence[Snapshot], bodies: Bodies, obj: GraspObject, settings: PhysicsSettings
) -> Capacity:
    """What the pads can hold, by the contact forces at the moment of grasp."""
    contacts = mean_contacts(grasped, bodies.object_body)
    pads = [contacts.of(bodies.robot_body, link) for link in bodies.pad_links.values()]
    last = grasped[-1]
    return grasp_capacity(
        tuple(PadLoad(pad.point_m, pad.normal, pad.normal_force_n) for pad in pads),
        closing_axis=gripper_pose(last)[:3, 0],
        center_of_mass_m=np.array(last.object_position_m),
        mass_kg=obj.mass_kg,
        friction=obj.friction * settings.pad_friction,
        spinning_friction_mm=obj.spinning_friction_mm * settings.pad_friction,
    )


def motion_of(lifted: Sequence[Snapshot], bodies: Bodies, pad: str) -> Motion:
    """How the object moved from the first of ``lifted`` on; slides in the gel axes of ``pad``."""
    grippers = pose(
        rotation_of(np.array([snapshot.gripper_quaternion for snapshot in lifted])),
        np.array([snapshot.gripper_position_m for snapshot in lifted]),
    )
    inertial = pose(
        rotation_of(np.array([snapshot.object_quaternion for snapshot in lifted])),
        np.array([snapshot.object_position_m for snapshot in lifted]),
    )
    in_gripper = np.linalg.inv(grippers) @ inertial @ inverse(bodies.inertial)
    left_m, right_m = lifted[0].pad_distance_m
    between_pads = np.array([(right_m - left_m) / 2, 0.0, 0.0, 1.0])
    gel_axes = gripper_pose(lifted[0])[:3, :3].T @ gel_pose(lifted[0], pad)[:3, :2]
    return Motion(
        time_s=np.array([snapshot.step for snapshot in lifted]) * bodies.time_step_s,
        rise_mm=(inertial[:, 2, 3] - inertial[0, 2, 3]) * MM_PER_M,
        turn_rad=turn_rad(in_gripper[0, :3, :3].T @ in_gripper[:, :3, :3]),
        slide_mm=_slide_mm(in_gripper, between_pads) @ gel_axes,
        center_slide_mm=_slide_mm(in_gripper, in_gripper[0] @ bodies.inertial[:, 3]) @ gel_axes,
    )


def _slide_mm(in_gripper: NDArray[np.float64], start_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Displacement (n, 3) in the gripper frame of the object's point that starts at ``start_m``."""
    material = np.linalg.inv(in_gripper[0]) @ start_m
    return ((in_gripper @ material)[:, :3] - start_m[:3]) * MM_PER_M


def frames_of(
    windows: Sequence[Sequence[Snapshot]], bodies: Bodies, pads: Sequence[str]
) -> dict[str, tuple[ContactFrame, ...]]:
    """The tactile frames of each of ``pads``, one a window."""
    felt = [contact_frames(window, bodies, pads) for window in windows]
    return {pad: tuple(frame[pad] for frame in felt) for pad in pads}


def object_poses_mm(snapshots: Sequence[Snapshot], bodies: Bodies) -> NDArray[np.float64]:
    """(n, 7) position (mm) and quaternion x, y, z, w of the object's frame in the world."""
    poses = [object_pose(snapshot, bodies) for snapshot in snapshots]
    return frozen_array(
        [[*(p[:3, 3] * MM_PER_M), *quaternion_from_rotation(p[:3, :3])] for p in poses]
    )

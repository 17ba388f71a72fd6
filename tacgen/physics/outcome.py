"""What the snapshots of a grasp amount to: loads, motion in the hand, label and tactile frames."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tacgen.core.records import (
    LABEL_FAILURE,
    LABEL_SUCCESS,
    ContactFrame,
    FailureMode,
    GraspObject,
    frozen_array,
)
from tacgen.core.types import (
    MM_PER_M,
    STANDARD_GRAVITY_M_S2,
    BoolArray,
    FloatArray,
    inverse,
    pose,
    quaternion_from_rotation,
    rotation_of,
    turn_rad,
)
from tacgen.physics.contacts import (
    Bodies,
    Placement,
    Snapshot,
    contact_frames,
    gel_pose,
    gripper_pose,
    load_courses,
    mean_contacts,
    object_pose,
    pressed,
    with_past,
)
from tacgen.physics.engine import Touch
from tacgen.physics.margins import (
    Capacity,
    TorsionLimit,
    dome_stiffness_n_mm2,
    grasp_capacity,
)
from tacgen.physics.settings import PhysicsSettings


@dataclass(frozen=True, slots=True)
class Motion:
    """How the object moved during the lift, n samples from its start on.

    ``time_s`` (n,) since closing on; ``rise_mm`` (n,), the height of the centre of mass above where
    it was; ``turn_rad`` (n,), the rotation relative to the gripper; ``slide_mm`` and
    ``center_slide_mm`` (n, 2), displacements in the gel's x and y of the object's point between the
    pads and of the centre of mass.
    """

    time_s: FloatArray
    rise_mm: FloatArray
    turn_rad: FloatArray
    slide_mm: FloatArray
    center_slide_mm: FloatArray


def label_of(rise_mm: float, turn_rad: float, settings: PhysicsSettings) -> int:
    """1 if the object rose far enough and turned little enough, else 0."""
    held = rise_mm >= settings.success_rise_mm and turn_rad < settings.success_turn_rad
    return LABEL_SUCCESS if held else LABEL_FAILURE


def failure_mode(motion: Motion, settings: PhysicsSettings) -> FailureMode:
    """Which limit the object passed first: the turn's, or the slide that the rise allows.

    Where neither was passed, the one it came closer to.
    """
    slide, turn = _over_limits(motion, settings)
    first_slide, first_turn = _first(slide >= 1.0), _first(turn >= 1.0)
    if first_slide == first_turn:
        turned = turn.max() >= slide.max()
    else:
        turned = first_turn < first_slide
    return "rotational_slip" if turned else "translational_slip"


def outcome_time_s(motion: Motion, settings: PhysicsSettings, label: int) -> float:
    """When a failure passed the first limit; the end of the lift where it passed none, or held."""
    passed = np.maximum(*_over_limits(motion, settings)) >= 1.0
    last = len(passed) - 1
    return float(motion.time_s[last if label == LABEL_SUCCESS else min(_first(passed), last)])


def _over_limits(motion: Motion, settings: PhysicsSettings) -> tuple[FloatArray, FloatArray]:
    """Slide (n,) over that which the rise allows, and turn (n,) over that of a success."""
    slide = np.linalg.norm(motion.slide_mm, axis=1) / (settings.lift_mm - settings.success_rise_mm)
    return slide, motion.turn_rad / settings.success_turn_rad


def first_slip(motion: Motion, settings: PhysicsSettings) -> tuple[float, FloatArray]:
    """Time and direction (2,) of the first slip; NaN and 0 where nothing slips.

    The direction is that in which the object slides at the pad, in the gel's x and y; where it
    only turns, that in which its centre of mass goes.
    """
    slid = np.linalg.norm(motion.slide_mm, axis=1) >= settings.slip_mm
    k = _first(slid | (motion.turn_rad >= settings.slip_turn_rad))
    if k == len(slid):
        return float("nan"), np.zeros(2)
    direction = motion.slide_mm[k] if slid[k] else motion.center_slide_mm[k]
    length = float(np.linalg.norm(direction))
    return float(motion.time_s[k]), direction / length if length > 0 else np.zeros(2)


def _first(flags: BoolArray) -> int:
    """Index of the first True, or the length where there is none."""
    return int(np.argmax(flags)) if flags.any() else len(flags)


def capacity_of(
    grasped: Sequence[Snapshot],
    bodies: Bodies,
    obj: GraspObject,
    settings: PhysicsSettings,
    torsion: Mapping[str, TorsionLimit],
    touches: Mapping[str, Sequence[Touch]],
) -> Capacity:
    """What the pads can hold, each pressing as at the moment of grasp, where it touches then.

    ``torsion`` and ``touches`` by pad.
    """
    contacts = mean_contacts(grasped)
    last = grasped[-1]
    closing_axis = gripper_pose(last)[:3, 0]
    acceleration_m_s2 = settings.lift_acceleration_mm_s2 / MM_PER_M
    weight_n = obj.mass_kg * (STANDARD_GRAVITY_M_S2 + acceleration_m_s2)
    stiffness_n_m2 = dome_stiffness_n_mm2(settings.pad_dome_radius_mm) * MM_PER_M**2
    pads = []
    for pad in bodies.pads:
        force_n = abs(float(contacts.of(pad).force_n.sum(axis=0) @ closing_axis))
        own = pressed(pad, touches[pad], closing_axis, force_n, stiffness_n_m2, weight_n / 2)
        pads.append((own, torsion[pad]))
    return grasp_capacity(
        pads,
        closing_axis=closing_axis,
        center_of_mass_m=np.array(last.object_position_m),
        weight_n=weight_n,
        friction=obj.friction * settings.pad_friction,
        success_turn_rad=settings.success_turn_rad,
    )


def motion_of(start: Snapshot, lifted: Sequence[Placement], bodies: Bodies, pad: str) -> Motion:
    """How the object moved from ``start``, the first of ``lifted``, on; slides in the gel axes of
    ``pad``.
    """
    grippers = pose(
        rotation_of(np.array([snapshot.gripper_quaternion for snapshot in lifted])),
        np.array([snapshot.gripper_position_m for snapshot in lifted]),
    )
    inertial = pose(
        rotation_of(np.array([snapshot.object_quaternion for snapshot in lifted])),
        np.array([snapshot.object_position_m for snapshot in lifted]),
    )
    in_gripper = np.linalg.inv(grippers) @ inertial @ inverse(bodies.inertial)
    left_m, right_m = start.pad_distance_m
    between_pads = np.array([(right_m - left_m) / 2, 0.0, 0.0, 1.0])
    gel_axes = gripper_pose(start)[:3, :3].T @ gel_pose(start, bodies, pad)[:3, :2]
    return Motion(
        time_s=np.array([snapshot.step for snapshot in lifted]) * bodies.time_step_s,
        rise_mm=(inertial[:, 2, 3] - inertial[0, 2, 3]) * MM_PER_M,
        turn_rad=turn_rad(in_gripper[0, :3, :3].T @ in_gripper[:, :3, :3]),
        slide_mm=_slide_mm(in_gripper, between_pads) @ gel_axes,
        center_slide_mm=_slide_mm(in_gripper, in_gripper[0] @ bodies.inertial[:, 3]) @ gel_axes,
    )


def _slide_mm(in_gripper: FloatArray, start_m: FloatArray) -> FloatArray:
    """Displacement (n, 3) in the gripper frame of the object's point that starts at ``start_m``."""
    material = np.linalg.inv(in_gripper[0]) @ start_m
    return ((in_gripper @ material)[:, :3] - start_m[:3]) * MM_PER_M


def frames_of(
    windows: Sequence[Sequence[Snapshot]],
    bodies: Bodies,
    pads: Sequence[str],
    past: Sequence[Snapshot] = (),
) -> dict[str, tuple[ContactFrame, ...]]:
    """The tactile frames of each of ``pads``, one a window, with their ``past`` if it is kept."""
    frames = [contact_frames(window, bodies, pads) for window in windows]
    if past:
        courses = load_courses(past, bodies, pads)
        frames = [{pad: with_past(one[pad], courses[pad]) for pad in pads} for one in frames]
    return {pad: tuple(frame[pad] for frame in frames) for pad in pads}


def object_poses_mm(snapshots: Sequence[Snapshot], bodies: Bodies) -> NDArray[np.float64]:
    """(n, 7) position (mm) and quaternion x, y, z, w of the object's frame in the world."""
    return _poses_mm([object_pose(snapshot, bodies) for snapshot in snapshots])


def gripper_poses_mm(snapshots: Sequence[Snapshot]) -> NDArray[np.float64]:
    """(n, 7) the same of the gripper's frame."""
    return _poses_mm([gripper_pose(snapshot) for snapshot in snapshots])


def _poses_mm(poses: Sequence[FloatArray]) -> NDArray[np.float64]:
    return frozen_array(
        [[*(p[:3, 3] * MM_PER_M), *quaternion_from_rotation(p[:3, :3])] for p in poses]
    )

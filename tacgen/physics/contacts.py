"""From contact points to the loads on a pad; pure functions of recorded snapshots.

Inside, lengths are in metres and axes are the world's; the frames that come out are in mm, N and
the gel frame.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np
from numpy.typing import NDArray

from tacgen.core.engine_contacts import ContactPoint
from tacgen.core.records import PADS, ContactFrame, frozen_array
from tacgen.core.types import MM_PER_M, FloatArray, Pose, cross, inverse, pose, rotation_of
from tacgen.physics.engine import TABLE, Touch
from tacgen.physics.gripper import Pad
from tacgen.physics.standing import NEAR_TABLE_M, PadLoad, Table, least_shear, outermost


@dataclass(frozen=True, slots=True)
class Placement:
    """Where the object and the gripper are at one step, as the engine gave it.

    ``object_position_m`` is the centre of mass, ``object_quaternion`` the principal axes.
    """

    step: int
    object_position_m: tuple[float, ...]
    object_quaternion: tuple[float, ...]
    gripper_position_m: tuple[float, ...]
    gripper_quaternion: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Snapshot(Placement):
    """All that is kept of one step: nothing is computed while the simulation runs."""

    contacts: Sequence[ContactPoint[str]]
    object_angular_velocity: tuple[float, ...]
    pad_distance_m: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Contacts:
    """Contact points on the object: (n,) what touches it, (n, 3) points, normals, forces.

    Normals point into the object; ``force_n`` is the whole force on the object.
    """

    part: NDArray[np.str_]
    point_m: FloatArray
    normal: FloatArray
    normal_force_n: FloatArray
    force_n: FloatArray

    def of(self, part: str) -> "Contacts":
        """Those of one part."""
        keep = self.part == part
        return Contacts(*(getattr(self, column.name)[keep] for column in fields(self)))


def contacts_of(points: Sequence[ContactPoint[str]]) -> Contacts:
    """The points as arrays."""
    rows = [(*p.point_m, *p.normal, p.normal_force_n, *p.force_n) for p in points]
    table = np.array(rows, dtype=np.float64).reshape(-1, 10)
    parts = np.array([point.part for point in points], dtype=np.str_)
    return Contacts(parts, table[:, :3], table[:, 3:6], table[:, 6], table[:, 7:])


def mean_contacts(window: Sequence[Snapshot]) -> Contacts:
    """The contact points of all steps of ``window``, each with its share of the mean force.

    The first of several snapshots serves only to compute accelerations.
    """
    steps = window[1:] if len(window) > 1 else window
    contacts = contacts_of([point for step in steps for point in step.contacts])
    return replace(
        contacts,
        normal_force_n=contacts.normal_force_n / len(steps),
        force_n=contacts.force_n / len(steps),
    )


def pressed(
    pad: str,
    touches: Sequence[Touch],
    closing_axis: FloatArray,
    force_n: float,
    stiffness_n_m2: float,
    carried_n: float = 0.0,
) -> Contacts:
    """The touches of ``pad`` on the object as contact points that ``force_n`` is shared between.

    Rigid bodies that touch in several points leave open how they share a force, and a solver's
    answer varies with the last micrometre. As an elastic dome that has come nearer by δ the pad
    presses with ``stiffness_n_m2`` (δ − gap)² at each, δ such that along the closing axis they
    make up ``force_n``. The normal forces are those of an object that hangs in the air, of which
    the pad carries ``carried_n``, at each touch its part.
    """
    count = len(touches)
    point_m = np.array([touch.point_m for touch in touches]).reshape(-1, 3)
    normal = np.array([touch.normal for touch in touches]).reshape(-1, 3)
    gap_m = np.array([touch.gap_m for touch in touches])
    along = np.abs(normal @ closing_axis)
    normal_force_n = np.zeros(count)
    order = np.argsort(gap_m / along)[: count if force_n > 0 else 0]
    for number in range(1, len(order) + 1):
        # The nearest touches, as many as come in before the δ at which they make up the force.
        near, farther = order[:number], order[number:]
        slope, gap = along[near], gap_m[near]
        a, b, c = (slope**3).sum(), (slope**2 * gap).sum(), (slope * gap**2).sum()
        delta_m = (b + math.sqrt(max(0.0, b * b - a * (c - force_n / stiffness_n_m2)))) / a
        if (gap_m[farther] >= delta_m * along[farther]).all():
            along_n = stiffness_n_m2 * (delta_m * slope - gap) ** 2 * slope
            hanging_n = along_n * (slope + normal[near, 2] * carried_n / force_n)
            normal_force_n[near] = np.maximum(0.0, hanging_n)
            break
    force_n_of = normal_force_n[:, None] * normal
    return Contacts(np.full(count, pad), point_m, normal, normal_force_n, force_n_of)


@dataclass(frozen=True, slots=True)
class Bodies:
    """What a snapshot's numbers belong to.

    ``pads`` are the gripper's by name; ``spinning_friction_m`` maps each to the moment about its
    normal that the engine lets it resist, for each newton; ``inertial`` is the object's inertial
    frame in its own frame. Before ``lift_step`` the object stands on the table where it touches it,
    with those of its ``vertices_m`` (n, 3) that are near it.
    """

    pads: Mapping[str, Pad]
    principal_moments_kg_m2: FloatArray
    inertial: Pose
    spinning_friction_m: Mapping[str, float]
    time_step_s: float
    pad_friction: float = 0.0
    table_friction: float = 0.0
    lift_step: int = 0
    vertices_m: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))


def gripper_pose(snapshot: Placement) -> Pose:
    """The gripper frame in the world."""
    return pose(rotation_of(snapshot.gripper_quaternion), snapshot.gripper_position_m)


def object_pose(snapshot: Placement, bodies: Bodies) -> Pose:
    """The object's own frame in the world."""
    inertial = pose(rotation_of(snapshot.object_quaternion), snapshot.object_position_m)
    return inertial @ inverse(bodies.inertial)


def gel_pose(snapshot: Snapshot, bodies: Bodies, name: str) -> Pose:
    """The gel frame of the pad ``name`` in the world."""
    pad, distance_m = bodies.pads[name], snapshot.pad_distance_m[PADS.index(name)]
    in_gripper = pose(pad.gel_axes, [pad.side * distance_m, 0.0, 0.0])
    return gripper_pose(snapshot) @ in_gripper


def contact_frames(
    window: Sequence[Snapshot], bodies: Bodies, pads: Sequence[str]
) -> dict[str, ContactFrame]:
    """The load on each of ``pads`` at the end of ``window``, forces averaged over its steps."""
    last = window[-1]
    loads = _pad_loads(window, bodies)
    closing_axis = gripper_pose(last)[:3, 0]
    object_in_world = object_pose(last, bodies)
    frames = {}
    for pad in pads:
        gel = gel_pose(last, bodies, pad)
        on_gel, center_mm, torsion_n_m = np.zeros(3), np.zeros(2), 0.0
        if load := loads.get(pad):
            on_gel = -load.force_n @ gel[:3, :3]
            center_mm = ((load.center_m - gel[:3, 3]) @ gel[:3, :2]) * MM_PER_M
            torsion_n_m = -load.moment_n_m * float(gel[:3, 2] @ closing_axis)
        gel_from_object = inverse(gel) @ object_in_world
        gel_from_object[:3, 3] *= MM_PER_M
        frames[pad] = ContactFrame(
            time_s=last.step * bodies.time_step_s,
            force_normal_n=0.0 - float(on_gel[2]),
            force_shear_n=frozen_array(on_gel[:2]),
            torsion_n_mm=torsion_n_m * MM_PER_M,
            pose_gel_object=frozen_array(gel_from_object),
            center_mm=frozen_array(center_mm),
        )
    return frames


def load_courses(
    snapshots: Sequence[Snapshot], bodies: Bodies, pads: Sequence[str]
) -> dict[str, FloatArray]:
    """The load on each of ``pads`` (n, 4) at every snapshot, as of ``ContactFrame.past``."""
    courses: dict[str, FloatArray] = {pad: np.zeros((len(snapshots), 4)) for pad in pads}
    for k, snapshot in enumerate(snapshots):
        loads = _pad_loads([snapshot], bodies)
        for pad, course in courses.items():
            force_n = loads[pad].force_n if pad in loads else np.zeros(3)
            x, y, z = -force_n @ gel_pose(snapshot, bodies, pad)[:3, :3]
            course[k] = snapshot.step * bodies.time_step_s, -z, x, y
    return courses


def _pad_loads(window: Sequence[Snapshot], bodies: Bodies) -> dict[str, PadLoad]:
    """What the pads that press do to the object, on the mean of ``window``.

    While it stands on the table they do no more than it takes: see ``standing``. What was before
    the lift is not in the mean of a window of the lift.
    """
    last = window[-1]
    if last.step >= bodies.lift_step:
        window = [one for one in window if one.step >= bodies.lift_step - 1]
    contacts = mean_contacts(window)
    closing_axis = gripper_pose(last)[:3, 0]
    spins, loads = _spinning_moments_n_m(window, contacts, bodies), {}
    for pad in bodies.pads:
        own = contacts.of(pad)
        normal_n = float(own.normal_force_n.sum())
        if normal_n > 0:
            center_m = own.normal_force_n @ own.point_m / normal_n
            moment = cross(own.point_m - center_m, own.force_n).sum(axis=0)
            loads[pad] = PadLoad(
                center_m=center_m,
                normal=own.normal_force_n @ own.normal / normal_n,
                force_n=own.force_n.sum(axis=0),
                moment_n_m=float(moment @ closing_axis) + spins[pad],
            )
    touched = [point.point_m for point in last.contacts if point.part == TABLE]
    if loads and touched and last.step < bodies.lift_step:
        pushes, frame = contacts.of(TABLE), object_pose(last, bodies)
        # An engine need not name all the corners on which an object stands.
        places_m = bodies.vertices_m @ frame[:3, :3].T + frame[:3, 3]
        near = places_m[:, 2] < min(z for _, _, z in touched) + NEAR_TABLE_M
        corners_m = outermost(np.concatenate([touched, places_m[near]]), closing_axis)
        table = Table(bodies.table_friction, corners_m, pushes.point_m, pushes.force_n)
        shared = least_shear(list(loads.values()), closing_axis, bodies.pad_friction, table)
        loads = dict(zip(loads, shared, strict=True))
    return loads


def with_past(frame: ContactFrame, course: FloatArray) -> ContactFrame:
    """The frame with the part of its pad's course that was before it."""
    return replace(frame, past=frozen_array(course[course[:, 0] < frame.time_s]))


def _spinning_moments_n_m(
    window: Sequence[Snapshot], contacts: Contacts, bodies: Bodies
) -> dict[str, float]:
    """The moment about the gripper's x by which each pad's spinning friction acts on the object.

    PyBullet applies it but does not report it. It is what the object's balance of angular
    momentum lacks once all reported contact forces are counted, shared between the pads as
    their normal forces are and never more than each can give.
    """
    last = window[-1]
    axis = gripper_pose(last)[:3, 0]
    center = np.array(last.object_position_m)
    pushes_n = contacts.normal_force_n
    normals = {pad: float(pushes_n[contacts.part == pad].sum()) for pad in bodies.pads}
    total = sum(normals.values())
    if total <= 0:
        return dict.fromkeys(normals, 0.0)
    reported = cross(contacts.point_m - center, contacts.force_n).sum(axis=0)
    rotation = rotation_of(last.object_quaternion)
    inertia = rotation @ np.diag(bodies.principal_moments_kg_m2) @ rotation.T
    omega = np.array(last.object_angular_velocity)
    needed = cross(omega, inertia @ omega)
    if len(window) > 1:
        span_s = (last.step - window[0].step) * bodies.time_step_s
        needed += inertia @ (omega - np.array(window[0].object_angular_velocity)) / span_s
    missing = float(axis @ (needed - reported))
    spins = {}
    for pad, normal in normals.items():
        limit = bodies.spinning_friction_m[pad] * normal
        spins[pad] = float(np.clip(missing * normal / total, -limit, limit))
    return spins

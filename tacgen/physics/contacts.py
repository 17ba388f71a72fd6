"""From PyBullet's contact points to the loads on a pad; pure functions of recorded snapshots.

Inside, lengths are in metres and axes are the world's; the frames that come out are in mm, N and
the gel frame.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from tacgen.core.arrays import FloatArray, IntArray
from tacgen.core.records import ContactFrame
from tacgen.core.units import MM_PER_M
from tacgen.physics.frames import GEL_AXES_IN_GRIPPER, PAD_SIDE, Pose, inverse, pose, rotation_of


@dataclass(frozen=True, slots=True)
class Placement:
    """Where the object and the gripper are at one step, as PyBullet gave it.

    ``object_position_m`` is the centre of mass, ``object_quaternion`` the principal axes.
    """

    step: int
    object_position_m: tuple[float, ...]
    object_quaternion: tuple[float, ...]
    gripper_position_m: tuple[float, ...]
    gripper_quaternion: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Snapshot(Placement):
    """All that is kept of one step: nothing is computed while the simulation runs.

    ``contacts`` are the tuples of ``getContactPoints``.
    """

    contacts: tuple[tuple[Any, ...], ...]
    object_angular_velocity: tuple[float, ...]
    pad_distance_m: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Contacts:
    """Contact points on the object: (n,) other body and link, (n, 3) points, normals, forces.

    Normals point into the object; ``force_n`` is the whole force on the object.
    """

    body: IntArray
    link: IntArray
    point_m: FloatArray
    normal: FloatArray
    normal_force_n: FloatArray
    force_n: FloatArray

    def of(self, body: int, link: int) -> "Contacts":
        """Those with one link of another body."""
        keep = (self.body == body) & (self.link == link)
        return Contacts(*(getattr(self, column.name)[keep] for column in fields(self)))


def object_contacts(raw: Sequence[tuple[Any, ...]], object_body: int) -> Contacts:
    """Contact points of ``object_body``, from unfiltered ``getContactPoints``.

    Unfiltered matters: with a filter PyBullet may swap the two bodies and turn the normal, but
    not the friction, whose sign is then lost. As it comes, both act on the first body.
    """
    rows, others = [], []
    for contact in raw:
        if contact[1] == object_body:
            sign, other = 1.0, (contact[2], contact[4])
        elif contact[2] == object_body:
            sign, other = -1.0, (contact[1], contact[3])
        else:
            continue
        others.append(other)
        point = contact[5] if sign > 0 else contact[6]
        rows.append(
            (*point, *contact[7], *contact[9:11], *contact[11], contact[12], *contact[13], sign)
        )
    table = np.array(rows, dtype=np.float64).reshape(-1, 16)
    other_ids = np.array(others, dtype=np.int64).reshape(-1, 2)
    sign_column = table[:, 15:]
    normal = sign_column * table[:, 3:6]
    friction = sign_column * (table[:, 7:8] * table[:, 8:11] + table[:, 11:12] * table[:, 12:15])
    return Contacts(
        body=other_ids[:, 0],
        link=other_ids[:, 1],
        point_m=table[:, :3],
        normal=normal,
        normal_force_n=table[:, 6],
        force_n=table[:, 6:7] * normal + friction,
    )


def mean_contacts(window: Sequence[Snapshot], object_body: int) -> Contacts:
    """The contact points of all steps of ``window``, each with its share of the mean force.

    The first of several snapshots serves only to compute accelerations.
    """
    steps = window[1:] if len(window) > 1 else window
    contacts = object_contacts([c for step in steps for c in step.contacts], object_body)
    return replace(
        contacts,
        normal_force_n=contacts.normal_force_n / len(steps),
        force_n=contacts.force_n / len(steps),
    )


def pressed(
    touches: Sequence[tuple[Any, ...]],
    closing_axis: FloatArray,
    force_n: float,
    stiffness_n_m2: float,
    carried_n: float = 0.0,
) -> Contacts:
    """The touches of a pad on the object as contact points that ``force_n`` is shared between.

    Rigid bodies that touch in several points leave open how they share a force, and a solver's
    answer varies with the last micrometre. As an elastic dome that has come nearer by δ the pad
    presses with ``stiffness_n_m2`` (δ − gap)² at each, δ such that along the closing axis they
    make up ``force_n``. The normal forces are those of an object that hangs in the air, of which
    the pad carries ``carried_n``, at each touch its part.
    """
    count = len(touches)
    point_m = np.array([touch[6] for touch in touches]).reshape(-1, 3)
    normal = -np.array([touch[7] for touch in touches]).reshape(-1, 3)
    gap_m = np.array([touch[8] for touch in touches])
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
    none = np.zeros(count, dtype=np.int64)
    force = normal_force_n[:, None] * normal
    return Contacts(none, none, point_m, normal, normal_force_n, force)


@dataclass(frozen=True, slots=True)
class Bodies:
    """What a snapshot's numbers belong to.

    ``spinning_friction_m`` maps each pad to the moment about its normal that Bullet lets it
    resist, for each newton; ``inertial`` is the object's inertial frame in its own frame.
    """

    object_body: int
    robot_body: int
    pad_links: Mapping[str, int]
    principal_moments_kg_m2: FloatArray
    inertial: Pose
    spinning_friction_m: Mapping[str, float]
    time_step_s: float


def gripper_pose(snapshot: Placement) -> Pose:
    """The gripper frame in the world."""
    return pose(rotation_of(snapshot.gripper_quaternion), snapshot.gripper_position_m)


def object_pose(snapshot: Placement, bodies: Bodies) -> Pose:
    """The object's own frame in the world."""
    inertial = pose(rotation_of(snapshot.object_quaternion), snapshot.object_position_m)
    return inertial @ inverse(bodies.inertial)


def gel_pose(snapshot: Snapshot, pad: str) -> Pose:
    """The gel frame of ``pad`` in the world."""
    distance_m = snapshot.pad_distance_m[0 if pad == "left" else 1]
    in_gripper = pose(GEL_AXES_IN_GRIPPER[pad], [PAD_SIDE[pad] * distance_m, 0.0, 0.0])
    return gripper_pose(snapshot) @ in_gripper


def contact_frames(
    window: Sequence[Snapshot], bodies: Bodies, pads: Sequence[str]
) -> dict[str, ContactFrame]:
    """The load on each of ``pads`` at the end of ``window``, forces averaged over its steps."""
    last = window[-1]
    contacts = mean_contacts(window, bodies.object_body)
    spins = _spinning_moments_n_m(window, contacts, bodies)
    object_in_world = object_pose(last, bodies)
    frames = {}
    for pad in pads:
        gel = gel_pose(last, pad)
        own = contacts.of(bodies.robot_body, bodies.pad_links[pad])
        on_gel = -own.force_n @ gel[:3, :3]
        at = (own.point_m - gel[:3, 3]) @ gel[:3, :3]
        force = on_gel.sum(axis=0)
        moment = float(np.sum(at[:, 0] * on_gel[:, 1] - at[:, 1] * on_gel[:, 0]))
        # The spinning moment is about the gripper's x, along which both gels' z lie.
        moment -= spins[pad] * float(gel[:3, 2] @ gripper_pose(last)[:3, 0])
        gel_from_object = inverse(gel) @ object_in_world
        gel_from_object[:3, 3] *= MM_PER_M
        for array in (force, gel_from_object):
            array.setflags(write=False)
        frames[pad] = ContactFrame(
            time_s=last.step * bodies.time_step_s,
            force_normal_n=0.0 - float(force[2]),
            force_shear_n=force[:2],
            torsion_n_mm=moment * MM_PER_M,
            pose_gel_object=gel_from_object,
        )
    return frames


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
    normals = {
        pad: float(contacts.of(bodies.robot_body, link).normal_force_n.sum())
        for pad, link in bodies.pad_links.items()
    }
    total = sum(normals.values())
    if total <= 0:
        return dict.fromkeys(normals, 0.0)
    reported = np.cross(contacts.point_m - center, contacts.force_n).sum(axis=0)
    rotation = rotation_of(last.object_quaternion)
    inertia = rotation @ np.diag(bodies.principal_moments_kg_m2) @ rotation.T
    omega = np.array(last.object_angular_velocity)
    needed = np.cross(omega, inertia @ omega)
    if len(window) > 1:
        span_s = (last.step - window[0].step) * bodies.time_step_s
        needed += inertia @ (omega - np.array(window[0].object_angular_velocity)) / span_s
    missing = float(axis @ (needed - reported))
    spins = {}
    for pad, normal in normals.items():
        limit = bodies.spinning_friction_m[pad] * normal
        spins[pad] = float(np.clip(missing * normal / total, -limit, limit))
    return spins

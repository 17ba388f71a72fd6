"""The MJCF model of one grasp: table, object and floating gripper. Lengths are in metres."""

import operator
from collections.abc import Iterable, Sequence
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np

from tacgen.core.arrays import FloatArray
from tacgen.core.records import GraspObject, Mesh
from tacgen.core.units import M_PER_MM, STANDARD_GRAVITY_M_S2
from tacgen.physics.frames import PAD_SIDE, Pose, quaternion_from_rotation
from tacgen.physics.gripper import (
    FINGER_LENGTH_MM,
    FINGER_MASS_KG,
    HAND_MASS_KG,
    PALM_HALF_EXTENTS_MM,
    STEM_CENTER_MM,
    STEM_HALF_EXTENTS_MM,
    STROKE_MM,
    pad_vertices_m,
    touches_as_sphere,
)
from tacgen.physics.settings import PAD_NAMES, PhysicsSettings
from tacgen.physics.world import HULL_MARGIN_MM, Collides, ball_of

DRIVEN_MASS_KG = 1e6
"""Added to axes whose speed is set at every step: 100 N then bend it by 0.2 µm/s in a step."""
FINGER_INERTIA_KG_M2 = 1e-3  # about axes on which nothing turns; MuJoCo wants one
SOFTNESS = {"solref": "0.005 1", "solimp": "0.99 0.999 0.0001 0.5 2"}
"""Of the table and the fingers' motors: two time steps, and 0.01 mm under a few kilograms."""
OPTIONS = {
    "cone": "elliptic",  # the ellipsoidal limit surface of a patch: its friction and its moment
    "impratio": "100",  # friction is that much stiffer than the normal: 0.03 mm/s of creep …
    "noslip_iterations": "5",  # … and 0.1 µm/s after five of these
    "integrator": "implicitfast",
    "iterations": "100",  # of Newton's method, which needs some ten
    "tolerance": "1e-12",  # relative; far below a pad's force of 1 N
}


def scene_xml(
    obj: GraspObject,
    settings: PhysicsSettings,
    inertial: Pose,
    moments_kg_m2: FloatArray,
    met: Sequence[Mesh],
) -> str:
    """The model of ``obj`` with its inertial frame and principal moments, before the approach.

    The pads can touch ``met`` alone; on the way to the grasp the whole parts count.

    The joints are, in this order: the object's free one, the hand's height, and a motor and a
    finger for each pad. The motor moves at the commanded speed whatever acts on it and carries the
    finger by a dry friction of the commanded force: the finger follows, and presses with it.
    """
    root = Element("mujoco")
    step = f"{settings.time_step_s:.17g}"
    gravity = _text((0, 0, -STANDARD_GRAVITY_M_S2))
    option = _add(root, "option", timestep=step, gravity=gravity, **OPTIONS)
    # A single touch for each pair: the dome's. An unstable state is reported, not reset.
    _add(option, "flag", multiccd="disable", autoreset="disable")
    scene, assets = _add(root, "worldbody"), _add(root, "asset")
    table = {"contype": str(int(Collides.TABLE)), "conaffinity": "0", "priority": "1", **SOFTNESS}
    friction = _text((settings.table_friction, 0, 0))
    _add(scene, "geom", type="plane", size="0 0 1", friction=friction, **table)
    body = _add(scene, "body", name="object")
    _add(body, "freejoint")
    _inertial(body, obj.mass_kg, moments_kg_m2, inertial)
    _add_object(assets, body, obj.collision, met)
    hand = _add(scene, "body", name="hand")
    _slide(hand, "height", (0, 0, 1), armature=repr(DRIVEN_MASS_KG))
    _inertial(hand, HAND_MASS_KG, np.full(3, FINGER_INERTIA_KG_M2))
    palm_height_mm = FINGER_LENGTH_MM + PALM_HALF_EXTENTS_MM[2]
    _add_box(hand, "palm", PALM_HALF_EXTENTS_MM, (0, 0, palm_height_mm))
    for pad in PAD_NAMES:
        side = PAD_SIDE[pad]
        position_m = (side * STROKE_MM / 2 * M_PER_MM, 0, 0)
        finger = _add(hand, "body", name=pad, pos=_text(position_m))
        _slide(finger, f"{pad}_motor", (-side, 0, 0), armature=repr(DRIVEN_MASS_KG))
        limit = {f"{key}friction": value for key, value in SOFTNESS.items()}
        _slide(finger, pad, (-side, 0, 0), frictionloss="1", **limit)
        _inertial(finger, FINGER_MASS_KG, np.full(3, FINGER_INERTIA_KG_M2))
        vertices_m = np.array(pad_vertices_m(side, settings.pad_dome_radius_mm))
        _mesh(assets, pad, vertices_m)
        # The pad's surface lies inside it by the margin in which it touches.
        surface = {"condim": "4", "friction": _text((obj.friction * settings.pad_friction, 0, 0))}
        margin_m = HULL_MARGIN_MM * M_PER_MM
        outline = {"type": "mesh", "mesh": pad, "margin": repr(margin_m)}
        shape = outline
        if touches_as_sphere(settings):
            radius_m = settings.pad_dome_radius_mm * M_PER_MM
            place = {"pos": _text((side * radius_m, 0, 0)), "size": repr(radius_m - margin_m)}
            shape = {"type": "sphere", "margin": repr(margin_m), **place}
        _gripper_geom(finger, name=pad, **shape, **surface)
        _add(finger, "geom", name=f"{pad}_outline", contype="0", conaffinity="0", **outline)
        x_mm, y_mm, z_mm = STEM_CENTER_MM
        _add_box(finger, f"{pad}_stem", STEM_HALF_EXTENTS_MM, (side * x_mm, y_mm, z_mm))
    equality = _add(root, "equality")
    left, right = PAD_NAMES
    _add(equality, "joint", joint1=left, joint2=right, active="false", **SOFTNESS)
    return tostring(root, encoding="unicode")


def _add_object(assets: Element, body: Element, parts: Sequence[Mesh], met: Sequence[Mesh]) -> None:
    """Several parts meet the table as one hull, as in PyBullet."""
    whole = len(met) == len(parts) and all(map(operator.is_, met, parts))
    alone = len(parts) == 1 and whole
    for number, part in enumerate(parts):
        group = Collides.GRIPPER if whole else Collides.NOTHING
        group |= Collides.TABLE if alone else Collides.NOTHING
        affinity = {"contype": "0", "conaffinity": str(int(group))}
        if alone and (ball := ball_of(part)):
            center, size = _text(ball[0] * M_PER_MM), repr(ball[1] * M_PER_MM)
            _add(body, "geom", type="sphere", pos=center, size=size, **affinity)
            return
        _mesh(assets, f"part{number}", part.vertices_mm * M_PER_MM)
        _add(body, "geom", type="mesh", mesh=f"part{number}", **affinity)
    if not alone:
        _mesh(assets, "hull", np.concatenate([part.vertices_mm for part in parts]) * M_PER_MM)
        group = Collides.TABLE
        _add(body, "geom", type="mesh", mesh="hull", contype="0", conaffinity=str(int(group)))
    for number, part in enumerate(() if whole else met):
        _mesh(assets, f"met{number}", part.vertices_mm * M_PER_MM)
        group = Collides.GRIPPER
        affinity = {"contype": "0", "conaffinity": str(int(group))}
        _add(body, "geom", type="mesh", mesh=f"met{number}", **affinity)


def _mesh(assets: Element, name: str, vertices_m: FloatArray) -> None:
    """A mesh that collides as the convex hull of its vertices."""
    vertex = _text(vertices_m.ravel())
    _add(assets, "mesh", name=name, vertex=vertex, inertia="convex")


def _add_box(
    body: Element, name: str, half_extents_mm: Iterable[float], center_mm: Iterable[float]
) -> None:
    """A part of the gripper without friction."""
    size, position = (
        _text(M_PER_MM * mm for mm in given) for given in (half_extents_mm, center_mm)
    )
    _gripper_geom(body, name=name, type="box", size=size, pos=position, friction="0 0 0")


def _gripper_geom(body: Element, **attributes: str) -> None:
    """The gripper's surfaces state the friction with an object, and touch nothing else."""
    group = {"contype": str(int(Collides.GRIPPER)), "conaffinity": "0", "priority": "1"}
    _add(body, "geom", **SOFTNESS, **group, **attributes)


def _slide(body: Element, name: str, axis: Iterable[float], **attributes: str) -> None:
    _add(body, "joint", name=name, type="slide", axis=_text(axis), **attributes)


def _inertial(
    body: Element, mass_kg: float, moments_kg_m2: FloatArray, frame: Pose | None = None
) -> None:
    frame = np.eye(4) if frame is None else frame
    x, y, z, w = quaternion_from_rotation(frame[:3, :3])
    place = {"pos": _text(frame[:3, 3]), "quat": _text((w, x, y, z))}
    _add(body, "inertial", mass=repr(mass_kg), diaginertia=_text(moments_kg_m2), **place)


def _add(parent: Element, tag: str, **attributes: str) -> Element:
    return SubElement(parent, tag, attributes)


def _text(numbers: Iterable[float]) -> str:
    return " ".join(f"{number:.12g}" for number in numbers)

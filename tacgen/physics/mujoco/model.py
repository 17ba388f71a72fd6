"""The MuJoCo model of one grasp: table, object and robot. Lengths are in metres."""

import operator
from collections.abc import Sequence
from typing import Any

import numpy as np

from tacgen.core.records import PADS, GraspObject, Mesh
from tacgen.core.types import (
    M_PER_MM,
    STANDARD_GRAVITY_M_S2,
    FloatArray,
    Pose,
    quaternion_from_rotation,
)
from tacgen.physics.engine import PALM, TABLE, Link, Vector
from tacgen.physics.gripper import PAD_MARGIN_MM, GripperSpec, outline_of, touches_as_sphere
from tacgen.physics.robots import RobotSpec
from tacgen.physics.settings import PhysicsSettings
from tacgen.physics.world import Collides, ball_of

OBJECT, BASE, HAND = "object", "base", "hand"
"""Names of bodies; the object's is that of its free joint too."""
DRIVEN_MASS = 1e6
"""Added (kg or kg m²) to axes whose speed is set at every step: 100 N then change it by 0.2 µm/s in
a step."""
FINGER_INERTIA_KG_M2 = 1e-3  # a finger turns with the hand alone; MuJoCo wants one
SOFTNESS = {"solref": [0.005, 1.0], "solimp": [0.99, 0.999, 0.0001, 0.5, 2.0]}
"""The fingers' boxes, motors and coupling: two time steps, and 0.01 mm under a few kilograms."""
IMPEDANCE_RATIO = 1e3  # friction is that much stiffer than the normal …
NOSLIP_ITERATIONS = 5  # … and after five of these a held object creeps by less than 1 µm/s
ITERATIONS = 100  # of Newton's method, which needs some ten
TOLERANCE = 1e-12  # relative; far below a pad's force of 1 N


def carrying_joint(number: int) -> str:
    """Name of the joint of a link that carries the hand."""
    return f"carrying {number}"


def motor_of(pad: str) -> str:
    """Name of the joint of the motor that drives the finger of ``pad``."""
    return f"{pad} motor"


def pair_of(touched: str, part: str) -> str:
    """Name of the pair of a pad or the table and a part of the object."""
    return f"{touched} and {part}"


class Scene:
    """Builds the model of one grasp.

    A finger hangs by a dry friction of the commanded force, its joint's, on a motor that moves at
    the commanded speed whatever acts on it: the finger follows, and presses with that force.
    """

    def __init__(self, mujoco: Any, settings: PhysicsSettings) -> None:
        self._mujoco, self._settings = mujoco, settings
        self.parts: list[str] = []  # names of the object's geoms
        self.met: list[str] = []  # of those that the gripper can touch
        self._spec = mujoco.MjSpec()
        option, disabled = self._spec.option, mujoco.mjtDisableBit
        option.timestep = settings.time_step_s
        option.gravity = [0.0, 0.0, -STANDARD_GRAVITY_M_S2]
        # The ellipsoidal limit surface of a patch: its friction and its moment.
        option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        option.impratio, option.noslip_iterations = IMPEDANCE_RATIO, NOSLIP_ITERATIONS
        option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        option.iterations, option.tolerance = ITERATIONS, TOLERANCE
        # A single touch for each pair: the dome's. An unstable state is reported, not reset.
        option.disableflags = int(disabled.mjDSBL_MULTICCD | disabled.mjDSBL_AUTORESET)
        self._spec.worldbody.add_geom(
            name=TABLE, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 1.0],
            contype=0, conaffinity=0,
        )  # fmt: skip

    def compiled(self) -> Any:
        """The model of all that was added."""
        return self._spec.compile()

    def add_object(
        self,
        obj: GraspObject,
        inertial: Pose,
        moments_kg_m2: FloatArray,
        met: Sequence[Mesh] | None = None,
    ) -> None:
        """The object in its rest pose; several parts meet the table as one hull, as in PyBullet.

        The gripper can touch ``met`` alone, if it is given; on the way to the grasp the whole
        parts count.
        """
        body = self._spec.worldbody.add_body(name=OBJECT)
        body.add_freejoint(name=OBJECT)
        _set_inertia(body, obj.mass_kg, moments_kg_m2, inertial)
        parts, alone = obj.collision, len(obj.collision) == 1
        met = parts if met is None else met
        whole = len(met) == len(parts) and all(map(operator.is_, met, parts))
        touch = {"contype": 0, "conaffinity": int(Collides.GRIPPER)}
        self.parts = self.met = [f"part {number}" for number in range(len(parts))]
        if not whole:
            self.met = [f"met {number}" for number in range(len(met))]
            for name, part in zip(self.met, met, strict=True):
                self._add_hull(body, name, part.vertices_mm * M_PER_MM, **touch)
            touch["conaffinity"] = int(Collides.NOTHING)
        for name, part in zip(self.parts, parts, strict=True):
            if alone and (ball := ball_of(part)):
                sphere, size = self._mujoco.mjtGeom.mjGEOM_SPHERE, [ball[1] * M_PER_MM, 0.0, 0.0]
                body.add_geom(name=name, type=sphere, pos=ball[0] * M_PER_MM, size=size, **touch)
            else:
                self._add_hull(body, name, part.vertices_mm * M_PER_MM, **touch)
        standing = self.parts[0]
        if not alone:
            standing = "hull"
            vertices_m = np.concatenate([part.vertices_mm for part in parts]) * M_PER_MM
            self._add_hull(body, standing, vertices_m, contype=0, conaffinity=0)
        self._add_pair(TABLE, standing, self._settings.table_friction, condim=3)

    def add_robot(self, robot: RobotSpec, friction: float) -> None:
        """The links that carry the hand, and the gripper with ``friction`` of its pads."""
        body, gripper = self._spec.worldbody.add_body(name=BASE), robot.gripper
        for number, link in enumerate(robot.links()):
            body = self._add_link(body, number, link)
        body.name = HAND
        self._add_box(body, PALM, *gripper.hand.box.half_and_center_mm)
        for pad in PADS:
            self._add_finger(body, gripper, pad, friction)
        left, right = PADS
        self._spec.add_equality(
            type=self._mujoco.mjtEq.mjEQ_JOINT, name1=left, name2=right, active=False, **SOFTNESS
        )

    def _add_link(self, before: Any, number: int, link: Link) -> Any:
        place = {"pos": link.frame[:3, 3], "quat": _quaternion(link.frame)}
        body = before.add_body(name=f"link {number}", **place)
        center = np.eye(4)
        center[:3, 3] = link.center_of_mass_m
        _set_inertia(body, link.mass_kg, link.moments_kg_m2, center)
        if link.joint != "fixed":
            kinds = self._mujoco.mjtJoint
            kind = kinds.mjJNT_SLIDE if link.joint == "slide" else kinds.mjJNT_HINGE
            name = carrying_joint(number)
            body.add_joint(name=name, type=kind, axis=[0, 0, 1], armature=DRIVEN_MASS)
        return body

    def _add_finger(self, hand: Any, gripper: GripperSpec, pad: str, friction: float) -> None:
        side, slide = gripper.side(pad).side, self._mujoco.mjtJoint.mjJNT_SLIDE
        finger = hand.add_body(name=pad, pos=[side * gripper.stroke_mm / 2 * M_PER_MM, 0.0, 0.0])
        _set_inertia(finger, gripper.finger.mass_kg, [FINGER_INERTIA_KG_M2] * 3, np.eye(4))
        inwards = [-side, 0.0, 0.0]
        finger.add_joint(name=motor_of(pad), type=slide, axis=inwards, armature=DRIVEN_MASS)
        limit = {f"{key}_friction": value for key, value in SOFTNESS.items()}
        finger.add_joint(name=pad, type=slide, axis=inwards, frictionloss=1.0, **limit)
        radius_mm, margin = self._settings.pad_dome_radius_mm, PAD_MARGIN_MM * M_PER_MM
        vertices_m = np.array(gripper.pad_vertices_m(pad, radius_mm))
        # Geoms lie inside the pad's surface by the margin in which it touches.
        alone = {"margin": margin, "contype": 0, "conaffinity": 0}
        self._add_hull(finger, outline_of(pad), vertices_m, **alone)
        if touches_as_sphere(radius_mm):
            finger.add_geom(
                name=pad, type=self._mujoco.mjtGeom.mjGEOM_SPHERE, **alone,
                pos=[side * radius_mm * M_PER_MM, 0.0, 0.0],
                size=[radius_mm * M_PER_MM - margin, 0.0, 0.0],
            )  # fmt: skip
        else:
            self._add_hull(finger, pad, vertices_m, **alone)
        for part in self.met:
            self._add_pair(pad, part, friction, condim=4, margin=margin)
        for number, (half_mm, center_mm) in enumerate(gripper.finger_boxes_mm(pad)):
            self._add_box(finger, f"{pad} finger {number}", half_mm, center_mm)

    def _add_pair(self, touched: str, part: str, friction: float, **attributes: Any) -> None:
        """Add a pair of geoms: MuJoCo takes a damping of friction from pairs alone."""
        self._spec.add_pair(
            name=pair_of(touched, part), geomname1=touched, geomname2=part,
            friction=[friction, friction, 0.0, 0.0, 0.0], **attributes,
        )  # fmt: skip

    def _add_hull(self, body: Any, name: str, vertices_m: FloatArray, **attributes: Any) -> None:
        """A mesh that collides as the convex hull of its vertices."""
        convex = self._mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
        self._spec.add_mesh(name=name, uservert=vertices_m.ravel().tolist(), inertia=convex)
        mesh = self._mujoco.mjtGeom.mjGEOM_MESH
        body.add_geom(name=name, type=mesh, meshname=name, **attributes)

    def _add_box(self, body: Any, name: str, half_mm: FloatArray, center_mm: FloatArray) -> None:
        """A part of the gripper without friction."""
        size, position = half_mm * M_PER_MM, center_mm * M_PER_MM
        box, friction = self._mujoco.mjtGeom.mjGEOM_BOX, [0.0, 0.0, 0.0]
        body.add_geom(name=name, type=box, size=size, pos=position, friction=friction, **_GRIPPER)


_GRIPPER: dict[str, Any] = {
    "contype": int(Collides.GRIPPER), "conaffinity": 0, "priority": 1, **SOFTNESS,
}  # fmt: skip
"""The gripper's surfaces state the friction with an object, and touch nothing else."""


def _set_inertia(
    body: Any, mass_kg: float, moments_kg_m2: Sequence[float] | FloatArray | Vector, frame: Pose
) -> None:
    body.explicitinertial, body.mass, body.inertia = True, mass_kg, moments_kg_m2
    body.ipos, body.iquat = frame[:3, 3], _quaternion(frame)


def _quaternion(frame: Pose) -> FloatArray:
    """MuJoCo's order: w, x, y, z."""
    return np.roll(quaternion_from_rotation(frame[:3, :3]), 1)

"""One grasp, from placing the gripper to the label."""

import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np

from tacgen.core.errors import PhysicsError
from tacgen.core.records import (
    LABEL_NOT_EXECUTED,
    LABEL_SUCCESS,
    PADS,
    ContactFrame,
    ContactPatch,
    GraspConfig,
    GraspObject,
    GraspTrace,
    Status,
    frozen_array,
)
from tacgen.core.types import M_PER_MM, MM_PER_M, PUBLISHED_K_N_MM3_PER_N, FloatArray
from tacgen.physics import outcome
from tacgen.physics.approach import approach, grasp_target
from tacgen.physics.contacts import (
    Bodies,
    Placement,
    Snapshot,
    contacts_of,
    mean_contacts,
)
from tacgen.physics.engine import TABLE, Engine
from tacgen.physics.gripper import touches_as_sphere
from tacgen.physics.margins import (
    Capacity,
    TorsionLimit,
    dome_patch,
    slip_margin,
    torsion_factor,
    torsion_limit,
)
from tacgen.physics.reach import within_reach
from tacgen.physics.recorder import Recorder, frame_end_steps, frame_of_moment
from tacgen.physics.rest import topples_deg
from tacgen.physics.robots import RobotSpec, load_robot
from tacgen.physics.settings import (
    EngineChoice,
    EngineName,
    FrameRequest,
    PhysicsSettings,
    engine_of,
    force_problem,
)

CHUNK_STEPS = 5  # between checks of the closing fingers: 10 ms
PAST_STEPS = 5  # between samples of a load's past: 10 ms
GEL_STEP_S = 0.1
"""Between the loads by which a gel's shear is advanced from the moment of grasp on. Counted anew at
the start of the lift, whose first step jerks the pads: it is no load that a gel keeps."""
STEADY_CHUNKS = 5  # checks in a row, 52 ms, for which a steady force keeps to the delivered one
CREEP_TIMES = 5.0  # time constants of soft pads after which 0.7 % of their creep is left
FORCE_TOLERANCE = 0.02  # of the delivered force, by which a pad may be off at the moment of grasp
STEADY_TOLERANCE = 0.01  # the same while the fingers close
OBSERVATIONS = 20  # of the moment of grasp: 0.2 s, after which a force that is lost stays lost
TOUCH_REACH_M = 0.001  # by which no pad indents: ``margins.STIFFER_THAN_GEL``

PatchOf = Callable[[ContactFrame], ContactPatch]
"""The patch in which a gel presses on the object at a pad's pose and normal force."""


@dataclass(frozen=True, slots=True)
class GelModel:
    """What a grasp has to know of the pads' gels.

    The moment that a pad holds about its normal follows from the patch that ``patch_of`` finds at
    the moment of grasp; without it from that of a flat face on the pad's dome and a gel of the
    published k_n. An object's own ``spinning_friction_mm`` replaces either. With ``keeps_past``
    each frame has the load before it, for a gel that remembers it.
    """

    patch_of: PatchOf | None = None
    keeps_past: bool = False


FLAT_FACE = GelModel()


def _pybullet(robot: RobotSpec) -> Engine:
    from tacgen.physics import bullet  # an engine that is not used need not be installed

    return bullet.BulletEngine(robot)


def _mujoco(robot: RobotSpec) -> Engine:
    from tacgen.physics import mujoco  # as above

    return mujoco.MujocoEngine(robot)


_ENGINES: dict[EngineName, Callable[[RobotSpec], Engine]] = {
    "pybullet": _pybullet,
    "mujoco": _mujoco,
}


class GraspSimulator:
    """A physics engine and a kind of robot; use it as a context manager.

    A grasp's trace depends on its arguments alone, not on the grasps before it.

    ``robot`` is the name of a gripper, which floats, or ``ur5e_`` and the name of a gripper.

    Raises ``PhysicsError`` if the robot or the engine is unknown, the engine is missing, or
    PyBullet lacks numpy.
    """

    def __init__(self, robot: str | RobotSpec = "wsg50", engine: EngineChoice = "auto") -> None:
        if engine not in get_args(EngineChoice):
            msg = f"engine {engine!r} is not known; known: {', '.join(get_args(EngineChoice))}"
            raise PhysicsError(msg)
        self.robot = load_robot(robot) if isinstance(robot, str) else robot
        self.engine = engine_of(engine)
        self.world = _ENGINES[self.engine](self.robot)
        self.started = 0
        """How many grasps; the world is that of the latest."""

    def __enter__(self) -> "GraspSimulator":
        self.world.__enter__()
        return self

    def __exit__(self, *raised: object) -> None:
        self.world.__exit__(*raised)


def run_grasp(
    simulator: GraspSimulator,
    obj: GraspObject,
    config: GraspConfig,
    settings: PhysicsSettings,
    *,
    frames: FrameRequest,
    gel: GelModel = FLAT_FACE,
) -> GraspTrace:
    """Simulate one grasp of ``obj`` as ``config`` asks; frames in the gel frame (mm, N).

    It is a ``StartedGrasp`` and its lift.

    A grasp that cannot be executed has the status ``toppled`` (the object does not stand as its
    rest pose says), ``unreachable`` or ``no_contact``, a reason, the label −1 and no frames.

    Raises ``PhysicsError`` if the force is not one the gripper can be asked for, or the simulator
    has another engine than ``settings``.
    """
    return StartedGrasp(simulator, obj, config, settings, frames=frames, gel=gel).lift()


class StartedGrasp:
    """A grasp up to its lift, held and not yet lifted; the next one in its world ends it.

    The arguments, and what it raises, are those of ``run_grasp``.
    """

    def __init__(
        self,
        simulator: GraspSimulator,
        obj: GraspObject,
        config: GraspConfig,
        settings: PhysicsSettings,
        *,
        frames: FrameRequest,
        gel: GelModel = FLAT_FACE,
    ) -> None:
        if simulator.engine != settings.engine:
            msg = (
                f"the settings ask for the engine {settings.engine!r}, the simulator has "
                f"{simulator.engine!r}; open GraspSimulator(robot, {settings.engine!r})"
            )
            raise PhysicsError(msg)
        self.world, self.gripper = simulator.world, simulator.robot.gripper
        pad = self.gripper.pad
        problem = force_problem(config.force_n, settings.max_force_n)
        problem = problem or settings.compliance_problem(config.force_n, pad.depth_mm)
        if problem:
            msg = f"grasp {config.index} of {config.object!r}: force_n {problem}"
            raise PhysicsError(msg)
        simulator.started += 1
        self._simulator, self._number = simulator, simulator.started
        self._ended: GraspTrace | None = None
        self.obj, self.config, self.settings = obj, config, settings
        self.gel = gel
        self.note = ""
        met, height_mm = obj.collision, config.z_mm + settings.height_offset_mm
        if touches_as_sphere(settings.pad_dome_radius_mm):
            pad_mm = pad.width_mm, pad.height_mm
            met = within_reach(obj.collision, config, height_mm=height_mm, pad_mm=pad_mm)
        self.body, self.robot = self.world.build(obj, settings, config.force_n, met)
        sequence = frames.mode == "sequence"
        self.frame_ends = frame_end_steps(frames, settings.time_step_s) if sequence else []
        self.ends_at_lift = sequence and frames.until == "lift"
        self._gel_steps: list[int] = []
        self.bodies = Bodies(
            pads=self.gripper.sides,
            principal_moments_kg_m2=self.body.principal_moments_kg_m2,
            inertial=self.body.inertial,
            spinning_friction_m=dict.fromkeys(PADS, 0.0),
            time_step_s=settings.time_step_s,
            pad_friction=obj.friction * settings.pad_friction,
            table_friction=settings.table_friction,
            lift_step=sys.maxsize,
            vertices_m=np.concatenate([p.vertices_mm for p in obj.collision]) * M_PER_MM,
        )
        self._hold()

    def _hold(self) -> None:
        """Approach, close and hold, to where the lift starts."""
        settings = self.settings
        if fall_deg := topples_deg(self.obj):
            self._ended = self._not_executed(
                "toppled",
                f"the object topples by {fall_deg:.0f}° before the grasp: its centre of mass is "
                "not over what it stands on; rest its mesh, or correct its center_of_mass_mm",
            )
            return
        target = grasp_target(self.config, settings)
        reason = approach(self.world, self.robot, self.gripper, self.obj, target, settings)
        reason = reason or self.robot.prepare_lift(settings.lift_mm * M_PER_MM)
        if reason:
            self._ended = self._not_executed("unreachable", reason)
            return
        stroke_m = self.gripper.stroke_mm * M_PER_MM
        self.recorder = Recorder(
            self.world, self.robot, self.body, stroke_m, settings, self.frame_ends
        )
        if self.gel.keeps_past:
            self.recorder.keep_past(PAST_STEPS)
        reason = self._close()
        if reason:
            self._ended = self._not_executed("no_contact", reason)
            return
        self._grasped = self._observe()
        self._capacity = self._load_pads(self._grasped)
        hold_steps = self._steps(settings.hold_s)
        self._plan_gel_steps(self.recorder.step + hold_steps)
        self.recorder.advance_to_frame(hold_steps)
        if self.ends_at_lift:
            lift_step = self.recorder.step
            earlier = [min(end, lift_step) for end in self.frame_ends[:-1]]
            self.frame_ends = [*earlier, lift_step]

    def held(self) -> GraspTrace:
        """The trace up to the lift, without an outcome: its label is −1, rise and turn are NaN.

        Raises ``PhysicsError`` if it was asked for frames of the lift.
        """
        if self._ended is not None:
            return self._ended
        if self.frame_ends and not self.ends_at_lift:
            msg = "frames until the outcome are there after the lift alone; ask for until: lift"
            raise PhysicsError(msg)
        return self._executed()

    def lift(self) -> GraspTrace:
        """Lift and label: the whole trace.

        Raises ``PhysicsError`` if another grasp has been started in its world.
        """
        if self._ended is not None:
            return self._ended
        if self._simulator.started != self._number:
            msg = "another grasp was started in this simulator, whose world it is now; lift that"
            raise PhysicsError(msg)
        self.robot.fingers.couple()
        self.bodies = replace(self.bodies, lift_step=self.recorder.step + 1)
        self._plan_gel_steps(sys.maxsize)
        start, lifted = self._lift()
        if self.frame_ends:
            self.recorder.advance(self.frame_ends[-1] - self.recorder.step)
        motion = outcome.motion_of(start, lifted, self.bodies, self.settings.sensing_pads[0])
        self._ended = self._executed(motion)
        return self._ended

    def _plan_gel_steps(self, end: int) -> None:
        """Keep the loads at fixed steps from now to the step ``end``, before the last frame."""
        every = max(1, self._steps(GEL_STEP_S))
        last = min(end, max(self.frame_ends, default=0) - 1)
        steps = range(self.recorder.step + every, last + 1, every)
        self.recorder.plan(steps)
        self._gel_steps += steps

    def _steps(self, seconds: float) -> int:
        return round(seconds / self.settings.time_step_s)

    def _close(self) -> str:
        """Close until both pads press steadily with the delivered force; why not, if not."""
        settings, recorder, fingers = self.settings, self.recorder, self.robot.fingers
        force_n = settings.delivered_force_n(self.config.force_n)
        if force_n <= 0:
            return "no force is delivered of the one commanded, so the fingers do not close"
        speed_m_s = settings.closing_speed_mm_s * M_PER_MM
        fingers.drive(speed_m_s, force_n)
        half_m = self.gripper.stroke_mm / 2 * M_PER_MM
        limit_s = (half_m - min(fingers.travel_m())) / speed_m_s + settings.settle_limit_s
        damping_n_s_m = 0.0
        if settings.pad_stiffness_n_mm > 0:  # the pads' springs take up the force as they give way
            damping_n_s_m = settings.pad_damping_n_s_mm / M_PER_MM
            limit_s += CREEP_TIMES * settings.pad_damping_n_s_mm / settings.pad_stiffness_n_mm
        opening_m = sum(recorder.pad_distance_m())
        steady, waits = 0, True
        touched = dict.fromkeys(PADS, 0.0)
        for _ in range(self._steps(limit_s) // CHUNK_STEPS):
            recorder.advance(CHUNK_STEPS)
            before_m, opening_m = opening_m, sum(recorder.pad_distance_m())
            if opening_m <= 0:
                return "the pads met with nothing between them"
            touched = self._pad_forces_n()
            waits = waits and all(point.part == TABLE for point in self.world.contacts())
            if waits:  # while it comes to rest an object walks, by its solver
                self.body.keep_place()
            creep_m_s = abs(before_m - opening_m) / 2 / (CHUNK_STEPS * settings.time_step_s)
            off_n = max(abs(force - force_n) for force in touched.values())
            off_n = max(off_n, damping_n_s_m * creep_m_s)
            steady = steady + 1 if off_n <= STEADY_TOLERANCE * force_n else 0
            if steady == STEADY_CHUNKS:
                return ""
        missing = [pad for pad, force in touched.items() if force <= 0]
        if missing:
            return f"the {' and the '.join(missing)} pad did not touch"
        self.note = f"the pads' force was not steady {limit_s:.1f} s after closing on"
        return ""

    def _observe(self) -> list[Snapshot]:
        """The moment of grasp: again where a pad's mean force is not the delivered one."""
        force_n = self.settings.delivered_force_n(self.config.force_n)
        axis = self._closing_axis()
        for _ in range(OBSERVATIONS):
            grasped = self.recorder.observe()
            contacts = mean_contacts(grasped)
            loads_n = [abs(float(contacts.of(pad).force_n.sum(axis=0) @ axis)) for pad in PADS]
            off = max(abs(load_n / force_n - 1) for load_n in loads_n)
            if off <= FORCE_TOLERANCE or self.note:
                return grasped
        self.note = f"a pad's force was off by {100 * off:.0f} % at the moment of grasp"
        return grasped

    def _pad_forces_n(self) -> dict[str, float]:
        own = [p for p in self.world.contacts() if p.part != TABLE and p.normal_force_n > 0]
        if not own:  # as most of the time
            return dict.fromkeys(PADS, 0.0)
        contacts = contacts_of(own)
        along_n = contacts.force_n @ self._closing_axis()
        return {pad: abs(float(along_n[contacts.part == pad].sum())) for pad in PADS}

    def _closing_axis(self) -> FloatArray:
        return np.array([math.cos(self.config.yaw_rad), math.sin(self.config.yaw_rad), 0.0])

    def _load_pads(self, grasped: Sequence[Snapshot]) -> Capacity:
        """Set the torsion that the pads can hold beside the weight."""
        loads = outcome.frames_of([grasped], self.bodies, PADS, self.recorder.past())
        torsion = {pad: self._torsion_limit(load) for pad, (load,) in loads.items()}
        touches = {pad: self.world.touches(pad, TOUCH_REACH_M) for pad in PADS}
        capacity = outcome.capacity_of(
            grasped, self.bodies, self.obj, self.settings, torsion, touches
        )
        spinning_m = [mm * M_PER_MM for mm in capacity.spinning_mm]
        by_pad = dict(zip(self.bodies.pads, spinning_m, strict=True))
        self.bodies = replace(self.bodies, spinning_friction_m=by_pad)
        self.robot.fingers.set_spinning_friction(by_pad, capacity.friction_share)
        return capacity

    def _torsion_limit(self, load: ContactFrame) -> TorsionLimit:
        """What a pad under that load holds about its normal."""
        factor = self.settings.pad_friction * self.obj.spinning_friction_factor
        declared_mm = self.obj.spinning_friction_mm
        if declared_mm is not None:
            return lambda share: declared_mm * factor * torsion_factor(share)
        patch = self._flat_face(load) if self.gel.patch_of is None else self.gel.patch_of(load)
        friction, arm_mm = self.obj.friction * factor, torsion_limit(patch)
        return lambda share: friction * arm_mm(share)

    def _flat_face(self, load: ContactFrame) -> ContactPatch:
        return dome_patch(
            load.force_normal_n,
            dome_radius_mm=self.settings.pad_dome_radius_mm,
            k_n_mm3_per_n=PUBLISHED_K_N_MM3_PER_N,
        )

    def _lift(self) -> tuple[Snapshot, list[Placement]]:
        """Lift by the profile: a snapshot at its start, and placements from there on."""
        settings, recorder = self.settings, self.recorder
        sampled = max(1, self._steps(settings.slip_sample_s))
        heights_m, speeds_m_s = trapezoid(
            settings.lift_mm * M_PER_MM,
            settings.lift_speed_mm_s * M_PER_MM,
            settings.lift_acceleration_mm_s2 * M_PER_MM,
            settings.time_step_s,
        )
        start = recorder.snapshot()
        samples: list[Placement] = [start]
        motion = zip(heights_m.tolist(), speeds_m_s.tolist(), strict=True)
        for k, (height_m, speed_m_s) in enumerate(motion):
            self.robot.command_lift(height_m, speed_m_s)
            recorder.advance(1)
            if k % sampled == 0:
                samples.append(recorder.placement())
        self.robot.command_lift(settings.lift_mm * M_PER_MM, 0.0)
        samples.append(recorder.placement())
        return start, samples

    def _executed(self, motion: outcome.Motion | None = None) -> GraspTrace:
        """The trace so far, or after the lift with that motion."""
        settings, last = self.settings, self._grasped[-1]
        end = last.object_position_m
        if motion is not None:
            end = float(motion.rise_mm[-1]), float(motion.turn_rad[-1])
        if not np.isfinite(end).all():
            return self._not_executed("crashed", "the simulation became unstable; shorten its step")
        windows = [self.recorder.window(end) for end in self.frame_ends]
        frame = frame_of_moment(self.frame_ends, last.step)
        if len(windows) != 1:
            windows[frame : frame + 1] = [list(self._grasped)]
        past, pads = self.recorder.past(), settings.sensing_pads
        steps = [[self.recorder.snapshots[step]] for step in self._gel_steps]
        ends = [window[-1] for window in windows]
        held = GraspTrace(
            config=self.config,
            status="executed",
            label=LABEL_NOT_EXECUTED,
            frames=outcome.frames_of(windows, self.bodies, pads, past),
            gel_steps=outcome.frames_of(steps, self.bodies, pads, past),
            object_pose=outcome.object_poses_mm(ends, self.bodies),
            rise_mm=math.nan,
            turn_rad=math.nan,
            reason=self.note,
            grasp_time_s=last.step * settings.time_step_s,
            grasp_frame=frame,
            gripper_pose=outcome.gripper_poses_mm(ends),
            pad_distance_mm=frozen_array([end.pad_distance_m for end in ends]) * MM_PER_M,
        )
        if motion is None:
            return held
        rise_mm, turn_rad = float(motion.rise_mm[-1]), float(motion.turn_rad[-1])
        label = outcome.label_of(rise_mm, turn_rad, settings)
        slip = outcome.first_slip(motion, settings)
        return replace(
            held,
            label=label,
            failure_mode="" if label == LABEL_SUCCESS else outcome.failure_mode(motion, settings),
            rise_mm=rise_mm,
            turn_rad=turn_rad,
            margin=slip_margin(self._capacity, self.obj.mass_kg, *slip),
            lift_start_time_s=float(motion.time_s[0]),
            lift_end_time_s=float(motion.time_s[-1]),
            outcome_time_s=outcome.outcome_time_s(motion, settings, label),
        )

    def _not_executed(self, status: Status, reason: str) -> GraspTrace:
        return not_executed(self.config, status, reason, self.settings.sensing_pads)


def not_executed(
    config: GraspConfig, status: Status, reason: str, pads: Sequence[str]
) -> GraspTrace:
    """The trace of a grasp that was not executed, without frames of its sensing ``pads``."""
    return GraspTrace(
        config=config,
        status=status,
        label=LABEL_NOT_EXECUTED,
        frames=dict.fromkeys(pads, ()),
        object_pose=frozen_array(np.zeros((0, 7))),
        reason=reason,
    )


def trapezoid(
    distance: float, speed: float, acceleration: float, time_step_s: float
) -> tuple[FloatArray, FloatArray]:
    """Positions and speeds at the end of each step of a motion over ``distance``, rest to rest.

    The speed rises and falls by ``acceleration`` and stays at ``speed`` between; where the
    distance is too short for that speed, it turns round halfway.
    """
    speed = min(speed, float(np.sqrt(distance * acceleration)))
    ramp_s = speed / acceleration
    total_s = distance / speed + ramp_s
    count = int(np.ceil(total_s / time_step_s - 1e-9))
    time_s = np.arange(count + 1) * time_step_s
    rising = np.minimum(time_s, ramp_s)
    falling = np.clip(time_s - (total_s - ramp_s), 0.0, ramp_s)
    cruise = np.clip(time_s - ramp_s, 0.0, total_s - 2 * ramp_s)
    positions = acceleration * rising**2 / 2 + speed * cruise
    positions = positions + speed * falling - acceleration * falling**2 / 2
    return positions[1:], np.diff(positions) / time_step_s

"""Settings of the simulated grasp, and which tactile frames are recorded."""

import math
from typing import Annotated, Literal

from pydantic import (
    AfterValidator,
    ConfigDict,
    Field,
    NonNegativeFloat,
    PositiveFloat,
    PositiveInt,
    model_validator,
)
from pydantic.dataclasses import dataclass

from tacgen.core.errors import PhysicsError
from tacgen.core.records import PADS, PadName, Until
from tacgen.core.types import STANDARD_GRAVITY_M_S2
from tacgen.physics.pybullet_import import load_bullet

EngineName = Literal["pybullet", "mujoco"]
EngineChoice = Literal["auto", "pybullet", "mujoco"]
Pads = Literal[PadName, "both"]
SMALLEST_DOME_RADIUS_MM = 20.0
"""A dome must be wider than the pad, whose half diagonal is 15.3 mm."""
MAX_FORCE_N = 1000.0
"""Of a finger: ten times what grippers with such pads have."""
ITERATIONS_PER_FORCE_RATIO = 0.5
"""Iterations by force over weight: with 50, a 2 g block creeps in a 20 N grip, a ratio of 1000."""
MOST_ITERATIONS = 500  # what that block needs; a bound on the time of a grasp


_CONFIG = ConfigDict(extra="forbid", use_attribute_docstrings=True, validate_default=True)


def force_problem(force_n: float, limit_n: float) -> str:
    """What is wrong with asking a finger for ``force_n``, with its fix; empty if nothing is."""
    if not force_n > 0:
        return f"= {force_n:g} is not a force to grip with; ask for more than 0 N"
    if force_n > limit_n:
        limit = f"robot.max_force_n = {limit_n:g}"
        return f"= {force_n:g} exceeds {limit}; lower it or raise robot.max_force_n"
    return ""


def engine_of(choice: EngineChoice) -> EngineName:
    """The engine that ``choice`` means here: ``auto`` is PyBullet where it can be imported."""
    if choice != "auto":
        return choice
    try:
        load_bullet()
    except PhysicsError:
        return "mujoco"
    return "pybullet"


@dataclass(frozen=True, slots=True, config=_CONFIG)
class PhysicsSettings:
    """How a grasp is simulated; ``docs/explanation/physics.md`` has their reasons.

    Raises pydantic's ``ValidationError``, which lists every figure that cannot be.
    """

    engine: Annotated[EngineChoice, AfterValidator(engine_of)] = "auto"
    """The physics engine. ``auto`` is PyBullet where it can be imported (it has wheels up to
    Python 3.11), otherwise MuJoCo; ``tacgen recipe show`` and the dataset state which it was."""
    time_step_s: PositiveFloat = 1 / 480
    """The engine's time step."""
    solver_iterations: PositiveInt = 100
    """Most iterations of PyBullet's solver; large forces on light objects may take more."""
    clearance_mm: NonNegativeFloat = 8.0
    """Gap between the nearer pad and the object before closing."""
    closing_speed_mm_s: PositiveFloat = 40.0
    """Speed of each finger."""
    settle_limit_s: PositiveFloat = 1.0
    """Longest wait for a steady force after the fingers could have met."""
    hold_s: NonNegativeFloat = 0.3
    """Time between the moment of grasp and the lift."""
    lift_mm: PositiveFloat = 180.0
    """Height of the lift."""
    lift_speed_mm_s: PositiveFloat = 120.0
    """Largest speed of the lift."""
    lift_acceleration_mm_s2: PositiveFloat = 120.0
    """Acceleration of the lift; about 1 % of gravity's, to shift no threshold by more."""
    success_rise_mm: PositiveFloat = 150.0
    """Least rise of an object that is grasped successfully."""
    success_turn_rad: PositiveFloat = 0.1
    """Largest turn relative to the gripper of an object that is grasped successfully."""
    slip_mm: PositiveFloat = 0.5
    """Motion at the pad from which the object slips."""
    slip_turn_rad: PositiveFloat = 0.01
    """Turn at the pad from which the object slips."""
    slip_sample_s: PositiveFloat = 0.0125
    """Interval at which the lift is checked for slip."""
    contact_average_steps: PositiveInt = 5
    """Steps over which a frame's contact forces are averaged."""
    pad_dome_radius_mm: Annotated[float, Field(ge=SMALLEST_DOME_RADIUS_MM)] = 30.0
    """Radius of curvature of the colliding pads; makes the contact with a flat face a point."""
    pad_friction: NonNegativeFloat = 1.0
    """Factor on the object's friction coefficient."""
    table_friction: NonNegativeFloat = 0.4
    """Coefficient of friction between object and table."""
    pad_stiffness_n_mm: NonNegativeFloat = 0.0
    """Normal stiffness of the pads; 0: rigid."""
    pad_damping_n_s_mm: NonNegativeFloat = 0.5
    """Normal damping of the pads."""
    delivered_force_scale: NonNegativeFloat = 1.0
    """Force of a finger over the commanded one."""
    delivered_force_offset_n: float = 0.0
    """Added to the force of a finger."""
    height_offset_mm: float = 0.0
    """Added to the height of the pads."""
    max_force_n: Annotated[PositiveFloat, Field(le=MAX_FORCE_N)] = 40.0
    """Largest force of a finger; set it as ``robot.max_force_n``. The WSG-50's grasping
    force of 80 N is twice a finger's (Weiss Robotics, WSG 50 data sheet)."""
    tactile_pads: Pads = "left"
    """Fingers with a sensor; set it as ``robot.tactile_pads``."""

    @model_validator(mode="after")
    def _lifts_far_enough(self) -> "PhysicsSettings":
        if self.success_rise_mm >= self.lift_mm:
            msg = (
                f"success_rise_mm = {self.success_rise_mm:g} is not reached by "
                f"lift_mm = {self.lift_mm:g}; lift further"
            )
            raise ValueError(msg)
        return self

    @property
    def sensing_pads(self) -> tuple[str, ...]:
        """Names of the pads that carry a sensor."""
        return PADS if self.tactile_pads == "both" else (self.tactile_pads,)

    def iterations_for(self, force_n: float, mass_kg: float) -> int:
        """Solver iterations for a commanded ``force_n`` on an object of ``mass_kg``.

        The solver's error is a part of the pads' force but moves the object by its mass: too few
        iterations let a light object creep in a strong grip.
        """
        ratio = self.delivered_force_n(force_n) / (mass_kg * STANDARD_GRAVITY_M_S2)
        needed = min(math.ceil(ITERATIONS_PER_FORCE_RATIO * ratio), MOST_ITERATIONS)
        return max(self.solver_iterations, needed)

    def compliance_problem(self, force_n: float, pad_depth_mm: float) -> str:
        """What is wrong with the pads' stiffness under a commanded force; empty if nothing is."""
        delivered_n = self.delivered_force_n(force_n)
        if self.pad_stiffness_n_mm * pad_depth_mm > delivered_n or self.pad_stiffness_n_mm == 0:
            return ""
        given_mm, least = delivered_n / self.pad_stiffness_n_mm, delivered_n / pad_depth_mm
        return (
            f"= {force_n:g} presses the pads in by {given_mm:.3g} mm, but they are "
            f"{pad_depth_mm:g} mm deep; raise physics.pad_stiffness_n_mm above {least:.3g} or "
            "lower the force"
        )

    def delivered_force_n(self, commanded_n: float) -> float:
        """The force a finger presses with when ``commanded_n`` is asked for."""
        return max(0.0, self.delivered_force_scale * commanded_n + self.delivered_force_offset_n)


@dataclass(frozen=True, slots=True, config=_CONFIG)
class FrameRequest:
    """The tactile frames of a grasp.

    ``single``: one frame at the moment of grasp, when the force has reached the command and is
    steady. ``sequence``: ``count`` frames over ``span_s`` from the moment the fingers start to
    close, the first at 0 and the last at its end; the one before the moment of grasp is taken at
    that moment. A sequence of one frame is the one at the end. With ``until: lift`` no frame is
    later than the start of the lift, and the last is taken then.
    """

    mode: Literal["single", "sequence"] = "single"
    """One image at the moment of grasp, or a sequence from the start of closing."""
    count: PositiveInt = 24
    """Number of frames of a sequence."""
    span_s: PositiveFloat = 3.0
    """Time from the first to the last frame of a sequence."""
    until: Until = "outcome"
    """Where a sequence ends: at the start of the ``lift``, before the outcome shows, or after
    ``span_s``, which shows the ``outcome`` of most grasps."""

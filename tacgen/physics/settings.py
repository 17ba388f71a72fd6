"""Every constant of the simulated grasp, and which tactile frames are wanted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

RobotName = Literal["wsg50", "ur5e_wsg50"]
Pads = Literal["left", "right", "both"]


@dataclass(frozen=True, slots=True)
class PhysicsSettings:
    """How a grasp is simulated.

    Attributes
    ----------
    time_step_s, solver_iterations
        Of PyBullet's constraint solver.
    clearance_mm
        Gap left between the nearer pad and the object when the fingers are pre-positioned.
    closing_speed_mm_s
        Speed of each finger.
    hold_s
        Time between the commanded force being reached and the lift.
    lift_mm, lift_speed_mm_s, lift_acceleration_mm_s2
        The lift's trapezoidal profile; the acceleration is small beside gravity's 9807 mm/s².
    success_rise_mm, success_turn_rad
        A grasp succeeds if the object rises at least this far and turns less than that relative
        to the gripper.
    contact_average_steps
        Contact forces of a frame are the mean over this many steps.
    pad_friction
        Factor on the object's own coefficient of friction.
    pad_stiffness_n_mm, pad_damping_n_s_mm
        Normal compliance of the pad; 0 is rigid.
    delivered_force_scale, delivered_force_offset_n
        The force each finger really presses with, from the commanded one.
    height_offset_mm
        Added to the height of the pads: a table that is not where it was taken to be.
    max_force_n
        Largest force per finger the gripper may be asked for.
    tactile_pads
        Which pads carry a sensor.
    """

    time_step_s: float = 1 / 480
    solver_iterations: int = 50
    clearance_mm: float = 8.0
    closing_speed_mm_s: float = 40.0
    hold_s: float = 0.5
    lift_mm: float = 180.0
    lift_speed_mm_s: float = 120.0
    lift_acceleration_mm_s2: float = 120.0
    success_rise_mm: float = 150.0
    success_turn_rad: float = 0.1
    contact_average_steps: int = 5
    pad_friction: float = 1.0
    pad_stiffness_n_mm: float = 0.0
    pad_damping_n_s_mm: float = 0.0
    delivered_force_scale: float = 1.0
    delivered_force_offset_n: float = 0.0
    height_offset_mm: float = 0.0
    max_force_n: float = 80.0
    tactile_pads: Pads = "left"

    __pydantic_config__: ClassVar[dict[str, str]] = {"extra": "forbid"}


@dataclass(frozen=True, slots=True)
class FrameRequest:
    """Which tactile frames a grasp records.

    ``single``: one frame at the moment of grasp, when the force has reached the command and is
    steady. ``sequence``: ``count`` frames over ``span_s`` from the moment the fingers start to
    close, the last one at its end.
    """

    mode: Literal["single", "sequence"] = "single"
    count: int = 24
    span_s: float = 3.0

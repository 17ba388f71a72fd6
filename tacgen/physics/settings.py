"""Every constant of the simulated grasp, and which tactile frames are wanted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

RobotName = Literal["wsg50", "ur5e_wsg50"]
Pads = Literal["left", "right", "both"]
PAD_NAMES = ("left", "right")


@dataclass(frozen=True, slots=True)
class PhysicsSettings:
    """How a grasp is simulated; ``docs/physics.md`` gives the reason for each figure.

    Attributes
    ----------
    time_step_s, solver_iterations
        Of PyBullet's constraint solver.
    clearance_mm
        Gap left between the nearer pad and the object when the fingers are pre-positioned.
    closing_speed_mm_s
        Speed of each finger.
    settle_limit_s
        How long the pads may take to reach a steady force once the fingers had time to meet.
    hold_s
        Time between the moment of grasp and the lift.
    lift_mm, lift_speed_mm_s, lift_acceleration_mm_s2
        The lift's trapezoidal profile; the acceleration is about 1 % of gravity's, so that
        inertia moves no threshold by more.
    success_rise_mm, success_turn_rad
        A grasp succeeds if the object rises at least this far and turns less than that relative
        to the gripper.
    slip_mm, slip_turn_rad
        The object slips once it has moved this far at the pad, or turned this far.
    slip_sample_s
        How often the lift is looked at for slip.
    contact_average_steps
        Contact forces of a frame are the mean over this many steps, the last at its time.
    pad_dome_radius_mm
        Radius of curvature of the pads that collide; the dome makes the contact a single point
        on a flat face, whose moment about the normal is the object's ``spinning_friction_mm``.
    pad_friction
        Factor on the object's own coefficient of friction against the gel.
    table_friction
        Coefficient of friction of the object on the table.
    pad_stiffness_n_mm, pad_damping_n_s_mm
        Normal compliance of the pads; a stiffness of 0 makes them rigid.
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
    settle_limit_s: float = 1.0
    hold_s: float = 0.3
    lift_mm: float = 180.0
    lift_speed_mm_s: float = 120.0
    lift_acceleration_mm_s2: float = 120.0
    success_rise_mm: float = 150.0
    success_turn_rad: float = 0.1
    slip_mm: float = 0.5
    slip_turn_rad: float = 0.01
    slip_sample_s: float = 0.0125
    contact_average_steps: int = 5
    pad_dome_radius_mm: float = 30.0
    pad_friction: float = 1.0
    table_friction: float = 0.4
    pad_stiffness_n_mm: float = 0.0
    pad_damping_n_s_mm: float = 0.5
    delivered_force_scale: float = 1.0
    delivered_force_offset_n: float = 0.0
    height_offset_mm: float = 0.0
    max_force_n: float = 40.0
    tactile_pads: Pads = "left"

    __pydantic_config__: ClassVar[dict[str, str]] = {"extra": "forbid"}

    @property
    def sensing_pads(self) -> tuple[str, ...]:
        """Names of the pads that carry a sensor."""
        return PAD_NAMES if self.tactile_pads == "both" else (self.tactile_pads,)

    def delivered_force_n(self, commanded_n: float) -> float:
        """The force a finger presses with when ``commanded_n`` is asked for."""
        return max(0.0, self.delivered_force_scale * commanded_n + self.delivered_force_offset_n)


@dataclass(frozen=True, slots=True)
class FrameRequest:
    """Which tactile frames a grasp records.

    ``single``: one frame at the moment of grasp, when the force has reached the command and is
    steady. ``sequence``: ``count`` frames over ``span_s`` from the moment the fingers start to
    close, the first at 0 and the last at its end.
    """

    mode: Literal["single", "sequence"] = "single"
    count: int = 24
    span_s: float = 3.0

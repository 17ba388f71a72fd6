"""The way to the grasp: above the object, turned, down, adjusted in the plane, fingers near.

Nothing touches the object on a free path, so the gripper is put at points along it and each is
checked for collisions; no time is simulated.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from tacgen.core.records import GraspConfig, GraspObject
from tacgen.core.types import M_PER_MM, MM_PER_M
from tacgen.physics.engine import PALM, Engine, GripperTarget, Robot
from tacgen.physics.gripper import GripperSpec
from tacgen.physics.settings import PhysicsSettings

WAYPOINT_SPACING_MM = 6.0
"""Between points that are checked for collisions: half a finger's thickness."""
TOUCH_M = 1e-6
"""Nearer than this fingers touch, a hundredth of a time step's way. A nearest distance, of a face
at θ to the closing direction, falls short of the way by 1 − cos θ: it is taken again …"""
MOST_ADVANCES = 20  # … at most so often, which suffices up to 60°
ABOVE_MM = 10.0  # clearance between the object's top and the pads before they descend; chosen


def grasp_target(config: GraspConfig, settings: PhysicsSettings) -> GripperTarget:
    """Where the gripper frame is to be when the fingers close."""
    return GripperTarget(
        config.x_mm * M_PER_MM,
        config.y_mm * M_PER_MM,
        (config.z_mm + settings.height_offset_mm) * M_PER_MM,
        config.yaw_rad,
    )


def approach(
    world: Engine,
    robot: Robot,
    gripper: GripperSpec,
    obj: GraspObject,
    target: GripperTarget,
    settings: PhysicsSettings,
) -> str:
    """Bring the gripper to ``target``, fingers ``clearance_mm`` from the object.

    Returns why the robot cannot get there, or nothing.
    """
    below_mm = gripper.below_mm
    lowest_mm = target.z_m * MM_PER_M - below_mm
    if lowest_mm < 0:
        return (
            f"the pads would reach {-lowest_mm:.1f} mm into the table; "
            f"grasp at z_mm = {below_mm:g} or higher"
        )
    robot.fingers.place(0.0)
    top_mm = max(float(part.vertices_mm[:, 2].max()) for part in obj.collision)
    above_m = max(target.z_m, (top_mm + below_mm + ABOVE_MM) * M_PER_MM)
    reasons = []
    for corners in _ways(target, above_m):
        reason = _first_obstacle(world, robot, gripper.stroke_mm, corners)
        if not reason:
            # Near the object, symmetrically, so that closing takes little time.
            travel_m = _travel_to_touch_m(world, robot, gripper.stroke_mm * M_PER_MM)
            robot.fingers.place(max(0.0, travel_m - _clearance_m(settings)))
            return ""
        reasons.append(reason)
    return reasons[-1]


def _travel_to_touch_m(world: Engine, robot: Robot, stroke_m: float) -> float:
    """How far in the fingers touch the object, or each other; by no more than they are apart."""
    travel_m = 0.0
    for _ in range(MOST_ADVANCES):
        near_m = min((distance for _, distance in world.distances(stroke_m)), default=stroke_m)
        travel_m = min(travel_m + near_m, stroke_m / 2)
        if near_m < TOUCH_M or travel_m == stroke_m / 2:
            break
        robot.fingers.place(travel_m)
    return travel_m


def _clearance_m(settings: PhysicsSettings) -> float:
    """The clearance, to the nearest odd number of half steps: the pads touch between two steps.

    At a whole number of them rounding would decide in which step each pad touches.
    """
    step_mm = settings.closing_speed_mm_s * settings.time_step_s
    return (math.floor(settings.clearance_mm / step_mm + 1e-9) + 0.5) * step_mm * M_PER_MM


def _ways(target: GripperTarget, above_m: float) -> Iterator[list[GripperTarget]]:
    """Corners of the ways to try: adjusting in the plane at the bottom, then at the top."""
    above_goal = replace(target, z_m=above_m)
    if target.x_m or target.y_m:
        middle = replace(target, x_m=0.0, y_m=0.0)
        yield [replace(middle, z_m=above_m), middle, target]
    yield [above_goal, target]


def _waypoints(corners: Sequence[GripperTarget]) -> Iterator[GripperTarget]:
    """Points along the way, the last corner last."""
    yield corners[0]
    for start, end in itertools.pairwise(corners):
        a, b = (np.array([corner.x_m, corner.y_m, corner.z_m]) for corner in (start, end))
        count = max(1, int(np.ceil(np.linalg.norm(b - a) * MM_PER_M / WAYPOINT_SPACING_MM)))
        for k in range(1, count + 1):
            x_m, y_m, z_m = (a + (b - a) * (k / count)).tolist()
            yield GripperTarget(x_m, y_m, z_m, end.yaw_rad)


def _first_obstacle(
    world: Engine, robot: Robot, stroke_mm: float, corners: Sequence[GripperTarget]
) -> str:
    """Why the gripper cannot go along the way, or nothing; it stays at the way's end."""
    for waypoint in _waypoints(corners):
        reason = robot.place(waypoint)
        if reason:
            return reason
        met = world.distances(0.0)
        if met:
            height = f"with the pads {waypoint.z_m * MM_PER_M:.0f} mm above the table"
            if {part for part, _ in met} == {PALM}:
                return (
                    f"the palm meets the object {height}; the object is too tall, grasp it higher"
                )
            return (
                f"the open fingers meet the object {height}; the object is wider there than the "
                f"stroke of {stroke_mm:g} mm"
            )
    return ""

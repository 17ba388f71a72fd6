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
from tacgen.core.units import M_PER_MM, MM_PER_M
from tacgen.physics.bodies import ObjectBody
from tacgen.physics.gripper import PAD_HEIGHT_MM, STROKE_MM
from tacgen.physics.robots import GripperTarget, Robot
from tacgen.physics.settings import PhysicsSettings
from tacgen.physics.world import World

WAYPOINT_SPACING_MM = 6.0
"""Between points that are checked for collisions: half a finger's thickness."""
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
    world: World,
    robot: Robot,
    body: ObjectBody,
    obj: GraspObject,
    target: GripperTarget,
    settings: PhysicsSettings,
) -> str:
    """Bring the gripper to ``target``, fingers ``clearance_mm`` from the object.

    Returns why the robot cannot get there, or nothing.
    """
    lowest_mm = target.z_m * MM_PER_M - PAD_HEIGHT_MM / 2
    if lowest_mm < 0:
        return (
            f"the pads would reach {-lowest_mm:.1f} mm into the table; "
            f"grasp at z_mm = {PAD_HEIGHT_MM / 2:g} or higher"
        )
    robot.fingers.place(0.0)
    top_mm = max(float(part.vertices_mm[:, 2].max()) for part in obj.collision)
    above_m = max(target.z_m, (top_mm + PAD_HEIGHT_MM / 2 + ABOVE_MM) * M_PER_MM)
    reasons = []
    for corners in _ways(target, above_m):
        reason = _first_obstacle(world, robot, body, corners)
        if not reason:
            # Near the object, symmetrically, so that closing takes little time.
            found = _distances(world, robot, body, STROKE_MM * M_PER_MM)
            near_m = min((distance for _, distance in found), default=0.0)
            robot.fingers.place(max(0.0, near_m - _clearance_m(settings)))
            return ""
        reasons.append(reason)
    return reasons[-1]


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


def _distances(
    world: World, robot: Robot, body: ObjectBody, limit_m: float
) -> list[tuple[int, float]]:
    """Links and how near they are to the object; of the pads their outlines, not their domes."""
    found = world.distances(robot.body, body.body, limit_m)
    return [one for one in found if one[0] not in robot.fingers.links.values()]


def _first_obstacle(
    world: World, robot: Robot, body: ObjectBody, corners: Sequence[GripperTarget]
) -> str:
    """Why the gripper cannot go along the way, or nothing; it stays at the way's end."""
    for waypoint in _waypoints(corners):
        reason = robot.place(waypoint)
        if reason:
            return reason
        met = _distances(world, robot, body, 0.0)
        if met:
            height = f"with the pads {waypoint.z_m * MM_PER_M:.0f} mm above the table"
            if {link for link, _ in met} == {robot.palm}:
                return (
                    f"the palm meets the object {height}; the object is too tall, grasp it higher"
                )
            return (
                f"the open fingers meet the object {height}; the object is wider there than the "
                f"stroke of {STROKE_MM:g} mm"
            )
    return ""

"""The way to the grasp: above the object, turned, down, adjusted in the plane, fingers near.

Nothing touches the object on a free path, so the gripper is put at points along it and each is
checked for collisions; no time is simulated.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from tacgen.core.records import GraspConfig, GraspObject
from tacgen.core.units import M_PER_MM, MM_PER_M
from tacgen.physics.engine import PALM, Engine, GripperTarget, Robot
from tacgen.physics.gripper import GripperSpec
from tacgen.physics.settings import PhysicsSettings

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
            found = world.distances(gripper.stroke_mm * M_PER_MM)
            near_m = min((distance for _, distance in found), default=0.0)
            robot.fingers.place(max(0.0, near_m - settings.clearance_mm * M_PER_MM))
            return ""
        reasons.append(reason)
    return reasons[-1]


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

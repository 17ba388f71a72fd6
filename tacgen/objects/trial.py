"""Suggested grasps tried in the simulation before they are written."""

import itertools

from tacgen.core.errors import PhysicsError
from tacgen.core.records import GraspConfig, GraspObject
from tacgen.objects.grasp_ranges import largest_grid
from tacgen.physics import FrameRequest, GraspSimulator, PhysicsSettings, run_grasp

LIFT_MM = 20.0  # whether a grasp is executed is known before the lift


def executed_ranges(obj: GraspObject) -> tuple[dict[str, tuple[float, ...]], list[str]]:
    """The largest grid of the object's ranges in which each place is executed, and notes.

    All stay where nothing is executed. Each place is tried with the largest and the least force.
    """
    ranges = dict(obj.grasp_ranges)
    forces = ranges["force_n"]
    try:
        with GraspSimulator() as simulator:
            settings = PhysicsSettings(
                engine=simulator.engine, lift_mm=LIFT_MM, success_rise_mm=LIFT_MM / 2
            )

            def problem(y_mm: float, z_mm: float) -> str:
                """Why a grasp there is not executed; empty if it is."""
                for force_n in (max(forces), min(forces)):  # the largest squeezes wedges out
                    config = GraspConfig(0, obj.name, force_n, 0.0, y_mm, z_mm)
                    trace = run_grasp(simulator, obj, config, settings, frames=FrameRequest())
                    if trace.label < 0:
                        return trace.reason
                return ""

            places = itertools.product(ranges["y_mm"], ranges["z_mm"])
            found = {place: text for place in places if (text := problem(*place))}
    except PhysicsError as error:
        return ranges, [f"the suggested grasps were not tried: {error}"]
    kept = largest_grid(ranges, found)
    if kept is None:
        first = next(iter(found.values()))
        note = f"none of the suggested grasps can be executed ({first}); edit grasp_ranges"
        return ranges, [note]
    return kept, []

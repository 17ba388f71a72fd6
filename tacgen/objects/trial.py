"""Suggested grasps tried in the simulation before they are written."""

from tacgen.core.errors import PhysicsError
from tacgen.core.records import GraspConfig, GraspObject
from tacgen.physics import FrameRequest, GraspSimulator, PhysicsSettings, run_grasp

LIFT_MM = 20.0  # whether a grasp is executed is known before the lift


def executed_ranges(obj: GraspObject) -> tuple[dict[str, tuple[float, ...]], list[str]]:
    """The object's ranges without places at which no grasp is executed, and notes.

    A height stays if the middle of y does there; a y if all those heights do. Where nothing is
    executed all stay. The force is the middle one.
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
                config = GraspConfig(0, obj.name, forces[len(forces) // 2], 0.0, y_mm, z_mm)
                trace = run_grasp(simulator, obj, config, settings, frames=FrameRequest())
                return trace.reason if trace.label < 0 else ""

            middle = min(ranges["y_mm"], key=abs)
            found = {z: problem(middle, z) for z in ranges["z_mm"]}
            z_mm = tuple(z for z, text in found.items() if not text)
            y_mm = tuple(
                y for y in ranges["y_mm"] if y == middle or not any(problem(y, z) for z in z_mm)
            )
    except PhysicsError as error:
        return ranges, [f"the suggested grasps were not tried: {error}"]
    if not z_mm:
        first = next(iter(found.values()))
        return ranges, [
            f"none of the suggested grasps can be executed ({first}); edit grasp_ranges"
        ]
    return ranges | {"y_mm": y_mm, "z_mm": z_mm}, []

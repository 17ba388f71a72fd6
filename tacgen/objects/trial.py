"""Suggested grasps tried in the simulation before they are written."""

import itertools
from bisect import bisect_left
from collections.abc import Mapping
from functools import partial

import numpy as np

from tacgen.core.errors import PhysicsError
from tacgen.core.records import GraspConfig, GraspObject
from tacgen.core.types import FloatArray
from tacgen.objects.grasp_ranges import FORCES_N, largest_grid
from tacgen.objects.showing import is_shown_in, usual_patch
from tacgen.physics import FrameRequest, GelModel, GraspSimulator, PhysicsSettings, run_grasp

SUCCESSES = (0.4, 0.6)  # of the suggested grasps: a sensor of another gel moves some thresholds
VISIBLE_SHARE = 0.92  # of the suggested grasps; with this many, more places count
VISIBLE_WEIGHT = 2.0  # against mixed labels: a picture that shows nothing teaches nothing
WINDOWS = (5, 6, 7, 8)  # how many forces, a quarter apart: from just failing to firm

Ranges = dict[str, tuple[float, ...]]
Place = tuple[float, float]


def tried_ranges(obj: GraspObject) -> tuple[Ranges, list[str]]:
    """Of the object's ranges forces and places with both outcomes, and notes.

    At each place the least force that holds is searched for among ``FORCES_N``, and the least that
    shows the contact, of the object as it then lies between the pads. A grid is taken
    of which each place can be executed, and whose grasps show their contact, which counts most, are
    mixed and are many. All places stay where nothing is executed.
    """
    ranges, surface = dict(obj.grasp_ranges), obj.surface
    places = list(itertools.product(ranges["y_mm"], ranges["z_mm"]))
    holds, poses, reasons = dict[Place, int](), dict[Place, FloatArray](), list[str]()
    try:
        with GraspSimulator() as simulator:
            # Decides as the whole lift does, in half the time.
            settings = PhysicsSettings(engine=simulator.engine, lift_mm=40.0, success_rise_mm=30.0)
            gel = GelModel(partial(usual_patch, surface))

            def held(force_n: float, y_mm: float, z_mm: float) -> bool:
                config = GraspConfig(0, obj.name, force_n, 0.0, y_mm, z_mm)
                trace = run_grasp(simulator, obj, config, settings, frames=FrameRequest(), gel=gel)
                if trace.label < 0:
                    raise _NotExecuted(trace.reason)
                frames = trace.frames[settings.sensing_pads[0]]
                poses[y_mm, z_mm] = frames[trace.grasp_frame].pose_gel_object
                return trace.label == 1

            for place in places:
                try:
                    holds[place] = bisect_left(FORCES_N, True, key=lambda f: held(f, *place))
                except _NotExecuted as error:
                    reasons.append(str(error))
    except PhysicsError as error:
        return ranges, [f"the suggested grasps were not tried: {error}"]
    if not holds:
        note = f"none of the suggested grasps can be executed ({reasons[0]}); edit grasp_ranges"
        return ranges, [note]
    shown = {
        place: bisect_left(FORCES_N, True, key=partial(is_shown_in, surface, poses[place]))
        for place in holds
    }
    return _mixed(ranges, holds, shown)


class _NotExecuted(Exception):  # noqa: N818
    """A grasp cannot be executed, for the reason that it says."""


def _mixed(
    ranges: Ranges, holds: Mapping[Place, int], shown: Mapping[Place, int]
) -> tuple[Ranges, list[str]]:
    """The grid of ``tried_ranges``; both mappings give the first of ``FORCES_N`` at a place."""
    places = set(itertools.product(ranges["y_mm"], ranges["z_mm"]))
    found = list[tuple[tuple[float, int, float], Ranges, float]]()
    for count, first in itertools.product(WINDOWS, range(len(FORCES_N) - min(WINDOWS) + 1)):
        forces = np.arange(len(FORCES_N))[first : first + count]
        for level in set(shown.values()):
            grid = largest_grid(ranges, places - {p for p in holds if shown[p] <= level})
            if grid is None:
                continue
            taken = list(itertools.product(grid["y_mm"], grid["z_mm"]))
            successes = float(np.mean([forces >= holds[place] for place in taken]))
            visible = float(np.mean([forces >= shown[place] for place in taken]))
            off = abs(successes - float(np.clip(successes, *SUCCESSES)))
            short = VISIBLE_WEIGHT * max(VISIBLE_SHARE - visible, 0.0) + off
            score = -short, len(taken), -abs(successes - 0.5)
            chosen = {**grid, "force_n": FORCES_N[first : first + count]}
            found.append((score, chosen, successes))
    _, chosen, successes = max(found, key=lambda one: one[0])
    if SUCCESSES[0] <= successes <= SUCCESSES[1]:
        return chosen, []
    why = ": pictures of weaker ones would show little" if successes > SUCCESSES[1] else ""
    note = f"about {100 * successes:.0f} % of the suggested grasps hold{why}; edit grasp_ranges"
    return chosen, [note]

"""Where a press begins, when it is not known exactly: a free contact point for every trial.

The volume of a known ball grows as the square of its depth, so a depth that is counted from a few
hundredths of a millimetre too early or too late bends V against F. The depth's zero and the
gauge's zero are then quantities to estimate, trial by trial.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from tacgen.core.arrays import FloatArray
from tacgen.presses.geometry import ball_depth_mm, ball_volume_mm3
from tacgen.presses.press_log import PressLog

MIN_CONTACT_SAMPLES = 6  # fewer samples in contact do not carry a slope and a contact point
TAIL_SHARE = 0.02  # of the largest force: several times the noise; beyond it residuals are tails


@dataclass(frozen=True, slots=True)
class ContactPoint:
    """Shifts of one trial: depth = logged depth + ``depth_mm``, force = logged − ``force_n``."""

    trial: int
    depth_mm: float
    force_n: float


def free_contact_points(log: PressLog) -> tuple[PressLog, tuple[ContactPoint, ...]]:
    """The log with every trial's contact point found, and the shifts.

    Where the ball is known (``radius_mm``) its depth (``depth_mm``, or the volume's) is shifted
    and the volume recomputed; elsewhere only the force is.
    """
    volume, force = log["volume_mm3"].copy(), log["force_normal_n"].copy()
    points = []
    for trial in log.trials:
        rows = np.flatnonzero(log["trial"] == trial)
        radius = log["radius_mm"][rows] if "radius_mm" in log else np.array([np.nan])
        if np.isfinite(radius).all() and (radius > 0).all():
            depth = log["depth_mm"][rows] if "depth_mm" in log else None
            if depth is None or not np.isfinite(depth).all():
                depth = ball_depth_mm(volume[rows], radius)
            point, volume[rows] = _shift_depth(int(trial), depth, radius, force[rows])
        else:
            point = _shift_force(int(trial), volume[rows], force[rows])
        force[rows] -= point.force_n
        points.append(point)
    changed = {"volume_mm3": volume, "force_normal_n": force}
    for values in changed.values():
        values.setflags(write=False)
    return replace(log, columns={**log.columns, **changed}), tuple(points)


def _shift_depth(
    trial: int, depth_mm: FloatArray, radius_mm: FloatArray, force_n: FloatArray
) -> tuple[ContactPoint, FloatArray]:
    """Fit F = F₀ + V(d + d₀)/k: the depth comes from a stage and is exact, the force is not."""
    touching = depth_mm > 0
    before = np.flatnonzero(~touching)
    zero_n = float(np.median(force_n[before])) if len(before) else 0.0
    if touching.sum() < MIN_CONTACT_SAMPLES:
        return ContactPoint(trial, 0.0, zero_n), ball_volume_mm3(depth_mm, radius_mm)
    deepest = float(depth_mm.max())
    load = force_n - zero_n
    scale_n = float(load.max())

    def misfit(parameters: FloatArray) -> FloatArray:
        shift, compliance, zero = parameters
        volume = ball_volume_mm3(depth_mm + shift, radius_mm)
        return np.asarray((load / scale_n - zero - volume / np.exp(compliance) / scale_n)[touching])

    start = np.log(ball_volume_mm3(deepest, radius_mm[touching].mean()) / scale_n)
    # A force zero that was seen before the contact is known; else it is free too.
    zero_bound = 1e-9 if len(before) >= MIN_CONTACT_SAMPLES else 0.2
    found = least_squares(
        misfit,
        [0.0, start, 0.0],
        bounds=([-0.9 * deepest, -np.inf, -zero_bound], [2.0 * deepest, np.inf, zero_bound]),
        x_scale=[0.1 * deepest, 1.0, 0.1],
    )
    shift, zero_n = float(found.x[0]), zero_n + scale_n * float(found.x[2])
    volume = np.where(touching, ball_volume_mm3(depth_mm + shift, radius_mm), 0.0)
    return ContactPoint(trial, shift, zero_n), volume


def _shift_force(trial: int, volume_mm3: FloatArray, force_n: FloatArray) -> ContactPoint:
    """Fit F = F₀ + V/k, robust to tails: only the force's zero can move."""
    scale = np.abs(volume_mm3).max() or 1.0, np.abs(force_n).max() or 1.0
    volume, force = volume_mm3 / scale[0], force_n / scale[1]

    def misfit(parameters: FloatArray) -> FloatArray:
        return np.asarray(force - parameters[0] - parameters[1] * volume)

    zero, _ = least_squares(misfit, [0.0, 1.0], loss="soft_l1", f_scale=TAIL_SHARE).x
    return ContactPoint(trial, 0.0, float(zero * scale[1]))

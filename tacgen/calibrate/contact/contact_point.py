"""Where a press begins, when it is not known exactly: a free contact point for every trial.

The volume of a known ball grows as the square of its depth, so a depth that is counted from a few
hundredths of a millimetre too early or too late bends V against F. The depth's zero and the
gauge's zero are then quantities to estimate, trial by trial. That costs most of a compliance's
certainty, so it is done only where the presses show that they begin elsewhere than logged.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.special import fdtrc

from tacgen.core.arrays import FloatArray
from tacgen.presses.geometry import ball_depth_mm, ball_volume_mm3
from tacgen.presses.press_log import PressLog

MIN_CONTACT_SAMPLES = 6  # fewer samples in contact do not carry a slope and a contact point
MEDIAN_STDERR = 1.25  # of normal noise, in standard errors of the mean
BEGINS_ELSEWHERE_P = 0.1  # a shift that is fitted in vain costs certainty, one left out is an error
TAIL_SHARE = 0.02  # of the largest force: several times the noise; beyond it residuals are tails


@dataclass(frozen=True, slots=True)
class ContactPoint:
    """Shifts of one trial: depth = logged depth + ``depth_mm``, force = logged − ``force_n``.

    ``k_stderr_share`` is the relative standard error of a compliance fitted together with them.
    """

    trial: int
    depth_mm: float
    force_n: float
    k_stderr_share: float = 0.0


def begins_elsewhere(log: PressLog) -> bool:
    """Whether presses of known balls begin at another depth than logged: an F-test over all trials.

    ``log`` has ``depth_mm`` and ``radius_mm``; where they are not known throughout, True.
    """
    fixed, free, samples, shifts = 0.0, 0.0, 0, 0
    for trial in log.trials:
        rows = np.flatnonzero(log["trial"] == trial)
        radius, depth, force = (log[n][rows] for n in ("radius_mm", "depth_mm", "force_normal_n"))
        if not (np.isfinite(radius).all() and (radius > 0).all() and np.isfinite(depth).all()):
            return True
        if (depth > 0).sum() < MIN_CONTACT_SAMPLES:
            continue
        # From rows in contact alone, with the gauge's zero free: its error is no shift of depth.
        touching = depth > 0
        rows_of = depth[touching], radius[touching], force[touching]
        fits = [_fit_press(*rows_of, free=free_depth) for free_depth in (False, True)]
        left = [float((fit.residual_n**2).sum()) for fit in fits]
        fixed, free = fixed + left[0], free + left[1]
        samples, shifts = samples + len(fits[1].residual_n), shifts + 1
    dof = samples - 3 * shifts
    if shifts == 0 or dof < 1:
        return True
    if not free > 0:
        return fixed > 0
    return bool(fdtrc(shifts, dof, (fixed - free) / shifts / (free / dof)) < BEGINS_ELSEWHERE_P)


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


@dataclass(frozen=True, slots=True)
class _Press:
    """One press of a ball: the shift of its depth, its zero of force and what they leave."""

    shift_mm: float
    zero_n: float
    k_stderr_share: float
    residual_n: FloatArray


def _shift_depth(
    trial: int, depth_mm: FloatArray, radius_mm: FloatArray, force_n: FloatArray
) -> tuple[ContactPoint, FloatArray]:
    touching = depth_mm > 0
    if touching.sum() < MIN_CONTACT_SAMPLES:
        zero_n = float(np.median(force_n[~touching])) if (~touching).any() else 0.0
        return ContactPoint(trial, 0.0, zero_n), ball_volume_mm3(depth_mm, radius_mm)
    fit = _fit_press(depth_mm, radius_mm, force_n, free=True)
    volume = np.where(touching, ball_volume_mm3(depth_mm + fit.shift_mm, radius_mm), 0.0)
    return ContactPoint(trial, fit.shift_mm, fit.zero_n, fit.k_stderr_share), volume


def _fit_press(
    depth_mm: FloatArray, radius_mm: FloatArray, force_n: FloatArray, *, free: bool
) -> _Press:
    """Fit F = F₀ + V(d + d₀)/k: the depth comes from a stage and is exact, the force is not.

    Without ``free``, d₀ = 0.
    """
    touching = depth_mm > 0
    before = np.flatnonzero(~touching)
    zero_n = float(np.median(force_n[before])) if len(before) else 0.0
    deepest = float(depth_mm.max())
    load = force_n - zero_n
    scale_n = float(load.max())

    # The median of the rows before contact knows the zero as well as so many rows.
    known_rows = np.sqrt(len(before)) / MEDIAN_STDERR

    def misfit(parameters: FloatArray) -> FloatArray:
        shift, compliance, zero = parameters
        volume = ball_volume_mm3(depth_mm + shift, radius_mm)
        left = (load / scale_n - zero - volume / np.exp(compliance) / scale_n)[touching]
        return np.append(left, zero * known_rows)

    start = np.log(ball_volume_mm3(deepest, radius_mm[touching].mean()) / scale_n)
    least, most = (-0.9 * deepest, 2.0 * deepest) if free else (-1e-9, 1e-9)
    found = least_squares(
        misfit,
        [0.0, start, 0.0],
        bounds=([least, -np.inf, -0.2], [most, np.inf, 0.2]),
        x_scale=[0.1 * deepest, 1.0, 0.1],
    )
    jacobian = found.jac[:, (0 if free else 1) :]
    variance = 2.0 * found.cost / max(len(jacobian) - jacobian.shape[1], 1)
    spread = np.linalg.pinv(jacobian.T @ jacobian)[int(free), int(free)]
    return _Press(
        float(found.x[0]),
        zero_n + scale_n * float(found.x[2]),
        float(np.sqrt(variance * spread)),
        np.asarray(found.fun * scale_n),
    )


def _shift_force(trial: int, volume_mm3: FloatArray, force_n: FloatArray) -> ContactPoint:
    """Fit F = F₀ + V/k, robust to tails: only the force's zero can move."""
    scale = np.abs(volume_mm3).max() or 1.0, np.abs(force_n).max() or 1.0
    volume, force = volume_mm3 / scale[0], force_n / scale[1]

    def misfit(parameters: FloatArray) -> FloatArray:
        return np.asarray(force - parameters[0] - parameters[1] * volume)

    zero, _ = least_squares(misfit, [0.0, 1.0], loss="soft_l1", f_scale=TAIL_SHARE).x
    return ContactPoint(trial, 0.0, float(zero * scale[1]))
